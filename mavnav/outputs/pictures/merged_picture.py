"""map.png of several sessions: hits in colour, and the path of each session."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.outputs.pictures import map_axes
from mavnav.outputs.pictures.canvas import stroke
from mavnav.outputs.pictures.plot import Style, centred_legend, heading
from mavnav.outputs.pictures.viewport import window_of
from mavnav.units import pluralize

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.outputs.files.gridmap import GridMap
    from mavnav.pose import Trajectory

COLOURS: Final = ("#d55e00", "#0072b2", "#cc79a7", "#e69f00", "#009e73", "#56b4e9", "#000000")
"""Those of Okabe and Ito, which people with colour blindness tell apart; sessions beyond repeat them."""


def write(drawn: GridMap, paths: dict[str, Trajectory], path: Path) -> None:
    """Draw the map, and map_T_laser of the sessions by their names."""
    window = window_of(drawn.known, np.concatenate([poses.xyyaw[:, :2] for poses in paths.values()]))
    axes = map_axes.framed_map(window, 7.5, map_axes.MARGINS, least=(960, 420))
    map_axes.draw_counts(axes, drawn.known, drawn.cells)
    lines = [
        Style(COLOURS[number % len(COLOURS)], name, partial(stroke, width_pt=1.2)) for number, name in enumerate(paths)
    ]
    for line, poses in zip(lines, paths.values(), strict=True):
        axes.lines(line, [poses.xyyaw[:, :2]])
        axes.mark(map_axes.START, poses.xyyaw[:1, :2])
    map_axes.draw_axes(axes)
    axes.names("x [m]", "y [m]")
    centred_legend(axes.canvas, [*lines[: len(COLOURS)], map_axes.START])
    heading(axes.canvas, pluralize(len(paths), "session"), f"{sum(map(len, paths.values()))} scans")
    axes.canvas.save(path)
