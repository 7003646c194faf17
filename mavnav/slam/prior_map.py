"""A map that is given, to be localised in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mavnav.mapping.occupancy_grid import Grid, counts, occupied_cells
from mavnav.pose import Pose, transform_points

if TYPE_CHECKING:
    from numpy.typing import NDArray

SURELY = 10
"""A map file has no counts: every cell is taken as seen by this many beams."""


TIE = 1e-9
"""Of a cell, what rounding must not decide: a middle on an edge of the old cells belongs to the upper one."""


@dataclass(frozen=True, slots=True)
class PriorMap:
    """A map in its own frame: what is known of its cells, the middles of the occupied ones (n, 2), m.

    ``start`` is about where the laser begins, None where that is not known.
    """

    grid: Grid
    walls_xy_m: NDArray[np.float64]
    start: Pose | None = None


def prior_map_of(grid: Grid, map_T_grid: Pose, start: Pose | None = None) -> PriorMap:
    """Bring a grid that lies anywhere in its map frame to that frame, each cell from the old one at its middle."""
    rows, cols = occupied_cells(grid).T
    walls_xy_m = (np.column_stack((cols, rows)) + 0.5) * grid.cell_m + np.array(grid.origin_xy_m)
    return PriorMap(_upright(grid, map_T_grid), transform_points(map_T_grid, walls_xy_m), start)


def _upright(grid: Grid, map_T_grid: Pose) -> Grid:
    (rows, cols), cell_m, (ox, oy) = grid.hits.shape, grid.cell_m, grid.origin_xy_m
    corners = np.array([(ox + x * cols * cell_m, oy + y * rows * cell_m) for x in (0, 1) for y in (0, 1)])
    corners_map_m = transform_points(map_T_grid, corners)
    low = np.floor(corners_map_m.min(axis=0) / cell_m).astype(np.int64)
    high = np.ceil(corners_map_m.max(axis=0) / cell_m).astype(np.int64)
    x, y = ((np.arange(low[k], high[k]) + 0.5) * cell_m for k in (0, 1))
    back = map_T_grid.inverse()
    c, s = np.cos(back.yaw_rad), np.sin(back.yaw_rad)
    col = np.floor((back.x_m + c * x - s * y[:, None] - ox) / cell_m + TIE).astype(np.int64)
    row = np.floor((back.y_m + s * x + c * y[:, None] - oy) / cell_m + TIE).astype(np.int64)
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    row, col = np.where(inside, row, 0), np.where(inside, col, 0)
    hits, passes = (
        counts(np.where(inside, cells[row, col], 0) * np.int32(SURELY)) for cells in (grid.hits, grid.passes)
    )
    return Grid(cell_m, (float(low[0] * cell_m), float(low[1] * cell_m)), hits, passes)
