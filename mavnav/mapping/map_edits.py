"""Edits of a finished map: obstacles erased, areas made unknown, a part kept."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import FREE, OCCUPIED, Grid, counts, occupancy, part_of
from mavnav.mapping.tiled_arrays import bands
from mavnav.pose import Pose

Mask = NDArray[np.bool_]

CORNERS_TOUCH: Final = np.ones((3, 3), np.bool_)
"""Neighbours of a cell with those at its corners."""


class Rectangle(NamedTuple):
    """A rectangle along the axes of the map frame, m."""

    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float


class MapEdits(Struct, frozen=True):
    """What to change on a map, in the order in which it is done."""

    erase: tuple[Rectangle, ...] = ()
    unknown: tuple[Rectangle, ...] = ()
    crop: Rectangle | None = None
    keep_largest: bool = False


def edit_grid(grid: Grid, edits: MapEdits, map_T_grid: Pose) -> Grid:
    """Return an edited copy of a grid that lies at ``map_T_grid`` in the map frame.

    The hits in an erased cell become crossings, so that it is free. An unknown cell has neither.
    """
    edited = Grid(grid.cell_m, grid.origin_xy_m, grid.hits.copy(), grid.passes.copy())
    for rectangle in edits.erase:
        inside = _inside(grid, rectangle, map_T_grid)
        edited.passes[inside] = counts(edited.passes[inside].astype(np.int64) + edited.hits[inside])
        edited.hits[inside] = 0
    for rectangle in edits.unknown:
        inside = _inside(grid, rectangle, map_T_grid)
        edited.hits[inside] = edited.passes[inside] = 0
    if edits.crop:
        edited = _cut_out(edited, _inside(grid, edits.crop, map_T_grid))
    return _masked(edited, largest_area(edited)) if edits.keep_largest else edited


def _inside(grid: Grid, rectangle: Rectangle, map_T_grid: Pose) -> Mask:
    """Return which cells have their centres in a rectangle, (rows, cols)."""
    rows, cols = grid.hits.shape
    inside = np.zeros((rows, cols), np.bool_)
    (x0_m, y0_m, x1_m, y1_m), (c, s) = rectangle, (np.cos(map_T_grid.yaw_rad), np.sin(map_T_grid.yaw_rad))
    u = (np.arange(cols) + 0.5) * grid.cell_m + grid.origin_xy_m[0]
    v = (np.arange(rows) + 0.5) * grid.cell_m + grid.origin_xy_m[1]
    for _, _, band in bands(inside.shape):
        x, y = map_T_grid.x_m + c * u - s * v[band, None], map_T_grid.y_m + s * u + c * v[band, None]
        inside[band] = (x >= x0_m) & (x <= x1_m) & (y >= y0_m) & (y <= y1_m)
    return inside


def _masked(grid: Grid, mask: Mask) -> Grid:
    """Return a grid that is unknown outside of a mask (rows, cols)."""
    return Grid(grid.cell_m, grid.origin_xy_m, np.where(mask, grid.hits, 0), np.where(mask, grid.passes, 0))


def _cut_out(grid: Grid, mask: Mask) -> Grid:
    """Return the part of a grid round a mask (rows, cols), unknown outside of that; one cell where it is empty."""
    rows, cols = (np.flatnonzero(mask.any(axis=axis)) if mask.any() else np.zeros(1, np.int64) for axis in (1, 0))
    return part_of(_masked(grid, mask), *(slice(int(k[0]), int(k[-1]) + 1) for k in (rows, cols)))


def largest_area(grid: Grid) -> Mask:
    """Return the cells of the largest free area, whose cells touch at edges, and the walls that touch it."""
    from scipy.ndimage import binary_dilation, label  # noqa: PLC0415  takes 0.1 s to load

    cells = occupancy(grid)
    areas, count = label(cells == FREE)
    if not count:
        return np.ones(cells.shape, np.bool_)
    largest = areas == 1 + np.argmax(np.bincount(areas.ravel())[1:])
    walls, _ = label(cells == OCCUPIED, CORNERS_TOUCH)
    touching = np.unique(walls[binary_dilation(largest, CORNERS_TOUCH)])
    kept: Mask = largest | np.isin(walls, touching[touching > 0])
    return kept
