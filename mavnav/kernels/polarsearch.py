"""The paper's scan matching: cost function (steps iii-xi) and minimisation (steps i-v) in polar coordinates.

A pruned grid has the minimum of the exhaustive one: the same index, the lowest of equals, and the same cost, bit for
bit. Every candidate gets a lower bound of its cost; that of the least bound is evaluated, then those whose bounds leave
them a chance. The bounds come

* on wide grids from the cost in single precision, of points as they are seen from the grid's middle: beams that may be
  off by more than `RANGE_M`, or may not contribute, are counted but not summed;
* on small ones, where most beams keep the segment that they meet and contribute throughout or nowhere, from the
  polynomial of second order of their sum, less twice its third-order term; the others are summed for each candidate.

Shared arguments: ``scan`` is the virtual ranges, the points as rows x, y, beam number, range, bearing, whether they
hang together with the point before, (6, n), and the limits of ``polar_cost``; ``work`` is scratch,
(6, 2 n or beams) and (2, 2 n): ranges, beam numbers, what segments show and their slopes. ``motion`` (5,) is cosine and
sine of the turn, shift in x and y (m) and turn (rad). ``window`` (4,) is half-window in m and rad, one of them 0, and
the point (m) that turns are about.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import boolean, float32, float64, int32, int64, types, uint64, void

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Scan = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
    Work = tuple[NDArray[np.float64], NDArray[np.int32]]

MAX_ITERATIONS = 60
HELD_SHARE = 1.0 / 16.0
"""Of a point's range, and of a segment's width, that motion within a small grid may change."""
HELD_BEAMS, TRIMMED_BEAMS, WORTH_TRIMMING = 0.25, 6.0, 15
"""Where points pass more beams on average, too few beams keep their segments, or are of no use on the whole grid; it
takes as long to find these as to bound some ten candidates."""
HIDDEN_M = 0.05
"""So far behind another a surface stays hidden within a small grid; beams whose range may change more are not held."""
SUM_M2 = 1e-11
"""More than the series of the bearings, and another order of summation, change a cost."""

CLOSE = 1e-8
"""So near to the end of a segment, in beams, or to a threshold, in m, rounding and series decide what contributes."""

BEARING_RAD, RANGE_M, RANGE_SHARE = 6e-7, 5e-5, 1e-6
"""In single precision bearings are better than this, and ranges where the surface is not too steep: in m, or of the
farthest."""
DOUBT, NOTHING = np.float32(-1e30), np.float32(np.inf)
ZERO, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
THIRD, FIFTH, SEVENTH, NINTH = (np.float32(1.0 / n) for n in (3.0, 5.0, 7.0, 9.0))
LITTLE, TOO_NEAR = np.float32(0.2), np.float32(0.2)
"""Of a point's squared range: shifts up to here turn it so little that the series is good to 3e-8. Of its range: points
that come nearer than this are not known as well in single precision."""
NEARLY_BEHIND_RAD = 3.0
"""Beyond, a neighbour may have turned the other way round."""

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)
_S1 = types.Array(float32, 1, "C", readonly=True)
_S2 = types.Array(float32, 2, "C", readonly=True)
_SCAN = types.Tuple((_F1, _F2, _F1))
_WORK = types.Tuple((float64[:, ::1], int32[:, ::1]))

# ---- the cost -------------------------------------------------------------------------------------------------------


@kernel(void(_F2, _F1, _F1, float64[::1], float64[::1]))
def _see(
    points: NDArray[np.float64],
    motion: NDArray[np.float64],
    limits: NDArray[np.float64],
    r: NDArray[np.float64],
    beam: NDArray[np.float64],
) -> None:
    """Write range and beam number of the moved points.

    Between neighbouring poses a point's bearing changes little: a series of the tangent is then good to 1e-11. Without
    branches the loop works on four points at a time; those that turn farther are seen to afterwards.
    """
    c, s, x, y, yaw = motion
    per_step, turn = 1.0 / limits[1], 2.0 * np.pi / abs(limits[1])
    per_turn, first, wide = 1.0 / turn, limits[0], 0
    from_x, from_y, bearing = points[0], points[1], points[4]
    for k in range(len(r)):
        px, py = c * from_x[k] - s * from_y[k], s * from_x[k] + c * from_y[k]
        qx, qy = px + x, py + y
        r[k] = np.sqrt(qx * qx + qy * qy)
        cross, dot = px * qy - py * qx, px * qx + py * qy
        t = cross / dot
        u = t * t
        far = (u >= 0.04) | (dot <= 0.0)
        wide += far
        between = t * (1.0 - u * (1 / 3 - u * (1 / 5 - u * (1 / 7 - u * (1 / 9 - u * (1 / 11 - u * (1 / 13)))))))
        at = (bearing[k] + yaw + between - first) * per_step
        beam[k] = np.nan if far else at - turn * np.floor(at * per_turn)
    for k in range(len(r) if wide else 0):
        if np.isnan(beam[k]):
            px, py = c * from_x[k] - s * from_y[k], s * from_x[k] + c * from_y[k]
            qx, qy = px + x, py + y
            at = (bearing[k] + yaw + np.arctan2(px * qy - py * qx, px * qx + py * qy) - first) * per_step
            beam[k] = at - turn * np.floor(at * per_turn)


@kernel(void(_SCAN, _WORK))
def _span(scan: Scan, work: Work) -> None:
    """Write what the first virtual beam that meets the segment before each point sees there, and the segment's slope.

    Only between neighbouring beams of one surface, where it turns its front to the virtual laser (step iv). The
    integers are that beam's number and how many more meet the segment, -1 where it lies across the seam.
    """
    r, beam, value, slope = work[0][0], work[0][1], work[0][2], work[0][3]
    first, more, joined = work[1][0], work[1][1], scan[1][5]
    turn, last = 2.0 * np.pi / abs(scan[2][1]), len(scan[0]) - 1.0
    for k in range(1, len(joined)):
        start, ahead = beam[k - 1], beam[k] - beam[k - 1]
        ahead = ahead + turn if ahead < -0.5 * turn else ahead
        front = (joined[k] > 0.0) & (ahead > 0.0) & (ahead < 0.25 * turn)
        at, end = np.ceil(start) if start > 0.0 else 0.0, min(np.floor(start + ahead), last)  # 0 for NaN as well
        slope[k] = (r[k] - r[k - 1]) / ahead
        meets = front & (at <= end)
        value[k] = r[k - 1] + (at - start) * slope[k] if meets else np.inf
        first[k] = int32(min(at, last))
        more[k] = int32(-1) if front & (start + ahead >= turn) else int32(end - at if meets else 0.0)


@kernel(void(_SCAN, _WORK, float64[::1]))
def _lay(scan: Scan, work: Work, seen: NDArray[np.float64]) -> None:
    """Lower what each virtual beam sees to the moved points: nearer surfaces hide farther ones."""
    r, beam, value, slope = work[0][0], work[0][1], work[0][2], work[0][3]
    first, more, beams, turn = work[1][0], work[1][1], len(seen), 2.0 * np.pi / abs(scan[2][1])
    for k in range(1, scan[1].shape[1]):
        at, from_r, start = first[k], r[k - 1], beam[k - 1]
        seen[uint64(at)] = min(seen[uint64(at)], value[k])
        for j in range(at + 1, at + more[k] + 1):
            seen[uint64(j)] = min(seen[uint64(j)], from_r + (j - start) * slope[k])
        if more[k] >= 0:
            continue
        ahead = beam[k] - start + (turn if beam[k] < start else 0.0)
        for _ in range(2):
            for j in range(max(int64(np.ceil(start)), 0), min(int64(np.floor(start + ahead)), beams - 1) + 1):
                seen[uint64(j)] = min(seen[uint64(j)], from_r + (j - start) * slope[k])
            start -= turn  # it goes on at beam 0


@kernel(types.UniTuple(float64, 2)(_F1, _F1, float64[::1], float64[::1]))
def _compare(
    virtual: NDArray[np.float64], limits: NDArray[np.float64], seen: NDArray[np.float64], squares: NDArray[np.float64]
) -> tuple[float, float]:
    """Sum the squared differences of the beams that see the same, and count these."""
    near, far, occlusion, counted = limits[2], limits[3], limits[4], limits[7] > 0.0
    total, used = 0.0, 0
    for j in range(len(virtual)):
        # Step ix: empty cells match nothing. Step vi: too close or too far. Steps v and viii
        v, d = virtual[j], seen[j] - virtual[j]
        both = (near < v) & (v < far) & (near < seen[j]) & (seen[j] < far)
        same = abs(d) < occlusion
        squares[j] = d * d if both & same else (occlusion * occlusion if both & counted else 0.0)
        used += both & (same | counted)
    for j in range(len(virtual)):
        total += squares[j]
    return total, float(used)


@kernel(types.UniTuple(float64, 2)(_SCAN, _WORK))
def _mean(scan: Scan, work: Work) -> tuple[float, float]:
    """Return cost and number of beams in it, from ranges and beam numbers of the moved points."""
    virtual, _, limits = scan
    # Cost function, step iv
    seen = work[0][4, : len(virtual)]
    seen[:] = np.inf
    _span(scan, work)
    _lay(scan, work, seen)
    total, used = _compare(virtual, limits, seen, work[0][5, : len(virtual)])
    # Steps x and xi
    if used < limits[6] or used == 0.0:
        return np.inf, used
    return total / used, used


@kernel(types.UniTuple(float64, 2)(_SCAN, _F1, _WORK))
def _evaluate(scan: Scan, motion: NDArray[np.float64], work: Work) -> tuple[float, float]:
    """Return cost and number of beams in it, see ``polar_cost``."""
    n = scan[1].shape[1]
    # Cost function, step iii
    _see(scan[1], motion, scan[2], work[0][0, :n], work[0][1, :n])
    return _mean(scan, work)


@kernel(_F2(_F2, float64))
def _joined(points: NDArray[np.float64], edge: float) -> NDArray[np.float64]:
    """Return points (5, n) with a row more: 1 where a point and the one before are of one surface."""
    out = np.zeros((6, points.shape[1]))
    out[:5] = points
    for k in range(1, points.shape[1]):
        out[5, k] = (points[2, k] == points[2, k - 1] + 1.0) & (abs(points[3, k] - points[3, k - 1]) < edge)
    return out


@kernel(types.UniTuple(float64, 2)(_F1, _F2, float64, float64, float64, _F1))
def polar_cost(
    virtual: NDArray[np.float64],
    points: NDArray[np.float64],
    x: float,
    y: float,
    yaw: float,
    limits: NDArray[np.float64],
) -> tuple[float, float]:
    """Mean squared radius difference (m2) between virtual and roto-translated scan, and the number of beams in it.

    Parameters
    ----------
    virtual : (beams,) ranges of the virtual scan, m, NaN where it saw no cell
    points : (5, n) the scan's good points in beam order: x, y (m), beam number, its range (m) and bearing (rad)
    x, y, yaw : proposed motion from the virtual scan's pose, m, rad
    limits : (8,) bearing of beam 0 and bearing step (rad); near, far, occlusion threshold, range jump between
        surfaces (m); least number of beams; 1 where occluded beams count with the squared threshold, 0 where they are
        left out

    The cost is inf where fewer beams than the least number contribute.
    """
    n = points.shape[1]
    motion = np.array([np.cos(yaw), np.sin(yaw), x, y, yaw])
    work = np.empty((6, max(n, len(virtual)))), np.empty((2, n), np.int32)
    return _evaluate((virtual, _joined(points, limits[5]), limits), motion, work)


# ---- wide grids: bounds in single precision -------------------------------------------------------------------------


@kernel(void(_S2, _S1, float32[:, ::1]))
def _glance(points: NDArray[np.float32], motion: NDArray[np.float32], moved: NDArray[np.float32]) -> None:
    """Write range and turn in beams of the moved points; the turn is NaN where it is not known well.

    Half the turn has the tangent cross / (product of the ranges + dot). Of points that turn little a short series is
    good to 1e-7; the others are seen to afterwards.
    """
    x, y, turned, per_step = motion
    shift2, wide = x * x + y * y, int32(0)
    for k in range(points.shape[1]):
        along, cross = points[0, k] * x + points[1, k] * y, points[0, k] * y - points[1, k] * x
        r = np.sqrt(points[3, k] + (along + along + shift2))
        t = cross / (points[6, k] * r + (points[3, k] + along))
        u = t * t
        far = LITTLE * points[3, k] < shift2
        wide = int32(wide + int32(far))  # 32 bits wide, or half as many points are done at a time
        half = t * (ONE - u * (THIRD - u * (FIFTH - u * (SEVENTH - u * NINTH))))
        moved[0, k] = r
        moved[1, k] = NOTHING - NOTHING if far else points[4, k] + (turned + per_step * (half + half))
    for k in range(points.shape[1] if wide else 0):
        if LITTLE * points[3, k] < shift2 and moved[0, k] > TOO_NEAR * points[6, k]:
            px, py, dx, dy = float64(points[0, k]), float64(points[1, k]), float64(x), float64(y)
            between = np.arctan2(px * dy - py * dx, px * (px + dx) + py * (py + dy))
            if abs(between) < NEARLY_BEHIND_RAD:
                moved[1, k] = points[4, k] + (turned + per_step * between)


@kernel(void(_S2, _S1, float32[:, ::1], int32[:, ::1]))
def _span_glance(
    points: NDArray[np.float32], widths: NDArray[np.float32], moved: NDArray[np.float32], spans: NDArray[np.int32]
) -> None:
    """Write, as ``_span``, what the first beam that meets each segment sees; `DOUBT` where that is not known well.

    Doubtful are beams close to the ends of a segment, steep segments, and those across the seam.
    """
    turn, close, steep, last = widths[0], widths[1], widths[2], widths[3]
    quarter, by_seam = turn / (TWO + TWO), close + close + close  # numbers are rounded when they are added
    for k in range(1, points.shape[1]):
        number, start, end = points[2, k - 1], moved[1, k - 1], moved[1, k] + ONE
        ahead, joined = end - start, points[5, k] > ZERO
        low, high = np.ceil(start - close), np.floor(end + close)
        slope = (moved[0, k] - moved[0, k - 1]) / ahead
        meets = joined & (low <= high) & (ahead < quarter + ONE)
        across = (number + start < by_seam) | (number + end > turn - by_seam)
        inside = meets & (number + low <= last) & (number + low >= ZERO)
        doubt = (low - start < close) | (end - high < close) | (abs(slope) > steep) | (ahead > quarter - ONE)
        value = DOUBT if doubt else moved[0, k - 1] + (low - start) * slope
        moved[2, k] = value if inside & (not across) else NOTHING
        moved[3, k] = slope
        spans[0, k] = int32(min(max(number + low, ZERO), last)) if inside else int32(0)
        # A turn is no whole number of beams: across the seam others meet a segment than before it.
        special = across & (ahead > -close) & (ahead < quarter + ONE)
        special = joined & (special | (abs(ahead) > TWO * quarter) | np.isnan(ahead))
        spans[1, k] = int32(-1) if special else int32(min(number + high, last) - (number + low) if inside else ZERO)


@kernel(boolean(_S2, _S1, float32[:, ::1], int32[:, ::1], float32[::1]))
def _lay_glance(
    points: NDArray[np.float32],
    widths: NDArray[np.float32],
    moved: NDArray[np.float32],
    spans: NDArray[np.int32],
    seen: NDArray[np.float32],
) -> bool:
    """Write, as ``_lay``, what each virtual beam sees; False where a point is not known well."""
    seen[:] = NOTHING
    turn, last, across = widths[0], len(seen) - 1, 0
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
        if not -ONE <= end - start <= turn:  # not known, or the laser has gone through it
            return False
        for around in range(int64(np.floor(-end / turn)), int64(np.ceil((last - start) / turn)) + 1):
            low, high = np.floor(start + around * turn), np.ceil(end + around * turn)
            for j in range(max(int64(low), 0), min(int64(high), last) + 1):
                seen[j] = DOUBT
    return True


@kernel(float64(_S1, _S1, float32[::1], float32[::1]))
def _least_mean(
    virtual: NDArray[np.float32], widths: NDArray[np.float32], seen: NDArray[np.float32], squares: NDArray[np.float32]
) -> float:
    """Return what the cost is at least: the sum of what contributes for sure, by the beams that may contribute."""
    near, far, occlusion, off_by = widths[4], widths[5], widths[6], widths[7]
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
    return squares[0] * (1.0 - 1e-5) / most if most >= max(widths[8], ONE) else np.inf


@kernel(_S2(_SCAN, _F1, float64[:, ::1]))
def _at_middle(scan: Scan, middle: NDArray[np.float64], scratch: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the points as they lie in the middle of a grid, (7, n).

    Their x, y, beam number as measured, squared range, how many beams they have moved on from there (not back at the
    seam), whether they hang together with the point before, and range.
    """
    points, (c, s, x, y, yaw), per_step = scan[1], middle, 1.0 / scan[2][1]
    out, turn, before = np.empty((7, points.shape[1]), np.float32), 2.0 * np.pi * abs(per_step), 0.0
    for k in range(points.shape[1]):
        r, beam, number = scratch[0, k], scratch[1, k], points[2, k]
        at = before if points[5, k] > 0.0 else (points[4, k] + yaw - scan[2][0]) * per_step
        before = beam + turn * np.rint((at - beam) / turn)
        out[0, k] = c * points[0, k] - s * points[1, k] + x
        out[1, k] = s * points[0, k] + c * points[1, k] + y
        out[2, k], out[3, k], out[5, k], out[6, k] = number, r * r, points[5, k], r
        out[4, k] = before - number if abs(before - number) < 0.55 * turn else np.nan
    return out


@kernel(void(_SCAN, _F2, _WORK, float64[::1]))
def _bound_wide(scan: Scan, motions: NDArray[np.float64], work: Work, bounds: NDArray[np.float64]) -> None:
    """Write a lower bound of each candidate's cost, -inf where none is known.

    ``work`` holds the points as they are seen from the grid's middle, the last of the ``motions``; the candidates are
    taken for shifts from there and then turns.
    """
    (virtual, points, limits), (_, _, x, y, yaw) = scan, motions[-1]
    n, beams, per_step = points.shape[1], len(virtual), 1.0 / limits[1]
    small, motion, moved = _at_middle(scan, motions[-1], work[0]), np.empty(4, np.float32), np.empty((4, n), np.float32)
    expected, seen, squares = np.empty(beams, np.float32), np.empty(beams, np.float32), np.empty(beams, np.float32)
    for j in range(beams):
        expected[j] = virtual[j] if limits[2] < virtual[j] < limits[3] else np.nan
    widths, close, off_by = np.empty(9, np.float32), BEARING_RAD * abs(per_step), max(RANGE_M, RANGE_SHARE * limits[3])
    widths[0], widths[1], widths[2], widths[3] = 2.0 * np.pi * abs(per_step), close, 0.5 * off_by / close, beams - 1
    widths[4:7], widths[7], widths[8] = limits[2:5], off_by, limits[6]
    for i in range(len(bounds)):
        turn = motions[i, 4] - yaw
        c, s = np.cos(turn), np.sin(turn)
        motion[0], motion[1] = c * motions[i, 2] + s * motions[i, 3] - x, c * motions[i, 3] - s * motions[i, 2] - y
        motion[2], motion[3] = turn * per_step, per_step
        _glance(small, motion, moved)
        _span_glance(small, widths, moved, work[1])
        known = _lay_glance(small, widths, moved, work[1], seen)
        bounds[i] = _least_mean(expected, widths, seen, squares) if known else -np.inf


# ---- small grids: the sum of most beams is a polynomial of the motion -----------------------------------------------


@kernel(types.UniTuple(float64, 2)(_SCAN, _F1, _F1, float64[:, ::1], float64[:, ::1]))
def _reach(
    scan: Scan,
    motion: NDArray[np.float64],
    window: NDArray[np.float64],
    scratch: NDArray[np.float64],
    reach: NDArray[np.float64],
) -> tuple[float, float]:
    """Write how far each point comes on the grid: in m, in beams, and in beams more than the one before it.

    Returns the beams on average, and the largest share of a point's range.
    """
    points, (c, s, x, y, _), (shift, turn, pivot_x, pivot_y) = scan[1], motion, window
    r, per_step, shear = scratch[0], 1.0 / abs(scan[2][1]), shift + turn * np.hypot(pivot_x, pivot_y)
    n, beams, largest = points.shape[1], 0.0, 0.0
    for k in range(n):
        qx, qy = c * points[0, k] - s * points[1, k] + x, s * points[0, k] + c * points[1, k] + y
        reach[0, k] = shift + turn * np.sqrt((qx - pivot_x) * (qx - pivot_x) + (qy - pivot_y) * (qy - pivot_y))
        share, before = reach[0, k] / r[k], max(k - 1, 0)
        reach[1, k] = share * per_step * (1.0 + share) + CLOSE
        dx, dy = points[0, k] - points[0, before], points[1, k] - points[1, before]
        reach[2, k] = 1.2 * shear * np.sqrt(dx * dx + dy * dy) * per_step / (r[k] * r[before])
    for k in range(n):
        beams, largest = beams + reach[1, k], max(largest, reach[0, k] / r[k])
    return beams / n, largest


@kernel(void(_SCAN, float64[:, ::1], float64[:, ::1], float64[:, ::1]))
def _sweep(scan: Scan, scratch: NDArray[np.float64], reach: NDArray[np.float64], swept: NDArray[np.float64]) -> None:
    """Write the beams that each segment may meet somewhere on the grid, from and to.

    An empty range where it meets none, beyond 0 or a whole turn where it may cross the seam.
    """
    beam, joined, turn = scratch[1], scan[1][5], 2.0 * np.pi / abs(scan[2][1])
    for k in range(1, len(joined)):
        start, ahead, less, more = beam[k - 1], beam[k] - beam[k - 1], reach[1, k - 1], reach[1, k]
        ahead = ahead + turn if ahead < -0.5 * turn else ahead
        none = (joined[k] == 0.0) | (ahead < -more - less) | (ahead > 0.25 * turn + more + less)
        swept[0, k] = 1.0 if none else start - less
        swept[1, k] = 0.0 if none else start + ahead + more


@kernel(void(_SCAN, _WORK, float64[:, ::1], float64[:, ::1], float64[:, ::1], int64[::1]))
def _hold(
    scan: Scan,
    work: Work,
    reach: NDArray[np.float64],
    swept: NDArray[np.float64],
    sight: NDArray[np.float64],
    held: NDArray[np.int64],
) -> None:
    """Write what each beam sees and which segment it meets all over the grid: 0 for none, -1 where that may change.

    ``sight`` (3, beams) is what a beam sees in the middle, and the least and the most that it can see anywhere.
    """
    r, beam, value, slope, last = work[0][0], work[0][1], work[0][2], work[0][3], len(held) - 1
    (seen, least, most), (by_m, by_beams) = (sight[0], sight[1], sight[2]), (reach[0], reach[1])
    first, more, turn = work[1][0], work[1][1], 2.0 * np.pi / abs(scan[2][1])
    sight[:2], sight[2], held[:] = np.inf, 0.0, 0
    for k in range(1, scan[1].shape[1]):
        if value[k] == np.inf or beam[k] < beam[k - 1]:
            continue  # across the seam: loose in any case
        for i in range(more[k] + 1):
            j, at = uint64(first[k] + i), value[k] + i * slope[k]
            if at < seen[j]:
                seen[j], held[j] = at, k
    for k in range(1, scan[1].shape[1]):
        low, high = swept[0, k], swept[1, k]
        if low > high:
            continue
        near, far = min(r[k - 1] - by_m[k - 1], r[k] - by_m[k]), max(r[k - 1] + by_m[k - 1], r[k] + by_m[k])
        from_beam, to_beam, seam = beam[k - 1] + by_beams[k - 1], beam[k] - by_beams[k], low < 0.0 or high >= turn
        for around in range(-1 if seam else 0, 2 if seam else 1):
            by = around * turn
            for i in range(max(int64(np.ceil(low + by)), 0), min(int64(np.floor(high + by)), last) + 1):
                j = uint64(i)
                mine, sure = held[j] == k, from_beam <= i <= to_beam and not seam
                least[j], most[j] = min(least[j], near), max(most[j], far)
                if not (mine and sure) and (mine or near <= seen[j] + HIDDEN_M):
                    held[j] = -1


@kernel(void(_SCAN, float64[:, ::1], float64[:, ::1], float64[:, ::1], int64[::1], boolean))
def _let_go(
    scan: Scan,
    scratch: NDArray[np.float64],
    reach: NDArray[np.float64],
    sight: NDArray[np.float64],
    held: NDArray[np.int64],
    small: bool,
) -> None:
    """Set to 0 which beams contribute nowhere on the grid, to -1 which may or may not: the others, if not small."""
    virtual, (near, far, occlusion) = scan[0], (scan[2][2], scan[2][3], scan[2][4])
    r, beam = scratch[0], scratch[1]
    for j in range(len(virtual)):
        k, at, least, most = held[j], sight[0, j], sight[1, j], sight[2, j]
        if k > 0 and not small:
            held[j] = -1
        elif k > 0:
            wide = beam[k] - beam[k - 1]
            share = (reach[1, k - 1] + reach[2, k]) / max(wide - reach[2, k], 1e-9)
            change = max(reach[0, k - 1], reach[0, k]) + share * abs(r[k] - r[k - 1]) + CLOSE
            least, most = max(least, at - change), min(most, at + change)
            stays = near < least and most < far and abs(at - virtual[j]) + change < occlusion
            if not stays or change > HIDDEN_M or reach[2, k] > HELD_SHARE * wide:
                held[j] = -1
        apart = max(least - virtual[j], virtual[j] - most) > occlusion + CLOSE or most < near or least > far
        if apart or not near < virtual[j] < far:
            held[j] = 0


@kernel(_F2(_SCAN, float64[:, ::1], int64[::1]))
def _rest(scan: Scan, swept: NDArray[np.float64], held: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the points (6, m) of the segments that loose beams may meet."""
    points, last, turn, count = scan[1], len(held) - 1, 2.0 * np.pi / abs(scan[2][1]), 0
    n, loose = points.shape[1], np.zeros(len(held) + 1, np.int64)
    needed, kept = np.zeros(n + 1, np.bool_), np.empty(n, np.int64)
    for j in range(len(held)):
        loose[j + 1] = loose[j] + (held[j] < 0)
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


@kernel(void(_SCAN, _F1, _F1, _F1, _F1, float64[:, ::1]))
def _derive(
    scan: Scan,
    motion: NDArray[np.float64],
    pivot: NDArray[np.float64],
    way: NDArray[np.float64],
    r: NDArray[np.float64],
    rates: NDArray[np.float64],
) -> None:
    """Write the first three derivatives of the points' ranges, and of their beam numbers, along a way.

    ``way`` (3,) is the speed of x, of y and of the turn about the pivot. With a point as a complex number, range and
    bearing are real and imaginary part of its logarithm: (a, b), (e, f) are its first and second derivative by itself.
    """
    points, (c, s, x, y, _), (right, up, turn), per_step = scan[1], motion, way, 1.0 / scan[2][1]
    for k in range(points.shape[1]):
        qx, qy = c * points[0, k] - s * points[1, k] + x, s * points[0, k] + c * points[1, k] + y
        ox, oy, per = turn * (qx - pivot[0]), turn * (qy - pivot[1]), 1.0 / (qx * qx + qy * qy)
        tx, ty = right - oy, up + ox
        a, b = (tx * qx + ty * qy) * per, (ty * qx - tx * qy) * per
        e, f = -turn * (ox * qx + oy * qy) * per, -turn * (oy * qx - ox * qy) * per
        a2, b2 = e - a * a + b * b, f - 2.0 * a * b
        a3 = -turn * turn * a - 3.0 * (a * e - b * f) + 2.0 * a * (a * a - 3.0 * b * b)
        b3 = -turn * turn * b - 3.0 * (a * f + b * e) + 2.0 * b * (3.0 * a * a - b * b)
        rates[0, k], rates[1, k], rates[2, k] = r[k] * a, r[k] * (a2 + a * a), r[k] * (a3 + 3.0 * a * a2 + a * a * a)
        rates[3, k], rates[4, k], rates[5, k] = per_step * b, per_step * b2, per_step * b3


@kernel(void(float64[:, ::1], float64[:, ::1], int64[::1], float64[:, ::1], float64[:, ::1]))
def _expand(
    scratch: NDArray[np.float64],
    beams: NDArray[np.float64],
    held: NDArray[np.int64],
    rates: NDArray[np.float64],
    terms: NDArray[np.float64],
) -> None:
    """Write the squared differences of held beams, their first and second derivative, and the third's amounts.

    ``beams`` (2, m) are the numbers of the held beams and their differences, ``held`` (m,) the segments that they meet.
    """
    r, beam = scratch[0], scratch[1]
    for i in range(len(held)):
        k = uint64(held[i])
        b = uint64(held[i] - 1)
        v, per, d = r[k] - r[b], 1.0 / (beam[k] - beam[b]), beams[1, i]
        a1, a2, a3, b1, b2, b3 = rates[0, b], rates[1, b], rates[2, b], rates[3, b], rates[4, b], rates[5, b]
        v1, v2, v3 = rates[0, k] - a1, rates[1, k] - a2, rates[2, k] - a3
        w1, w2, w3 = rates[3, k] - b1, rates[4, k] - b2, rates[5, k] - b3
        u = (beams[0, i] - beam[b]) * per  # the share of the segment's way at which the beam meets it, (j - b) / w
        u1 = -(b1 + u * w1) * per
        u2 = -(b2 + u * w2 + 2.0 * u1 * w1) * per
        u3 = -(b3 + u * w3 + 3.0 * (u1 * w2 + u2 * w1)) * per
        d1, d2 = a1 + u1 * v + u * v1, a2 + u2 * v + 2.0 * u1 * v1 + u * v2
        d3 = a3 + u3 * v + 3.0 * (u2 * v1 + u1 * v2) + u * v3
        terms[0, i], terms[1, i] = d * d, 2.0 * d * d1
        terms[2, i], terms[3, i] = 2.0 * (d1 * d1 + d * d2), 2.0 * abs(3.0 * d1 * d2 + d * d3)


@kernel(void(float64[:, ::1], float64[::1]))
def _sum_up(terms: NDArray[np.float64], sums: NDArray[np.float64]) -> None:
    """Sum rows (4, m), halves in parallel."""
    for i in range(len(terms)):
        row, n = terms[i], terms.shape[1]
        while n > 1:
            half = (n + 1) // 2
            for j in range(n - half):
                row[j] += row[half + j]
            n = half
        sums[i] = row[0] if terms.shape[1] else 0.0


@kernel(float64[::1](_SCAN, _F1, _F1, float64[:, ::1], float64[::1], int64[::1]))
def _form(
    scan: Scan,
    motion: NDArray[np.float64],
    window: NDArray[np.float64],
    scratch: NDArray[np.float64],
    seen: NDArray[np.float64],
    held: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return what 1, u, v, uu, uv, vv add to the sum of the held beams; less the error.

    u and v are the shifts, or u the turn. The error is twice the third-order term of all beams' absolute values, where
    it is largest of four ways to the edge of the grid.
    """
    rates, out, widest, diagonal = np.empty((6, scan[1].shape[1])), np.zeros(6), 0.0, np.sqrt(0.5)
    at = np.flatnonzero(held > 0)
    meets, terms, sums = held[at], np.empty((4, len(at))), np.empty(4)
    beams = np.empty((2, len(at)))
    for i in range(len(at)):
        beams[0, i], beams[1, i] = at[i], seen[at[i]] - scan[0][at[i]]
    ways = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [diagonal, diagonal, 0.0], [diagonal, -diagonal, 0.0]])
    if window[1] > 0.0:
        ways = np.array([[0.0, 0.0, 1.0]])
    for i in range(len(ways)):
        _derive(scan, motion, window[2:], ways[i], scratch[0], rates)
        _expand(scratch, beams, meets, rates, terms)
        _sum_up(terms, sums)
        s0, s1, s2, s3 = sums
        out[0], widest = s0, max(widest, s3)
        if i < 2:
            out[1 + i], out[3 + 2 * i] = s1, 0.5 * s2
        else:
            out[4] += 0.5 * s2 if i == 2 else -0.5 * s2
    out[0] -= 2.0 * widest / 6.0 * max(window[0], window[1]) ** 3
    return out


@kernel(types.UniTuple(float64, 2)(_SCAN, _F1, _F1, _WORK))
def _sum_rest(scan: Scan, loose: NDArray[np.int64], motion: NDArray[np.float64], work: Work) -> tuple[float, float]:
    """Sum the squared differences of loose beams for one candidate; returns how many contribute as well."""
    virtual, points, limits = scan
    scratch, n, total, used = work[0], points.shape[1], 0.0, 0.0
    if len(loose) == 0:
        return total, used
    _see(points, motion, limits, scratch[0, :n], scratch[1, :n])
    seen = scratch[4, : len(virtual)]
    for i in range(len(loose)):
        seen[loose[i]] = np.inf
    _span(scan, work)
    _lay(scan, work, seen)
    for i in range(len(loose)):
        at, d = seen[loose[i]], seen[loose[i]] - virtual[loose[i]]
        if limits[2] < at < limits[3] and abs(d) < limits[4]:
            total += d * d
            used += 1.0
    return total, used


@kernel(_SCAN(_SCAN, _F2, _F2, _F1, _WORK, float64[::1]))
def _bound(
    scan: Scan,
    motions: NDArray[np.float64],
    offsets: NDArray[np.float64],
    window: NDArray[np.float64],
    work: Work,
    bounds: NDArray[np.float64],
) -> Scan:
    """Write a lower bound of each candidate's cost, -inf where none is known.

    ``motions`` are those of the candidates, and of the grid's middle at the end; ``offsets`` (m, 2) from there. Returns
    the scan without what matters nowhere on the grid: it costs the same, to the bit.
    """
    virtual, points, limits = scan
    n, beams, scratch, middle = points.shape[1], len(virtual), work[0], motions[-1]
    _see(points, middle, limits, scratch[0, :n], scratch[1, :n])
    reach, swept, sight, held = np.empty((3, n)), np.empty((2, n)), np.empty((3, beams)), np.empty(beams, np.int64)
    passed, share = _reach(scan, middle, window, scratch, reach)
    small = passed <= HELD_BEAMS and share <= HELD_SHARE
    if not small and (passed > TRIMMED_BEAMS or share > 0.5 or len(bounds) < WORTH_TRIMMING):
        _bound_wide(scan, motions, work, bounds)
        return scan
    _span(scan, work)
    _sweep(scan, scratch, reach, swept)
    _hold(scan, work, reach, swept, sight, held)
    _let_go(scan, scratch, reach, sight, held, small)
    rest = _rest(scan, swept, held)
    if not small:
        _see(rest, middle, limits, scratch[0, : rest.shape[1]], scratch[1, : rest.shape[1]])
        trimmed = np.where(held < 0, virtual, np.nan), rest, limits
        _bound_wide(trimmed, motions, work, bounds)
        return trimmed
    form = _form(scan, middle, window, scratch, sight[0], held)
    loose, holding = np.flatnonzero(held < 0), float(np.count_nonzero(held > 0))
    for i in range(len(bounds)):
        u, v = offsets[i]
        total, used = _sum_rest((virtual, rest, limits), loose, motions[i], work)
        total += form[0] + u * (form[1] + u * form[3] + v * form[4]) + v * (form[2] + v * form[5])
        used += holding
        bounds[i] = total / used - SUM_M2 if used >= max(limits[6], 1.0) else np.inf
    return scan


# ---- the minimisation -----------------------------------------------------------------------------------------------


@kernel(types.Tuple((int64, float64, float64))(_SCAN, _F2, _F1, _WORK))
def _least(
    scan: Scan, motions: NDArray[np.float64], bounds: NDArray[np.float64], work: Work
) -> tuple[int, float, float]:
    """Return the first candidate of least cost (-1 where all are inf), its cost and its beams."""
    promising = int64(np.argmin(bounds))
    best, used = _evaluate(scan, motions[promising], work)
    best_i = promising if best < np.inf else -1
    for i in range(len(bounds)):
        if bounds[i] > best or bounds[i] == np.inf or i == promising:
            continue
        cost, n = _evaluate(scan, motions[i], work)
        if cost < best or (cost == best and i < best_i):
            best, used, best_i = cost, n, i
    return best_i, best, used


@kernel(void(_F1, _F1, float64, float64[:, ::1], float64[:, ::1]))
def _turns(
    at: NDArray[np.float64],
    pivot: NDArray[np.float64],
    half_rad: float,
    motions: NDArray[np.float64],
    offsets: NDArray[np.float64],
) -> None:
    """Write the turns of the azimuth grid (minimisation, step i), and that of its middle; ``at`` is pivot and yaw."""
    x, y, yaw = at
    azimuths = len(offsets)
    step = 2.0 * half_rad / (azimuths - 1)
    for i in range(azimuths + 1):
        a = yaw - half_rad + i * step if i < azimuths else yaw
        c, s = np.cos(a), np.sin(a)
        motions[i, 0], motions[i, 1], motions[i, 4] = c, s, a
        motions[i, 2], motions[i, 3] = x - c * pivot[0] + s * pivot[1], y - s * pivot[0] - c * pivot[1]
        if i < azimuths:
            offsets[i, 0], offsets[i, 1] = a - yaw, 0.0


@kernel(void(_F1, _F1, float64, int64, float64[:, ::1], float64[:, ::1]))
def _shifts(
    at: NDArray[np.float64],
    pivot: NDArray[np.float64],
    half_m: float,
    nx: int,
    motions: NDArray[np.float64],
    offsets: NDArray[np.float64],
) -> None:
    """Write the shifts of the plane's grid (step iii), and that of its middle.

    They cover a circular area: the square lattice is mapped onto the disc, its border onto the circle, so that NxM
    points cost N*M evaluations as in the paper.
    """
    x, y, yaw = at
    ny, c, s = len(offsets) // nx, np.cos(yaw), np.sin(yaw)
    to_x, to_y = x - c * pivot[0] + s * pivot[1], y - s * pivot[0] - c * pivot[1]
    motions[:, 0], motions[:, 1], motions[:, 2], motions[:, 3], motions[:, 4] = c, s, to_x, to_y, yaw
    for j in range(ny):
        v = -1.0 + 2.0 * j / (ny - 1)
        for i in range(nx):
            u = -1.0 + 2.0 * i / (nx - 1)
            dx, dy = half_m * u * np.sqrt(1.0 - 0.5 * v * v), half_m * v * np.sqrt(1.0 - 0.5 * u * u)
            offsets[j * nx + i, 0], offsets[j * nx + i, 1] = dx, dy
            motions[j * nx + i, 2], motions[j * nx + i, 3] = to_x + dx, to_y + dy


@kernel(_F1(_F1, float64))
def _at_occlusion(limits: NDArray[np.float64], occlusion_m: float) -> NDArray[np.float64]:
    """Return the limits with another occlusion threshold."""
    out = limits.copy()
    out[4] = occlusion_m
    return out


@kernel(float64[::1](_F1, _F2, _F1, _F1, _F1))
def search(
    virtual: NDArray[np.float64],
    points: NDArray[np.float64],
    grid: NDArray[np.float64],
    schedule: NDArray[np.float64],
    limits: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Minimise the cost; returns [x, y, yaw, cost_m2, beams used, evaluations, iterations, converged].

    Parameters
    ----------
    virtual, limits : as for ``polar_cost``
    points : (n, 5), the columns of ``polar_cost``'s as rows
    grid : (5,) points of the azimuth grid, of the plane in x and in y, border extensions at most, 1 to prune
    schedule : (11,) half-window in the plane (m) and in azimuth (rad), shrink factor, 1 to leave no gaps between
        grids, spacings to stop at (m, rad), cost (m2) that is of no use, factor by which the occlusion threshold
        shrinks from iteration to iteration and the least that it shrinks to (m), 1 to turn about the laser instead of
        the points' centroid, 1 to stop where either spacing is reached instead of both

    Where occluded beams count, no bounds are known and every candidate is evaluated. A motion changes ranges by about
    its length: the search ends as well where the root of the cost exceeds that of one of no use by more than twice the
    half-window, and has not converged.
    """
    azimuths, nx, ny, extensions = int(grid[0]), int(grid[1]), int(grid[2]), int(grid[3])
    half_m, half_rad, shrink, covered, stop_m, stop_rad, useless, occlusion_shrink, least_m, at_laser, either = schedule
    prune = grid[4] > 0.0 and limits[7] == 0.0
    n = len(points)
    scan = part = virtual, _joined(points.T, limits[5]), limits
    work = np.empty((6, max(2 * n, len(virtual)))), np.empty((2, 2 * n), np.int32)
    turns, by_turn, turn_bounds = np.empty((azimuths + 1, 5)), np.empty((azimuths, 2)), np.full(azimuths, -np.inf)
    shifts, by_shift, bounds = np.empty((nx * ny + 1, 5)), np.empty((nx * ny, 2)), np.full(nx * ny, -np.inf)
    # Turning about the points' centroid keeps the two searches from undoing each other.
    pivot = np.zeros(2) if at_laser > 0.0 else np.array([points[:, 0].mean(), points[:, 1].mean()])
    at = np.array([pivot[0], pivot[1], 0.0])
    best, used, evaluations, iterations, converged = np.inf, 0.0, 0, 0, 0.0
    for _ in range(MAX_ITERATIONS):
        iterations += 1
        step_rad = 2.0 * half_rad / (azimuths - 1)
        for _ in range(extensions + 1):
            # Minimisation, steps i and ii
            _turns(at, pivot, half_rad, turns, by_turn)
            if prune:
                part = _bound(scan, turns, by_turn, np.array([0.0, half_rad, at[0], at[1]]), work, turn_bounds)
            i, best, beams = _least(part, turns, turn_bounds, work)
            evaluations += azimuths
            if i >= 0:
                used, at[2] = beams, at[2] - half_rad + i * step_rad
            else:
                i = azimuths // 2
            if 0 < i < azimuths - 1:
                break
        for _ in range(extensions + 1):
            # Steps iii and iv
            _shifts(at, pivot, half_m, nx, shifts, by_shift)
            if prune:
                part = _bound(scan, shifts, by_shift, np.array([half_m, 0.0, at[0], at[1]]), work, bounds)
            ji, best, beams = _least(part, shifts, bounds, work)
            evaluations += nx * ny
            if ji >= 0:
                used, at[0], at[1] = beams, at[0] + by_shift[ji, 0], at[1] + by_shift[ji, 1]
            else:
                ji = ny // 2 * nx + nx // 2
            if 0 < ji % nx < nx - 1 and 0 < ji // nx < ny - 1:
                break
        # Step v; the grid's spacing bounds the change still to come, also where the centre stays the best.
        spacing = 2.0 * half_m / (min(nx, ny) - 1)
        fine_xy, fine_yaw = spacing < stop_m, step_rad < stop_rad
        if (fine_xy and fine_yaw) or (either > 0.0 and (fine_xy or fine_yaw)):
            converged = 1.0
            break
        if best == np.inf or np.sqrt(best) > np.sqrt(useless) + 2.0 * half_m:
            break
        half_m *= max(shrink, covered * min(spacing / half_m, 0.9))
        half_rad *= max(shrink, covered * min(step_rad / half_rad, 0.9))
        if occlusion_shrink < 1.0:
            smaller_m = max(scan[2][4] * occlusion_shrink, min(least_m, limits[4]))
            scan = part = virtual, scan[1], _at_occlusion(limits, smaller_m)
    c, s = np.cos(at[2]), np.sin(at[2])
    x, y = at[0] - c * pivot[0] + s * pivot[1], at[1] - s * pivot[0] - c * pivot[1]
    return np.array([x, y, at[2], best, used, evaluations, iterations, converged])
