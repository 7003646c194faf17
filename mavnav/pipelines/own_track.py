"""What mavnav's own track of a log says of given poses; the track is made once for all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from mavnav.outputs.documents.sections import PoseJump
from mavnav.slam.matching.differences import differences
from mavnav.slam.pipeline import run_slam
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from mavnav.config.models import Config
    from mavnav.logs import Log
    from mavnav.pose import Trajectory
    from mavnav.profiling import Progress


def own_path(log: Log, config: Config, progress: Progress, *, whole: bool) -> Trajectory | None:
    """Return mavnav's own poses of the scans as recorded, or of the laser at mid-sweep; None if they are doubtful."""
    config = replace(config, method="robust", final_pass=whole)
    own = run_slam(
        log.scans, config, log.period_s, on_step=lambda phase, done: progress(phase, done, log.counts.usable), last=()
    )
    return own.trajectory if own.doubt and not own.doubt.high and not own.lost_for_good else None


def difference_section(path: Trajectory, own: Trajectory | None, log: Log) -> dict[str, Any]:
    """Return how given poses differ from mavnav's own, as `External` has it; nothing without those."""
    if own is None:
        return {}
    late_s, scale, jumps = differences(path, own)
    seen = [PoseJump((jump.stamp_ns - log.first_ns) * NS, jump.moved_m, jump.turned_rad / DEG) for jump in jumps]
    return {"late_s": late_s, "distance_scale": scale, "jumps": seen}
