"""Find the time offset at which the odometry of a log fits its scans over a second.

Stamps that jitter, or an offset between two clocks, make the steps of odometry wrong, but not its long motions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavnav.units import NS

if TYPE_CHECKING:
    from mavnav.pose import Pose, Trajectory
    from mavnav.slam.matching.motion_model import Odometry

COARSE_S, FINE_S = 0.1 * np.arange(-10, 11), 0.02 * np.arange(-4, 5)
"""Offsets that are tried, s, and those tried around the best of them."""

WINDOW_S = 1.0
"""Time over which motions are compared, s."""

MOST_WINDOWS, LEAST_WINDOWS = 100, 20
"""Number of windows that are compared, those with most motion, and the fewest that are enough."""

LARGEST_SHARE = 0.2
"""Largest RMS error of odometry that fits, as a share of the motion."""


class MotionWindow(NamedTuple):
    """A motion between two stamps: of the laser, in its frame at the first."""

    start_ns: int
    end_ns: int
    moved: Pose


def fitting_offset_s(odometry: Odometry, map_T_laser: Trajectory) -> float | None:
    """Return the time to add to the stamps of the odometry so that it fits the tracked poses, s; None if none does.

    The best offset within 1 s counts if the RMS error is at most ``LARGEST_SHARE`` of the motion. Errors and motions
    are in m; a radian counts as a metre.
    """
    windows = most_moving(map_T_laser)
    if len(windows) < LEAST_WINDOWS:
        return None
    coarse_s = min(COARSE_S.tolist(), key=lambda offset_s: rms_error(odometry, windows, offset_s))
    best_s = min((coarse_s + FINE_S).tolist(), key=lambda offset_s: rms_error(odometry, windows, offset_s))
    motion = np.sqrt(np.mean([size(window.moved) ** 2 for window in windows]))
    return round(best_s, 2) if rms_error(odometry, windows, best_s) <= LARGEST_SHARE * motion else None


def most_moving(map_T_laser: Trajectory) -> list[MotionWindow]:
    """Return the windows of a path with most motion, in the order of their times."""
    stamps_ns = map_T_laser.stamps_ns
    ends = np.searchsorted(stamps_ns, stamps_ns + round(WINDOW_S / NS))
    pairs = ((k, int(end)) for k, end in enumerate(ends) if end < len(stamps_ns))
    close = (pair for pair in pairs if (stamps_ns[pair[1]] - stamps_ns[pair[0]]) * NS < 2 * WINDOW_S)
    stamps = stamps_ns.tolist()
    windows = [MotionWindow(stamps[a], stamps[b], map_T_laser[a].between(map_T_laser[b])) for a, b in close]
    return sorted(sorted(windows, key=lambda window: -size(window.moved))[:MOST_WINDOWS])


def rms_error(odometry: Odometry, windows: list[MotionWindow], offset_s: float) -> float:
    """Return the error of odometry with an offset; infinite if it covers few of the windows."""
    errors = errors_m(at_offset(odometry, offset_s), windows)
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else np.inf


def errors_m(odometry: Odometry, windows: list[MotionWindow]) -> list[float]:
    """Return the errors of odometry in the windows that it covers; none if these are few."""
    errors = []
    for start_ns, end_ns, moved in windows:
        then, now = odometry(start_ns), odometry(end_ns)
        if then is not None and now is not None:
            errors.append(size(then.between(now).between(moved)))
    return errors if len(errors) >= LEAST_WINDOWS else []


def size(moved: Pose) -> float:
    """Return the size of a motion, m; a radian counts as a metre."""
    return float(np.hypot(np.hypot(moved.x_m, moved.y_m), moved.yaw_rad))


def at_offset(odometry: Odometry, offset_s: float) -> Odometry:
    """Return odometry with a time added to its stamps."""
    offset_ns = round(offset_s / NS)
    return lambda stamp_ns: odometry(stamp_ns - offset_ns)
