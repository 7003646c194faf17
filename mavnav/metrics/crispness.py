"""Crispness: the number of occupied cells per metre of wall, and the entropy of these cells."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from msgspec import Struct

from mavnav.mapping.occupancy_grid import OCCUPIED
from mavnav.mapping.tiled_arrays import count, where
from mavnav.metrics.fields import Measured, number

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid


class Crispness(Struct, frozen=True):
    """Occupied cells per metre of wall and entropy of the cells; null where unknown."""

    occupied_cells_per_m: Annotated[
        Measured, number("occupied cells per meter of wall", title="cells per m", better="lower")
    ]
    entropy_bits: Annotated[
        Measured, number("mean entropy of a hit cell; lower is crisper", title="entropy", better="lower")
    ]


def crispness(grid: Grid, cells: NDArray[np.int8], wall_m: float, *, counted: bool) -> Crispness:
    """Return the crispness of a map with occupancy ``cells``; ``counted``: hits and crossings are real counts."""
    occupied = count(cells, lambda some: some == OCCUPIED)
    return Crispness(
        occupied_cells_per_m=float(occupied / wall_m) if wall_m else np.nan,
        entropy_bits=entropy_bits(grid) if counted else np.nan,
    )


def entropy_bits(grid: Grid) -> float:
    """Return the mean entropy of the cells that were hit, with the share of beams that ended there as probability.

    It is 0 if every cell stops every beam that reaches it, and 1 at worst. Free space that was never hit is left out,
    because a large free area would hide blurred walls. NaN without any hit.
    """
    row, col = where(grid.hits, lambda some: some > 0).T
    hits = grid.hits[row, col].astype(np.float64)
    p = hits / (hits + grid.passes[row, col])
    if not len(p):
        return np.nan
    q = 1.0 - p
    log_q = np.log2(q, out=np.zeros_like(q), where=q > 0.0)
    return float(-(p * np.log2(p) + q * log_q).mean()) + 0.0
