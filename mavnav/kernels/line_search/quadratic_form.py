"""Fixed correspondences: one quadratic form of the motion replaces all points whose lines do not change."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.line_search.cost import Lines, Middle, SearchWindow
from mavnav.kernels.machine.jit import F64_2D, I64_1D, float64, helper, int32, int64, uint64
from mavnav.kernels.maps.lookup import slot_of

LANES = 32
"""Number of SIMD lanes of sums over points: several are added at a time in an unchanged order."""


@helper
def _fold(sums: F64_2D) -> None:
    """Sum the lanes of each row into its first one."""
    half = LANES // 2
    while half:
        for row in range(len(sums)):
            for k in range(half):
                sums[row, k] += sums[row, k + half]
        half //= 2


@helper
def quadratic_form(
    points: F64_2D, middle: Middle, window: SearchWindow, form: F64_2D, loose: I64_1D, line_map: Lines
) -> int:
    """Write the quadratic form (5, 5) of the cost sum in (1, cos - 1, sin, right, up) of a motion from the middle.

    Every point keeps its line at the middle, or stays truncated. If ``loose`` (n,) has space, points that the window
    moves to another cell, or across the truncation, are left out and listed there; returns their number. Only the upper
    triangle is written.
    """
    nearest, lines = line_map.nearest, line_map.lines
    n, fixes_all, loose_count = points.shape[1], len(loose) == 0, 0
    ox, oy, cell, inverse = line_map.origin_x_m, line_map.origin_y_m, line_map.cell_m, 1.0 / line_map.cell_m
    half_m, half_rad, truncate_m2 = window.half_m, window.half_rad, window.truncate_m2
    truncate_m = np.sqrt(truncate_m2)
    flat, wide = nearest.ravel(), float64(nearest.shape[1])
    last_col, last_row = nearest.shape[1] - 1.0, nearest.shape[0] - 1.0
    at_x, at_y, c, s = middle.x_m, middle.y_m, np.cos(middle.yaw_rad), np.sin(middle.yaw_rad)
    from_x, from_y = points[0], points[1]
    where, p, g = np.empty(LANES, np.int32), np.empty((9, LANES)), np.zeros((15, LANES))
    for first in range(0, n, LANES):
        block = min(LANES, n - first)
        for k in range(block):
            x, y = from_x[first + k], from_y[first + k]
            ex, ey = c * x - s * y, s * x + c * y
            fx, fy = (at_x + ex - ox) * inverse, (at_y + ey - oy) * inverse
            col, row = np.floor(fx), np.floor(fy)
            p[0, k], p[1, k] = ex, ey
            p[7, k] = min(fx - col, 1.0 - (fx - col), fy - row, 1.0 - (fy - row)) * cell
            where[k] = int32(min(max(row, 0.0), last_row) * wide + min(max(col, 0.0), last_col))
        for k in range(block):
            line = uint64(slot_of(flat[uint64(where[k])]))
            p[2, k], p[3, k] = lines[line, 0], lines[line, 1]
            p[4, k], p[5, k], p[6, k] = lines[line, 2], lines[line, 3], lines[line, 4]
        for k in range(block):
            ex, ey = p[0, k], p[1, k]
            dx, dy = at_x + ex - p[2, k], at_y + ey - p[3, k]
            a, b, d = p[4, k], p[5, k], p[6, k]
            hx, hy = a * dx + b * dy, b * dx + d * dy
            d2 = dx * hx + dy * hy
            # The eigenvalues are at most 1: the distance to the line changes by at most the motion of the point.
            move = half_m + half_rad * (abs(ex) + abs(ey)) + 1e-9
            near, far = max(truncate_m - 1.5 * move, 0.0), truncate_m + 1.5 * move
            stays = 1.0 if fixes_all or (p[7, k] > move and (d2 < near * near or d2 >= far * far)) else 0.0
            p[8, k] = stays
            kept = stays if d2 < truncate_m2 else 0.0
            a, b, d, hx, hy = kept * a, kept * b, kept * d, kept * hx, kept * hy
            # The point moves by (cos - 1) e + sin e' + (right, up), where e' is perpendicular to e.
            ax, ay = a * ex + b * ey, b * ex + d * ey
            bx, by = b * ex - a * ey, d * ex - b * ey
            g[0, k] += stays * min(d2, truncate_m2)
            g[1, k] += ex * hx + ey * hy
            g[2, k] += ex * hy - ey * hx
            g[3, k] += hx
            g[4, k] += hy
            g[5, k] += ex * ax + ey * ay
            g[6, k] += ex * bx + ey * by
            g[7, k] += ax
            g[8, k] += ay
            g[9, k] += ex * by - ey * bx
            g[10, k] += bx
            g[11, k] += by
            g[12, k] += a
            g[13, k] += b
            g[14, k] += d
        if not fixes_all:
            for k in range(block):
                loose[uint64(loose_count)] = first + k  # overwritten unless the point is loose
                loose_count += p[8, k] == 0.0
    _fold(g)
    m = 0
    for i in range(5):
        for j in range(i, 5):
            form[i, j] = g[m, 0]
            m += 1
    prior, ux, uy = n * window.prior, at_x - middle.expected_x_m, at_y - middle.expected_y_m
    form[0, 0] += prior * (ux * ux + uy * uy)
    form[0, 3] += prior * ux
    form[0, 4] += prior * uy
    form[3, 3] += prior
    form[4, 4] += prior
    return loose_count


@helper
def least_of_form(form: F64_2D, window: SearchWindow, turns: F64_2D, nx: int, ny: int) -> int:
    """Return the index (a ny + j) nx + i of the least value over yaw samples, ups and rights.

    Along a row the form is a parabola with its minimum at one of the two nodes around its vertex.
    """
    half_m, azimuths, a, best, best_at = window.half_m, turns.shape[1], form[3, 3], np.inf, 0
    step_x, step_y, last = 2 * half_m / (nx - 1), 2 * half_m / (ny - 1), nx - 1.0
    by_vertex, per_a = window.prune and a > 0.0, 1.0 / a
    k0, kx, ky = np.empty(azimuths), np.empty(azimuths), np.empty(azimuths)
    for turn in range(azimuths):
        c, s = turns[0, turn], turns[1, turn]
        k0[turn] = form[0, 0] + 2.0 * (c * form[0, 1] + s * form[0, 2] + c * s * form[1, 2])
        k0[turn] += c * c * form[1, 1] + s * s * form[2, 2]
        kx[turn] = form[0, 3] + c * form[1, 3] + s * form[2, 3]
        ky[turn] = form[0, 4] + c * form[1, 4] + s * form[2, 4]
    values, first = np.empty(azimuths), np.empty(azimuths)
    for j in range(ny):
        y = j * step_y - half_m
        for i in range(1 if by_vertex else nx):
            for turn in range(azimuths):
                low, b = k0[turn] + y * (2.0 * ky[turn] + y * form[4, 4]), kx[turn] + y * form[3, 4]
                left = np.floor(min(max((half_m - b * per_a) / step_x, 0.0), last)) if by_vertex else float64(i)
                x = left * step_x - half_m
                value = low + x * (2.0 * b + x * a)
                x = min(left + 1.0, last) * step_x - half_m
                other = low + x * (2.0 * b + x * a)
                values[turn] = min(value, other)
                first[turn] = left if value <= other else min(left + 1.0, last)
            for turn in range(azimuths):
                index = (turn * ny + j) * nx + int64(first[turn])
                if values[turn] < best or (values[turn] == best and index < best_at):
                    best, best_at = values[turn], index
    return best_at
