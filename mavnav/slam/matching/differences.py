"""How given poses differ from mavnav's own track of the same scans: late, of another scale, with jumps.

The track takes the part of the path, the poses that of odometry.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavnav.pose import MAX_GAP_NS, Trajectory, between, correct_path
from mavnav.slam.matching.motion_model import MOST_ERROR
from mavnav.slam.matching.odometry_fit import GOOD_ODOMETRY, WINDOW_S, LogOdometry, fit_odometry
from mavnav.units import DEG, NS

LEAST_LATE_S, LEAST_SCALE = 0.05, 0.015
"""Offset and difference of a scale from 1 that are reported; seven systems stayed below 0.025 s and 0.0144."""

LEAST_JUMP: Final = np.array((0.06, 1.5 * DEG))
"""Jump, m and rad, that is reported: the truth of five missions was within 0.06 m and 1.2 deg of the track."""

UNUSUAL: Final = 2.0
"""Ratio of a jump to the 0.9 quantile of the differences elsewhere in the log."""

FEWEST_SCANS, FEWEST_WINDOWS = 8, 5
"""Scans in a window, which is longer than `WINDOW_S` where they are rare, and windows across an instant."""

MOST_JUMPS: Final = 5


class Jump(NamedTuple):
    """An instant at which given poses move by more than the scans do."""

    stamp_ns: int
    moved_m: float
    turned_rad: float


class Differences(NamedTuple):
    """What makes given poses differ from a track: how late they are, and how many times as long distances are."""

    late_s: float = 0.0
    distance_scale: float = 1.0
    jumps: tuple[Jump, ...] = ()


def differences(given: Trajectory, tracked: Trajectory) -> Differences:
    """Return how poses differ from a track of the same scans; nothing where too little moves, or is covered."""
    fit = fit_odometry(LogOdometry(given), tracked, GOOD_ODOMETRY) if len(given) and len(tracked) else None
    if fit is None or fit.error > MOST_ERROR:
        return Differences()
    fitted = correct_path(given, round(fit.offset_s / NS), fit.distance_scale, fit.turn_scale)
    late_s = -fit.offset_s if abs(fit.offset_s) >= LEAST_LATE_S else 0.0
    scale = 1.0 / fit.distance_scale
    return Differences(late_s, scale if abs(scale - 1.0) >= LEAST_SCALE else 1.0, jumps(fitted, tracked))


def jumps(given: Trajectory, tracked: Trajectory) -> tuple[Jump, ...]:
    """Return the instants at which given poses move as they do nowhere else beside a track, in order of time."""
    stamps_s = (tracked.stamps_ns - tracked.stamps_ns[0]) * NS
    added, window_s = _added(given.poses_at(tracked.stamps_ns, MAX_GAP_NS), tracked.xyyaw, stamps_s)
    left, out = added / LEAST_JUMP, list[Jump]()
    while np.isfinite(left).any() and np.nanmax(left) >= 1.0 and len(out) < MOST_JUMPS:
        row, column = np.unravel_index(np.nanargmax(left), left.shape)
        here = np.abs(stamps_s - stamps_s[row]) <= window_s
        left[here], elsewhere, peak = np.nan, added[~here, column], added[row]
        if np.isfinite(elsewhere).any() and peak[column] >= UNUSUAL * np.nanquantile(elsewhere, 0.9):
            at = np.flatnonzero(here & (added[:, column] > 0.5 * peak[column]))
            out.append(Jump(int(tracked.stamps_ns[at].mean()), *peak.tolist()))
    return tuple(sorted(out))


def _added(
    given: NDArray[np.float64], tracked: NDArray[np.float64], stamps_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Return by how far and how much (n, 2), m and rad, given poses (n, 3) move more than tracked ones at each of them.

    It is the median over the windows across that instant: an outlier is in few of them, a step in all. Returns their
    length, too.
    """
    period_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 0.0
    window_s = max(WINDOW_S, FEWEST_SCANS * period_s)
    end = np.searchsorted(stamps_s, stamps_s + window_s - 0.5 * period_s)
    start = np.flatnonzero(end < len(stamps_s))
    start = start[stamps_s[end[start]] - stamps_s[start] < 1.5 * window_s]
    end = end[start]
    off = between(given[start], given[end]) - between(tracked[start], tracked[end])
    off[:, 2] = (off[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    added = np.full((len(stamps_s), 2), np.nan)
    for k in range(len(stamps_s)):
        across = off[np.searchsorted(end, k) : np.searchsorted(start, k)]
        if len(across) >= FEWEST_WINDOWS:
            x_m, y_m, yaw_rad = np.median(across, axis=0)
            added[k] = np.hypot(x_m, y_m), abs(yaw_rad)
    return added, window_s
