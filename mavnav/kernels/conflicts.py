"""What a scan in its place contradicts of the map: beams through walls, ends in open space (docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import boolean, float64, int64, types, uint16, uint32

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

WALL_HITS = 4  # fewer may be strays
FREE_PASSES = 3  # beams that crossed an open cell
REACH_CELLS = 7  # a hit so near explains an end point
GRAZE_CELLS = 10  # a beam may run along the wall that it ends on
STRIDE = 8  # cells of a beam that one look may clear
CLEAR_CELLS = 7  # from the middle of a stride to what it meets: half of it, 2 ** 0.5 for two cells, 1.5 to spare

FAR = 64  # squared reach of ``nearest`` in cells, as ``linemap`` has it
NEAR = 128  # an entry of ``nearest`` is an index times this, as ``linemap`` has it
LEAST = FAR + 1 - CLEAR_CELLS * CLEAR_CELLS  # of how near an entry tells where a hit cell is `CLEAR_CELLS` away
WIDE, SHIFT = 64, 6  # cells of a strip, as ``mavnav.lattice`` has them, and its logarithm

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)
_U2 = types.Array(uint16, 2, "C", readonly=True)
_U3 = types.Array(uint16, 3, "C", readonly=True)
_U4 = types.Array(uint32, 2, "C", readonly=True)


@kernel(boolean(int64, int64, _U3, _U2))
def _in_the_open(row: int, col: int, hits: NDArray[np.uint16], passes: NDArray[np.uint16]) -> bool:
    """Tell whether a cell was seen empty, with no hit within reach."""
    rows, cols = passes.shape
    if not (0 <= row < rows and 0 <= col < cols) or passes[row, col] < FREE_PASSES:
        return False
    if hits[col >> SHIFT, row, col & (WIDE - 1)] > 0:
        return False
    for r in range(max(row - REACH_CELLS, 0), min(row + REACH_CELLS + 1, rows)):
        for c in range(max(col - REACH_CELLS, 0), min(col + REACH_CELLS + 1, cols)):
            if hits[c >> SHIFT, r, c & (WIDE - 1)] > 0:
                return False
    return True


@kernel(boolean(float64, float64, float64, float64, _U3, _U2, _U4, types.UniTuple(float64, 2)))
def _through_a_wall(
    u0: float,
    v0: float,
    u1: float,
    v1: float,
    hits: NDArray[np.uint16],
    passes: NDArray[np.uint16],
    nearest: NDArray[np.uint32],
    behind: tuple[float, float],
) -> bool:
    """Tell whether the beam from (u0, v0) to (u1, v1), in cells, meets a wall well before its end.

    ``behind`` are column and row of the grid's cell [0, 0] in ``nearest``.
    """
    rows, cols = passes.shape
    length = np.sqrt((u1 - u0) * (u1 - u0) + (v1 - v0) * (v1 - v0))
    du, dv, last = (u1 - u0) / length, (v1 - v0) / length, int(length - GRAZE_CELLS)
    u, v = u0 + behind[0], v0 + behind[1]
    for start in range(2, last, STRIDE):
        middle = start + STRIDE // 2
        row, col = int(v + middle * dv), int(u + middle * du)
        inside = 0 <= row < nearest.shape[0] and 0 <= col < nearest.shape[1]
        if not inside or int64(nearest[row, col] % NEAR) < LEAST:
            continue
        for i in range(start, min(start + STRIDE, last)):
            row, col = int(np.floor(v0 + i * dv)), int(np.floor(u0 + i * du))
            inside = 0 <= row < rows and 0 <= col < cols
            if inside and hits[col >> SHIFT, row, col & (WIDE - 1)] >= max(WALL_HITS, passes[row, col]):
                return True
    return False


@kernel(int64(_F2, _F1, _F1, _U3, _U2, _U4, _F1))
def conflicts(
    points: NDArray[np.float64],
    pose: NDArray[np.float64],
    lattice: NDArray[np.float64],
    hits: NDArray[np.uint16],
    passes: NDArray[np.uint16],
    nearest: NDArray[np.uint32],
    geometry: NDArray[np.float64],
) -> int:
    """Count the points (n, 2), laser frame, m, that the map speaks against if the laser is at ``pose``: x, y (m), yaw.

    Either the point lies in the open: its cell was crossed by beams and no hit is near; or the beam from the laser to
    it meets a wall, a cell hit ``WALL_HITS`` times and at least as often as crossed. ``lattice``, ``hits`` and
    ``passes`` are the map's, see ``Tally``; ``nearest`` and ``geometry`` those of a ``LineMap`` of the same cells.
    """
    ox, oy, cell = lattice
    behind = (ox - geometry[0]) / cell, (oy - geometry[1]) / cell
    u0, v0, c, s = (pose[0] - ox) / cell, (pose[1] - oy) / cell, np.cos(pose[2]), np.sin(pose[2])
    count = 0
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        u1, v1 = (pose[0] + c * x - s * y - ox) / cell, (pose[1] + s * x + c * y - oy) / cell
        if _in_the_open(int(np.floor(v1)), int(np.floor(u1)), hits, passes) or _through_a_wall(
            u0, v0, u1, v1, hits, passes, nearest, behind
        ):
            count += 1
    return count
