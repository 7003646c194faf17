"""The robust method's map: occupied cells, each with the local line through the points around it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from mavnav.kernels.linemap import REACH_CELLS, insert_points

if TYPE_CHECKING:
    from numpy.typing import NDArray

_BLOCK_CELLS = 256


@dataclass(slots=True)
class LineMap:
    """A growing map of local lines; see ``mavnav.kernels.linemap`` for the arrays.

    ``origin_cells`` is the lattice index (col, row) of cell [0, 0], so that the map frame's origin is a corner of
    cells however the map grows.
    """

    cell_m: float
    line_sigma_m: float
    line_noise_m: float
    origin_cells: tuple[int, int] = (0, 0)
    count: int = 0
    nearest: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 0), np.int32))
    cells: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 2), np.int32))
    own: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 6)))
    smooth: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 6)))
    lines: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 8)))

    @property
    def geometry(self) -> NDArray[np.float64]:
        """Origin x, origin y, cell, line sigma, line noise in m, shape (5,)."""
        col, row = self.origin_cells
        return np.array([col * self.cell_m, row * self.cell_m, self.cell_m, self.line_sigma_m, self.line_noise_m])

    def insert(self, xy_map_m: NDArray[np.float64]) -> None:
        """Add points (n, 2), in m, and refit the lines around them."""
        if len(xy_map_m) == 0:
            return
        self._cover(xy_map_m)
        self._reserve(self.count + len(xy_map_m))
        self.count = insert_points(
            np.ascontiguousarray(xy_map_m),
            self.geometry,
            self.count,
            self.nearest,
            self.cells,
            self.own,
            self.smooth,
            self.lines,
        )

    def _cover(self, xy_map_m: NDArray[np.float64]) -> None:
        """Grow the lattice in whole blocks until the points and the reach around them lie inside."""
        low = np.floor(xy_map_m.min(axis=0) / self.cell_m).astype(int) - REACH_CELLS - 1
        high = np.floor(xy_map_m.max(axis=0) / self.cell_m).astype(int) + REACH_CELLS + 2
        rows, cols = self.nearest.shape
        old_low = np.array(self.origin_cells)
        old_high = old_low + (cols, rows)
        if self.nearest.size and (low >= old_low).all() and (high <= old_high).all():
            return
        if self.nearest.size:
            low, high = np.minimum(low, old_low), np.maximum(high, old_high)
        low = np.floor_divide(low, _BLOCK_CELLS) * _BLOCK_CELLS
        high = -np.floor_divide(-high, _BLOCK_CELLS) * _BLOCK_CELLS
        grown = np.full((high[1] - low[1], high[0] - low[0]), -1, np.int32)
        if self.nearest.size:
            dc, dr = old_low - low
            grown[dr : dr + rows, dc : dc + cols] = self.nearest
            self.cells[: self.count] += np.array([dr, dc], np.int32)
        self.nearest = grown
        self.origin_cells = (int(low[0]), int(low[1]))

    def _reserve(self, needed: int) -> None:
        """Make room for ``needed`` cells, doubling so that the cost a cell stays constant."""
        capacity = len(self.cells)
        if needed <= capacity:
            return
        capacity = max(needed, 2 * capacity, 4096)
        cells = np.zeros((capacity, 2), np.int32)
        cells[: self.count] = self.cells[: self.count]
        self.cells = cells
        for name in ("own", "smooth", "lines"):
            grown = np.zeros((capacity, getattr(self, name).shape[1]))
            grown[: self.count] = getattr(self, name)[: self.count]
            setattr(self, name, grown)
