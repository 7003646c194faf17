"""What did not stay where it was seen, such as people walking by (docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import boolean, int16, int64, types, uint16

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

CLEAR_BEAMS = 8  # went clear through an open cell
STAYS_SHARE = 0.15  # of the beams to a cell that holds something end in it
WALL_HITS = 4  # fewer may be strays
REACH_CELLS = 7  # a wall so near explains an end point
MOST_SHIELDED = 32767  # the count ends there
WIDE, SHIFT = 64, 6  # cells of a strip, as ``mavnav.lattice`` has them, and its logarithm

_U2 = types.Array(uint16, 2, "C", readonly=True)
_U3 = types.Array(uint16, 3, "C", readonly=True)
_I3 = types.Array(int16, 3, "C", readonly=True)


@kernel(int64(int64, int64))
def _clear(passes: int, shielded: int) -> int:
    """Return how many beams went clear through a cell; where their count has ended, none that is known of."""
    return passes - shielded if shielded < MOST_SHIELDED else 0


@kernel(boolean(int64, int64, _U3, _U2, _I3))
def _is_open(
    row: int, col: int, hits: NDArray[np.uint16], passes: NDArray[np.uint16], shielded: NDArray[np.int16]
) -> bool:
    """Tell whether beams went clear through a cell that hardly any ended in, with no wall within reach."""
    rows, cols = passes.shape
    strip, c = col >> SHIFT, col & (WIDE - 1)
    ended, clear = int64(hits[strip, row, c]), _clear(passes[row, col], shielded[strip, row, c])
    if clear < CLEAR_BEAMS or ended >= STAYS_SHARE * (ended + clear):
        return False
    for r in range(max(row - REACH_CELLS, 0), min(row + REACH_CELLS + 1, rows)):
        for c in range(max(col - REACH_CELLS, 0), min(col + REACH_CELLS + 1, cols)):
            strip, k = c >> SHIFT, c & (WIDE - 1)
            ended = int64(hits[strip, r, k])
            if ended >= WALL_HITS and ended >= STAYS_SHARE * (ended + _clear(passes[r, c], shielded[strip, r, k])):
                return False
    return True


@kernel(int64[:, ::1](_U3, _U2, _I3))
def passing_cells(
    hits: NDArray[np.uint16], passes: NDArray[np.uint16], shielded: NDArray[np.int16]
) -> NDArray[np.int64]:
    """List row and column (n, 2) of the cells that were hit and are open all the same; the counts are ``Tally``'s."""
    hit, n = 0, 0
    for count in hits.ravel():
        hit += 1 if count > 0 else 0
    out = np.empty((hit, 2), np.int64)
    for row in range(passes.shape[0]):
        for col in range(passes.shape[1]):
            if hits[col >> SHIFT, row, col & (WIDE - 1)] > 0 and _is_open(row, col, hits, passes, shielded):
                out[n, 0], out[n, 1] = row, col
                n += 1
    return out[:n]
