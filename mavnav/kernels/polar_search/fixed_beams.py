"""Fixed beams, which meet the same segment everywhere on a small grid, and the others, summed for each candidate."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, I64_1D, helper, int64, uint64
from mavnav.kernels.polar_search.cost import Beams, Work

FIXED_SHARE = 1.0 / 16.0
"""Largest change by motion within a small grid, as a share of a point's range and of a segment's width."""
HIDDEN_M = 0.05
"""Least depth behind another surface at which a surface stays hidden on a small grid.

It is also the largest change of the range of a fixed beam.
"""
CLOSE = 1e-8
"""Distance to the end of a segment, in beams, or to a threshold, in m, within which rounding may decide."""


class HalfWindow(NamedTuple):
    """Half-window in m and rad, one of them 0, and the centre of rotation (m)."""

    half_m: float
    half_rad: float
    pivot_x_m: float
    pivot_y_m: float


class BeamReach(NamedTuple):
    """Largest motion of each point (n,) on the grid: in m, in beams, and in beams relative to the point before."""

    by_m: F64_1D
    by_beams: F64_1D
    apart_beams: F64_1D


class Sight(NamedTuple):
    """Range of each beam (beams,) in the middle of the grid, and its least and greatest range on the grid, m."""

    seen: F64_1D
    least: F64_1D
    most: F64_1D


@helper
def reach_of(scan: Beams, motion: F64_1D, window: HalfWindow, r: F64_1D, reach: BeamReach) -> tuple[float, float]:
    """Write the largest motion of each point on the grid: in m, in beams, and in beams relative to the point before.

    Returns the mean in beams, and the largest one as a share of a point's range.
    """
    points, (c, s, x, y, _), (shift, turn, pivot_x, pivot_y) = scan.points, motion, window
    per_step, shear = 1.0 / abs(scan.limits.step_rad), shift + turn * np.hypot(pivot_x, pivot_y)
    n, beams, largest = points.shape[1], 0.0, 0.0
    for k in range(n):
        qx, qy = c * points[0, k] - s * points[1, k] + x, s * points[0, k] + c * points[1, k] + y
        reach.by_m[k] = shift + turn * np.sqrt((qx - pivot_x) * (qx - pivot_x) + (qy - pivot_y) * (qy - pivot_y))
        share, before = reach.by_m[k] / r[k], max(k - 1, 0)
        reach.by_beams[k] = share * per_step * (1.0 + share) + CLOSE
        dx, dy = points[0, k] - points[0, before], points[1, k] - points[1, before]
        reach.apart_beams[k] = 1.2 * shear * np.sqrt(dx * dx + dy * dy) * per_step / (r[k] * r[before])
    for k in range(n):
        beams, largest = beams + reach.by_beams[k], max(largest, reach.by_m[k] / r[k])
    return beams / n, largest


@helper
def sweep(scan: Beams, beam: F64_1D, by_beams: F64_1D, swept: F64_2D) -> None:
    """Write the first and last beam that each segment may meet somewhere on the grid.

    The range is empty if it meets none, and extends below 0 or above a whole turn if it may cross the seam.
    """
    joined, turn = scan.points[5], 2.0 * np.pi / abs(scan.limits.step_rad)
    for k in range(1, len(joined)):
        start, ahead, less, more = beam[k - 1], beam[k] - beam[k - 1], by_beams[k - 1], by_beams[k]
        ahead = ahead + turn if ahead < -0.5 * turn else ahead
        none = (joined[k] == 0.0) | (ahead < -more - less) | (ahead > 0.25 * turn + more + less)
        swept[0, k] = 1.0 if none else start - less
        swept[1, k] = 0.0 if none else start + ahead + more


@helper
def find_fixed(scan: Beams, work: Work, reach: BeamReach, swept: F64_2D, sight: Sight, fixed: I64_1D) -> None:
    """Write the range of each beam, and its segment everywhere on the grid: 0 for none, -1 if that may change."""
    r, beam, value, slope, first, more = work.r, work.beam, work.value, work.slope, work.first, work.more
    (seen, least, most), by_m, by_beams = sight, reach.by_m, reach.by_beams
    last, turn = len(fixed) - 1, 2.0 * np.pi / abs(scan.limits.step_rad)
    seen[:], least[:], most[:], fixed[:] = np.inf, np.inf, 0.0, 0
    for k in range(1, scan.points.shape[1]):
        if value[k] == np.inf or beam[k] < beam[k - 1]:
            continue  # across the seam: never fixed
        for i in range(more[k] + 1):
            j, at = uint64(first[k] + i), value[k] + i * slope[k]
            if at < seen[j]:
                seen[j], fixed[j] = at, k
    for k in range(1, scan.points.shape[1]):
        low, high = swept[0, k], swept[1, k]
        if low > high:
            continue
        near, far = min(r[k - 1] - by_m[k - 1], r[k] - by_m[k]), max(r[k - 1] + by_m[k - 1], r[k] + by_m[k])
        from_beam, to_beam, seam = beam[k - 1] + by_beams[k - 1], beam[k] - by_beams[k], low < 0.0 or high >= turn
        for around in range(-1 if seam else 0, 2 if seam else 1):
            by = around * turn
            for i in range(max(int64(np.ceil(low + by)), 0), min(int64(np.floor(high + by)), last) + 1):
                j = uint64(i)
                mine, sure = fixed[j] == k, from_beam <= i <= to_beam and not seam
                least[j], most[j] = min(least[j], near), max(most[j], far)
                if not (mine and sure) and (mine or near <= seen[j] + HIDDEN_M):
                    fixed[j] = -1


@helper
def classify(scan: Beams, work: Work, reach: BeamReach, sight: Sight, fixed: I64_1D, small: bool) -> None:
    """Set ``fixed`` to 0 for beams that contribute nowhere on the grid, and to -1 for those that may contribute.

    On a grid that is not small, no other beam stays fixed.
    """
    virtual, near, far, occlusion = scan.virtual, scan.limits.near_m, scan.limits.far_m, scan.limits.occlusion_m
    r, beam, by_m, by_beams, apart_beams = work.r, work.beam, reach.by_m, reach.by_beams, reach.apart_beams
    for j in range(len(virtual)):
        k, at, least, most = fixed[j], sight.seen[j], sight.least[j], sight.most[j]
        if k > 0 and not small:
            fixed[j] = -1
        elif k > 0:
            wide = beam[k] - beam[k - 1]
            share = (by_beams[k - 1] + apart_beams[k]) / max(wide - apart_beams[k], 1e-9)
            change = max(by_m[k - 1], by_m[k]) + share * abs(r[k] - r[k - 1]) + CLOSE
            least, most = max(least, at - change), min(most, at + change)
            stays = near < least and most < far and abs(at - virtual[j]) + change < occlusion
            if not stays or change > HIDDEN_M or apart_beams[k] > FIXED_SHARE * wide:
                fixed[j] = -1
        apart = max(least - virtual[j], virtual[j] - most) > occlusion + CLOSE or most < near or least > far
        if apart or not near < virtual[j] < far:
            fixed[j] = 0


@helper
def rest_of(scan: Beams, swept: F64_2D, fixed: I64_1D) -> F64_2D:
    """Return the points (6, m) of the segments that beams with -1 may meet."""
    points, last, turn, count = scan.points, len(fixed) - 1, 2.0 * np.pi / abs(scan.limits.step_rad), 0
    n, loose = points.shape[1], np.zeros(len(fixed) + 1, np.int64)
    needed, kept = np.zeros(n + 1, np.bool_), np.empty(n, np.int64)
    for j in range(len(fixed)):
        loose[j + 1] = loose[j] + (fixed[j] < 0)
    for k in range(1, n):
        low, high = swept[0, k], swept[1, k]
        first, end = max(int64(np.ceil(low)), 0), min(int64(np.floor(high)), last) + 1
        needed[k] = low < 0.0 or high >= turn or (first < end and loose[end] > loose[first])
    for k in range(n):
        kept[count] = k
        count += needed[k] | needed[k + 1]
    out = np.empty((6, count))
    for row in range(6):
        for i in range(count):
            out[row, i] = points[row, uint64(kept[i])]
    for i in range(count):
        out[5, i] *= i > 0 and kept[i] == kept[i - 1] + 1
    return out
