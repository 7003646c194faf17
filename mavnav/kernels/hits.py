"""Counting laser hits in cells, and the beams that passed through them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.kernels._jit import helper, kernel
from mavnav.kernels._types import F64_1D, F64_2D, I8_2D, float64, int8, int16, int32, int64, uint16, uint64, void
from mavnav.kernels.layout import MOST, MOST_SHIELDED, SHIFT, WIDE

if TYPE_CHECKING:
    from numpy.typing import NDArray

NEAR_CELLS = 3
"""A beam does not go clear through a cell if one of the same scan ends so near to it."""

BLOCK = 8  # cells of a beam that are found at once


@kernel(int64(F64_1D, F64_2D, F64_1D, F64_1D, I8_2D, int8[:, ::1]))
def show_ends(
    ranges_m: NDArray[np.float64],
    directions: NDArray[np.float64],
    pose: NDArray[np.float64],
    lattice: NDArray[np.float64],
    walls: NDArray[np.int8],
    cells: NDArray[np.int8],
) -> int:
    """Copy ``walls`` to ``cells``, both (rows, cols), where a beam of one scan ended in an occupied cell, 100.

    Returns how many did; both may be the same array, in which nothing changes then.
    ``ranges_m`` (beams,) are NaN without a return, ``directions`` (beams, 2) cosines and sines in the laser's frame,
    ``pose`` (3,) x, y, yaw of the laser in the map, ``lattice`` as of ``add_scan``. Ends outside are passed over.
    """
    (rows, cols), (x, y, yaw), (ox, oy, cell) = cells.shape, pose, lattice
    c, s, count = np.cos(yaw), np.sin(yaw), 0
    for k in range(len(ranges_m)):
        if not np.isfinite(ranges_m[k]):
            continue
        px, py = ranges_m[k] * directions[k, 0], ranges_m[k] * directions[k, 1]
        col = int(np.floor((x + c * px - s * py - ox) / cell))
        row = int(np.floor((y + s * px + c * py - oy) / cell))
        if 0 <= row < rows and 0 <= col < cols and walls[row, col] == 100:
            cells[row, col] = 100
            count += 1
    return count


@helper
def _shield(
    ends: NDArray[np.float64],
    passes: NDArray[np.uint16],
    shielded: NDArray[np.int16],
    cells: NDArray[np.int64],
) -> int:
    """List the cells near points (n, 2), in cells, once each; returns how many.

    ``cells`` are their indices in ``shielded`` and in ``passes``, and how often they were crossed before. Their counts
    are made negative, to mark them.
    """
    rows, cols = passes.shape
    flat, crossed, across = shielded.ravel(), passes.ravel(), (rows - 1) * WIDE
    at_row, at_col, n = -2 * NEAR_CELLS - 1, -2 * NEAR_CELLS - 1, 0
    for k in range(len(ends)):
        row, col = int(np.floor(ends[k, 1])), int(np.floor(ends[k, 0]))
        if abs(row - at_row) <= 1 and abs(col - at_col) <= 1:
            continue  # the neighbour's square is enough
        first, end = max(col - NEAR_CELLS, 0), min(col + NEAR_CELLS + 1, cols)
        for r in range(max(row - NEAR_CELLS, 0), min(row + NEAR_CELLS + 1, rows)):
            # In its rows the square before has listed all columns but those on one side.
            beside = abs(r - at_row) <= NEAR_CELLS
            start = max(first, at_col + NEAR_CELLS + 1) if beside and col >= at_col else first
            stop = min(end, at_col - NEAR_CELLS) if beside and col < at_col else end
            for c in range(start, stop):
                at, place = uint64(c + (c >> SHIFT) * across + WIDE * r), uint64(r * cols + c)
                count = flat[at]
                # Written over unless it is new.
                cells[0, uint64(n)], cells[1, uint64(n)], cells[2, uint64(n)] = at, place, crossed[place]
                flat[at] = -1 - count if count >= 0 else count
                n += count >= 0
        at_row, at_col = row, col
    return n


@helper
def path_cells(
    u0: float, v0: float, u1: float, v1: float, wide: float, steps: NDArray[np.float64], cells: NDArray[np.int32]
) -> int:
    """List the cells that a beam from (u0, v0) to (u1, v1), in cells, enters, its last one too; returns how many.

    It crosses the edges of columns and those of rows at even shares of its length (Amanatides and Woo 1987); how many
    of the others it has crossed before gives the cell. ``steps`` count 0, 1, 2 ...; ``cells`` has a block more.
    """
    col, row, du, dv = np.floor(u0), np.floor(v0), u1 - u0, v1 - v0
    cols, rows = abs(np.floor(u1) - col), abs(np.floor(v1) - row)
    step_col, step_row = (1.0 if du > 0 else -1.0), (wide if dv > 0 else -wide)
    to_col, to_row = abs(col + (du > 0) - u0), abs(row + (dv > 0) - v0)
    at, rise = row * wide + col + step_col, (abs(dv) / abs(du) if du else 0.0)
    start = to_col * rise - to_row + 1.0
    for i in range((int(cols) + BLOCK - 1) // BLOCK * BLOCK):
        before = np.floor(min(start + steps[i] * rise, rows))
        cells[i] = int32(at + steps[i] * step_col + before * step_row)
    others, at, rise = cells[int(cols) :], row * wide + col + step_row, (abs(du) / abs(dv) if dv else 0.0)
    start = to_row * rise - to_col
    for i in range((int(rows) + BLOCK - 1) // BLOCK * BLOCK):
        before = np.ceil(min(max(start + steps[i] * rise, 0.0), cols))
        others[i] = int32(at + steps[i] * step_row + before * step_col)
    return int(cols + rows)


@kernel(void(F64_2D, F64_1D, F64_1D, uint16[:, :, ::1], uint16[:, ::1], int16[:, :, ::1]))
def add_scan(
    xy_map_m: NDArray[np.float64],
    laser_xy_m: NDArray[np.float64],
    lattice: NDArray[np.float64],
    hits: NDArray[np.uint16],
    passes: NDArray[np.uint16],
    shielded: NDArray[np.int16],
) -> None:
    """Count every end point (n, 2) in ``hits`` and the cells between the laser and it in ``passes``, up to `MOST`.

    ``shielded`` counts those of the crossings that were of cells with an end point of the same scan near by. It and
    ``hits`` are in strips, see ``mavnav.mapping.tiled_arrays``.
    ``lattice`` is (3,): x and y of the corner of cell [0, 0], and the cell edge, in m. The caller sees to it that all
    lies inside.
    """
    (ox, oy, cell), (laser_x, laser_y) = lattice, laser_xy_m
    u0, v0 = (laser_x - ox) / cell, (laser_y - oy) / cell
    (rows, cols), flat = passes.shape, passes.ravel()
    near = np.empty((3, (2 * NEAR_CELLS + 1) ** 2 * len(xy_map_m) + 1), np.int64)
    ends = np.empty((len(xy_map_m), 2))
    for k in range(len(xy_map_m)):
        ends[k, 0], ends[k, 1] = (xy_map_m[k, 0] - ox) / cell, (xy_map_m[k, 1] - oy) / cell
    n_near = _shield(ends, passes, shielded, near)
    steps, path = np.arange(float(max(rows, cols) + BLOCK)), np.empty(rows + cols + BLOCK, np.int32)
    begin = uint64(int(np.floor(v0)) * cols + int(np.floor(u0)))
    for k in range(len(xy_map_m)):
        row, col = int(np.floor(ends[k, 1])), int(np.floor(ends[k, 0]))
        flat[begin] += flat[begin] < MOST
        for i in range(path_cells(u0, v0, ends[k, 0], ends[k, 1], float64(cols), steps, path)):
            at = uint64(path[uint64(i)])
            if flat[at] < MOST:
                flat[at] += 1
        passes[row, col] -= passes[row, col] < MOST  # it ends there
        ended = hits[col >> SHIFT, row]
        ended[col & (WIDE - 1)] += ended[col & (WIDE - 1)] < MOST
    flat_shielded = shielded.ravel()
    for i in range(n_near):
        at, place, before = uint64(near[0, uint64(i)]), uint64(near[1, uint64(i)]), near[2, uint64(i)]
        flat_shielded[at] = min(int64(flat[place]) - before - 1 - flat_shielded[at], MOST_SHIELDED)
