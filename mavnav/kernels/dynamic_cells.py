"""Cells that were occupied for a while only, such as by people who walked by (docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.kernels._jit import helper, kernel
from mavnav.kernels._types import I16_3D, U16_2D, U16_3D, int64
from mavnav.kernels.layout import EXPLAINED_CELLS, MOST_SHIELDED, WALL_HITS
from mavnav.kernels.lookup import count_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

CLEAR_BEAMS = 8  # went clear through an open cell
STAYS_SHARE = 0.15  # of the beams to a cell that holds something end in it


@helper
def _clear(passes: int, shielded: int) -> int:
    """Return how many beams went clear through a cell; where their count has ended, none that is known of."""
    return passes - shielded if shielded < MOST_SHIELDED else 0


@helper
def _is_open(
    row: int, col: int, hits: NDArray[np.uint16], passes: NDArray[np.uint16], shielded: NDArray[np.int16]
) -> bool:
    """Return whether beams went clear through a cell that hardly any ended in, with no wall within reach."""
    rows, cols = passes.shape
    ended, clear = int64(count_at(hits, row, col)), _clear(passes[row, col], count_at(shielded, row, col))
    if clear < CLEAR_BEAMS or ended >= STAYS_SHARE * (ended + clear):
        return False
    for r in range(max(row - EXPLAINED_CELLS, 0), min(row + EXPLAINED_CELLS + 1, rows)):
        for c in range(max(col - EXPLAINED_CELLS, 0), min(col + EXPLAINED_CELLS + 1, cols)):
            ended = int64(count_at(hits, r, c))
            if ended < WALL_HITS:
                continue
            if ended >= STAYS_SHARE * (ended + _clear(passes[r, c], count_at(shielded, r, c))):
                return False
    return True


@kernel(int64[:, ::1](U16_3D, U16_2D, I16_3D))
def dynamic_cells(
    hits: NDArray[np.uint16], passes: NDArray[np.uint16], shielded: NDArray[np.int16]
) -> NDArray[np.int64]:
    """List row and column (n, 2) of the cells that were hit and are open all the same; the counts are ``Tally``'s."""
    hit, n = 0, 0
    for count in hits.ravel():
        hit += 1 if count > 0 else 0
    out = np.empty((hit, 2), np.int64)
    for row in range(passes.shape[0]):
        for col in range(passes.shape[1]):
            if count_at(hits, row, col) > 0 and _is_open(row, col, hits, passes, shielded):
                out[n, 0], out[n, 1] = row, col
                n += 1
    return out[:n]
