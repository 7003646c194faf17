"""Coarse-to-fine search over grids for the pose that lays a scan's points on the map (docs/method.md).

Grids are searched in turn as in the paper's minimisation, steps i-v: azimuth with the position fixed, then the plane
with the azimuth fixed; the scan turns about its points' centroid. A point costs its squared distance to the line of the
cell that it falls into (arrays of ``linemap``). Where the window is a few cells wide every point first holds the line
that it has in the middle: then one quadratic form stands for a joint grid of azimuth and plane.

Every grid has an exhaustive and a pruned form with the same minimum: the same index, the lowest of equals, and the
same cost, bit for bit. Pruning rests on three facts:

* a sum of squares that exceeds the best total so far only grows: the rest of that candidate is left out;
* while a point stays in one cell its cost is a polynomial of the motion, so that a few sums over the points stand for
  all candidates: nearly, but for rounding, and what comes within `ROUNDING_M2` of the best is summed point by point;
* a metric's eigenvalues are 1 at most, so that a cost tells how far its point may move before it is truncated, or after
  it was.

Sums over points run in `LANES` lanes, so that the compiler adds several at once without changing their order.

Shared arguments of the grids: ``points`` (2, n) about their centroid, m; ``at`` (5,) centroid x, y (m) and yaw (rad) in
the middle of the grid, and where the centroid was expected; ``window`` (5,) half-windows (m, rad), cost of a squared
metre from there, truncation (m2), 1 to prune.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import boolean, float64, int32, int64, types, uint32, uint64, void

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_LEVELS = 40
FEWEST_DRAWN = 0.5  # share of the points on known ground below which the others decide too
NEAR = 128  # an entry of ``nearest`` is an index times this, as ``linemap`` has it
CHUNK = 32  # points between two looks at the bound
LANES = 32
RECTANGLE_COST = 3  # of a polynomial on a rectangle of candidates, in candidates summed point by point
ARC_COST = 30  # of the polynomials along an arc of two cells, in azimuths summed point by point
ROUNDING_M2 = 1e-9  # above any difference between two orders of summation, as long as maps are smaller than 100 km

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)
_U2 = types.Array(uint32, 2, "C", readonly=True)


@kernel(float64(types.Array(float64, 1, "A", readonly=True)))
def _mean(values: NDArray[np.float64]) -> float:
    """Return the mean; NumPy's own in a kernel costs 0.1 s of start-up, because it loads scipy with it."""
    total = 0.0
    for value in values:
        total += value
    return total / len(values)


@kernel(types.Tuple((float64, int64))(_F1))
def _least(sums: NDArray[np.float64]) -> tuple[float, int]:
    """Return up to where rounding may hide the least, and its index where it is alone there, else -1."""
    at = 0
    for k in range(len(sums)):
        if sums[k] < sums[at]:
            at = k
    near, within = sums[at] + 2.0 * ROUNDING_M2, 0
    for value in sums:
        within += value <= near
    return near, at if within == 1 else -1


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


@kernel(int64(float64, float64, float64, float64, float64, _U2))
def _slot_at(px: float, py: float, ox: float, oy: float, inverse: float, nearest: NDArray[np.uint32]) -> int:
    """Return the line that a point of the map frame belongs to; beyond the edge what is there: 0, nowhere."""
    fx, fy = (px - ox) * inverse, (py - oy) * inverse
    col = int64(min(max(fx, 0.0), nearest.shape[1] - 1.0))
    row = int64(min(max(fy, 0.0), nearest.shape[0] - 1.0))
    return int(nearest[uint64(row), uint64(col)] // NEAR)


@kernel(float64(float64[::1], float64[::1], _F1, float64, _U2, _F2, _F1, float64))
def _cost_sum(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    offset: NDArray[np.float64],
    truncate_m2: float,
    nearest: NDArray[np.uint32],
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


@kernel(void(float64[:, ::1]))
def _fold(sums: NDArray[np.float64]) -> None:
    """Add up the lanes of each row in its first one."""
    half = LANES // 2
    while half:
        for row in range(len(sums)):
            for k in range(half):
                sums[row, k] += sums[row, k + half]
        half //= 2


@kernel(float64[:, ::1](float64, int64))
def _turns(half_rad: float, azimuths: int) -> NDArray[np.float64]:
    """Return cosine - 1 and sine of the turns of an azimuth grid from its middle, (2, azimuths)."""
    out = np.empty((2, azimuths))
    for i in range((azimuths + 1) // 2):
        turn = i * (2 * half_rad / (azimuths - 1)) - half_rad
        out[0, i], out[1, azimuths - 1 - i] = -2.0 * np.sin(0.5 * turn) ** 2, -np.sin(turn)
        out[0, azimuths - 1 - i], out[1, i] = out[0, i], np.sin(turn)
    return out


@kernel(int64(_F2, _F1, _F1, float64[:, ::1], int64[::1], _U2, _F2, _F1))
def _form(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    window: NDArray[np.float64],
    form: NDArray[np.float64],
    loose: NDArray[np.int64],
    nearest: NDArray[np.uint32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> int:
    """Write the quadratic form (5, 5) of the cost sum in (1, cos - 1, sin, right, up) of a motion from the middle.

    Every point keeps the line that it has there; one that is truncated there stays so. But points that the window
    brings to another cell, or to and from truncation, are left out and listed in ``loose`` (n,), if that has room;
    returns how many.
    """
    n, holds_all, found = points.shape[1], len(loose) == 0, 0
    ox, oy, cell, inverse = geometry[0], geometry[1], geometry[2], 1.0 / geometry[2]
    half_m, half_rad, truncate_m2, truncate_m = window[0], window[1], window[3], np.sqrt(window[3])
    flat, wide = nearest.ravel(), float64(nearest.shape[1])
    last_col, last_row = nearest.shape[1] - 1.0, nearest.shape[0] - 1.0
    at_x, at_y, c, s, from_x, from_y = at[0], at[1], np.cos(at[2]), np.sin(at[2]), points[0], points[1]
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
            line = uint64(flat[uint64(where[k])] // NEAR)
            p[2, k], p[3, k] = lines[line, 0], lines[line, 1]
            p[4, k], p[5, k], p[6, k] = lines[line, 2], lines[line, 3], lines[line, 4]
        for k in range(block):
            ex, ey = p[0, k], p[1, k]
            dx, dy = at_x + ex - p[2, k], at_y + ey - p[3, k]
            a, b, d = p[4, k], p[5, k], p[6, k]
            hx, hy = a * dx + b * dy, b * dx + d * dy
            d2 = dx * hx + dy * hy
            # Eigenvalues are 1 at most: a point that moves so far is no farther from its line, nor nearer, than that.
            move = half_m + half_rad * (abs(ex) + abs(ey)) + 1e-9
            near, far = max(truncate_m - 1.5 * move, 0.0), truncate_m + 1.5 * move
            stays = 1.0 if holds_all or (p[7, k] > move and (d2 < near * near or d2 >= far * far)) else 0.0
            p[8, k] = stays
            kept = stays if d2 < truncate_m2 else 0.0
            a, b, d, hx, hy = kept * a, kept * b, kept * d, kept * hx, kept * hy
            # The point moves by (cos - 1) e + sin e' + (right, up), e' at right angles to e.
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
        if not holds_all:
            for k in range(block):
                loose[uint64(found)] = first + k  # written over unless the point is loose
                found += p[8, k] == 0.0
    _fold(g)
    m = 0
    for i in range(5):
        for j in range(i, 5):
            form[i, j] = g[m, 0]
            m += 1
    prior, ux, uy = n * window[2], at_x - at[3], at_y - at[4]
    form[0, 0] += prior * (ux * ux + uy * uy)
    form[0, 3] += prior * ux
    form[0, 4] += prior * uy
    form[3, 3] += prior
    form[4, 4] += prior
    return found


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


@kernel(void(_F2, _F1, _F1, _F2, float64[::1], _U2, _F2, _F1))
def _turn_sums(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    window: NDArray[np.float64],
    turns: NDArray[np.float64],
    sums: NDArray[np.float64],
    nearest: NDArray[np.uint32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> None:
    """Add the costs of all azimuths to ``sums`` (azimuths,), right but for rounding.

    Points that stay in their cells make one form. For each of the others the polynomial changes from cell to cell
    along its arc: ``bends`` hold by how much the sum of them changes from one azimuth to the next.
    """
    azimuths, truncate_m2, truncate_m = len(sums), window[3], np.sqrt(window[3])
    form, loose, reach = np.zeros((5, 5)), np.empty(points.shape[1], np.int64), window.copy()
    reach[0] = 0.0
    found = _form(points, at, reach, form, loose, nearest, lines, geometry)
    cos, sin, less_1, turn = np.empty(azimuths), np.empty(azimuths), turns[0], turns[1]
    for i in range(azimuths if found else 0):
        yaw = at[2] - window[1] + i * (2 * window[1] / (azimuths - 1))
        cos[i], sin[i] = np.cos(yaw), np.sin(yaw)
    at_x, at_y, ox, oy, inverse = at[0], at[1], geometry[0], geometry[1], 1.0 / geometry[2]
    c, s, wide = np.cos(at[2]), np.sin(at[2]), float64(nearest.shape[1])
    flat, last_col, last_row = nearest.ravel(), nearest.shape[1] - 1.0, nearest.shape[0] - 1.0
    bends, cells, starts = np.zeros((azimuths + 1, 6)), np.empty(azimuths), np.empty(azimuths + 1, np.int64)
    bends[0] = (form[0, 0], form[0, 1], form[0, 2], form[1, 1], form[1, 2], form[2, 2])
    for n in range(found):
        k = uint64(loose[uint64(n)])
        from_x, from_y = points[0, k], points[1, k]
        for i in range(azimuths):
            # The sums are those of ``_slot_at``, so that both agree on every candidate.
            fx = np.floor((cos[i] * from_x - sin[i] * from_y + at_x - ox) * inverse)
            fy = np.floor((sin[i] * from_x + cos[i] * from_y + at_y - oy) * inverse)
            cells[i] = min(max(fy, 0.0), last_row) * wide + min(max(fx, 0.0), last_col)
        ex, ey = c * from_x - s * from_y, s * from_x + c * from_y
        move = 1.5 * window[1] * (abs(ex) + abs(ey)) + 1e-9
        near, far = max(truncate_m - move, 0.0) ** 2, (truncate_m + move) ** 2
        b0 = b_c = b_s = b_cc = b_cs = b_ss = 0.0
        for run in range(_runs(cells, starts)):
            i0, i1 = uint64(starts[uint64(run)]), uint64(starts[uint64(run + 1)])
            line = uint64(flat[uint64(int64(cells[i0]))] // NEAR)
            dx, dy = at_x + ex - lines[line, 0], at_y + ey - lines[line, 1]
            a, b, d = lines[line, 2], lines[line, 3], lines[line, 4]
            # The turned point is d + (cos - 1) e + sin e', e' at right angles to e.
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


@kernel(int64(_F2, _F1, _F1, _F2, _U2, _F2, _F1))
def _turn_on_lines(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    window: NDArray[np.float64],
    turns: NDArray[np.float64],
    nearest: NDArray[np.uint32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> int:
    """Search the azimuth grid on the lines; returns the index of the least cost."""
    azimuths = turns.shape[1]
    sums, step, near = np.zeros(azimuths), 2 * window[1] / (azimuths - 1), np.inf
    pruned = window[4] > 0
    by_cells = pruned and ARC_COST * window[1] * _mean(np.abs(points).ravel()) < azimuths * geometry[2]
    if by_cells:
        _turn_sums(points, at, window, turns, sums, nearest, lines, geometry)
        near, alone = _least(sums)
        if alone >= 0:
            return alone
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
    return int(best_i)


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


@kernel(int64(float64, float64, float64, _F1, int64[::1], int64[::1]))
def _spans(
    p: float,
    origin: float,
    inverse: float,
    to: NDArray[np.float64],
    cells: NDArray[np.int64],
    starts: NDArray[np.int64],
) -> int:
    """Write which cells a point comes to by evenly spaced moves along an axis, and the first move to each.

    The number of moves stands behind them. The sums are those of ``_slot_at``. Returns how many cells there are.
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


@kernel(void(_F2, _F1, _F1, float64[:, ::1], _U2, _F2, _F1))
def _shift_sums(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    window: NDArray[np.float64],
    sums: NDArray[np.float64],
    nearest: NDArray[np.uint32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> None:
    """Add the costs of all shifts of the turned points to ``sums`` (ny, nx), right but for rounding.

    Points that stay in their cells make one form. For each of the others candidates that put it into one cell form a
    rectangle, over which its cost is one polynomial of the shift. ``bends`` hold the second differences of the sum of
    these polynomials; each rectangle adds what it differs by at its first corner, ``steps`` what the rectangles of the
    row before did along theirs.
    """
    ny, nx = sums.shape
    half_m, truncate_m2, truncate_m = window[0], window[3], np.sqrt(window[3])
    to_x, to_y = np.empty(nx), np.empty(ny)
    for i in range(nx):
        to_x[i] = at[0] - half_m + i * (2 * half_m / (nx - 1))
    for j in range(ny):
        to_y[j] = at[1] - half_m + j * (2 * half_m / (ny - 1))
    right, up = to_x - at[0], to_y - at[1]
    form, loose, reach = np.zeros((5, 5)), np.empty(points.shape[1], np.int64), window.copy()
    reach[1] = 0.0
    found = _form(points, at, reach, form, loose, nearest, lines, geometry)
    bends, steps = np.zeros((ny, nx, 6)), np.zeros((nx, 6))
    bends[0, 0] = (form[0, 0], 2.0 * form[0, 3], 2.0 * form[0, 4], form[3, 3], 2.0 * form[3, 4], form[4, 4])
    at_x, at_y, ox, oy, inverse = at[0], at[1], geometry[0], geometry[1], 1.0 / geometry[2]
    c, s = np.cos(at[2]), np.sin(at[2])
    near, far = max(truncate_m - 1.5 * half_m, 0.0) ** 2, (truncate_m + 1.5 * half_m) ** 2
    flat, wide, last_col, last_row = nearest.ravel(), nearest.shape[1], nearest.shape[1] - 1, nearest.shape[0] - 1
    starts_i, starts_j = np.empty(nx + 1, np.int64), np.empty(ny + 1, np.int64)
    cols, rows = np.empty(nx, np.int64), np.empty(ny, np.int64)
    for m in range(found):
        k = uint64(loose[uint64(m)])
        px, py = c * points[0, k] - s * points[1, k], s * points[0, k] + c * points[1, k]
        n_i = _spans(px, ox, inverse, to_x, cols, starts_i)
        n_j = _spans(py, oy, inverse, to_y, rows, starts_j)
        for r in range(n_j):
            j0, base = uint64(starts_j[uint64(r)]), min(max(rows[uint64(r)], 0), last_row) * wide
            l0 = l_u = l_v = l_uu = l_uv = l_vv = 0.0
            for q in range(n_i):
                i0 = uint64(starts_i[uint64(q)])
                line = uint64(flat[uint64(base + min(max(cols[uint64(q)], 0), last_col))] // NEAR)
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
                before, bend = steps[uint64(q)], bends[j0, i0]
                bend[0] += d0 - before[0]
                bend[1] += d_u - before[1]
                bend[2] += d_v - before[2]
                bend[3] += d_uu - before[3]
                bend[4] += d_uv - before[4]
                bend[5] += d_vv - before[5]
                before[0], before[1], before[2], before[3], before[4], before[5] = d0, d_u, d_v, d_uu, d_uv, d_vv
        for q in range(n_i):
            steps[uint64(q)] = 0.0
    _integrate(bends, right, up, sums)


@kernel(int64(_F2, _F1, _F1, int64, int64, _U2, _F2, _F1))
def _shift_on_lines(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    window: NDArray[np.float64],
    nx: int,
    ny: int,
    nearest: NDArray[np.uint32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> int:
    """Search the plane on the lines; returns the index j nx + i of the least cost."""
    n = points.shape[1]
    pruned = window[4] > 0
    by_cells = pruned and RECTANGLE_COST * (2 * window[0] / geometry[2] + 1) ** 2 < nx * ny
    sums, near = np.zeros((ny, nx)), np.inf
    costs = sums.ravel()
    if by_cells:
        _shift_sums(points, at, window, sums, nearest, lines, geometry)
        near, alone = _least(costs)
        if alone >= 0:
            return alone
    x, y, offset = np.empty(n), np.empty(n), np.empty(2)
    _rotate(points, at[2], x, y)
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


@kernel(int64(_F2, _F1, _F2, int64, int64))
def _least_of_form(
    form: NDArray[np.float64], window: NDArray[np.float64], turns: NDArray[np.float64], nx: int, ny: int
) -> int:
    """Return the index (a ny + j) nx + i of the least value over azimuths, ups and rights.

    Along a row the form is a parabola, least at one of the two nodes about its vertex.
    """
    half_m, azimuths, a, best, best_at = window[0], turns.shape[1], form[3, 3], np.inf, 0
    step_x, step_y, last = 2 * half_m / (nx - 1), 2 * half_m / (ny - 1), nx - 1.0
    by_vertex, per_a = window[4] > 0 and a > 0.0, 1.0 / a
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


# ---- coarse to fine --------------------------------------------------------------------------------------------------


@kernel(float64[:, ::1](_F2, _F1, _F1, _U2, _F2, _F1))
def _drawn(
    points: NDArray[np.float64],
    at: NDArray[np.float64],
    known: NDArray[np.float64],
    nearest: NDArray[np.uint32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the points (2, m) on known ground; all, if those are too few.

    ``known`` (2,): how near an occupied cell has to be, as told by ``nearest``, and on how many points its line has to
    rest.
    """
    n, count = points.shape[1], 0
    kept = np.empty(n, np.int64)
    x, y = np.empty(n), np.empty(n)
    _rotate(points, at[2], x, y)
    for k in range(n):
        fx, fy = (x[k] + at[0] - geometry[0]) / geometry[2], (y[k] + at[1] - geometry[1]) / geometry[2]
        if not (0 <= fx < nearest.shape[1] and 0 <= fy < nearest.shape[0]):
            continue
        row, col = uint64(fy), uint64(fx)
        there = nearest[row, col]
        if there % NEAR >= known[0] and lines[uint64(there // NEAR), 5] >= known[1]:
            kept[count] = k
            count += 1
    if count < FEWEST_DRAWN * n:
        return points.copy()
    out = np.empty((2, count))
    for k in range(count):
        out[0, k], out[1, k] = points[0, kept[k]], points[1, kept[k]]
    return out


@kernel(types.Tuple((*(5 * [float64]), int64, int64, boolean))(_F2, _F1, _F1, _F1, _U2, _F2, _F1))
def search(
    points: NDArray[np.float64],
    start: NDArray[np.float64],
    grid: NDArray[np.float64],
    limits: NDArray[np.float64],
    nearest: NDArray[np.uint32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> tuple[float, float, float, float, float, int, int, bool]:
    """Find the pose of the scan in the map; returns x, y, yaw, cost_m2, inliers, evaluations, grids, converged.

    Parameters
    ----------
    points : (n, 2) points in the laser's frame, m, in an order that makes any prefix a fair sample
    start : (3,) predicted pose: x, y (m), yaw (rad)
    grid : (5,) points of the azimuth grid and of the plane in x and y, border extensions a grid at most, 1 to prune
    limits : (13,) half-window in the plane (m) and azimuth (rad), spacing to stop at (m, rad), truncation (m), how many
        points search until it is settled which decide, alternations a level down to a cell, what a squared metre away
        from the start costs a point, the half-windows (m) up to which lines are held and up to which points may change
        their cells as well, 0 for never; what known ground is (``_drawn``): within a cell the points elsewhere are left
        out; and of how many points a scan is dense. Within a cell only dense scans hold lines, and let points change
        their cells on the first and the last level alone
    nearest, lines, geometry : the map, see ``linemap``
    """
    n = len(points)
    azimuths, nx, ny, extensions = int(grid[0]), int(grid[1]), int(grid[2]), int(grid[3])
    stop_m, stop_rad, truncate_m2, joint = limits[2], limits[3], limits[4] * limits[4], int(limits[6])
    pivot_x, pivot_y = _mean(points[:, 0]), _mean(points[:, 1])
    centred = np.empty((2, n))
    centred[0], centred[1] = points[:, 0] - pivot_x, points[:, 1] - pivot_y
    c, s = np.cos(start[2]), np.sin(start[2])
    at_x, at_y = start[0] + c * pivot_x - s * pivot_y, start[1] + s * pivot_x + c * pivot_y
    at = np.array([at_x, at_y, start[2], at_x, at_y])
    window = np.array([limits[0], limits[1], limits[7], truncate_m2, grid[4]])

    deciding, settled, few, none = centred, limits[10] == 0, int(min(n, limits[5])), np.empty(0, np.int64)
    dense, turns = n >= limits[12], joint
    evaluations, grids, converged, form = 0, 0, False, np.zeros((5, 5))
    for _ in range(MAX_LEVELS):
        step_x, step_y, step_rad = 2 * window[0] / (nx - 1), 2 * window[0] / (ny - 1), 2 * window[1] / (azimuths - 1)
        last = max(step_x, step_y) < stop_m and step_rad < stop_rad
        within = window[0] <= limits[9]
        sampled, held = within and not settled, window[0] <= limits[8] and (dense or not within)
        alternations = turns if not held else int(sampled or (within and last))
        used = deciding if settled or (held and not sampled) else deciding[:, :few].copy()
        turned = _turns(window[1], azimuths)
        for turn in range(joint + extensions if held else 0):
            _form(used, at, window, form, none, nearest, lines, geometry)
            best = _least_of_form(form, window, turned, nx, ny)
            i, j, a = best % nx, (best // nx) % ny, best // (nx * ny)
            at[0] += i * step_x - window[0]
            at[1] += j * step_y - window[0]
            at[2] += a * step_rad - window[1]
            evaluations += azimuths * nx * ny
            grids += 1
            if turn + 1 >= joint and 0 < i < nx - 1 and 0 < j < ny - 1 and 0 < a < azimuths - 1:
                break
        for _ in range(alternations):
            for _ in range(extensions + 1):
                i = _turn_on_lines(used, at, window, turned, nearest, lines, geometry)
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
        if sampled:
            # Points on new ground lower the cost by falling back onto the map: the others decide, from this level on.
            settled, deciding = True, _drawn(centred, at, limits[10:], nearest, lines, geometry)
            right, up = _mean(deciding[0]), _mean(deciding[1])
            pivot_x, pivot_y = pivot_x + right, pivot_y + up
            for points_m in (centred, deciding):
                points_m[0] -= right
                points_m[1] -= up
            at[0] += np.cos(at[2]) * right - np.sin(at[2]) * up
            at[1] += np.sin(at[2]) * right + np.cos(at[2]) * up
            at[3] += c * right - s * up
            at[4] += s * right + c * up
            continue
        if last:
            converged = True
            break
        if within:
            turns = 1  # finer levels begin where they will end
        window[0] = min(1.5 * max(step_x, step_y), 0.9 * window[0])
        window[1] = min(1.5 * step_rad, 0.9 * window[1])

    x, y = np.empty(n), np.empty(n)
    _rotate(centred, at[2], x, y)
    total, inliers = 0.0, 0
    for k in range(n):
        px, py = x[k] + at[0], y[k] + at[1]
        slot = _slot_at(px, py, geometry[0], geometry[1], 1.0 / geometry[2], nearest)
        d2 = _distance2(px, py, truncate_m2, slot, lines)
        total += d2
        inliers += d2 < 0.25 * truncate_m2
    c, s = np.cos(at[2]), np.sin(at[2])
    to_x, to_y = at[0] - c * pivot_x + s * pivot_y, at[1] - s * pivot_x - c * pivot_y
    return to_x, to_y, at[2], total / n, inliers / n, evaluations, grids, converged
