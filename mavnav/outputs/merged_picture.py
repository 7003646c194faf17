"""map.png of several sessions: hits in colour, and the path of each session."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.outputs import map_axes
from mavnav.outputs.canvas import stroke
from mavnav.outputs.plot import Line, colour_bar, legend, legend_width
from mavnav.outputs.viewport import INK, MUTED, window_of

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.outputs.gridmap import DrawnMap
    from mavnav.outputs.plot import Mark
    from mavnav.pose import Trajectory

COLOURS: Final = ("#d55e00", "#0072b2", "#cc79a7", "#e69f00", "#009e73", "#56b4e9", "#000000")
"""Those of Okabe and Ito, which people with colour blindness tell apart; sessions beyond repeat them."""

MARGINS: Final = (100, 110, 130, 120)
"""Left, top, right and bottom of the map in the picture, in pixels."""


def write(drawn: DrawnMap, paths: dict[str, Trajectory], path: Path) -> None:
    """Draw the map, and map_T_laser of the sessions by their names."""
    window = window_of(drawn.known, np.concatenate([poses.xyyaw[:, :2] for poses in paths.values()]))
    axes = map_axes.framed_map(window, 7.5, MARGINS, least=(960, 420))
    top = map_axes.top_of_scale([drawn.known])
    map_axes.draw_free(axes, drawn.known, drawn.cells)
    map_axes.draw_hits(axes, drawn.known, top)
    colour_bar(axes, map_axes.HIT_COLOURS, map_axes.hit_ticks(top), "laser hits per cell")
    lines = [
        Line(COLOURS[number % len(COLOURS)], name, partial(stroke, width_pt=1.2)) for number, name in enumerate(paths)
    ]
    for line, poses in zip(lines, paths.values(), strict=True):
        axes.lines(line, [poses.xyyaw[:, :2]])
        axes.mark(map_axes.START, poses.xyyaw[:1, :2])
    map_axes.draw_axes(axes)
    axes.names("x [m]", "y [m]")
    canvas = axes.canvas
    marks: list[Mark | Line] = [*lines[: len(COLOURS)], map_axes.START]
    legend(canvas, marks, canvas.image.height - 28, (canvas.image.width - legend_width(marks)) / 2.0)
    title = "1 session" if len(paths) == 1 else f"{len(paths)} sessions"
    canvas.text((canvas.image.width / 2, 26), title, 12.0, INK, bold=True)
    canvas.text((canvas.image.width / 2, 74), f"{sum(map(len, paths.values()))} scans", 8.5, MUTED)
    canvas.save(path)
