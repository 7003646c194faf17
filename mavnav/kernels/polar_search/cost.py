"""The paper's cost function (steps iii-xi) in polar coordinates, and the beams of a scan that it uses (step vii).

``motion`` (5,) is cosine and sine of the turn, shift in x and y (m) and turn (rad), from the virtual scan's pose.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, I32_1D, helper, int32, int64, kernel, uint64


class Limits(NamedTuple):
    """Limits of the beams in the cost.

    Bearing of beam 0 and bearing step (rad); near, far, occlusion threshold, range jump between surfaces (m); minimum
    number of beams; whether occluded beams count with the squared threshold, or are left out.
    """

    first_rad: float
    step_rad: float
    near_m: float
    far_m: float
    occlusion_m: float
    edge_m: float
    fewest_beams: float
    counted: bool


class Beams(NamedTuple):
    """The virtual ranges (beams,), the points of the scan (6, n), and the limits.

    The rows of points are x, y, beam number, range, bearing, and 1 if a point and the one before are on one surface.
    """

    virtual: F64_1D
    points: F64_2D
    limits: Limits


class Work(NamedTuple):
    """Scratch arrays: range and beam number of the moved points; results of ``span`` for the segments before them.

    ``seen`` and ``squares`` are the ranges in which beams meet the moved points, and the squared differences.
    """

    r: F64_1D
    beam: F64_1D
    value: F64_1D
    slope: F64_1D
    first: I32_1D
    more: I32_1D
    seen: F64_1D
    squares: F64_1D


@kernel
def good_beams(ranges_m: F64_1D, directions: F64_2D, first_rad: float, step_rad: float, mixed_pixel_m: float) -> F64_2D:
    """Return the valid beams as rows x, y, beam number, range, bearing (n, 5), in m and rad.

    ``ranges_m`` (beams,) are NaN without a return, ``directions`` (beams, 2) the beams' cosines and sines. Beams that
    differ from both their neighbours by more than ``mixed_pixel_m`` are left out.
    """
    last, count, out = len(ranges_m) - 1, 0, np.empty((len(ranges_m), 5))
    for i in range(last + 1):
        r = ranges_m[i]
        # Cost function, step vii: mixed pixels are left out.
        alone = 0 < i < last and abs(r - ranges_m[i - 1]) > mixed_pixel_m and abs(r - ranges_m[i + 1]) > mixed_pixel_m
        if alone or not np.isfinite(r):
            continue
        out[count, 0], out[count, 1] = r * directions[i, 0], r * directions[i, 1]
        out[count, 2], out[count, 3], out[count, 4] = i, r, first_rad + step_rad * i
        count += 1
    return out[:count].copy()


@helper
def limits_of(limits: F64_1D) -> Limits:
    """Return the limits (8,) of ``polar_cost`` as a record."""
    first_rad, step_rad, near_m, far_m, occlusion_m, edge_m, fewest_beams, counted = limits
    return Limits(first_rad, step_rad, near_m, far_m, occlusion_m, edge_m, fewest_beams, counted > 0.0)


@helper
def scan_of(virtual: F64_1D, points: F64_2D, limits: Limits) -> Beams:
    """Return a scan of virtual ranges (beams,) and points (5, n)."""
    return Beams(virtual.copy(), _mark_surfaces(points, limits.edge_m), limits)


@helper
def work_for(points: int, beams: int) -> Work:
    """Return scratch arrays for these numbers of points and beams."""
    r, beam, value, slope = np.empty(points), np.empty(points), np.empty(points), np.empty(points)
    first, more = np.empty(points, np.int32), np.empty(points, np.int32)
    return Work(r, beam, value, slope, first, more, np.empty(beams), np.empty(beams))


@helper
def _mark_surfaces(points: F64_2D, edge: float) -> F64_2D:
    """Return points (5, n) with one more row: 1 if a point and the one before are on one surface."""
    out = np.zeros((6, points.shape[1]))
    for row in range(5):
        for k in range(points.shape[1]):
            out[row, k] = points[row, k]
    for k in range(1, points.shape[1]):
        out[5, k] = (points[2, k] == points[2, k - 1] + 1.0) & (abs(points[3, k] - points[3, k - 1]) < edge)
    return out


@helper
def to_polar(points: F64_2D, motion: F64_1D, limits: Limits, r: F64_1D, beam: F64_1D) -> None:
    """Write range and beam number of the moved points.

    Between neighbouring poses a point's bearing changes little, so that a series of the tangent is accurate to 1e-11.
    The loop has no branches, so that it uses SIMD lanes; points with larger changes are processed afterwards.
    """
    c, s, x, y, yaw = motion
    per_step, turn = 1.0 / limits.step_rad, 2.0 * np.pi / abs(limits.step_rad)
    per_turn, first, wide = 1.0 / turn, limits.first_rad, 0
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


@helper
def span(scan: Beams, work: Work) -> None:
    """Write the range in which the first virtual beam meets the segment before each point, and the segment's slope.

    Segments are between neighbouring beams on one surface, with their front towards the virtual laser (step iv). The
    integers are that beam's number and the number of further beams that meet the segment, -1 if it crosses the seam.
    """
    r, beam, value, slope, first, more = work.r, work.beam, work.value, work.slope, work.first, work.more
    joined, turn, last = scan.points[5], 2.0 * np.pi / abs(scan.limits.step_rad), len(scan.virtual) - 1.0
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


@helper
def lower_ranges(scan: Beams, work: Work, seen: F64_1D) -> None:
    """Lower the range in which each virtual beam meets the moved points: nearer surfaces hide farther ones."""
    r, beam, value, slope, first, more = work.r, work.beam, work.value, work.slope, work.first, work.more
    beams, turn = len(seen), 2.0 * np.pi / abs(scan.limits.step_rad)
    for k in range(1, scan.points.shape[1]):
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
            start -= turn  # the segment continues at beam 0


@helper
def _compare(virtual: F64_1D, limits: Limits, seen: F64_1D, squares: F64_1D) -> tuple[float, float]:
    """Return the sum of the squared differences of the contributing beams, and their number.

    The bounds of the pruned search apply step viii as well: ``polynomial``, ``fixed_beams``, ``wide_bounds``.
    """
    near, far, occlusion, counted = limits.near_m, limits.far_m, limits.occlusion_m, limits.counted
    total, used = 0.0, 0
    for j in range(len(virtual)):
        # Cost step ix: empty cells match nothing. vi: too close or too far. v: the squared difference.
        # viii: a difference above the threshold is an occlusion.
        v, d = virtual[j], seen[j] - virtual[j]
        both = (near < v) & (v < far) & (near < seen[j]) & (seen[j] < far)
        same = abs(d) < occlusion
        squares[j] = d * d if both & same else (occlusion * occlusion if both & counted else 0.0)
        used += both & (same | counted)
    for j in range(len(virtual)):
        total += squares[j]
    return total, float(used)


@helper
def evaluate(scan: Beams, motion: F64_1D, work: Work) -> tuple[float, float]:
    """Return the cost and the number of beams in it, see ``polar_cost``."""
    (virtual, points, limits), n = scan, scan.points.shape[1]
    # Cost function, step iii
    to_polar(points, motion, limits, work.r[:n], work.beam[:n])
    # Step iv
    seen = work.seen[: len(virtual)]
    seen[:] = np.inf
    span(scan, work)
    lower_ranges(scan, work, seen)
    total, used = _compare(virtual, limits, seen, work.squares[: len(virtual)])
    # Steps x and xi
    if used < limits.fewest_beams or used == 0.0:
        return np.inf, used
    return total / used, used


@kernel
def polar_cost(virtual: F64_1D, points: F64_2D, x: float, y: float, yaw: float, limits: F64_1D) -> tuple[float, float]:
    """Return the mean squared range difference (m2) of virtual and roto-translated scan, and the number of its beams.

    Parameters
    ----------
    virtual : (beams,) ranges of the virtual scan, m, NaN where it saw no cell
    points : (5, n) the scan's valid points in beam order: x, y (m), beam number, its range (m) and bearing (rad)
    x, y, yaw : proposed motion from the virtual scan's pose, m, rad
    limits : (8,) bearing of beam 0 and bearing step (rad); near, far, occlusion threshold, range jump between
        surfaces (m); minimum number of beams; 1 if occluded beams count with the squared threshold, 0 if they are left
        out

    The cost is inf if fewer beams than the minimum contribute.
    """
    scan = scan_of(virtual, points, limits_of(limits))
    motion = np.array([np.cos(yaw), np.sin(yaw), x, y, yaw])
    return evaluate(scan, motion, work_for(points.shape[1], len(virtual)))
