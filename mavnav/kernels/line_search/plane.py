"""Search over a grid of shifts in the plane, with the yaw fixed."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.line_search.cost import ROUNDING_M2, Lines, Middle, SearchWindow, cost_sum, least, rotate
from mavnav.kernels.line_search.quadratic_form import quadratic_form
from mavnav.kernels.machine.jit import F64_1D, F64_2D, F64_3D, I64_1D, helper, int64, uint64
from mavnav.kernels.maps.lookup import slot_of

RECTANGLE_COST = 3
"""Cost of a polynomial on a rectangle of candidates, in candidates that are summed point by point."""


@helper
def _shift(ji: int, nx: int, ny: int, middle: Middle, window: SearchWindow) -> tuple[float, float, float]:
    """Return the centroid of candidate j nx + i of the plane, and the prior cost of its distance per point."""
    x = middle.x_m - window.half_m + (ji % nx) * (2 * window.half_m / (nx - 1))
    y = middle.y_m - window.half_m + (ji // nx) * (2 * window.half_m / (ny - 1))
    dx, dy = x - middle.expected_x_m, y - middle.expected_y_m
    return x, y, window.prior * (dx * dx + dy * dy)


@helper
def _integrate(diffs: F64_3D, right: F64_1D, up: F64_1D, sums: F64_2D) -> None:
    """Integrate second differences (ny, nx, 6) of polynomials, and add each candidate's value to ``sums``."""
    ny, nx = sums.shape
    flat = diffs.ravel()
    for m in range(6 * nx, len(flat)):
        flat[m] += flat[m - 6 * nx]
    for j in range(ny):
        v, p0, p_u, p_v, p_uu, p_uv, p_vv = up[j], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(nx):
            u = right[i]
            p0 += diffs[j, i, 0]
            p_u += diffs[j, i, 1]
            p_v += diffs[j, i, 2]
            p_uu += diffs[j, i, 3]
            p_uv += diffs[j, i, 4]
            p_vv += diffs[j, i, 5]
            sums[j, i] += p0 + u * (p_u + u * p_uu + v * p_uv) + v * (p_v + v * p_vv)


@helper
def _spans(p: float, origin: float, inverse: float, to: F64_1D, cells: I64_1D, starts: I64_1D) -> int:
    """Write the cells that a point reaches by evenly spaced moves along an axis, and the first move to each.

    After the last cell the number of moves is written. The operations are those of ``slot_at``. Returns the number of
    cells.
    """
    last = len(to) - 1
    first, end = (p + to[0] - origin) * inverse, np.floor((p + to[last] - origin) * inverse)
    per_cell, at, i, n = last / ((to[last] - to[0]) * inverse), np.floor(first), 0, 1
    cells[0], starts[0] = int64(at), 0
    while at < end:
        i = max(i, int64((at + 1.0 - first) * per_cell - 1e-6))
        there = at
        while there == at:
            i += 1
            there = np.floor((p + to[uint64(i)] - origin) * inverse)
        at = there
        cells[uint64(n)], starts[uint64(n)] = int64(at), i
        n += 1
    starts[uint64(n)] = last + 1
    return n


@helper
def _nodes(middle_m: float, half_m: float, count: int) -> tuple[F64_1D, F64_1D]:
    """Return the nodes of a grid along an axis, and their distances from its middle."""
    to, away = np.empty(count), np.empty(count)
    for i in range(count):
        to[i] = middle_m - half_m + i * (2 * half_m / (count - 1))
        away[i] = to[i] - middle_m
    return to, away


@helper
def shift_sums(points: F64_2D, middle: Middle, window: SearchWindow, sums: F64_2D, line_map: Lines) -> None:
    """Add the costs of all shifts of the rotated points to ``sums`` (ny, nx), exact except for rounding.

    Points that stay in their cells are summed in one quadratic form. For each other point, the candidates that put it
    into one cell form a rectangle, on which its cost is one polynomial of the shift. ``diffs`` are the second
    differences of the sum of these polynomials. Each rectangle adds its difference from the last one at its first
    corner, less ``steps``, the differences of the rectangles in the row before.
    """
    ny, nx = sums.shape
    nearest, lines, half_m, truncate_m2 = line_map.nearest, line_map.lines, window.half_m, window.truncate_m2
    at_x, at_y, c, s = middle.x_m, middle.y_m, np.cos(middle.yaw_rad), np.sin(middle.yaw_rad)
    truncate_m = np.sqrt(truncate_m2)
    (to_x, right), (to_y, up) = _nodes(at_x, half_m, nx), _nodes(at_y, half_m, ny)
    form, loose = np.zeros((5, 5)), np.empty(points.shape[1], np.int64)
    shifting = SearchWindow(half_m, 0.0, window.prior, truncate_m2, window.prune)
    loose_count = quadratic_form(points, middle, shifting, form, loose, line_map)
    diffs, steps = np.zeros((ny, nx, 6)), np.zeros((nx, 6))
    diffs[0, 0, 0], diffs[0, 0, 1], diffs[0, 0, 2] = form[0, 0], 2.0 * form[0, 3], 2.0 * form[0, 4]
    diffs[0, 0, 3], diffs[0, 0, 4], diffs[0, 0, 5] = form[3, 3], 2.0 * form[3, 4], form[4, 4]
    ox, oy, inverse = line_map.origin_x_m, line_map.origin_y_m, 1.0 / line_map.cell_m
    near, far = max(truncate_m - 1.5 * half_m, 0.0) ** 2, (truncate_m + 1.5 * half_m) ** 2
    flat, wide, last_col, last_row = nearest.ravel(), nearest.shape[1], nearest.shape[1] - 1, nearest.shape[0] - 1
    starts_i, starts_j = np.empty(nx + 1, np.int64), np.empty(ny + 1, np.int64)
    cols, rows = np.empty(nx, np.int64), np.empty(ny, np.int64)
    for m in range(loose_count):
        k = uint64(loose[uint64(m)])
        px, py = c * points[0, k] - s * points[1, k], s * points[0, k] + c * points[1, k]
        n_i = _spans(px, ox, inverse, to_x, cols, starts_i)
        n_j = _spans(py, oy, inverse, to_y, rows, starts_j)
        for r in range(n_j):
            j0, base = uint64(starts_j[uint64(r)]), min(max(rows[uint64(r)], 0), last_row) * wide
            l0 = l_u = l_v = l_uu = l_uv = l_vv = 0.0
            for q in range(n_i):
                i0 = uint64(starts_i[uint64(q)])
                line = uint64(slot_of(flat[uint64(base + min(max(cols[uint64(q)], 0), last_col))]))
                dx, dy = px + at_x - lines[line, 0], py + at_y - lines[line, 1]
                p_uu, b, p_vv = lines[line, 2], lines[line, 3], lines[line, 4]
                gx, gy = p_uu * dx + b * dy, b * dx + p_vv * dy
                p0, p_u, p_v, p_uv = dx * gx + dy * gy, 2.0 * gx, 2.0 * gy, 2.0 * b
                if p0 >= near:
                    always, a, d = p0 >= far, p_uu, p_vv
                    p0, p_u, p_v, p_uu, p_uv, p_vv = (truncate_m2 if always else 0.0), 0.0, 0.0, 0.0, 0.0, 0.0
                    for j in range(j0, j0 if always else uint64(starts_j[uint64(r + 1)])):
                        y = dy + up[j]
                        for i in range(i0, uint64(starts_i[uint64(q + 1)])):
                            x = dx + right[i]
                            sums[j, i] += min(x * x * a + 2.0 * x * y * b + y * y * d, truncate_m2)
                d0, d_u, d_v, d_uu, d_uv, d_vv = p0 - l0, p_u - l_u, p_v - l_v, p_uu - l_uu, p_uv - l_uv, p_vv - l_vv
                l0, l_u, l_v, l_uu, l_uv, l_vv = p0, p_u, p_v, p_uu, p_uv, p_vv
                before, bend = steps[uint64(q)], diffs[j0, i0]
                bend[0] += d0 - before[0]
                bend[1] += d_u - before[1]
                bend[2] += d_v - before[2]
                bend[3] += d_uu - before[3]
                bend[4] += d_uv - before[4]
                bend[5] += d_vv - before[5]
                before[0], before[1], before[2], before[3], before[4], before[5] = d0, d_u, d_v, d_uu, d_uv, d_vv
        for q in range(n_i):
            steps[uint64(q)] = 0.0
    _integrate(diffs, right, up, sums)


@helper
def least_shift(points: F64_2D, middle: Middle, window: SearchWindow, nx: int, ny: int, line_map: Lines) -> int:
    """Return the index j nx + i of the shift of least cost, with the lines found separately for every candidate."""
    n, pruned, truncate_m2 = points.shape[1], window.prune, window.truncate_m2
    by_cells = pruned and RECTANGLE_COST * (2 * window.half_m / line_map.cell_m + 1) ** 2 < nx * ny
    sums, near = np.zeros((ny, nx)), np.inf
    costs = sums.ravel()
    if by_cells:
        shift_sums(points, middle, window, sums, line_map)
        near, alone = least(costs)
        if alone >= 0:
            return alone
    x, y = np.empty(n), np.empty(n)
    rotate(points, middle.yaw_rad, x, y)
    best, best_ji = np.inf, -1
    for turn in range(-1 if pruned and not by_cells else 0, nx * ny):
        ji = (ny // 2) * nx + nx // 2 if turn < 0 else turn
        if costs[ji] > near:
            continue
        to_x, to_y, prior = _shift(ji, nx, ny, middle, window)
        expected = n * prior
        bound = best - expected + ROUNDING_M2 if pruned else np.inf
        cost = expected + cost_sum(x, y, to_x, to_y, truncate_m2, line_map, bound)
        if cost < best or (cost == best and ji < best_ji):
            best, best_ji = cost, ji
    return best_ji
