"""diff.png: the walls of two maps, those that are gone and those that are new, with the numbers of the changes.

The colours are those of Okabe and Ito, which people with colour blindness tell apart; the marks differ in shape too.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import Grid
from mavnav.metrics.map_difference import Change, Difference, View
from mavnav.outputs.pictures import map_axes
from mavnav.outputs.pictures.canvas import FREE_GREY, INK, rgb_of
from mavnav.outputs.pictures.plot import Area, Axes, Mark, circle, cross
from mavnav.pose import Pose, transform_points

WALL, GONE, NEW = "#8a929a", "#d55e00", "#0072b2"
FREE_CELL, WALL_CELL, GONE_CELL, NEW_CELL = 1, 2, 3, 4
_COLOURS: Final = np.array([rgb_of(c) for c in ("#ffffff", FREE_GREY, WALL, GONE, NEW)], np.uint8)

_CROSS: Final = partial(cross, size_pt=6.0, width_pt=1.2)
MARKS: Final = {"gone": Mark(GONE, "gone", _CROSS), "new": Mark(NEW, "new", partial(circle, size_pt=7.0, width_pt=1.2))}
AREAS: Final = (Area(WALL, "wall, no change"), Area(FREE_GREY, "free"), Area("#ffffff", "unknown"))
MARGINS: Final = (100, 110, 60, 120)
"""Left, top, right and bottom of the map in the picture, in pixels."""

NUMBERED: Final = 40
"""So many changes, the largest, have their numbers beside them."""


def write(a: View, b: View, a_T_b: Pose, difference: Difference, title: str, path: Path) -> None:
    """Draw the changes in the frame of the first map."""
    layers = {
        FREE_CELL: np.concatenate((a.middles(a.known), transform_points(a_T_b, b.middles(b.known)))),
        WALL_CELL: np.concatenate((a.middles(a.walls), transform_points(a_T_b, b.middles(b.walls)))),
        GONE_CELL: difference.gone_xy_m,
        NEW_CELL: difference.new_xy_m,
    }
    window = map_axes.window_around(layers[WALL_CELL], least_margin_m=5 * a.grid.cell_m)
    axes = map_axes.framed_map(window, 7.5, MARGINS, least=(700, 420))
    grid, cells = _raster(layers, max(a.grid.cell_m, b.grid.cell_m))
    map_axes.draw_cells(axes, grid, cells, lambda values: _COLOURS[values])
    for kind, mark in MARKS.items():
        axes.mark(mark, np.array([(c.x_m, c.y_m) for c in difference.changes if c.kind == kind]).reshape(-1, 2))
    _draw_numbers(axes, difference.changes[:NUMBERED])
    map_axes.finish(axes, [*MARKS.values(), *AREAS], title, _subtitle(difference), path, title_pt=10.0)


def _raster(layers: dict[int, NDArray[np.float64]], cell_m: float) -> tuple[Grid, NDArray[Any]]:
    """Enter the points (n, 2) of layers into cells, later ones over earlier ones; return their lattice and values."""
    low = np.floor(layers[FREE_CELL].min(axis=0) / cell_m)
    cols, rows = (np.floor(layers[FREE_CELL].max(axis=0) / cell_m) - low).astype(int) + 1
    cells = np.zeros((rows, cols), np.uint16)
    for value, xy_m in layers.items():
        col, row = (np.floor(xy_m / cell_m) - low).astype(np.int64).T
        cells[row, col] = value
    origin = (float(low[0] * cell_m), float(low[1] * cell_m))
    return Grid(cell_m, origin, cells, np.zeros_like(cells)), cells


def _draw_numbers(axes: Axes, changes: tuple[Change, ...]) -> None:
    places = axes.to_canvas(np.array([(c.x_m, c.y_m) for c in changes]).reshape(-1, 2)).tolist()
    for number, (x, y) in enumerate(places, start=1):
        axes.canvas.text((x + 14, y - 14), str(number), 8.0, INK)


def _subtitle(difference: Difference) -> str:
    kinds = [change.kind for change in difference.changes]
    gone, new = (f"{kinds.count(k)} {k}, {difference.m2(k):.2f} m2" for k in ("gone", "new"))
    return f"{gone}; {new} of wall cells; {difference.compared_m2:.1f} m2 compared"
