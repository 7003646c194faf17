"""The pose of a part of a log by odometry alone, where its scans show nothing of the map.

A laser that crosses a hall wider than its range, or whose scans pause while it moves on, sees nothing that it has seen
before. How far the odometry of the log can be relied on is measured where the laser was tracked.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.slam.loop_closure.key_frames import drift_bound
from mavnav.slam.matching.motion_model import Odometry
from mavnav.slam.matching.odometry_fit import with_noise
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Step, Steps, tracked_trajectory
from mavnav.slam.track import Track
from mavnav.units import NS, pluralize

SAMPLE_S = 0.25
"""Time between the poses of odometry whose distances are the path across a gap."""

MOST_CONFLICTS = 0.1
"""Largest median of the visibility conflicts of the scans of a part: a laser that was carried sees other walls."""


def pose_by_odometry(
    part: Sequence[Step], scans: Iterable[tuple[Step, Scan]], steps: Steps, track: Track
) -> tuple[Pose, float] | None:
    """Return the pose of a part's map in the map of a track by odometry from the nearest pose in time.

    Also returns the error to be expected, m. None if odometry does not cover the time between, if the error is larger
    than the drift for which loop closure allows after such a path, or if the ``scans`` of the part, with their steps,
    conflict with the map.
    """
    odometry, beside = track.motion.odometry, list(neighbours(part, steps))
    if odometry is None or track.log_odometry is None or not beside:
        return None
    here, there = min(beside, key=lambda pair: abs(pair[1].stamp_ns - pair[0].stamp_ns))
    across = odometry_path(odometry, there.stamp_ns, here.stamp_ns)
    if across is None:
        return None
    path_m = sum(size(a.between(b)) for a, b in pairwise(across))
    used = with_noise(track.log_odometry, tracked_trajectory(steps), track.findings.odometry)
    error_m = used.error * path_m
    if error_m > drift_bound(path_m)[0]:
        return None
    pose = there.match.map_T_laser @ across[0].between(across[-1])
    map_T_part = pose @ here.match.map_T_laser.inverse()
    return (map_T_part, error_m) if median_conflicts(map_T_part, scans, track) <= MOST_CONFLICTS else None


def neighbours(part: Sequence[Step], steps: Steps) -> Iterator[tuple[Step, Step]]:
    """Yield the first and the last step of a part, each with the next tracked step beyond it, if there is one."""
    for end, beyond in ((part[0], range(part[0].index - 1, -1, -1)), (part[-1], range(part[-1].index + 1, len(steps)))):
        other = next((steps[k] for k in beyond if steps[k].tracked), None)
        if other is not None:
            yield end, other


def odometry_path(odometry: Odometry, start_ns: int, end_ns: int) -> list[Pose] | None:
    """Return poses of odometry from one stamp to another, ``SAMPLE_S`` apart; None where it covers not both ends."""
    count = int(np.ceil(abs(end_ns - start_ns) * NS / SAMPLE_S)) + 1
    poses = [odometry(start_ns + (end_ns - start_ns) * k // max(count - 1, 1)) for k in range(count)]
    covered = poses[0] is not None and poses[-1] is not None
    return [pose for pose in poses if pose is not None] if covered else None


def size(moved: Pose) -> float:
    """Return the size of a motion, m; a radian counts as a metre."""
    return float(np.hypot(moved.distance_m, moved.yaw_rad))


def median_conflicts(map_T_part: Pose, scans: Iterable[tuple[Step, Scan]], track: Track) -> float:
    """Return the median of the visibility conflicts with the map of a track of scans of a part at their poses."""
    refiner = track.refiner
    if refiner is None:
        return np.inf
    placed = ((no_match(map_T_part @ step.match.map_T_laser), scan) for step, scan in scans)
    conflicts = [refiner.conflicts(refiner.match_points(scan), match) for match, scan in placed]
    return float(np.median(conflicts)) if conflicts else np.nan


def placed_warning(part: Sequence[Step], first_ns: int, error_m: float) -> str:
    """Return the warning of a part that was placed by odometry."""
    from_s, to_s = ((step.stamp_ns - first_ns) * NS for step in (part[0], part[-1]))
    return (
        f"{pluralize(len(part), 'scan')} from {from_s:.1f} to {to_s:.1f} s do not match the map of the others and are "
        f"placed by odometry alone, to about {max(error_m, 0.1):.1f} m; check the map there"
    )
