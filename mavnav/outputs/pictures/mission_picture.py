"""true_map.png: the true walls, start, goal and the path that was really taken (the paper's Figures 2 and 4)."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.outputs.pictures import map_axes
from mavnav.outputs.pictures.canvas import stroke
from mavnav.outputs.pictures.plot import Mark, Style, arrow, circle, legend_room
from mavnav.outputs.pictures.viewport import INK, PATH_GREY, POSE_MAGENTA, Viewport, wall_lines, window_around
from mavnav.pose import Pose, transform_points

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.outputs.pictures.plot import Axes, Sign
    from mavnav.outputs.run import RunResult, Truth

MARGINS: Final = (100, 90, 50, 120)
"""Left, top, right and bottom of the map in the picture, in pixels."""
LEAST_SHARE: Final = 0.4
"""Of the shorter side of the map to the longer."""
ARROW_SHARE: Final = 0.07
"""Length of the heading's arrow, of the picture's longer side."""

WALL: Final = Style(INK, "wall", partial(stroke, width_pt=1.8))
PATH: Final = Style(PATH_GREY, "", partial(stroke, width_pt=0.9))
HEADING: Final = Style(POSE_MAGENTA, "", partial(stroke, width_pt=1.8))
FIRST_HEADING: Final = Mark(POSE_MAGENTA, "heading at the start", partial(arrow, size_pt=15.0, width_pt=1.8))
TRUE_POSE: Final = Mark(PATH_GREY, "true path", partial(circle, size_pt=2.4, width_pt=1.2))


def write(run: RunResult, path: Path) -> None:
    """Draw the truth of a mission; the run must have one."""
    if run.truth is None:
        raise ValueError("the truth is not known")
    measured = [map_axes.MEASURED_WALL] if run.truth.measured_by_hand else []
    named: list[Sign] = [WALL, *measured, TRUE_POSE, map_axes.START, FIRST_HEADING, map_axes.GOAL]
    axes = map_axes.framed_map(_window(run.truth, run.turn_rad), 7.0, MARGINS, least=(legend_room(named), 0))
    _draw(axes, run.truth)
    map_axes.finish(axes, named, f"{run.name}: the true map", _subtitle(run.truth), path, about_y=62)


def _window(truth: Truth, turn_rad: float) -> Viewport:
    points = np.vstack((truth.map_T_laser.xyyaw[:, :2], [truth.goal_xy_map_m], *wall_lines(truth)))
    return window_around(transform_points(Pose(yaw_rad=turn_rad), points), 0.1, turn_rad).widen(LEAST_SHARE)


def _draw(axes: Axes, truth: Truth) -> None:
    xy_m = truth.map_T_laser.xyyaw[:, :2]
    axes.lines(WALL, wall_lines(truth))
    if truth.measured_by_hand:
        axes.lines(map_axes.MEASURED_WALL, wall_lines(truth.measured_by_hand))
    axes.lines(PATH, [xy_m])
    axes.mark(TRUE_POSE, xy_m)
    _draw_heading(axes, truth)
    axes.mark(map_axes.START, xy_m[:1])
    axes.mark(map_axes.GOAL, np.array([truth.goal_xy_map_m]))


def _draw_heading(axes: Axes, truth: Truth) -> None:
    """Point a magenta arrow where the laser looks at the start."""
    arrow = np.array([[0.0, 0.0], [0.75, 0.0], [1.0, 0.0], [0.75, 0.12], [0.75, -0.12]])
    xy_m = transform_points(truth.map_T_laser[0], arrow * ARROW_SHARE * max(axes.size))
    axes.lines(HEADING, [xy_m[:2]])
    axes.canvas.smooth(axes.box, HEADING.colour, lambda on: on.polygon(axes.to_mask(xy_m[2:], axes.box), fill=255))


def _subtitle(truth: Truth) -> str:
    path, goal = truth.map_T_laser, np.array(truth.goal_xy_map_m)
    left_m = float(np.hypot(*(goal - path.xyyaw[-1, :2])))
    ends = f"path {path.length_m:.2f} m in {len(path)} scans, ends {left_m:.2f} m from the goal"
    heights = "" if truth.slice_m is None else "; walls between {:g} and {:g} m".format(*truth.slice_m)
    return f"{ends}; frame: the laser's first pose{heights}"
