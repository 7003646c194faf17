"""The occupancy grid: an integer count of laser hits a cell (paper, "Occupancy Grid Representation")."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(slots=True)
class Grid:
    """Hit counts on a square lattice; the one mutable thing of a run, grown as scans come in.

    ``hits[row, col]`` counts laser end points, ``passes[row, col]`` beams that crossed the cell on their way;
    both (rows, cols) int32, row grows with +y. ``origin_xy_m`` is the corner of cell [0, 0] in the map frame,
    always a whole number of cells.
    """

    cell_m: float
    origin_xy_m: tuple[float, float] = (0.0, 0.0)
    hits: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 0), np.int32))
    passes: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 0), np.int32))
