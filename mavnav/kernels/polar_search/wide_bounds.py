"""Lower bounds of the cost on wide grids, in single precision, from points relative to the grid's middle.

Beams that may be off by more than `RANGE_M`, or may not contribute, are counted but not summed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavnav.kernels.machine.jit import F32_1D, F32_2D, F64_1D, F64_2D, I32_2D, float64, helper, int32, int64, uint64
from mavnav.kernels.polar_search.cost import Beams, Limits, Work

BEARING_RAD, RANGE_M, RANGE_SHARE = 6e-7, 5e-5, 1e-6
"""Errors in single precision: of bearings, and of ranges on surfaces that are not too steep.

The second is in m, the third a share of the greatest range.
"""
UNCERTAIN, NOTHING = np.float32(-1e30), np.float32(np.inf)
ZERO, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
THIRD, FIFTH, SEVENTH, NINTH = (np.float32(1.0 / n) for n in (3.0, 5.0, 7.0, 9.0))
LITTLE, TOO_NEAR = np.float32(0.2), np.float32(0.2)
"""Largest squared shift and least range of a moved point, as shares of the point's squared range and range.

Up to the first, the series is accurate to 3e-8. Below the second, points are not accurate in single precision.
"""
NEARLY_BEHIND_RAD = 3.0
"""Largest change of a bearing: beyond, a neighbour may have turned the other way."""


class BeamMotion(NamedTuple):
    """Shift along the axes of the grid's middle (m), turn in beams, and beams per radian, in single precision."""

    x: np.float32
    y: np.float32
    turned: np.float32
    per_step: np.float32


class Widths(NamedTuple):
    """A whole turn, the margin at a segment's ends and the last beam number, in beams; the least steep slope.

    Then near, far, occlusion threshold and the error of ranges in m, and the minimum number of beams.
    """

    turn: np.float32
    close: np.float32
    steep: np.float32
    last: np.float32
    near: np.float32
    far: np.float32
    occlusion: np.float32
    off_by: np.float32
    fewest: np.float32


@helper
def _widths_of(limits: Limits, beams: int) -> Widths:
    per_step, off_by = 1.0 / limits.step_rad, max(RANGE_M, RANGE_SHARE * limits.far_m)
    close = BEARING_RAD * abs(per_step)
    return Widths(
        np.float32(2.0 * np.pi * abs(per_step)),
        np.float32(close),
        np.float32(0.5 * off_by / close),
        np.float32(beams - 1),
        np.float32(limits.near_m),
        np.float32(limits.far_m),
        np.float32(limits.occlusion_m),
        np.float32(off_by),
        np.float32(limits.fewest_beams),
    )


@helper
def _to_polar_f32(points: F32_2D, motion: BeamMotion, moved: F32_2D) -> None:
    """Write the range and the change of the beam number of the moved points; NaN if that is not accurate.

    The tangent of half the change is cross / (product of the ranges + dot). A short series is accurate to 1e-7 for
    small changes; the other points are processed afterwards.
    """
    x, y, turned, per_step = motion
    shift2, wide = x * x + y * y, int32(0)
    for k in range(points.shape[1]):
        along, cross = points[0, k] * x + points[1, k] * y, points[0, k] * y - points[1, k] * x
        r = np.sqrt(points[3, k] + (along + along + shift2))
        t = cross / (points[6, k] * r + (points[3, k] + along))
        u = t * t
        far = LITTLE * points[3, k] < shift2
        wide = int32(wide + int32(far))  # 32 bits: with 64, half as many SIMD lanes are used
        half = t * (ONE - u * (THIRD - u * (FIFTH - u * (SEVENTH - u * NINTH))))
        moved[0, k] = r
        moved[1, k] = NOTHING - NOTHING if far else points[4, k] + (turned + per_step * (half + half))
    for k in range(points.shape[1] if wide else 0):
        if LITTLE * points[3, k] < shift2 and moved[0, k] > TOO_NEAR * points[6, k]:
            px, py, dx, dy = float64(points[0, k]), float64(points[1, k]), float64(x), float64(y)
            between = np.arctan2(px * dy - py * dx, px * (px + dx) + py * (py + dy))
            if abs(between) < NEARLY_BEHIND_RAD:
                moved[1, k] = points[4, k] + (turned + per_step * between)


@helper
def _span_f32(points: F32_2D, widths: Widths, moved: F32_2D, spans: I32_2D) -> None:
    """Write the results of ``span`` in single precision; the range is `UNCERTAIN` where it is not accurate.

    That are beams near the ends of a segment, steep segments, and those across the seam.
    """
    turn, close, steep, last = widths.turn, widths.close, widths.steep, widths.last
    quarter, by_seam = turn / (TWO + TWO), close + close + close  # three, because sums with numbers are rounded
    for k in range(1, points.shape[1]):
        number, start, end = points[2, k - 1], moved[1, k - 1], moved[1, k] + ONE
        ahead, joined = end - start, points[5, k] > ZERO
        low, high = np.ceil(start - close), np.floor(end + close)
        slope = (moved[0, k] - moved[0, k - 1]) / ahead
        meets = joined & (low <= high) & (ahead < quarter + ONE)
        across = (number + start < by_seam) | (number + end > turn - by_seam)
        inside = meets & (number + low <= last) & (number + low >= ZERO)
        doubt = (low - start < close) | (end - high < close) | (abs(slope) > steep) | (ahead > quarter - ONE)
        value = UNCERTAIN if doubt else moved[0, k - 1] + (low - start) * slope
        moved[2, k] = value if inside & (not across) else NOTHING
        moved[3, k] = slope
        spans[0, k] = int32(min(max(number + low, ZERO), last)) if inside else int32(0)
        # A turn is not a whole number of beams: beyond the seam, other beams meet a segment than before it.
        special = across & (ahead > -close) & (ahead < quarter + ONE)
        special = joined & (special | (abs(ahead) > TWO * quarter) | np.isnan(ahead))
        spans[1, k] = int32(-1) if special else int32(min(number + high, last) - (number + low) if inside else ZERO)


@helper
def _lower_ranges_f32(points: F32_2D, widths: Widths, moved: F32_2D, spans: I32_2D, seen: F32_1D) -> bool:
    """Write the range of each virtual beam as ``lower_ranges`` does; return False if a point is not accurate."""
    seen[:] = NOTHING
    turn, last, across = widths.turn, len(seen) - 1, 0
    for k in range(1, points.shape[1]):
        first, more, value = uint64(spans[0, k]), spans[1, k], moved[2, k]
        seen[first] = min(seen[first], value)
        if more == 0:
            continue
        for i in range(1, more + 1):
            at = first + uint64(i)
            seen[at] = min(seen[at], value + np.float32(i) * moved[3, k])
        if more < 0:
            spans[0, across] = k
            across += 1
    for k in spans[0, :across]:
        start, end = points[2, k - 1] + moved[1, k - 1], points[2, k - 1] + moved[1, k] + ONE
        if not -ONE <= end - start <= turn:  # not accurate, or the laser moved through it
            return False
        for around in range(int64(np.floor(-end / turn)), int64(np.ceil((last - start) / turn)) + 1):
            low, high = np.floor(start + around * turn), np.ceil(end + around * turn)
            for j in range(max(int64(low), 0), min(int64(high), last) + 1):
                seen[j] = UNCERTAIN
    return True


@helper
def _least_mean(virtual: F32_1D, widths: Widths, seen: F32_1D, squares: F32_1D) -> float:
    """Return a lower bound of the cost: the sum over beams that surely contribute, by the number of those that may."""
    near, far, occlusion, off_by = widths.near, widths.far, widths.occlusion, widths.off_by
    n, most = len(virtual), int32(0)
    for j in range(n):
        at, off = seen[j], abs(seen[j] - virtual[j])
        sure = (near + off_by < at) & (at < far - off_by) & (off_by < off) & (off < occlusion - off_by)
        may = (near - off_by < at) & (at < far + off_by) & (off < occlusion + off_by)
        squares[j] = (off - off_by) * (off - off_by) if sure else ZERO
        most = int32(most + int32(may | ((at < -ONE) & (virtual[j] > ZERO))))
    while n > 1:  # pairs in parallel: the order of summation does not matter here
        half = (n + 1) // 2
        for j in range(n - half):
            squares[j] += squares[half + j]
        n = half
    return squares[0] * (1.0 - 1e-5) / most if most >= max(widths.fewest, ONE) else np.inf


@helper
def _at_middle(scan: Beams, middle: F64_1D, work: Work) -> F32_2D:
    """Return the points in the middle of a grid, (7, n).

    The rows are x, y, beam number as measured, squared range, change of the beam number (not wrapped at the seam),
    whether a point is on one surface with the one before, and range.
    """
    points, (c, s, x, y, yaw), per_step = scan.points, middle, 1.0 / scan.limits.step_rad
    out, turn, before = np.empty((7, points.shape[1]), np.float32), 2.0 * np.pi * abs(per_step), 0.0
    for k in range(points.shape[1]):
        r, beam, number = work.r[k], work.beam[k], points[2, k]
        at = before if points[5, k] > 0.0 else (points[4, k] + yaw - scan.limits.first_rad) * per_step
        before = beam + turn * np.rint((at - beam) / turn)
        out[0, k] = c * points[0, k] - s * points[1, k] + x
        out[1, k] = s * points[0, k] + c * points[1, k] + y
        out[2, k], out[3, k], out[5, k], out[6, k] = number, r * r, points[5, k], r
        out[4, k] = before - number if abs(before - number) < 0.55 * turn else np.nan
    return out


@helper
def bound_wide(scan: Beams, motions: F64_2D, work: Work, bounds: F64_1D) -> None:
    """Write a lower bound of each candidate's cost, -inf if unknown.

    ``work`` has the points relative to the grid's middle, the last of the ``motions``; the candidates are expressed as
    shifts from there and then turns.
    """
    (virtual, points, limits), (_, _, x, y, yaw) = scan, motions[-1]
    n, beams, per_step = points.shape[1], len(virtual), 1.0 / limits.step_rad
    small, moved, spans = _at_middle(scan, motions[-1], work), np.empty((4, n), np.float32), np.empty((2, n), np.int32)
    expected, seen, squares = np.empty(beams, np.float32), np.empty(beams, np.float32), np.empty(beams, np.float32)
    for j in range(beams):
        expected[j] = virtual[j] if limits.near_m < virtual[j] < limits.far_m else np.nan
    widths = _widths_of(limits, beams)
    for i in range(len(bounds)):
        turn = motions[i, 4] - yaw
        c, s = np.cos(turn), np.sin(turn)
        right, up = c * motions[i, 2] + s * motions[i, 3] - x, c * motions[i, 3] - s * motions[i, 2] - y
        motion = BeamMotion(np.float32(right), np.float32(up), np.float32(turn * per_step), np.float32(per_step))
        _to_polar_f32(small, motion, moved)
        _span_f32(small, widths, moved, spans)
        known = _lower_ranges_f32(small, widths, moved, spans, seen)
        bounds[i] = _least_mean(expected, widths, seen, squares) if known else -np.inf
