"""Counts of laser hits in cells, and of beams that crossed them."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import (
    F64_1D,
    F64_2D,
    I8_2D,
    I16_3D,
    I32_1D,
    I64_2D,
    U16_2D,
    U16_3D,
    Out,
    float64,
    helper,
    int32,
    int64,
    kernel,
    uint64,
)
from mavnav.kernels.maps.layout import MOST, MOST_SHIELDED, SHIFT, WIDE

NEAR_CELLS = 3
"""Distance to an end point of the same scan within which a crossing is shielded, not clear."""

BLOCK = 8  # cells of a beam that are computed at a time


@kernel
def show_ends(
    ranges_m: F64_1D, directions: F64_2D, pose: F64_1D, lattice: F64_1D, walls: I8_2D, cells: Out[I8_2D]
) -> int:
    """Copy the occupied cells, 100, of ``walls`` in which beams of one scan ended to ``cells``, both (rows, cols).

    Returns the number of such beams. Both arrays may be the same, which then does not change.
    ``ranges_m`` (beams,) are NaN without a return, ``directions`` (beams, 2) cosines and sines in the laser's frame,
    ``pose`` (3,) x, y, yaw of the laser in the map, ``lattice`` as of ``add_scan``. End points outside are ignored.
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
def _mark_near(ends: F64_2D, passes: U16_2D, shielded: I16_3D, cells: I64_2D) -> int:
    """List each cell near points (n, 2), in cells, once; return their number.

    ``cells`` are their indices in ``shielded`` and in ``passes``, and their crossings so far. Their counts are made
    negative as a mark.
    """
    rows, cols = passes.shape
    flat, crossed, across = shielded.ravel(), passes.ravel(), (rows - 1) * WIDE
    at_row, at_col, n = -2 * NEAR_CELLS - 1, -2 * NEAR_CELLS - 1, 0
    for k in range(len(ends)):
        row, col = int(np.floor(ends[k, 1])), int(np.floor(ends[k, 0]))
        if abs(row - at_row) <= 1 and abs(col - at_col) <= 1:
            continue  # the square of the last point covers it nearly
        first, end = max(col - NEAR_CELLS, 0), min(col + NEAR_CELLS + 1, cols)
        for r in range(max(row - NEAR_CELLS, 0), min(row + NEAR_CELLS + 1, rows)):
            # In common rows the square before has listed all columns except those on one side.
            beside = abs(r - at_row) <= NEAR_CELLS
            start = max(first, at_col + NEAR_CELLS + 1) if beside and col >= at_col else first
            stop = min(end, at_col - NEAR_CELLS) if beside and col < at_col else end
            for c in range(start, stop):
                at, place = uint64(c + (c >> SHIFT) * across + WIDE * r), uint64(r * cols + c)
                count = flat[at]
                # The next entry overwrites this one unless it is new.
                cells[0, uint64(n)], cells[1, uint64(n)], cells[2, uint64(n)] = at, place, crossed[place]
                flat[at] = -1 - count if count >= 0 else count
                n += count >= 0
        at_row, at_col = row, col
    return n


@helper
def path_cells(u0: float, v0: float, u1: float, v1: float, wide: float, steps: F64_1D, cells: I32_1D) -> int:
    """List the cells that a beam from (u0, v0) to (u1, v1), in cells, enters, the last one included; return the number.

    It crosses the edges of columns and those of rows at even distances (Amanatides and Woo 1987). At an edge of one
    kind, the number of edges of the other kind crossed before gives the cell. ``steps`` are 0, 1, 2 ...; ``cells`` has
    room for one more block.
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


@kernel
def add_scan(
    xy_map_m: F64_2D,
    laser_xy_m: F64_1D,
    lattice: F64_1D,
    hits: Out[U16_3D],
    passes: Out[U16_2D],
    shielded: Out[I16_3D],
    room: bool,
) -> None:
    """Count every end point (n, 2) in ``hits`` and the cells between the laser and it in ``passes``, up to `MOST`.

    ``shielded`` counts the crossings of cells with an end point of the same scan near. ``shielded`` and ``hits`` are in
    strips, see ``mavnav.mapping.tiled_arrays``. ``lattice`` is (3,): x and y of the corner of cell [0, 0], and the cell
    edge, in m. All points and the laser must be inside. With ``room``, no cell is crossed so often that another n beams
    could exceed `MOST`, so that crossings are counted without a test; a beam may count a cell at whose corner it passes
    twice.
    """
    (ox, oy, cell), (laser_x, laser_y) = lattice, laser_xy_m
    u0, v0 = (laser_x - ox) / cell, (laser_y - oy) / cell
    (rows, cols), flat = passes.shape, passes.ravel()
    near = np.empty((3, (2 * NEAR_CELLS + 1) ** 2 * len(xy_map_m) + 1), np.int64)
    ends = np.empty((len(xy_map_m), 2))
    for k in range(len(xy_map_m)):
        ends[k, 0], ends[k, 1] = (xy_map_m[k, 0] - ox) / cell, (xy_map_m[k, 1] - oy) / cell
    n_near = _mark_near(ends, passes, shielded, near)
    steps, path = np.arange(float(max(rows, cols) + BLOCK)), np.empty(rows + cols + BLOCK, np.int32)
    begin = uint64(int(np.floor(v0)) * cols + int(np.floor(u0)))
    for k in range(len(xy_map_m)):
        row, col = int(np.floor(ends[k, 1])), int(np.floor(ends[k, 0]))
        before = passes[row, col]
        flat[begin] += flat[begin] < MOST
        entered = path_cells(u0, v0, ends[k, 0], ends[k, 1], float64(cols), steps, path)
        if room:
            for i in range(entered):
                flat[uint64(path[uint64(i)])] += 1
        else:
            for i in range(entered):
                at = uint64(path[uint64(i)])
                if flat[at] < MOST:
                    flat[at] += 1
        passes[row, col] = before  # the beam ends there; at a corner it may have counted a neighbor instead
        ended = hits[col >> SHIFT, row]
        ended[col & (WIDE - 1)] += ended[col & (WIDE - 1)] < MOST
    flat_shielded = shielded.ravel()
    for i in range(n_near):
        at, place, before = uint64(near[0, uint64(i)]), uint64(near[1, uint64(i)]), near[2, uint64(i)]
        flat_shielded[at] = min(int64(flat[place]) - before - 1 - flat_shielded[at], MOST_SHIELDED)
