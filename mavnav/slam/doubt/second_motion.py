"""A second motion in the scans: a large object that moves along with the laser is easily taken for the walls.

Behind a cart or between the members of a convoy most points across the direction of travel are on the others, and the
track is relative to these. Every match is then good, and all tracks of the log agree. But each pair of scans fits two
relative poses, and the distance between these grows with time at the same velocity. Walls that repeat do not show that.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mavnav.kernels.scans.points import extent
from mavnav.pose import Trajectory
from mavnav.slam.matching.scan_matching import empty_line_map
from mavnav.slam.matching.steps import tracked_trajectory
from mavnav.slam.methods.registry import Refiner
from mavnav.slam.track import Track
from mavnav.units import NS

Floats = NDArray[np.float64]


EXAMINED, LEAST_EXAMINED = 24, 6
"""Number of scans that are compared with later ones, evenly over the track, and minimum number that means something."""

SPANS_S = (0.8, 1.2)
"""Times from a scan to those that it is compared with."""

WORTH_A_SEARCH, LEAST_CONFLICTS = 0.02, 0.05
"""Minimum share of scans with visibility conflicts, and the conflicts of such a scan: what moves shows in these."""

SPEEDS_M_S = np.linspace(-1.5, 1.5, 31)
"""Velocities along each axis that are tried, relative to the track."""

APART_M_S, SAME_M_S = 0.25, 0.25
"""Least speed of a second motion relative to the track, and the largest difference of two that are the same."""

MARGIN, BARRIER = 0.15, 0.02
"""Largest additional cost of a second motion, and least rise of the cost between both, as shares of the worst cost.

Without the rise the motion is not observable, which is another reason for doubt.
"""

LEAST_AGREEING = 0.15
"""Least share of the examined scans that fit the same second motion: people and other passers-by show for moments."""

AT_REST_M_S = 0.2
"""Speed below which a laser is at rest: at a second motion of no speed something moves with the laser, as its own body.

That is no reason to doubt a track that moves, unless it costs less than the track: a vehicle may pass a laser at rest.
"""

NEAREST_M = 0.5
"""Distance up to which points may be on the vehicle itself, and are left out."""

POINTS = 200
"""Number of points, a sample of the scan, that are compared with the earlier scan."""


def second_motion(track: Track, refiner: Refiner, conflicts: Floats) -> Floats:
    """Return the share of the examined scans that fit the same second motion, (n,); 0 where they do not.

    ``conflicts`` (n,) are the visibility conflicts of the tracked scans.
    """
    path, out = tracked_trajectory(track.steps), np.zeros(len(conflicts))
    mostly_by_wheels = track.motion.odometry_at(path.stamps_ns).mean() >= 0.5
    if mostly_by_wheels or np.mean(conflicts >= LEAST_CONFLICTS) < WORTH_A_SEARCH:
        return out
    wanted = examined_rows(path.stamps_ns, track.motion.period_s)
    points = points_of_rows(track, refiner, {row for some in wanted for row in some})
    rows = [some for some in wanted if points.keys() >= set(some)]  # a stopped run ends early
    if len(rows) < LEAST_EXAMINED:
        return out
    velocities = np.array([rival(some, path, points, track) or (np.nan, np.nan) for some in rows])
    if np.isnan(velocities).all():
        return out
    same = np.hypot(*(velocities - np.nanmedian(velocities, axis=0)).T) <= SAME_M_S
    share = float(np.mean(same))
    for agrees, some in zip(same, rows, strict=True):
        if agrees and share >= LEAST_AGREEING:
            out[some[0] : some[-1] + 1] = share
    return out


def examined_rows(stamps_ns: NDArray[np.int64], period_s: float) -> list[tuple[int, ...]]:
    """Return the rows of the examined scans, each with those of the later ones it is compared with."""
    stamps_s, rows = (stamps_ns - stamps_ns[0]) * NS, []
    for first in np.unique(np.linspace(0, len(stamps_s) - 1, EXAMINED + 1).astype(int))[:-1].tolist():
        later = [int(np.searchsorted(stamps_s, stamps_s[first] + span_s - 0.5 * period_s)) for span_s in SPANS_S]
        some = (first, *later)
        late_s = stamps_s[later] - stamps_s[first] - SPANS_S if later[-1] < len(stamps_s) else np.inf
        if np.max(late_s) <= 2.0 * period_s and all(a < b for a, b in pairwise(some)):
            rows.append(some)
    return rows


def points_of_rows(track: Track, refiner: Refiner, rows: set[int]) -> dict[int, Floats]:
    """Return the match points (n, 2) of the tracked scans in some rows of the trajectory, de-skewed; m, laser frame.

    Without those within ``NEAREST_M``.
    """
    placed = ((row, scan, motion) for row, (_, scan, motion) in enumerate(track.placed_scans()) if row in rows)
    matched = ((row, refiner.match_points(scan, motion)) for row, scan, motion in placed)
    return {row: points[np.hypot(*points.T) > NEAREST_M] for row, points in matched}


def rival(
    rows: tuple[int, ...], path: Trajectory, points: dict[int, Floats], track: Track
) -> tuple[float, float] | None:
    """Return the velocity of a second motion that fits as well as the track, frame of the first scan; None if none."""
    robust, (first, *later) = track.config.robust, rows
    truncate_m, least = robust.expert.truncate_m, robust.min_points
    if min(len(points[row]) for row in rows) < least:
        return None
    lines = empty_line_map(track.config)
    lines.insert(points[first], extent(points[first]))
    n = len(SPEEDS_M_S)
    tried = np.column_stack([axis.ravel() for axis in np.meshgrid(SPEEDS_M_S, SPEEDS_M_S, indexing="ij")])
    shares = np.zeros(n * n)
    for row in later:
        moved, elapsed_s = path[first].between(path[row]), float(path.stamps_ns[row] - path.stamps_ns[first]) * NS
        xy_m, yaw_rad = moved.as_array()[:2] + elapsed_s * tried, np.array([moved.yaw_rad])
        costs = lines.costs(points[row][:POINTS], xy_m, yaw_rad, truncate_m)
        shares += costs[0] / (truncate_m**2 * len(later))
    own_m_s = moved.as_array()[:2] / elapsed_s
    minimum = second_minimum(shares.reshape(n, n))
    if minimum is None:
        return None
    x_m_s, y_m_s, more = minimum
    rests = np.hypot(*own_m_s) >= APART_M_S and np.hypot(own_m_s[0] + x_m_s, own_m_s[1] + y_m_s) < AT_REST_M_S
    return None if rests and more >= 0.0 else (x_m_s, y_m_s)


def second_minimum(shares: Floats) -> tuple[float, float, float] | None:
    """Return the velocity of the lowest minimum of the cost (n, n) apart from the track's, and its additional cost.

    The track's is at velocity 0. None if it costs over ``MARGIN`` more, or if the cost does not rise between both.
    """
    n, middle = len(SPEEDS_M_S), len(SPEEDS_M_S) // 2
    own = float(shares[middle - 1 : middle + 2, middle - 1 : middle + 2].min())
    inner = shares[1:-1, 1:-1]
    around = [shares[1 + i : n - 1 + i, 1 + j : n - 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    lowest = np.logical_and.reduce([inner <= other for other in around]) & (inner <= own + MARGIN)
    minima = [(float(shares[i, j]), int(i), int(j)) for i, j in np.argwhere(lowest) + 1]
    for cost, i, j in sorted(minima):
        if np.hypot(SPEEDS_M_S[i], SPEEDS_M_S[j]) < APART_M_S:
            continue
        on_the_way = np.rint(middle + np.outer(np.linspace(0.0, 1.0, n), (i - middle, j - middle))).astype(int)
        if shares[tuple(on_the_way.T)].max() >= max(cost, own) + BARRIER:
            return float(SPEEDS_M_S[i]), float(SPEEDS_M_S[j]), cost - own
    return None
