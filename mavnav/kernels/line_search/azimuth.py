"""Search over yaw samples, with the position fixed."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.line_search.cost import Lines, Middle, SearchWindow, cost_sum, least, mean_absolute, rotate
from mavnav.kernels.line_search.quadratic_form import quadratic_form
from mavnav.kernels.machine.jit import F64_1D, F64_2D, I64_1D, float64, helper, int64, uint64
from mavnav.kernels.maps.lookup import slot_of

ARC_COST = 30
"""Cost of the polynomials along an arc of two cells, in yaw samples that are summed point by point."""


@helper
def turns_of(half_rad: float, azimuths: int) -> F64_2D:
    """Return cosine - 1 and sine of the turns of the yaw samples from the middle, (2, azimuths)."""
    out = np.empty((2, azimuths))
    for i in range((azimuths + 1) // 2):
        turn = i * (2 * half_rad / (azimuths - 1)) - half_rad
        out[0, i], out[1, azimuths - 1 - i] = -2.0 * np.sin(0.5 * turn) ** 2, -np.sin(turn)
        out[0, azimuths - 1 - i], out[1, i] = out[0, i], np.sin(turn)
    return out


@helper
def _runs(cells: F64_1D, starts: I64_1D) -> int:
    """Write the starts of runs of equal cells, and after them the number of cells; return the number of runs."""
    n, last = 0, len(cells) - 1
    starts[0] = 0
    for i in range(last):
        starts[uint64(n + 1)] = i + 1  # overwritten unless a run starts there
        n += cells[uint64(i)] != cells[uint64(i + 1)]
    starts[uint64(n + 1)] = last + 1
    return n + 1


@helper
def turn_sums(
    points: F64_2D, middle: Middle, window: SearchWindow, turns: F64_2D, sums: F64_1D, line_map: Lines
) -> None:
    """Add the costs of all yaw samples to ``sums`` (azimuths,), exact except for rounding.

    Points that stay in their cells are summed in one quadratic form. The polynomial of each other point changes from
    cell to cell along its arc: ``diffs`` are the changes of their sum from one yaw sample to the next.
    """
    nearest, lines, half_rad, truncate_m2 = line_map.nearest, line_map.lines, window.half_rad, window.truncate_m2
    azimuths, truncate_m = len(sums), np.sqrt(truncate_m2)
    form, loose = np.zeros((5, 5)), np.empty(points.shape[1], np.int64)
    turning = SearchWindow(0.0, half_rad, window.prior, truncate_m2, window.prune)
    loose_count = quadratic_form(points, middle, turning, form, loose, line_map)
    cos, sin, less_1, turn = np.empty(azimuths), np.empty(azimuths), turns[0], turns[1]
    for i in range(azimuths if loose_count else 0):
        yaw = middle.yaw_rad - half_rad + i * (2 * half_rad / (azimuths - 1))
        cos[i], sin[i] = np.cos(yaw), np.sin(yaw)
    at_x, at_y, c, s = middle.x_m, middle.y_m, np.cos(middle.yaw_rad), np.sin(middle.yaw_rad)
    ox, oy, inverse = line_map.origin_x_m, line_map.origin_y_m, 1.0 / line_map.cell_m
    flat, wide = nearest.ravel(), float64(nearest.shape[1])
    last_col, last_row = nearest.shape[1] - 1.0, nearest.shape[0] - 1.0
    diffs, cells, starts = np.zeros((azimuths + 1, 6)), np.empty(azimuths), np.empty(azimuths + 1, np.int64)
    diffs[0, 0], diffs[0, 1], diffs[0, 2] = form[0, 0], form[0, 1], form[0, 2]
    diffs[0, 3], diffs[0, 4], diffs[0, 5] = form[1, 1], form[1, 2], form[2, 2]
    for n in range(loose_count):
        k = uint64(loose[uint64(n)])
        from_x, from_y = points[0, k], points[1, k]
        for i in range(azimuths):
            # The same operations as in ``slot_at``, so that both find the same cell for every candidate.
            fx = np.floor((cos[i] * from_x - sin[i] * from_y + at_x - ox) * inverse)
            fy = np.floor((sin[i] * from_x + cos[i] * from_y + at_y - oy) * inverse)
            cells[i] = min(max(fy, 0.0), last_row) * wide + min(max(fx, 0.0), last_col)
        ex, ey = c * from_x - s * from_y, s * from_x + c * from_y
        move = 1.5 * half_rad * (abs(ex) + abs(ey)) + 1e-9
        near, far = max(truncate_m - move, 0.0) ** 2, (truncate_m + move) ** 2
        b0 = b_c = b_s = b_cc = b_cs = b_ss = 0.0
        for run in range(_runs(cells, starts)):
            i0, i1 = uint64(starts[uint64(run)]), uint64(starts[uint64(run + 1)])
            line = uint64(slot_of(flat[uint64(int64(cells[i0]))]))
            dx, dy = at_x + ex - lines[line, 0], at_y + ey - lines[line, 1]
            a, b, d = lines[line, 2], lines[line, 3], lines[line, 4]
            # The rotated point is d + (cos - 1) e + sin e', where e' is perpendicular to e.
            gx, gy = a * dx + b * dy, b * dx + d * dy
            hx, hy = a * ex + b * ey, b * ex + d * ey
            p0, p_c, p_s = dx * gx + dy * gy, ex * gx + ey * gy, ex * gy - ey * gx
            p_cc, p_cs = ex * hx + ey * hy, ex * hy - ey * hx
            p_ss = a * ey * ey - 2.0 * b * ex * ey + d * ex * ex
            if p0 >= near:
                always = p0 >= far
                p0, p_c, p_s, p_cc, p_cs, p_ss = (truncate_m2 if always else 0.0), 0.0, 0.0, 0.0, 0.0, 0.0
                for i in range(i0, i0 if always else i1):
                    qx, qy = dx + less_1[i] * ex - turn[i] * ey, dy + less_1[i] * ey + turn[i] * ex
                    sums[i] += min(qx * qx * a + 2.0 * qx * qy * b + qy * qy * d, truncate_m2)
            diffs[i0, 0] += p0 - b0
            diffs[i0, 1] += p_c - b_c
            diffs[i0, 2] += p_s - b_s
            diffs[i0, 3] += p_cc - b_cc
            diffs[i0, 4] += p_cs - b_cs
            diffs[i0, 5] += p_ss - b_ss
            b0, b_c, b_s, b_cc, b_cs, b_ss = p0, p_c, p_s, p_cc, p_cs, p_ss
    k0 = k_c = k_s = k_cc = k_cs = k_ss = 0.0
    for i in range(azimuths):
        u, v = less_1[i], turn[i]
        k0 += diffs[i, 0]
        k_c += diffs[i, 1]
        k_s += diffs[i, 2]
        k_cc += diffs[i, 3]
        k_cs += diffs[i, 4]
        k_ss += diffs[i, 5]
        sums[i] += k0 + 2.0 * (u * k_c + v * k_s) + u * u * k_cc + 2.0 * u * v * k_cs + v * v * k_ss


@helper
def least_turn(points: F64_2D, middle: Middle, window: SearchWindow, turns: F64_2D, line_map: Lines) -> int:
    """Return the index of the yaw sample of least cost, with the lines found separately for every candidate."""
    azimuths, half_rad, pruned = turns.shape[1], window.half_rad, window.prune
    sums, step, near = np.zeros(azimuths), 2 * half_rad / (azimuths - 1), np.inf
    by_cells = pruned and ARC_COST * half_rad * mean_absolute(points) < azimuths * line_map.cell_m
    if by_cells:
        turn_sums(points, middle, window, turns, sums, line_map)
        near, alone = least(sums)
        if alone >= 0:
            return alone
    x, y = np.empty(points.shape[1]), np.empty(points.shape[1])
    best, best_i = np.inf, azimuths
    # Without sums the middle is evaluated first: few other costs are below its bound.
    for turn in range(-1 if pruned and not by_cells else 0, azimuths):
        i = azimuths // 2 if turn < 0 else turn
        if sums[i] > near:
            continue
        rotate(points, middle.yaw_rad - half_rad + i * step, x, y)
        bound = best if pruned else np.inf
        cost = cost_sum(x, y, middle.x_m, middle.y_m, window.truncate_m2, line_map, bound)
        if cost < best or (cost == best and i < best_i):
            best, best_i = cost, i
    return int(best_i)
