"""Occupied cells with the moments of their points, and the local line through each (docs/method.md).

Arrays of a map, which the other kernels read:

``nearest``  (rows, cols) uint32  index of the nearest occupied cell within reach, times `NEAR`, plus its closeness:
                                  `FAR` + 1 less the squared distance to it in cells; 0 without one
``cells``    (capacity, 2) int32  row, col of the occupied cells, in the order of their first hits; row 0 of this and
                                  the following arrays is no cell, and its line is beyond any distance
``moments``  (capacity, 12) float64  n, sum x, sum y, sum xx, sum xy, sum yy of a cell's points, m in the map
                                  frame; then the same, summed over a window of neighbours with Gaussian weights
``lines``    (capacity, 8) float64   foot x, y and the metric a_xx, a_xy, a_yy of the local line, and the number of
                                  points that it is fitted to; then the row of ``waiting`` with the cell's new points,
                                  0 without any, and scratch
``geometry`` (6,) float64        the fields of `Geometry`
``waiting``  (rows, 8) float64   row 0: number of cells with new points that no moments include yet; the other rows: n,
                                  sum x, sum y, sum xx, sum xy, sum yy of these points, the cell, and the number of
                                  points that it had when the first of them came
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, I32_2D, I64_1D, U32_2D, Out, helper, int64, kernel, uint64
from mavnav.kernels.maps.layout import FAR, NEAR, REACH_CELLS
from mavnav.kernels.maps.lookup import closeness_of, slot_of

WINDOW_CELLS = 4  # half-width of the line fit's window: 9x9 cells
BLOCK = 64  # lines that are fitted at a time


class Geometry(NamedTuple):
    """Corner of cell [0, 0], size of a cell, least spread and noise of a line (m), and the share that may wait."""

    origin_x_m: float
    origin_y_m: float
    cell_m: float
    line_sigma_m: float
    line_noise_m: float
    waiting_share: float


@helper
def _stamp(slot: int, row: int, col: int, nearest: U32_2D) -> None:
    """Make ``slot`` the nearest occupied cell wherever it is nearer than the present one; ties do not change it."""
    for r in range(row - REACH_CELLS, row + REACH_CELLS + 1):
        for c in range(col - REACH_CELLS, col + REACH_CELLS + 1):
            d2 = (r - row) * (r - row) + (c - col) * (c - col)
            if d2 <= FAR and FAR + 1 - d2 > closeness_of(nearest[r, c]):
                nearest[r, c] = slot * NEAR + FAR + 1 - d2


@helper
def _fit(slots: I64_1D, noise_m: float, moments: F64_2D, lines: F64_2D) -> None:
    """Refit some lines: A = ((tr C + s0^2) I - C) / (l1 + s0^2), 1 along the normal and small along the wall.

    They are processed in blocks, in SIMD lanes.
    """
    s2, m = noise_m * noise_m, np.empty((8, BLOCK))
    for first in range(0, len(slots), BLOCK):
        block = min(BLOCK, len(slots) - first)
        for k in range(block):
            slot = uint64(slots[first + k])
            m[0, k], m[1, k], m[2, k] = moments[slot, 6], moments[slot, 7], moments[slot, 8]
            m[3, k], m[4, k], m[5, k] = moments[slot, 9], moments[slot, 10], moments[slot, 11]
            m[6, k], m[7, k] = moments[slot, 1] / moments[slot, 0], moments[slot, 2] / moments[slot, 0]
            lines[slot, 5] = moments[slot, 6]
        for k in range(block):
            per_n = 1.0 / m[0, k]
            mx, my = m[1, k] * per_n, m[2, k] * per_n
            cxx = max(m[3, k] * per_n - mx * mx, 0.0)
            cyy = max(m[5, k] * per_n - my * my, 0.0)
            cxy = m[4, k] * per_n - mx * my
            half, diff = 0.5 * (cxx + cyy), 0.5 * (cxx - cyy)
            scale = 1.0 / (half + np.sqrt(diff * diff + cxy * cxy) + s2)
            axx, axy, ayy = (cyy + s2) * scale, -cxy * scale, (cxx + s2) * scale
            m[2, k], m[3, k], m[4, k] = axx, axy, ayy
            # Along the wall, the window's centroid is biased towards most points: the cell's own centroid replaces it.
            dx, dy = mx - m[6, k], my - m[7, k]
            m[0, k], m[1, k] = m[6, k] + axx * dx + axy * dy, m[7, k] + axy * dx + ayy * dy
        for k in range(block):
            slot = uint64(slots[first + k])
            lines[slot, 0], lines[slot, 1] = m[0, k], m[1, k]
            lines[slot, 2], lines[slot, 3], lines[slot, 4] = m[2, k], m[3, k], m[4, k]


@helper
def _weights(cell_m: float, sigma_m: float) -> F64_2D:
    """Return the Gaussian window of the line fit."""
    along = np.exp(-0.5 * (np.arange(-WINDOW_CELLS, WINDOW_CELLS + 1) * cell_m / sigma_m) ** 2)
    out: F64_2D = along.reshape(-1, 1) * along
    return out


@helper
def _gather(slot: int, weight: F64_2D, nearest: U32_2D, cells: I32_2D, moments: F64_2D) -> None:
    """Add the moments of a cell and its neighbours to the windowed moments of the cell."""
    wide, flat = int64(nearest.shape[1]), nearest.ravel()
    row, col = cells[slot, 0] - WINDOW_CELLS, cells[slot, 1] - WINDOW_CELLS
    for i in range(2 * WINDOW_CELLS + 1):
        for j in range(2 * WINDOW_CELLS + 1):
            there = flat[uint64((row + i) * wide + col + j)]
            if closeness_of(there) > FAR:
                other = int64(slot_of(there))
                for m in range(6):
                    moments[slot, 6 + m] += weight[i, j] * moments[other, m]


@kernel
def rebuild(
    geometry: F64_1D, nearest: Out[U32_2D], cells: Out[I32_2D], moments: Out[F64_2D], lines: Out[F64_2D]
) -> None:
    """Rebuild the map, with ``nearest`` all 0, from its cells and their own moments."""
    _, _, cell_m, sigma_m, noise_m, _ = geometry
    weight = _weights(cell_m, sigma_m)
    for slot in range(1, len(cells)):
        _stamp(slot, cells[slot, 0], cells[slot, 1], nearest)
    moments[1:, 6:] = 0.0
    for slot in range(1, len(cells)):
        _gather(slot, weight, nearest, cells, moments)
    _fit(np.arange(1, len(cells)), noise_m, moments, lines)


@helper
def _assign_cells(
    xy_map_m: F64_2D,
    geometry: F64_1D,
    count: int,
    nearest: U32_2D,
    cells: I32_2D,
    moments: F64_2D,
    lines: F64_2D,
    slots: I64_1D,
) -> int:
    """Write the index of every point's cell to ``slots``, also of new cells; return the new number of cells.

    A new cell starts with the moments of its neighbours.
    """
    (ox, oy, cell, sigma_m, _, _), wide, flat = geometry, int64(nearest.shape[1]), nearest.ravel()
    weight = _weights(cell, sigma_m)
    for k in range(len(xy_map_m)):
        slots[k] = int(np.floor((xy_map_m[k, 1] - oy) / cell)) * wide + int(np.floor((xy_map_m[k, 0] - ox) / cell))
    for k in range(len(xy_map_m)):
        at = uint64(slots[k])
        if closeness_of(flat[at]) <= FAR:  # only an occupied cell has a closeness of FAR + 1
            cells[count, 0], cells[count, 1] = slots[k] // wide, slots[k] % wide
            moments[count, :] = 0.0
            lines[count, 6:] = 0.0
            _stamp(count, cells[count, 0], cells[count, 1], nearest)
            _gather(count, weight, nearest, cells, moments)
            count += 1
        slots[k] = slot_of(flat[at])
    return count


@helper
def _add_waiting(xy_map_m: F64_2D, slots: I64_1D, moments: F64_2D, lines: F64_2D, waiting: F64_2D) -> None:
    """Add points to the waiting points of their cells."""
    n = int(waiting[0, 0])
    for k in range(len(slots)):
        slot = uint64(slots[k])
        if lines[slot, 6] == 0.0:
            n += 1
            lines[slot, 6] = n
            waiting[n, :6] = 0.0
            waiting[n, 6], waiting[n, 7] = slot, moments[slot, 0]
        x, y, row = xy_map_m[k, 0], xy_map_m[k, 1], uint64(lines[slot, 6])
        waiting[row, 0] += 1.0
        waiting[row, 1] += x
        waiting[row, 2] += y
        waiting[row, 3] += x * x
        waiting[row, 4] += x * y
        waiting[row, 5] += y * y
    waiting[0, 0] = n


@helper
def _distribute(
    slots: I64_1D, geometry: F64_1D, nearest: U32_2D, cells: I32_2D, moments: F64_2D, lines: F64_2D, waiting: F64_2D
) -> None:
    """Add the waiting points of some cells to them and their neighbours; refit the lines. Cells may be listed twice."""
    _, _, cell_m, sigma_m, noise_m, _ = geometry
    weight, n_waiting = _weights(cell_m, sigma_m), int(waiting[0, 0])
    wide, flat = int64(nearest.shape[1]), nearest.ravel()
    touched, n_touched = np.empty(min(len(slots) * weight.size, len(cells)) + 1, np.int64), 0
    for k in range(len(slots)):
        slot = uint64(slots[k])
        new = uint64(lines[slot, 6])
        if new == 0:
            continue
        n, x, y = waiting[new, 0], waiting[new, 1], waiting[new, 2]
        xx, xy, yy = waiting[new, 3], waiting[new, 4], waiting[new, 5]
        for m in range(6):
            moments[slot, m] += waiting[new, m]
        for m in range(8):
            waiting[new, m] = waiting[n_waiting, m]  # the last row replaces the freed one
        lines[uint64(waiting[new, 6]), 6] = new
        lines[slot, 6] = 0.0
        n_waiting -= 1
        row, col = cells[slot, 0] - WINDOW_CELLS, cells[slot, 1] - WINDOW_CELLS
        for i in range(2 * WINDOW_CELLS + 1):
            for j in range(2 * WINDOW_CELLS + 1):
                there = flat[uint64((row + i) * wide + col + j)]
                if closeness_of(there) > FAR:
                    other, w = uint64(slot_of(there)), weight[uint64(i), uint64(j)]
                    moments[other, 6] += w * n
                    moments[other, 7] += w * x
                    moments[other, 8] += w * y
                    moments[other, 9] += w * xx
                    moments[other, 10] += w * xy
                    moments[other, 11] += w * yy
                    touched[uint64(n_touched)] = other  # overwritten unless it is new
                    n_touched += lines[other, 7] == 0.0
                    lines[other, 7] = 1.0
    for t in range(n_touched):
        lines[touched[t], 7] = 0.0
    _fit(touched[:n_touched], noise_m, moments, lines)
    waiting[0, 0] = n_waiting


@kernel
def insert_points(
    xy_map_m: F64_2D,
    geometry: F64_1D,
    count: int,
    nearest: Out[U32_2D],
    cells: Out[I32_2D],
    moments: Out[F64_2D],
    lines: Out[F64_2D],
    waiting: Out[F64_2D],
) -> int:
    """Insert points (n, 2) into the map and refit the lines that they change; return the new number of cells.

    The points of a cell wait until they are more than a share of its included points: a line that is fitted to many
    points changes little, and the update of all neighbours takes most of the time.

    Every point must be ``REACH_CELLS`` + 1 or more inside ``nearest``, the arrays over cells must have space for one
    new cell per point, and ``waiting`` must have more rows than there are points.
    """
    _, _, _, _, _, waiting_share = geometry
    n_waiting, slots = int(waiting[0, 0]), np.empty(len(xy_map_m), np.int64)
    if n_waiting + len(xy_map_m) >= len(waiting):
        _distribute(waiting[1 : n_waiting + 1, 6].astype(np.int64), geometry, nearest, cells, moments, lines, waiting)
    count = _assign_cells(xy_map_m, geometry, count, nearest, cells, moments, lines, slots)
    _add_waiting(xy_map_m, slots, moments, lines, waiting)
    n = 0
    for k in range(len(slots)):
        row = uint64(lines[uint64(slots[k]), 6])
        slots[n] = slots[k]  # overwritten unless enough points wait
        n += waiting[row, 0] > waiting_share * waiting[row, 7]
    _distribute(slots[:n], geometry, nearest, cells, moments, lines, waiting)
    return count
