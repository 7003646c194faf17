"""The pipeline of ``mavnav replay``: log -> slam -> metrics -> outputs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any

from mavnav.logs import open_log
from mavnav.outputs import Run, Timing, check_directory, write_run

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavnav.config import Config
    from mavnav.logs import Log
    from mavnav.metrics.wall_thickness import WallThickness
    from mavnav.pose import Pose
    from mavnav.slam import Slam

    # (what is being done, how much of it is done, how much there is or None)
    Progress = Callable[[str, int, int | None], None]

THRESHOLDS = (1, 2, 5)
"""Wall thickness is reported for cells of at least so many hits (findings: the threshold decides the answer)."""


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked for: the log, which part of it, how, and where to.

    ``start_s`` and ``end_s`` count from the first usable scan; ``extrinsic`` is the laser's pose on its base.
    """

    log: Path
    directory: Path
    config: Config
    topic: str | None = None
    start_s: float | None = None
    end_s: float | None = None
    extrinsic: Pose | None = None
    force: bool = False


def default_directory(log: Path, config: Config) -> Path:
    """Return ``runs/<log>-<method>-<grid>``."""
    name = log.resolve()
    stem = name.name if name.is_dir() else name.name.removesuffix(".zst").removesuffix(".zstd")
    for suffix in (".mcap", ".bag.active", ".bag", ".db3"):
        stem = stem.removesuffix(suffix) or stem
    return Path("runs") / f"{stem}-{config.method}-{config.grid}"


def replay(request: Request, progress: Progress) -> tuple[Run, dict[str, Any]]:
    """Run the whole job and return the run with its document (run.json).

    What can be refused is refused before the long work. Raises what the rooms raise: TopicError, NoScansError,
    UsageError, OutputError.
    """
    check_directory(request.directory, force=request.force)
    wall_s, cpu_s = perf_counter(), process_time()
    log = _open(request, progress)
    compile_s, compile_cpu_s = _load_kernels(progress)
    outcome = _track(log, request.config, progress)
    thickness = _thickness(outcome)
    timing = Timing(
        wall_s=perf_counter() - wall_s - compile_s,
        cpu_s=process_time() - cpu_s - compile_cpu_s,
        compile_s=compile_s,
    )
    run = Run(log=log, config=request.config, slam=outcome, thickness=thickness, timing=timing)
    progress("writing", 0, None)
    return run, write_run(run, request.directory, force=request.force)


def _load_kernels(progress: Progress) -> tuple[float, float]:
    """Import the rooms whose kernels compile on import; return what it took by the clock and of the processor."""
    progress("compiling kernels, once after installation", 0, None)
    wall_s, cpu_s = perf_counter(), process_time()
    import mavnav.metrics.wall_thickness
    import mavnav.slam  # noqa: F401

    return perf_counter() - wall_s, process_time() - cpu_s


def _open(request: Request, progress: Progress) -> Log:
    """Survey the log; the paper's method never looks at odometry."""
    return open_log(
        request.log,
        topic=request.topic,
        odom="off" if request.config.method == "paper" else request.config.odom,
        start_s=request.start_s,
        end_s=request.end_s,
        extrinsic=request.extrinsic,
        progress=lambda done, total: progress("reading", done, total),
    )


def _track(log: Log, config: Config, progress: Progress) -> Slam:
    from mavnav import slam

    total = log.counts.usable
    return slam.replay(
        log.scans,
        config,
        log.period_s,
        log.odometry.odom_T_laser if log.odometry else None,
        on_step=lambda phase, done: progress(phase, done, total),
    )


def _thickness(outcome: Slam) -> dict[int, WallThickness]:
    from mavnav.metrics.wall_thickness import wall_thickness

    return {k: wall_thickness(outcome.grid.hits, outcome.grid.cell_m, k) for k in THRESHOLDS}
