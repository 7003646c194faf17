"""Coarse-to-fine search over grids for the pose that lays a scan's points on the map (docs/method.md).

Grids are searched in turn as in the paper's minimisation, steps i-v: azimuth with the position fixed, then the plane
with the azimuth fixed; the scan turns about its points' centroid. A point costs its squared distance to the line of the
cell that it falls into (arrays of ``linemap``). In between, while the window is a few cells wide, every point holds
the line that it has in the middle: then one quadratic form stands for a joint grid of azimuth and plane.

Every grid has an exhaustive and a pruned form with the same minimum: the same index, the lowest of equals, and the
same cost, bit for bit. Pruning rests on three facts:

* a sum of squares that exceeds the best total so far only grows: the rest of that candidate is left out;
* while a point stays in one cell its cost is a polynomial of the motion, so that a few sums over the points stand for
  all candidates: nearly, but for rounding, and what comes within `ROUNDING_M2` of the best is summed point by point;
* a metric's eigenvalues are 1 at most, so that the distance to a line's centroid tells where nothing is truncated.

Shared arguments of the grids: ``points`` (2, n) about their centroid, m; ``at`` (5,) centroid x, y (m) and yaw (rad) in
the middle of the grid, and where the centroid was expected; ``window`` (5,) half-windows (m, rad), cost of a squared
metre from there, truncation (m2), 1 to prune.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import float64, int32, int64, types, uint8, uint64, void

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_LEVELS = 40
FEWEST_DRAWN = 0.5  # share of the points below which even those on new ground decide
CHUNK = 32  # points between two looks at the bound
RECTANGLE_COST = 3  # of a polynomial on a rectangle of candidates, in candidates summed point by point
ARC_COST = 30  # of the polynomials along an arc of two cells, in azimuths summed point by point
ROUNDING_M2 = 1e-9  # above any difference between two orders of summation, as long as maps are smaller than 100 km

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)
_I2 = types.Array(int32, 2, "C", readonly=True)
_U2 = types.Array(uint8, 2, "C", readonly=True)


@kernel(void(_F2, float64, float64[::1], float64[::1]))
def _rotate(points: NDArray[np.float64], yaw: float, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    c, s = np.cos(yaw), np.sin(yaw)
    from_x, from_y = points[0], points[1]
    for k in range(len(x)):
        x[k] = c * from_x[k] - s * from_y[k]
        y[k] = s * from_x[k] + c * from_y[k]


@kernel(float64(int64, int64, int64, _F1, _F1, float64[::1]))
def _place(
    ji: int, nx: int, ny: int, at: NDArray[np.float64], window: NDArray[np.float64], offset: NDArray[np.float64]
) -> float:
    """Write the centroid of candidate j nx + i of the plane to ``offset``; returns what its distance costs a point."""
    offset[0] = at[0] - window[0] + (ji % nx) * (2 * window[0] / (nx - 1))
    offset[1] = at[1] - window[0] + (ji // nx) * (2 * window[0] / (ny - 1))
    dx, dy = offset[0] - at[3], offset[1] - at[4]
    return float(window[2] * (dx * dx + dy * dy))


# ---- the local lines -------------------------------------------------------------------------------------------------


@kernel(float64(float64, float64, float64, int64, _F2))
def _distance2(px: float, py: float, truncate_m2: float, slot: int, lines: NDArray[np.float64]) -> float:
    """Squared, truncated distance of a point of the map frame to a line; ``slot`` 0 is nowhere."""
    line = uint64(slot)
    dx, dy = px - lines[line, 0], py - lines[line, 1]
    d2 = dx * dx * lines[line, 2] + 2.0 * dx * dy * lines[line, 3] + dy * dy * lines[line, 4]
    return float(min(d2, truncate_m2))


@kernel(int64(float64, float64, float64, float64, float64, _I2))
def _slot_at(px: float, py: float, ox: float, oy: float, inverse: float, nearest: NDArray[np.int32]) -> int:
    """Return the line that a point of the map frame belongs to; beyond the edge what is there: 0, nowhere."""
    fx, fy = (px - ox) * inverse, (py - oy) * inverse
    col = int64(min(max(fx, 0.0), nearest.shape[1] - 1.0))
    row = int64(min(max(fy, 0.0), nearest.shape[0] - 1.0))
    return int(nearest[uint64(row), uint64(col)])


@kernel(float64(float64[::1], float64[::1], _F1, float64, _I2, _F2, _F1, float64))
def _cost_sum(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    offset: NDArray[np.float64],
    truncate_m2: float,
    nearest: NDArray[np.int32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
    bound: float,
) -> float:
    """Sum of the points' squared, truncated distances to their lines; gives up once it exceeds ``bound``."""
    ox, oy, inverse = geometry[0], geometry[1], 1.0 / geometry[2]
    to_x, to_y = offset[0], offset[1]
    total, k = 0.0, 0
    while k < len(x) and total <= bound:
        for m in range(k, min(k + CHUNK, len(x))):
            px, py = x[m] + to_x, y[m] + to_y
            total += _distance2(px, py, truncate_m2, _slot_at(px, py, ox, oy, inverse, nearest), lines)
        k += CHUNK
    return total


@kernel(int64(float64[::1], int64[::1]))
def _runs(cells: NDArray[np.float64], starts: NDArray[np.int64]) -> int:
    """Write where runs of equal cells start, and behind them the number of cells; returns how many runs there are."""
    n, last = 0, len(cells) - 1
    starts[0] = 0
    for i in range(last):
        starts[uint64(n + 1)] = i + 1  # written over unless a run starts there
        n += cells[uint64(i)] != cells[uint64(i + 1)]
    starts[uint64(n + 1)] = last + 1
    return n + 1


@kernel(void(_F2, _F1, _F1, float64[::1], _I2, _F2, _F1))
def _turn_sums(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    window: NDArray[np.float64],
    sums: NDArray[np.float64],
    nearest: NDArray[np.int32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> None:
    """Sum the costs of all azimuths into ``sums`` (azimuths,), right but for rounding.

    While a point is in one cell its cost is quadratic in the cosine - 1 and the sine of the turn from the middle.
    ``bends`` hold by how much the sum of these polynomials changes from one azimuth to the next.
    """
    azimuths, step, truncate_m2 = len(sums), 2 * window[1] / (len(sums) - 1), window[3]
    cos, sin, less_1, turn = np.empty(azimuths), np.empty(azimuths), np.empty(azimuths), np.empty(azimuths)
    for i in range(azimuths):
        yaw, by = at[2] - window[1] + i * step, i * step - window[1]
        cos[i], sin[i], less_1[i], turn[i] = np.cos(yaw), np.sin(yaw), -2.0 * np.sin(0.5 * by) ** 2, np.sin(by)
    at_x, at_y, ox, oy, inverse = at[0], at[1], geometry[0], geometry[1], 1.0 / geometry[2]
    wide = uint64(nearest.shape[1])
    c, s = np.cos(at[2]), np.sin(at[2])
    flat, last_col, last_row = nearest.ravel(), nearest.shape[1] - 1.0, nearest.shape[0] - 1.0
    bends, cells, starts = np.zeros((azimuths, 6)), np.empty(azimuths), np.empty(azimuths + 1, np.int64)
    starts[0] = 0
    for k in range(points.shape[1]):
        from_x, from_y = points[0, k], points[1, k]
        ex, ey = c * from_x - s * from_y, s * from_x + c * from_y
        px, py, size, runs = at_x + ex, at_y + ey, abs(ex) + abs(ey), 1
        fx, fy, swept = (px - ox) * inverse, (py - oy) * inverse, (window[1] * size + 1e-9) * inverse
        col, row = np.floor(fx), np.floor(fy)
        fx, fy = fx - col, fy - row
        cells[0] = min(max(row, 0.0), last_row) * wide + min(max(col, 0.0), last_col)
        if min(fx, 1.0 - fx, fy, 1.0 - fy) <= swept:
            # The sums are those of ``_slot_at``, so that both agree on every candidate.
            for i in range(azimuths):
                fx = np.floor((cos[i] * from_x - sin[i] * from_y + at_x - ox) * inverse)
                fy = np.floor((sin[i] * from_x + cos[i] * from_y + at_y - oy) * inverse)
                cells[i] = min(max(fy, 0.0), last_row) * wide + min(max(fx, 0.0), last_col)
            runs = _runs(cells, starts)
        b0 = b_c = b_s = b_cc = b_cs = b_ss = 0.0
        for run in range(runs):
            i0, i1 = uint64(starts[run]), uint64(starts[run + 1] if runs > 1 else azimuths)
            line = uint64(flat[uint64(cells[i0])])
            dx, dy = px - lines[line, 0], py - lines[line, 1]
            reach = size * (max(abs(turn[i0]), abs(turn[i1 - uint64(1)])) + step)
            far_x, far_y = abs(dx) + reach, abs(dy) + reach
            a, b, d = lines[line, 2], lines[line, 3], lines[line, 4]
            # The turned point is d + (cos - 1) e + sin e', e' at right angles to e.
            gx, gy = a * dx + b * dy, b * dx + d * dy
            hx, hy = a * ex + b * ey, b * ex + d * ey
            p0, p_c, p_s = dx * gx + dy * gy, ex * gx + ey * gy, ex * gy - ey * gx
            p_cc, p_cs = ex * hx + ey * hy, ex * hy - ey * hx
            p_ss = a * ey * ey - 2.0 * b * ex * ey + d * ex * ex
            if far_x * far_x + far_y * far_y >= truncate_m2:
                p0 = p_c = p_s = p_cc = p_cs = p_ss = 0.0
                if line == 0:
                    p0 = truncate_m2
                else:
                    for i in range(i0, i1):
                        qx, qy = px + less_1[i] * ex - turn[i] * ey, py + less_1[i] * ey + turn[i] * ex
                        sums[i] += _distance2(qx, qy, truncate_m2, int64(line), lines)
            bends[i0, 0] += p0 - b0
            bends[i0, 1] += p_c - b_c
            bends[i0, 2] += p_s - b_s
            bends[i0, 3] += p_cc - b_cc
            bends[i0, 4] += p_cs - b_cs
            bends[i0, 5] += p_ss - b_ss
            b0, b_c, b_s, b_cc, b_cs, b_ss = p0, p_c, p_s, p_cc, p_cs, p_ss
    k0 = k_c = k_s = k_cc = k_cs = k_ss = 0.0
    for i in range(azimuths):
        u, v = less_1[i], turn[i]
        k0 += bends[i, 0]
        k_c += bends[i, 1]
        k_s += bends[i, 2]
        k_cc += bends[i, 3]
        k_cs += bends[i, 4]
        k_ss += bends[i, 5]
        sums[i] += k0 + 2.0 * (u * k_c + v * k_s) + u * u * k_cc + 2.0 * u * v * k_cs + v * v * k_ss


@kernel(int64(_F2, _F1, _F1, int64, _I2, _F2, _F1))
def _turn_on_lines(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    window: NDArray[np.float64],
    azimuths: int,
    nearest: NDArray[np.int32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> int:
    """Search the azimuth grid on the lines; returns the index of the least cost."""
    sums, step, near = np.zeros(azimuths), 2 * window[1] / (azimuths - 1), np.inf
    pruned = window[4] > 0
    by_cells = pruned and ARC_COST * window[1] * np.abs(points).mean() < azimuths * geometry[2]
    if by_cells:
        _turn_sums(points, at, window, sums, nearest, lines, geometry)
        near = sums.min() + 2.0 * ROUNDING_M2
        if np.count_nonzero(sums <= near) == 1:
            return int(np.argmin(sums))
    x, y = np.empty(points.shape[1]), np.empty(points.shape[1])
    best, best_i = np.inf, azimuths
    # Without sums the middle comes first: its cost is a bound that few others come under.
    for turn in range(-1 if pruned and not by_cells else 0, azimuths):
        i = azimuths // 2 if turn < 0 else turn
        if sums[i] > near:
            continue
        _rotate(points, at[2] - window[1] + i * step, x, y)
        cost = _cost_sum(x, y, at, window[3], nearest, lines, geometry, best if pruned else np.inf)
        if cost < best or (cost == best and i < best_i):
            best, best_i = cost, i
    return best_i


@kernel(void(float64[:, :, ::1], float64[::1], float64[::1], float64[:, ::1]))
def _integrate(
    bends: NDArray[np.float64], right: NDArray[np.float64], up: NDArray[np.float64], sums: NDArray[np.float64]
) -> None:
    """Sum second differences (ny, nx, 6) of polynomials up, and add each candidate's value to ``sums``."""
    ny, nx = sums.shape
    flat = bends.ravel()
    for m in range(6 * nx, len(flat)):
        flat[m] += flat[m - 6 * nx]
    for j in range(ny):
        v, p0, p_u, p_v, p_uu, p_uv, p_vv = up[j], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(nx):
            u = right[i]
            p0 += bends[j, i, 0]
            p_u += bends[j, i, 1]
            p_v += bends[j, i, 2]
            p_uu += bends[j, i, 3]
            p_uv += bends[j, i, 4]
            p_vv += bends[j, i, 5]
            sums[j, i] += p0 + u * (p_u + u * p_uu + v * p_uv) + v * (p_v + v * p_vv)


@kernel(void(float64[::1], float64[::1], _F1, _F1, float64[:, ::1], _I2, _F2, _F1))
def _shift_sums(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    at: NDArray[np.float64],
    window: NDArray[np.float64],
    sums: NDArray[np.float64],
    nearest: NDArray[np.int32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> None:
    """Sum the costs of all shifts of the turned points into ``sums`` (ny, nx), right but for rounding.

    Candidates that put a point into one cell form a rectangle, over which its cost is one polynomial of the shift.
    ``bends`` hold the second differences of the sum of these polynomials; each rectangle adds what it differs by at its
    first corner, ``steps`` what the rectangles of the rows before did along theirs.
    """
    ny, nx = sums.shape
    half_m, truncate_m2 = window[0], window[3]
    to_x, to_y = np.empty(nx), np.empty(ny)
    for i in range(nx):
        to_x[i] = at[0] - half_m + i * (2 * half_m / (nx - 1))
    for j in range(ny):
        to_y[j] = at[1] - half_m + j * (2 * half_m / (ny - 1))
    right, up = to_x - at[0], to_y - at[1]
    at_x, at_y, ox, oy, inverse = at[0], at[1], geometry[0], geometry[1], 1.0 / geometry[2]
    last_x, last_y = to_x[nx - 1], to_y[ny - 1]
    flat, wide, high = nearest.ravel(), nearest.shape[1], nearest.shape[0]
    bends, steps, cols, rows = np.zeros((ny, nx, 6)), np.zeros((nx, 6)), np.empty(nx), np.empty(ny)
    starts_i, starts_j = np.empty(nx + 1, np.int64), np.empty(ny + 1, np.int64)
    k0 = k_u = k_v = k_uu = k_uv = k_vv = 0.0
    for k in range(len(x)):
        px, py = x[k], y[k]
        col, row = np.floor((px + to_x[0] - ox) * inverse), np.floor((py + to_y[0] - oy) * inverse)
        n_i = n_j = 1
        starts_i[0], starts_i[1], starts_j[0], starts_j[1], cols[0], rows[0] = 0, nx, 0, ny, col, row
        if col != np.floor((px + last_x - ox) * inverse):
            for i in range(nx):
                cols[i] = np.floor((px + to_x[i] - ox) * inverse)
            n_i = _runs(cols, starts_i)
        if row != np.floor((py + last_y - oy) * inverse):
            for j in range(ny):
                rows[j] = np.floor((py + to_y[j] - oy) * inverse)
            n_j = _runs(rows, starts_j)
        for r in range(n_j):
            j0, j1 = starts_j[r], starts_j[r + 1]
            row = rows[uint64(j0)]
            l0 = l_u = l_v = l_uu = l_uv = l_vv = 0.0
            for n in range(n_i):
                i0, i1 = starts_i[n], starts_i[n + 1]
                col = cols[uint64(i0)]
                slot = int64(0)
                if 0 <= col < wide and 0 <= row < high:
                    slot = int64(flat[uint64(row * wide + col)])
                line = uint64(slot)
                dx, dy = px + at_x - lines[line, 0], py + at_y - lines[line, 1]
                far_x = max(abs(dx + right[uint64(i0)]), abs(dx + right[uint64(i1 - 1)]))
                far_y = max(abs(dy + up[uint64(j0)]), abs(dy + up[uint64(j1 - 1)]))
                p_uu, b, p_vv = lines[line, 2], lines[line, 3], lines[line, 4]
                gx, gy = p_uu * dx + b * dy, b * dx + p_vv * dy
                p0, p_u, p_v, p_uv = dx * gx + dy * gy, 2.0 * gx, 2.0 * gy, 2.0 * b
                if (far_x * far_x + far_y * far_y) * (1.0 + 1e-9) >= truncate_m2:
                    p0 = p_u = p_v = p_uu = p_uv = p_vv = 0.0
                    if slot == 0:
                        p0 = truncate_m2
                    else:
                        for j in range(j0, j1):
                            for i in range(i0, i1):
                                sums[j, i] += _distance2(px + to_x[i], py + to_y[j], truncate_m2, slot, lines)
                if n == 0 and r == 0:
                    k0 += p0
                    k_u += p_u
                    k_v += p_v
                    k_uu += p_uu
                    k_uv += p_uv
                    k_vv += p_vv
                else:
                    bends[uint64(j0), uint64(i0), 0] += p0 - l0
                    bends[uint64(j0), uint64(i0), 1] += p_u - l_u
                    bends[uint64(j0), uint64(i0), 2] += p_v - l_v
                    bends[uint64(j0), uint64(i0), 3] += p_uu - l_uu
                    bends[uint64(j0), uint64(i0), 4] += p_uv - l_uv
                    bends[uint64(j0), uint64(i0), 5] += p_vv - l_vv
                if n_j > 1:
                    if r > 0:
                        for m in range(6):
                            bends[uint64(j0), uint64(i0), m] -= steps[uint64(n), m]
                    steps[uint64(n), 0], steps[uint64(n), 1], steps[uint64(n), 2] = p0 - l0, p_u - l_u, p_v - l_v
                    steps[uint64(n), 3], steps[uint64(n), 4], steps[uint64(n), 5] = (
                        p_uu - l_uu,
                        p_uv - l_uv,
                        p_vv - l_vv,
                    )
                l0, l_u, l_v, l_uu, l_uv, l_vv = p0, p_u, p_v, p_uu, p_uv, p_vv
    bends[0, 0] += np.array([k0, k_u, k_v, k_uu, k_uv, k_vv])
    _integrate(bends, right, up, sums)


@kernel(int64(_F2, _F1, _F1, int64, int64, _I2, _F2, _F1))
def _shift_on_lines(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    window: NDArray[np.float64],
    nx: int,
    ny: int,
    nearest: NDArray[np.int32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> int:
    """Search the plane on the lines; returns the index j nx + i of the least cost."""
    n = points.shape[1]
    x, y, offset = np.empty(n), np.empty(n), np.empty(2)
    _rotate(points, at[2], x, y)
    pruned = window[4] > 0
    by_cells = pruned and RECTANGLE_COST * (2 * window[0] / geometry[2] + 1) ** 2 < nx * ny
    sums, near = np.zeros((ny, nx)), np.inf
    costs = sums.ravel()
    if by_cells:
        _shift_sums(x, y, at, window, sums, nearest, lines, geometry)
        if window[2] > 0.0:
            for ji in range(nx * ny):
                costs[ji] += n * _place(ji, nx, ny, at, window, offset)
        near = costs.min() + 2.0 * ROUNDING_M2
        if np.count_nonzero(costs <= near) == 1:
            return int(np.argmin(costs))
    best, best_ji = np.inf, -1
    for turn in range(-1 if pruned and not by_cells else 0, nx * ny):
        ji = (ny // 2) * nx + nx // 2 if turn < 0 else turn
        if costs[ji] > near:
            continue
        expected = n * _place(ji, nx, ny, at, window, offset)
        bound = best - expected + ROUNDING_M2 if pruned else np.inf
        cost = expected + _cost_sum(x, y, offset, window[3], nearest, lines, geometry, bound)
        if cost < best or (cost == best and ji < best_ji):
            best, best_ji = cost, ji
    return best_ji


# ---- lines held fast -------------------------------------------------------------------------------------------------


@kernel(void(_F2, _F1, _F1, float64[:, ::1], _I2, _F2, _F1))
def _form(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    window: NDArray[np.float64],
    form: NDArray[np.float64],
    nearest: NDArray[np.int32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> None:
    """Write the quadratic form (5, 5) of the cost sum in (1, cos - 1, sin, right, up) of a motion from the middle.

    Every point keeps the line that it has there; one that is truncated there stays so.
    """
    truncate_m2, ox, oy, inverse = window[3], geometry[0], geometry[1], 1.0 / geometry[2]
    c, s = np.cos(at[2]), np.sin(at[2])
    g00 = g01 = g02 = g03 = g04 = g11 = g12 = g13 = g14 = g22 = g23 = g24 = g33 = g34 = g44 = 0.0
    for k in range(points.shape[1]):
        ex, ey = c * points[0, k] - s * points[1, k], s * points[0, k] + c * points[1, k]
        px, py = at[0] + ex, at[1] + ey
        line = uint64(_slot_at(px, py, ox, oy, inverse, nearest))
        dx, dy = px - lines[line, 0], py - lines[line, 1]
        a, b, d = lines[line, 2], lines[line, 3], lines[line, 4]
        hx, hy = a * dx + b * dy, b * dx + d * dy
        d2 = dx * hx + dy * hy
        if d2 >= truncate_m2:
            g00 += truncate_m2
            continue
        # The point moves by (cos - 1) e + sin e' + (right, up), e' at right angles to e.
        ax, ay = a * ex + b * ey, b * ex + d * ey
        bx, by = b * ex - a * ey, d * ex - b * ey
        g00 += d2
        g01 += ex * hx + ey * hy
        g02 += ex * hy - ey * hx
        g03 += hx
        g04 += hy
        g11 += ex * ax + ey * ay
        g12 += ex * bx + ey * by
        g13 += ax
        g14 += ay
        g22 += ex * by - ey * bx
        g23 += bx
        g24 += by
        g33 += a
        g34 += b
        g44 += d
    prior = points.shape[1] * window[2]
    ux, uy = at[0] - at[3], at[1] - at[4]
    form[0, 0], form[0, 1], form[0, 2] = g00 + prior * (ux * ux + uy * uy), g01, g02
    form[0, 3], form[0, 4] = g03 + prior * ux, g04 + prior * uy
    form[1, 1], form[1, 2], form[1, 3], form[1, 4] = g11, g12, g13, g14
    form[2, 2], form[2, 3], form[2, 4] = g22, g23, g24
    form[3, 3], form[3, 4], form[4, 4] = g33 + prior, g34, g44 + prior


@kernel(int64(_F2, _F1, int64, int64, int64))
def _least_of_form(form: NDArray[np.float64], window: NDArray[np.float64], azimuths: int, nx: int, ny: int) -> int:
    """Return the index (a ny + j) nx + i of the least value over azimuths, ups and rights.

    Along a row the form is a parabola, least at one of the two nodes about its vertex.
    """
    half_m, half_rad = window[0], window[1]
    step_x, step_y, step_rad = 2 * half_m / (nx - 1), 2 * half_m / (ny - 1), 2 * half_rad / (azimuths - 1)
    a = form[3, 3]
    best, best_at = np.inf, 0
    for turn in range(azimuths):
        angle = turn * step_rad - half_rad
        c, s = -2.0 * np.sin(0.5 * angle) ** 2, np.sin(angle)
        k0 = form[0, 0] + 2.0 * (c * form[0, 1] + s * form[0, 2] + c * s * form[1, 2])
        k0 += c * c * form[1, 1] + s * s * form[2, 2]
        kx = form[0, 3] + c * form[1, 3] + s * form[2, 3]
        ky = form[0, 4] + c * form[1, 4] + s * form[2, 4]
        for j in range(ny):
            y = j * step_y - half_m
            low, b = k0 + y * (2.0 * ky + y * form[4, 4]), kx + y * form[3, 4]
            first, last = 0, nx - 1
            if window[4] > 0 and a > 0.0:
                vertex = min(max((half_m - b / a) / step_x, 0.0), nx - 1.0)
                first, last = int(vertex), min(int(vertex) + 1, nx - 1)
            for i in range(first, last + 1):
                x = i * step_x - half_m
                value = low + x * (2.0 * b + x * a)
                if value < best:
                    best, best_at = value, (turn * ny + j) * nx + i
    return best_at


# ---- coarse to fine --------------------------------------------------------------------------------------------------


@kernel(float64[:, ::1](_F2, _F1, float64, float64, _I2, _U2, _F2, _F1))
def _drawn(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    least: float,
    most_n: float,
    nearest: NDArray[np.int32],
    closeness: NDArray[np.uint8],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the points (2, m) that are at least so close to an occupied cell; all, if those are too few."""
    n, count = points.shape[1], 0
    kept = np.empty(n, np.int64)
    x, y = np.empty(n), np.empty(n)
    _rotate(points, at[2], x, y)
    for k in range(n):
        col = np.floor((x[k] + at[0] - geometry[0]) / geometry[2])
        row = np.floor((y[k] + at[1] - geometry[1]) / geometry[2])
        inside = 0 <= col < closeness.shape[1] and 0 <= row < closeness.shape[0]
        if inside and closeness[int64(row), int64(col)] >= least and lines[nearest[int64(row), int64(col)], 5] >= most_n:
            kept[count] = k
            count += 1
    if count < FEWEST_DRAWN * n:
        return points.copy()
    out = np.empty((2, count))
    for k in range(count):
        out[0, k], out[1, k] = points[0, kept[k]], points[1, kept[k]]
    return out


@kernel(float64[::1](_F2, _F1, _F1, _F1, _I2, _U2, _F2, _F1))
def search(
    points: NDArray[np.float64],
    start: NDArray[np.float64],
    grid: NDArray[np.float64],
    limits: NDArray[np.float64],
    nearest: NDArray[np.int32],
    closeness: NDArray[np.uint8],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Find the pose of the scan in the map; returns [x, y, yaw, cost_m2, inliers, evaluations, grids, converged].

    Parameters
    ----------
    points : (n, 2) points in the laser's frame, m, in an order that makes any prefix a fair sample
    start : (3,) predicted pose: x, y (m), yaw (rad)
    grid : (5,) points of the azimuth grid and of the plane in x and y, border extensions a grid at most, 1 to prune
    limits : (11,) half-window in the plane (m) and azimuth (rad), spacing to stop at (m, rad), truncation (m),
        points of the first level where it is wide, alternations a level, what a squared metre away from the start
        costs a point, the half-windows (m) up to which and above which lines are held, and the closeness of the
        points that decide the levels within a cell
    nearest, closeness, lines, geometry : the map, see ``linemap``
    """
    n = len(points)
    azimuths, nx, ny, extensions = int(grid[0]), int(grid[1]), int(grid[2]), int(grid[3])
    stop_m, stop_rad, truncate_m2, turns = limits[2], limits[3], limits[4] * limits[4], int(limits[6])
    pivot_x, pivot_y = points[:, 0].mean(), points[:, 1].mean()
    centred = np.empty((2, n))
    centred[0], centred[1] = points[:, 0] - pivot_x, points[:, 1] - pivot_y
    sample = centred[:, : min(n, int(limits[5]))].copy()
    c, s = np.cos(start[2]), np.sin(start[2])
    at_x, at_y = start[0] + c * pivot_x - s * pivot_y, start[1] + s * pivot_x + c * pivot_y
    at = np.array([at_x, at_y, start[2], at_x, at_y])
    window = np.array([limits[0], limits[1], limits[7], truncate_m2, grid[4]])

    deciding, settled = centred, limits[10] == 0
    evaluations, grids, converged, form = 0, 0, 0.0, np.zeros((5, 5))
    for level in range(MAX_LEVELS):
        step_x, step_y, step_rad = 2 * window[0] / (nx - 1), 2 * window[0] / (ny - 1), 2 * window[1] / (azimuths - 1)
        held = limits[9] < window[0] <= limits[8]
        used = sample if level == 0 and not held else deciding
        for turn in range(turns + extensions if held else 0):
            _form(used, at, window, form, nearest, lines, geometry)
            best = _least_of_form(form, window, azimuths, nx, ny)
            i, j, a = best % nx, (best // nx) % ny, best // (nx * ny)
            at[0] += i * step_x - window[0]
            at[1] += j * step_y - window[0]
            at[2] += a * step_rad - window[1]
            evaluations += azimuths * nx * ny
            grids += 1
            if turn + 1 >= turns and 0 < i < nx - 1 and 0 < j < ny - 1 and 0 < a < azimuths - 1:
                break
        for _ in range(0 if held else turns):
            for _ in range(extensions + 1):
                i = _turn_on_lines(used, at, window, azimuths, nearest, lines, geometry)
                at[2] += i * step_rad - window[1]
                evaluations += azimuths
                grids += 1
                if 0 < i < azimuths - 1:
                    break
            for _ in range(extensions + 1):
                ji = _shift_on_lines(used, at, window, nx, ny, nearest, lines, geometry)
                i, j = ji % nx, ji // nx
                at[0] += i * step_x - window[0]
                at[1] += j * step_y - window[0]
                evaluations += nx * ny
                grids += 1
                if 0 < i < nx - 1 and 0 < j < ny - 1:
                    break
        if window[0] <= geometry[2] and not settled:
            # Points on new ground lower the cost by falling back onto the map: the others decide, from this level on.
            settled, deciding = True, _drawn(centred, at, limits[10], limits[11], nearest, closeness, lines, geometry)
            right, up = deciding[0].mean(), deciding[1].mean()
            pivot_x, pivot_y = pivot_x + right, pivot_y + up
            for points_m in (centred, deciding):
                points_m[0] -= right
                points_m[1] -= up
            at[0] += np.cos(at[2]) * right - np.sin(at[2]) * up
            at[1] += np.sin(at[2]) * right + np.cos(at[2]) * up
            at[3] += c * right - s * up
            at[4] += s * right + c * up
            continue
        if max(step_x, step_y) < stop_m and step_rad < stop_rad:
            converged = 1.0
            break
        window[0] = min(1.5 * max(step_x, step_y), 0.9 * window[0])
        window[1] = min(1.5 * step_rad, 0.9 * window[1])

    x, y = np.empty(n), np.empty(n)
    _rotate(centred, at[2], x, y)
    total, inliers = 0.0, 0
    for k in range(n):
        d2 = _cost_sum(x[k : k + 1], y[k : k + 1], at, truncate_m2, nearest, lines, geometry, np.inf)
        total += d2
        inliers += d2 < 0.25 * truncate_m2
    c, s = np.cos(at[2]), np.sin(at[2])
    to_x, to_y = at[0] - c * pivot_x + s * pivot_y, at[1] - s * pivot_x - c * pivot_y
    return np.array([to_x, to_y, at[2], total / n, inliers / n, evaluations, grids, converged])
