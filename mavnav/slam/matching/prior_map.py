"""A given map for localization."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import Grid, counts, occupied_xy_m
from mavnav.mapping.tiled_arrays import bands
from mavnav.pose import Pose, transform_points

SURELY = 10
"""Number of beams by which every known cell counts as seen: a map file has no counts."""


TIE = 1e-9
"""Tolerance for rounding, in cells: a centre on the edge of two old cells belongs to the upper one."""


class PriorMap(Struct, frozen=True):
    """A map in its own frame: the grid, and the centres of its occupied cells (n, 2), m.

    ``start`` is the approximate start pose of the laser, None if unknown.
    """

    grid: Grid
    walls_xy_m: NDArray[np.float64]
    start: Pose | None = None


def prior_map_of(grid: Grid, map_T_grid: Pose, start: Pose | None = None) -> PriorMap:
    """Resample a grid with any pose in its map frame to cells along the axes of that frame.

    Each new cell is a copy of the old one at its centre.
    """
    return PriorMap(_upright(grid, map_T_grid), transform_points(map_T_grid, occupied_xy_m(grid)), start)


def _upright(grid: Grid, map_T_grid: Pose) -> Grid:
    (rows, cols), cell_m, (ox, oy) = grid.hits.shape, grid.cell_m, grid.origin_xy_m
    corners = np.array([(ox + x * cols * cell_m, oy + y * rows * cell_m) for x in (0, 1) for y in (0, 1)])
    corners_map_m = transform_points(map_T_grid, corners)
    low = np.floor(corners_map_m.min(axis=0) / cell_m).astype(np.int64)
    high = np.ceil(corners_map_m.max(axis=0) / cell_m).astype(np.int64)
    x, y = ((np.arange(low[k], high[k]) + 0.5) * cell_m for k in (0, 1))
    back = map_T_grid.inverse()
    c, s = np.cos(back.yaw_rad), np.sin(back.yaw_rad)
    hits, passes = (np.zeros((len(y), len(x)), np.uint16) for _ in range(2))
    for _, _, band in bands(hits.shape):
        col = np.floor((back.x_m + c * x - s * y[band, None] - ox) / cell_m + TIE).astype(np.int64)
        row = np.floor((back.y_m + s * x + c * y[band, None] - oy) / cell_m + TIE).astype(np.int64)
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        row, col = row[inside], col[inside]
        hits[band][inside], passes[band][inside] = (
            counts(cells[row, col] * np.int32(SURELY)) for cells in (grid.hits, grid.passes)
        )
    return Grid(cell_m, (float(low[0] * cell_m), float(low[1] * cell_m)), hits, passes)
