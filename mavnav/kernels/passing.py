"""What did not stay where it was seen, such as people walking by (docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import boolean, int32, int64, types

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

CLEAR_BEAMS = 8  # went clear through an open cell
STAYS_SHARE = 0.15  # of the beams to a cell that holds something end in it
WALL_HITS = 4  # fewer may be strays
REACH_CELLS = 7  # a wall so near explains an end point

_I2 = types.Array(int32, 2, "C", readonly=True)


@kernel(boolean(int64, int64, _I2, _I2, _I2))
def _is_open(
    row: int, col: int, hits: NDArray[np.int32], passes: NDArray[np.int32], shielded: NDArray[np.int32]
) -> bool:
    """Tell whether beams went clear through a cell that hardly any ended in, with no wall within reach."""
    rows, cols = hits.shape
    ended, clear = hits[row, col], passes[row, col] - shielded[row, col]
    if clear < CLEAR_BEAMS or ended >= STAYS_SHARE * (ended + clear):
        return False
    for r in range(max(row - REACH_CELLS, 0), min(row + REACH_CELLS + 1, rows)):
        for c in range(max(col - REACH_CELLS, 0), min(col + REACH_CELLS + 1, cols)):
            ended = hits[r, c]
            if ended >= WALL_HITS and ended >= STAYS_SHARE * (ended + passes[r, c] - shielded[r, c]):
                return False
    return True


@kernel(int64[:, ::1](_I2, _I2, _I2))
def passing_cells(hits: NDArray[np.int32], passes: NDArray[np.int32], shielded: NDArray[np.int32]) -> NDArray[np.int64]:
    """List row and column (n, 2) of the cells that were hit and are open all the same; the counts are ``Grid``'s."""
    hit, n = 0, 0
    for count in hits.ravel():
        hit += 1 if count > 0 else 0
    out = np.empty((hit, 2), np.int64)
    for row in range(hits.shape[0]):
        for col in range(hits.shape[1]):
            if hits[row, col] > 0 and _is_open(row, col, hits, passes, shielded):
                out[n, 0], out[n, 1] = row, col
                n += 1
    return out[:n]
