"""Whether the odometry of a log fits its scans, and the track without it where it does not."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mavnav.slam.steps import tracked_trajectory

if TYPE_CHECKING:
    from mavnav.pose import Pose, Trajectory
    from mavnav.slam.motion_model import Odometry
    from mavnav.slam.track import Track

LEAST_STEPS, MISLEADING = 20, 0.3
"""Steps that judge odometry; the share of the motion by which it may be wrong."""

WARNING = "odometry contradicts the scans and is not used; check its scale, axes and clock"


def without_misleading_odometry(track: Track) -> Track:
    """Track again without odometry where it contradicts the scans."""
    odometry = track.motion.odometry
    if odometry is None or not misleads(odometry, tracked_trajectory(track.steps)):
        return track
    alone = track.again(replace(track, motion=track.motion._replace(odometry=None)))
    return alone.with_warning(WARNING) if alone else track


def misleads(odometry: Odometry, map_T_laser: Trajectory) -> bool:
    """Tell whether odometry predicts the tracked poses worse than constant velocity, and badly.

    Errors are root mean squares over steps, in m; a radian counts as a metre.
    """
    errors = []
    stamps = map_T_laser.stamps_ns.tolist()
    for k in range(2, len(stamps)):
        then, now = odometry(stamps[k - 1]), odometry(stamps[k])
        if then and now:
            went, moved = map_T_laser[k - 2].between(map_T_laser[k - 1]), map_T_laser[k - 1].between(map_T_laser[k])
            errors.append([_size(p) for p in (then.between(now).between(moved), went.between(moved), moved)])
    if len(errors) < LEAST_STEPS:
        return False
    by_odometry, by_velocity, motion = np.sqrt(np.square(errors).mean(axis=0))
    return bool(by_odometry > max(by_velocity, MISLEADING * motion))


def _size(motion: Pose) -> float:
    return float(np.hypot(motion.distance_m, motion.yaw_rad))
