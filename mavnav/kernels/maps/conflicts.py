"""Visibility conflicts of a scan with the map: beams through walls, end points in free space (docs/method.md)."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, U16_2D, U16_3D, U32_2D, helper, int64, kernel
from mavnav.kernels.maps.layout import EXPLAINED_CELLS, FAR, WALL_HITS
from mavnav.kernels.maps.lookup import closeness_of, count_at

FREE_PASSES = 3  # minimum number of beams that crossed a free cell
GRAZE_CELLS = 10  # last part of a beam, not tested: it may run along the wall that it ends on
STRIDE = 8  # cells of a beam that one read of ``nearest`` can exclude
CLEAR_CELLS = 7  # a hit farther from the middle of a stride is not on it: half of it, 2 ** 0.5 for cells, 1.5 margin

LEAST = FAR + 1 - CLEAR_CELLS * CLEAR_CELLS  # the closeness of a hit cell `CLEAR_CELLS` away


@helper
def _in_free_space(row: int, col: int, hits: U16_3D, passes: U16_2D) -> bool:
    """Return whether a cell is free, with no hit within `EXPLAINED_CELLS`."""
    rows, cols = passes.shape
    if not (0 <= row < rows and 0 <= col < cols) or passes[row, col] < FREE_PASSES:
        return False
    if count_at(hits, row, col) > 0:
        return False
    for r in range(max(row - EXPLAINED_CELLS, 0), min(row + EXPLAINED_CELLS + 1, rows)):
        for c in range(max(col - EXPLAINED_CELLS, 0), min(col + EXPLAINED_CELLS + 1, cols)):
            if count_at(hits, r, c) > 0:
                return False
    return True


@helper
def _through_wall(
    u0: float,
    v0: float,
    u1: float,
    v1: float,
    hits: U16_3D,
    passes: U16_2D,
    nearest: U32_2D,
    offset: tuple[float, float],
) -> bool:
    """Return whether the beam from (u0, v0) to (u1, v1), in cells, meets a wall well before its end.

    ``offset`` are column and row of the grid's cell [0, 0] in ``nearest``.
    """
    rows, cols = passes.shape
    length = np.sqrt((u1 - u0) * (u1 - u0) + (v1 - v0) * (v1 - v0))
    du, dv, last = (u1 - u0) / length, (v1 - v0) / length, int(length - GRAZE_CELLS)
    u, v = u0 + offset[0], v0 + offset[1]
    for start in range(2, last, STRIDE):
        middle = start + STRIDE // 2
        row, col = int(v + middle * dv), int(u + middle * du)
        inside = 0 <= row < nearest.shape[0] and 0 <= col < nearest.shape[1]
        if not inside or int64(closeness_of(nearest[row, col])) < LEAST:
            continue
        for i in range(start, min(start + STRIDE, last)):
            row, col = int(np.floor(v0 + i * dv)), int(np.floor(u0 + i * du))
            inside = 0 <= row < rows and 0 <= col < cols
            if inside and count_at(hits, row, col) >= max(WALL_HITS, passes[row, col]):
                return True
    return False


@kernel
def conflicts(
    points: F64_2D, pose: F64_1D, lattice: F64_1D, hits: U16_3D, passes: U16_2D, nearest: U32_2D, geometry: F64_1D
) -> int:
    """Count the visibility conflicts of points (n, 2), laser frame, m, with the laser at ``pose``: x, y (m), yaw (rad).

    Either the point lies in free space: beams crossed its cell and no hit is near. Or the beam from the laser to it
    meets a wall, a cell hit ``WALL_HITS`` times and at least as often as crossed. ``lattice``, ``hits`` and ``passes``
    are those of a ``GridBuilder``, ``nearest`` and ``geometry`` those of a ``LineMap`` with the same cells.
    """
    (ox, oy, cell), (x, y, yaw), (map_x, map_y, _, _, _, _) = lattice, pose, geometry
    offset = (ox - map_x) / cell, (oy - map_y) / cell
    u0, v0, c, s = (x - ox) / cell, (y - oy) / cell, np.cos(yaw), np.sin(yaw)
    count = 0
    for k in range(len(points)):
        px, py = points[k, 0], points[k, 1]
        u1, v1 = (x + c * px - s * py - ox) / cell, (y + s * px + c * py - oy) / cell
        row, col = int(np.floor(v1)), int(np.floor(u1))
        if _in_free_space(row, col, hits, passes) or _through_wall(u0, v0, u1, v1, hits, passes, nearest, offset):
            count += 1
    return count
