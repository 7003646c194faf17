"""The cost of a scan at every one of many poses: correlative search (Olson 2009; docs/method.md)."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, U32_2D, Out, float64, helper, int32, int64, kernel, uint64
from mavnav.kernels.maps.lookup import line_distance2, slot_of

BLOCK = 1024  # positions at a time: their data stay in the processor's cache


@helper
def pose_cost(
    points: F64_2D,
    xy_map_m: F64_1D,
    yaw_rad: float,
    truncate_m: float,
    nearest: U32_2D,
    lines: F64_2D,
    geometry: F64_1D,
) -> float:
    """Return the cost of ``pose_costs`` at one pose, bit for bit."""
    (rows, cols), (x, y) = nearest.shape, xy_map_m
    ox, oy, cell_m, _, _, _ = geometry
    inverse, truncate_m2, total = 1.0 / cell_m, truncate_m * truncate_m, 0.0
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    for k in range(len(points)):
        kx, ky = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        fx, fy = (kx + x - ox) * inverse, (ky + y - oy) * inverse
        d2 = truncate_m2
        if (fx >= 0.0) & (fy >= 0.0) & (fx < cols) & (fy < rows):
            slot = int64(slot_of(nearest[int32(fy), int32(fx)]))
            if slot > 0:
                d2 = line_distance2(kx + x, ky + y, truncate_m2, slot, lines)
        total += d2
    return total / len(points)


@kernel
def pose_costs(
    points: F64_2D,
    xy_map_m: F64_2D,
    yaws_rad: F64_1D,
    truncate_m: float,
    nearest: U32_2D,
    lines: F64_2D,
    geometry: F64_1D,
) -> F64_2D:
    """Return the mean truncated squared distance to the map's lines, m2, for all yaws (q) and positions (p): (q, p).

    ``points`` (n, 2) are in the laser frame, m; the map's arrays are described in ``linemap``. Most cells have no wall
    near. So the cells of one point are first computed for a block of positions, in SIMD lanes, and then read.
    """
    (rows, cols), n, m = nearest.shape, len(points), len(xy_map_m)
    ox, oy, cell_m, _, _, _ = geometry
    inverse, truncate_m2 = 1.0 / cell_m, truncate_m * truncate_m
    out, x, y = np.zeros((len(yaws_rad), m)), np.empty(BLOCK), np.empty(BLOCK)
    cells, flat, wide = np.empty(BLOCK, np.int32), nearest.ravel(), float64(cols)
    last_row, last_col = rows - 1.0, cols - 1.0
    for first in range(0, m, BLOCK):
        some = min(BLOCK, m - first)
        for p in range(some):
            x[p], y[p] = xy_map_m[first + p, 0], xy_map_m[first + p, 1]
        for q in range(len(yaws_rad)):
            c, s, sums = np.cos(yaws_rad[q]), np.sin(yaws_rad[q]), out[q, first : first + some]
            for k in range(n):
                kx, ky = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
                for p in range(some):  # outside, the edge counts, where no wall is near
                    fx, fy = (kx + x[p] - ox) * inverse, (ky + y[p] - oy) * inverse
                    row, col = np.floor(min(max(fy, 0.0), last_row)), min(max(fx, 0.0), last_col)
                    cells[p] = int32(row * wide + col)
                for p in range(some):
                    slot = int64(slot_of(flat[uint64(cells[uint64(p)])]))
                    sums[p] += line_distance2(kx + x[p], ky + y[p], truncate_m2, slot, lines)
            for p in range(some):
                sums[p] /= n
    return out


@helper
def is_same(moved_m: tuple[float, float], turned_rad: float, separate: F64_1D) -> bool:
    """Return whether two poses are the same minimum: both distance and rotation are below ``separate`` (m, rad)."""
    turn = abs((turned_rad + np.pi) % (2 * np.pi) - np.pi)
    return bool(turn < separate[1] and np.hypot(moved_m[0], moved_m[1]) < separate[0])


@kernel
def separate_minima(costs_m2: Out[F64_2D], xy_map_m: F64_2D, yaws_rad: F64_1D, separate: F64_1D, most: int) -> F64_2D:
    """Return the ``most`` lowest separate minima of ``pose_costs``: cost (m2), index of yaw and of position, (m, 3).

    Each is the lowest of the finite costs that is not the same minimum as one before it, by ``separate`` (m, rad); of
    equal costs the first. The costs around them are overwritten.
    """
    (yaws, positions), minima, n = costs_m2.shape, np.empty((most, 3)), 0
    while n < most:
        best, at_q, at_p = np.inf, 0, 0
        for q in range(yaws):
            for p in range(positions):
                if costs_m2[q, p] < best:
                    best, at_q, at_p = costs_m2[q, p], q, p
        if best == np.inf:
            break
        minima[n, 0], minima[n, 1], minima[n, 2] = best, at_q, at_p
        n += 1
        for q in range(yaws):
            turned_rad = yaws_rad[q] - yaws_rad[at_q]
            if not is_same((0.0, 0.0), turned_rad, separate):
                continue
            for p in range(positions):
                moved_m = xy_map_m[p, 0] - xy_map_m[at_p, 0], xy_map_m[p, 1] - xy_map_m[at_p, 1]
                if is_same(moved_m, 0.0, separate):
                    costs_m2[q, p] = np.inf
    return minima[:n].copy()
