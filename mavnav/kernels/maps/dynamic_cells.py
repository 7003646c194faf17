"""Dynamic cells: occupied for a limited time only, such as by people who walked by (docs/method.md)."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import I16_3D, I64_2D, U16_2D, U16_3D, helper, int64, kernel
from mavnav.kernels.maps.layout import EXPLAINED_CELLS, MOST_SHIELDED, WALL_HITS
from mavnav.kernels.maps.lookup import count_at

CLEAR_BEAMS = 8  # minimum number of beams that passed clear through a dynamic cell
STAYS_SHARE = 0.15  # minimum share of hits among the beams to a static cell


@helper
def _clear(passes: int, shielded: int) -> int:
    """Return the number of beams that passed clear through a cell; 0 if the count of shielded ones is saturated."""
    return passes - shielded if shielded < MOST_SHIELDED else 0


@helper
def _is_open(row: int, col: int, hits: U16_3D, passes: U16_2D, shielded: I16_3D) -> bool:
    """Return whether beams passed clear through a cell in which few ended, with no wall within `EXPLAINED_CELLS`."""
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


@kernel
def dynamic_cells(hits: U16_3D, passes: U16_2D, shielded: I16_3D) -> I64_2D:
    """Return row and column (n, 2) of the dynamic cells with hits; the counts are those of a ``GridBuilder``."""
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
