"""A lost laser goes on by odometry where that is sound: poses of the scans that show nothing, with growing covariances.

They are not in the map, and stay untracked: the laser may be blocked, blank or blinded there.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.pose import Pose, Trajectory
from mavnav.scan import runs_of
from mavnav.slam.matching.motion_model import MOST_ERROR
from mavnav.slam.matching.odometry_fit import with_noise
from mavnav.slam.matching.steps import LOST_SCANS, Step, tracked_trajectory
from mavnav.slam.recovery.across_gap import reach_across
from mavnav.slam.recovery.part_by_odometry import size
from mavnav.slam.track import Track
from mavnav.units import NS


class Bridges(Struct, frozen=True):
    """Poses of lost scans by odometry (map_T_laser), the numbers of these scans, and the errors to be expected (n,), m.

    A radian counts as a meter.
    """

    trajectory: Trajectory = field(default_factory=lambda: Trajectory.of([], []))
    numbers: tuple[int, ...] = ()
    errors_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def warnings(self, first_ns: int) -> Iterator[str]:
        """Yield a warning that the path goes on by odometry, if it does."""
        if self.numbers:
            from_s = (self.trajectory.stamps_ns[0] - first_ns) * NS
            yield (
                f"{len(self.numbers)} scans match nowhere, the first after {from_s:.1f} s: their poses are by odometry "
                f"alone, expected to be off by about {self.errors_m.max():.2f} m farthest from a match, unless the "
                "laser was carried"
            )

    def grow(self, covariances: NDArray[np.float64]) -> None:
        """Set the covariances of the poses among those of all steps (n, 6), in the order of `covariances_of`.

        They grow from those of the tracked poses before them.
        """
        rows = np.array(self.numbers, np.intp)
        before = np.maximum.accumulate(np.where(np.diff(rows, prepend=-1) > 1, rows - 1, 0)) if len(rows) else rows
        in_all_directions = self.errors_m[:, None] ** 2 * np.isin(np.arange(6), (0, 2, 5))
        covariances[rows] = np.nan_to_num(covariances[before]) + in_all_directions


def bridge_by_odometry(track: Track) -> Bridges:
    """Return the poses of lost scans by odometry; none where that does not fit the track, and none in causal mode.

    Nor does it fit where it leads from the pose before to another one than that after. A log that ends so must end
    blind: scans that show walls, but match nowhere, tell of a laser that was carried.
    """
    steps, odometry = track.steps, track.motion.odometry
    if odometry is None or track.log_odometry is None or track.refiner is None:
        return Bridges()
    error = with_noise(track.log_odometry, tracked_trajectory(steps), track.findings.odometry).error
    elsewhere = {step.index for part in track.findings.parts for step in part}
    poses: dict[int, tuple[Pose, float]] = {}
    for run in runs_of(~steps.column("tracked"), LOST_SCANS):
        if run.start and error <= MOST_ERROR and elsewhere.isdisjoint(run):
            ways = _ways(steps[run.start - 1 : run.stop + 1], track)
            poses |= {k: (pose, error * way_m) for k, (pose, way_m) in zip(run, ways, strict=False)}
    stamps_ns, numbers = steps.column("stamp_ns"), [*poses]
    path = Trajectory.of(stamps_ns[numbers].tolist(), [pose for pose, _ in poses.values()])
    return Bridges(path, tuple(numbers), np.array([error_m for _, error_m in poses.values()]))


def _ways(steps: list[Step], track: Track) -> Iterator[tuple[Pose, float]]:
    """Yield the poses of lost scans by odometry, and their distance on the path from the nearest tracked pose, m.

    ``steps`` are these scans and the tracked ones beside them. What odometry is off at the last is shared out.
    """
    seen = [pose for step in steps if (pose := track.motion.odometry and track.motion.odometry(step.stamp_ns))]
    here, beyond = steps[0], steps[-1]
    blind = all(step.match.beams_used < track.config.robust.min_points for step in steps[1:])
    if len(seen) < len(steps) or not (beyond.tracked or blind):
        return
    poses = [here.match.map_T_laser @ seen[0].between(pose) for pose in seen]
    ways_m = np.cumsum([0.0, *(size(a.between(b)) for a, b in pairwise(seen))])
    off = Pose()
    if beyond.tracked:
        off = poses[-1].between(beyond.match.map_T_laser)
        if not reach_across(here, beyond, track, track.motion.fastest).includes(beyond.match.map_T_laser):
            return
    for pose, way_m in zip(poses[1 : len(steps) - beyond.tracked], ways_m[1:].tolist(), strict=False):
        share = way_m / max(ways_m[-1], 1e-9)
        left_m = ways_m[-1] - way_m if beyond.tracked else way_m
        yield pose @ Pose(share * off.x_m, share * off.y_m, share * off.yaw_rad), min(way_m, left_m)
