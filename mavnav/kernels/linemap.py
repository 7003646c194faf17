"""Occupied cells with the moments of their points, and the local line through each (docs/method.md).

Layout shared by this file and ``linesearch``:

``nearest``  (rows, cols) int32   index of the nearest occupied cell within reach, -1 where none is
``cells``    (capacity, 2) int32  row, col of the occupied cells, in the order they were first hit
``own``      (capacity, 6) float64   n, sum x, sum y, sum xx, sum xy, sum yy of a cell's points, m in the map frame
``smooth``   (capacity, 6) float64   the same, summed over a window of neighbours with Gaussian weights
``lines``    (capacity, 8) float64   centroid x, y and the metric a_xx, a_xy, a_yy of the local line; the rest pads
``geometry`` (5,) float64        origin x, origin y, cell, line sigma, line noise, in m
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import boolean, float64, int32, int64, types, void

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

WINDOW_CELLS = 4  # half-width of the line fit's window: 9x9 cells
REACH_CELLS = 8  # nearest occupied cells are known this far

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)


@kernel(void(int64, int64, int64, int32[:, ::1], int32[:, ::1]))
def _stamp(slot: int, row: int, col: int, nearest: NDArray[np.int32], cells: NDArray[np.int32]) -> None:
    """Make ``slot`` the nearest occupied cell wherever it is nearer than the present one (ties keep the older)."""
    for r in range(row - REACH_CELLS, row + REACH_CELLS + 1):
        for c in range(col - REACH_CELLS, col + REACH_CELLS + 1):
            d2 = (r - row) * (r - row) + (c - col) * (c - col)
            if d2 > REACH_CELLS * REACH_CELLS:
                continue
            old = nearest[r, c]
            if old >= 0:
                dr, dc = r - cells[old, 0], c - cells[old, 1]
                if dr * dr + dc * dc <= d2:
                    continue
            nearest[r, c] = slot


@kernel(boolean(int64, int64, int64, int32[:, ::1]))
def _is_cell(slot: int, row: int, col: int, cells: NDArray[np.int32]) -> bool:
    """Tell whether an entry of ``nearest`` at (row, col) is the occupied cell (row, col) itself."""
    return slot >= 0 and cells[slot, 0] == row and cells[slot, 1] == col


@kernel(void(int64, float64, float64[:, ::1], float64[:, ::1]))
def _fit(slot: int, noise_m: float, smooth: NDArray[np.float64], lines: NDArray[np.float64]) -> None:
    """Refit one line: A = ((tr C + s0^2) I - C) / (l1 + s0^2), 1 along the normal and small along the wall."""
    n = smooth[slot, 0]
    mx, my = smooth[slot, 1] / n, smooth[slot, 2] / n
    cxx = max(smooth[slot, 3] / n - mx * mx, 0.0)
    cyy = max(smooth[slot, 5] / n - my * my, 0.0)
    cxy = smooth[slot, 4] / n - mx * my
    half, diff = 0.5 * (cxx + cyy), 0.5 * (cxx - cyy)
    l1 = half + np.sqrt(diff * diff + cxy * cxy)
    s2 = noise_m * noise_m
    scale = 1.0 / (l1 + s2)
    lines[slot, 0], lines[slot, 1] = mx, my
    lines[slot, 2] = (cyy + s2) * scale
    lines[slot, 3] = -cxy * scale
    lines[slot, 4] = (cxx + s2) * scale


@kernel(int64(_F2, _F1, int64, int32[:, ::1], int32[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1]))
def insert_points(
    xy_map_m: NDArray[np.float64],
    geometry: NDArray[np.float64],
    count: int,
    nearest: NDArray[np.int32],
    cells: NDArray[np.int32],
    own: NDArray[np.float64],
    smooth: NDArray[np.float64],
    lines: NDArray[np.float64],
) -> int:
    """Add points (n, 2) to the map and refit the lines that they touch; returns the new number of cells.

    The caller sees to room: every point lies ``REACH_CELLS`` or more inside ``nearest``, and the arrays over cells
    have space for one new cell a point.
    """
    ox, oy, cell, sigma, noise = geometry
    n = len(xy_map_m)
    slots = np.empty(n, np.int64)
    first = count
    weight = np.empty((2 * WINDOW_CELLS + 1, 2 * WINDOW_CELLS + 1))
    for i in range(-WINDOW_CELLS, WINDOW_CELLS + 1):
        for j in range(-WINDOW_CELLS, WINDOW_CELLS + 1):
            weight[i + WINDOW_CELLS, j + WINDOW_CELLS] = np.exp(-0.5 * (i * i + j * j) * (cell / sigma) ** 2)

    for k in range(n):
        row, col = int(np.floor((xy_map_m[k, 1] - oy) / cell)), int(np.floor((xy_map_m[k, 0] - ox) / cell))
        slot = int64(nearest[row, col])
        if not _is_cell(slot, row, col, cells):
            slot = count
            count += 1
            cells[slot, 0], cells[slot, 1] = row, col
            own[slot, :] = 0.0
            smooth[slot, :] = 0.0
            _stamp(slot, row, col, nearest, cells)
        slots[k] = slot

    # A new cell starts from what its neighbours held before this scan.
    for slot in range(first, count):
        row, col = cells[slot, 0], cells[slot, 1]
        for i in range(-WINDOW_CELLS, WINDOW_CELLS + 1):
            for j in range(-WINDOW_CELLS, WINDOW_CELLS + 1):
                other = int64(nearest[row + i, col + j])
                if _is_cell(other, row + i, col + j, cells):
                    w = weight[i + WINDOW_CELLS, j + WINDOW_CELLS]
                    for m in range(6):
                        smooth[slot, m] += w * own[other, m]

    order = np.argsort(slots, kind="mergesort")
    touched = np.empty(n * weight.size, np.int64)
    n_touched = 0
    k = 0
    delta = np.empty(6)
    while k < n:
        slot = slots[order[k]]
        delta[:] = 0.0
        while k < n and slots[order[k]] == slot:
            x, y = xy_map_m[order[k], 0], xy_map_m[order[k], 1]
            delta[0] += 1.0
            delta[1] += x
            delta[2] += y
            delta[3] += x * x
            delta[4] += x * y
            delta[5] += y * y
            k += 1
        for m in range(6):
            own[slot, m] += delta[m]
        row, col = cells[slot, 0], cells[slot, 1]
        for i in range(-WINDOW_CELLS, WINDOW_CELLS + 1):
            for j in range(-WINDOW_CELLS, WINDOW_CELLS + 1):
                other = int64(nearest[row + i, col + j])
                if not _is_cell(other, row + i, col + j, cells):
                    continue
                w = weight[i + WINDOW_CELLS, j + WINDOW_CELLS]
                for m in range(6):
                    smooth[other, m] += w * delta[m]
                if lines[other, 7] == 0.0:
                    lines[other, 7] = 1.0
                    touched[n_touched] = other
                    n_touched += 1
    for t in range(n_touched):
        _fit(touched[t], noise, smooth, lines)
        lines[touched[t], 7] = 0.0
    return count
