"""Counting laser hits in cells, and the beams that passed through them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import boolean, float64, int8, int32, types, uint64, void

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

NEAR_CELLS = 3
"""A beam does not go clear through a cell if one of the same scan ends so near to it."""

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)
_I2 = types.Array(int8, 2, "C", readonly=True)


@kernel(void(_F1, _F2, _F1, _F1, _I2, int8[:, ::1]))
def show_ends(
    ranges_m: NDArray[np.float64],
    directions: NDArray[np.float64],
    pose: NDArray[np.float64],
    lattice: NDArray[np.float64],
    walls: NDArray[np.int8],
    cells: NDArray[np.int8],
) -> None:
    """Copy ``walls`` to ``cells``, both (rows, cols), where a beam of one scan ended in an occupied cell, 100.

    ``ranges_m`` (beams,) are NaN without a return, ``directions`` (beams, 2) cosines and sines in the laser's frame,
    ``pose`` (3,) x, y, yaw of the laser in the map, ``lattice`` as of ``add_scan``. Ends outside are passed over.
    """
    rows, cols = cells.shape
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for k in range(len(ranges_m)):
        if not np.isfinite(ranges_m[k]):
            continue
        x, y = ranges_m[k] * directions[k, 0], ranges_m[k] * directions[k, 1]
        col = int(np.floor((pose[0] + c * x - s * y - lattice[0]) / lattice[2]))
        row = int(np.floor((pose[1] + s * x + c * y - lattice[1]) / lattice[2]))
        if 0 <= row < rows and 0 <= col < cols and walls[row, col] == 100:
            cells[row, col] = 100


@kernel(void(_F2, _F1, int32[:, ::1], boolean))
def _shield(
    xy_map_m: NDArray[np.float64], lattice: NDArray[np.float64], through: NDArray[np.int32], shielded: bool
) -> None:
    """Turn the counts n near points (n, 2) to -1 - n, so that they can be told from the others, or back again."""
    ox, oy, cell = lattice
    rows, cols = through.shape
    at_row, at_col = -2, -2
    for k in range(len(xy_map_m)):
        row, col = int(np.floor((xy_map_m[k, 1] - oy) / cell)), int(np.floor((xy_map_m[k, 0] - ox) / cell))
        if abs(row - at_row) <= 1 and abs(col - at_col) <= 1:
            continue  # the neighbour's square is enough
        at_row, at_col = row, col
        for r in range(max(row - NEAR_CELLS, 0), min(row + NEAR_CELLS + 1, rows)):
            for c in range(max(col - NEAR_CELLS, 0), min(col + NEAR_CELLS + 1, cols)):
                if (through[r, c] < 0) != shielded:
                    through[r, c] = -1 - through[r, c]


@kernel(void(_F2, _F1, _F1, int32[:, ::1], int32[:, ::1], int32[:, ::1]))
def add_scan(
    xy_map_m: NDArray[np.float64],
    laser_xy_m: NDArray[np.float64],
    lattice: NDArray[np.float64],
    hits: NDArray[np.int32],
    passes: NDArray[np.int32],
    through: NDArray[np.int32],
) -> None:
    """Count every end point (n, 2) in ``hits`` and the cells between the laser and it in ``passes``.

    ``through`` counts the same crossings, but for those of cells with an end point of this scan near by.
    ``lattice`` is (3,): x and y of the corner of cell [0, 0], and the cell edge, in m. A beam walks from cell to cell
    across their edges (Amanatides and Woo 1987). The caller sees to it that all lies inside.
    """
    ox, oy, cell = lattice
    u0, v0 = (laser_xy_m[0] - ox) / cell, (laser_xy_m[1] - oy) / cell
    wide, flat, clear = passes.shape[1], passes.ravel(), through.ravel()
    _shield(xy_map_m, lattice, through, True)
    for k in range(len(xy_map_m)):
        u1, v1 = (xy_map_m[k, 0] - ox) / cell, (xy_map_m[k, 1] - oy) / cell
        col, row = int(np.floor(u0)), int(np.floor(v0))
        end_col, end_row = int(np.floor(u1)), int(np.floor(v1))
        du, dv = u1 - u0, v1 - v0
        step_col, step_row = (1 if du > 0 else -1), (wide if dv > 0 else -wide)
        # Share of the beam at which the next column and the next row begin.
        next_u = ((col + (du > 0)) - u0) / du if du != 0.0 else np.inf
        next_v = ((row + (dv > 0)) - v0) / dv if dv != 0.0 else np.inf
        each_u = abs(1.0 / du) if du != 0.0 else np.inf
        each_v = abs(1.0 / dv) if dv != 0.0 else np.inf
        # The number of steps is known beforehand: rounding can then neither overshoot the end nor miss it.
        cols, rows, at = abs(end_col - col), abs(end_row - row), row * wide + col
        for _ in range(cols + rows):
            flat[uint64(at)] += 1
            if clear[uint64(at)] >= 0:
                clear[uint64(at)] += 1
            if (next_u < next_v and cols > 0) or rows == 0:
                at += step_col
                cols -= 1
                next_u += each_u
            else:
                at += step_row
                rows -= 1
                next_v += each_v
        hits[end_row, end_col] += 1
    _shield(xy_map_m, lattice, through, False)
