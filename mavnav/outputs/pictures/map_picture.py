"""map.png: hits in colour, the estimated poses, start and end (after the paper's Figure 3).

Where the true walls are known they lie on top (Figure 7); of a mission the true poses too, and its goal takes the place
of the end. The map of several sessions has the path of each.

true_map.png: the true walls, start, goal and the path that was really taken (Figures 2 and 4).
"""

from __future__ import annotations

from functools import partial
from itertools import compress, cycle
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavnav.outputs.documents.verdict import Verdict
from mavnav.outputs.files.document import run_verdict
from mavnav.outputs.files.gridmap import GridMap
from mavnav.outputs.pictures import canvas, map_axes
from mavnav.outputs.pictures.canvas import stroke
from mavnav.outputs.pictures.plot import Axes, Mark, Sign, Style, arrow, circle, legend_room
from mavnav.outputs.run import RunResult, Truth, require
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.slam.result import doubtful_parts, parts_of_path
from mavnav.units import MM, pluralize

CIRCLE_SPACING: Final = 0.018
"""Between two circles along the path, of the picture's longer side: so that they touch at most."""

SESSION_COLOURS: Final = ("#d55e00", "#0072b2", "#cc79a7", "#e69f00", "#009e73", "#56b4e9", "#000000")
"""Those of Okabe and Ito, which people with colour blindness tell apart; sessions beyond repeat them."""

MOST_CIRCLES: Final = 200
"""A path of more is a line: in several visits of a place circles hide the walls."""

PATH: Final = Style(map_axes.POSE.colour, "", partial(stroke, width_pt=0.72, opacity=150 / 255))
LONG_PATH: Final = Style(map_axes.POSE.colour, "estimated path", partial(stroke, width_pt=0.9, opacity=0.85))


def write(run: RunResult, path: Path) -> None:
    """Draw the map of a run."""
    trajectory = run.slam.trajectory
    window = map_axes.window_of(run.known, points_to_show(run), run.turn_rad)
    some = thin_path(trajectory.xyyaw[:, :2], CIRCLE_SPACING * max(window.size_m))
    line, circles = (PATH, some) if len(some) <= MOST_CIRCLES else (LONG_PATH, some[:0])
    ends = end_marks(run, trajectory.stamps_ns[some].tolist())
    shown = (len(trajectory), run.slam.loops.closed, run.true_walls, doubtful_parts(run.slam))
    signs = (map_axes.POSE if len(circles) else line, map_axes.LOOP, map_axes.TRUE_WALL, map_axes.DOUBTFUL)
    named: list[Sign] = [*compress(signs, shown), *(mark for mark, _ in ends), *map_axes.KNOWN]
    axes = map_axes.framed_map(window, 7.5, map_axes.JUDGED_MARGINS, least=(max(960, legend_room(named)), 420))
    map_axes.draw_counts(axes, run.known, run.cells)
    axes.lines(line, parts_of_path(run.slam))
    axes.lines(map_axes.LOOP, [trajectory.xyyaw[[loop.start, loop.end], :2] for loop in run.slam.loops.closed])
    if run.true_walls:
        axes.lines(map_axes.TRUE_WALL, map_axes.wall_lines(run.true_walls))
    axes.mark(map_axes.POSE, trajectory.xyyaw[circles, :2])
    axes.lines(map_axes.DOUBTFUL, doubtful_parts(run.slam))
    for mark, xy_m in ends:
        axes.mark(mark, xy_m)
    map_axes.finish_judged(axes, named, run.name, run_verdict(run), _subtitle(run), path)


def points_to_show(run: RunResult) -> NDArray[np.float64]:
    """Return the points (n, 2) that the picture has to show besides the map."""
    xy_m, truth = run.slam.trajectory.xyyaw[:, :2], run.truth
    walls = map_axes.wall_lines(run.true_walls) if run.true_walls else []
    mission = () if truth is None else (truth.map_T_laser.xyyaw[:, :2], [truth.goal_xy_map_m])
    return np.vstack((xy_m, *mission, *walls))


def end_marks(run: RunResult, stamps_ns: list[int]) -> list[tuple[Mark, NDArray[np.float64]]]:
    """Mark start and end; where the truth is known the true poses at the stamps of the circles, start and goal."""
    if (truth := run.truth) is None:
        xy_m = run.slam.trajectory.xyyaw[:, :2]
        return [(map_axes.START, xy_m[:1]), (map_axes.END, xy_m[-1:])] if len(xy_m) else []
    xy_m, at = truth.map_T_laser.xyyaw[:, :2], np.isin(truth.map_T_laser.stamps_ns, stamps_ns)
    goal_xy_m = np.array([truth.goal_xy_map_m])
    return [(map_axes.TRUE_POSE, xy_m[at]), (map_axes.START, xy_m[:1]), (map_axes.GOAL, goal_xy_m)]


def thin_path(xy_m: NDArray[np.float64], spacing_m: float) -> NDArray[np.intp]:
    """Choose points of a path (n, 2), evenly spread along its length; the first and the last are among them."""
    if not len(xy_m):
        return np.empty(0, np.intp)
    along = np.concatenate(([0.0], np.hypot(*np.diff(xy_m, axis=0).T).cumsum()))
    circles = max(2, int(along[-1] / spacing_m) + 1)
    return np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], circles)))


def _subtitle(run: RunResult) -> str:
    config, slam = run.config, run.slam
    scans = f"{len(slam.trajectory)} of {len(slam.steps)} scans accepted ({100 * slam.tracked_share:.0f} %)"
    cell_mm = run.slam.grid.cell_m / MM
    search = f"method {config.method}, {config.azimuth} yaw samples, search grid {config.grid}"
    how = f"{f'poses of {run.external.name}' if run.external else search}, cell {cell_mm:g} mm"
    if run.measures.cuts is None:
        return f"{how}\n{scans}"
    spread = run.walls.spread
    thickness = f"wall thickness median {spread.median_mm:.0f} mm, p95 {spread.p95_mm:.0f} mm"
    return f"{how}\n{scans}, {thickness if spread.length_m else 'no straight wall to measure'}"


def write_merged(drawn: GridMap, paths: dict[str, Trajectory], verdict: Verdict, path: Path, turn_rad: float) -> None:
    """Draw the map of several sessions, turned, with its verdict, and map_T_laser of each by its name."""
    window = map_axes.window_of(drawn.known, np.concatenate([poses.xyyaw[:, :2] for poses in paths.values()]), turn_rad)
    axes = map_axes.framed_map(window, 7.5, map_axes.JUDGED_MARGINS, least=(960, 420))
    map_axes.draw_counts(axes, drawn.known, drawn.cells)
    pen, colours = partial(stroke, width_pt=1.2), cycle(SESSION_COLOURS)
    lines = [Style(colour, name, pen) for colour, name in zip(colours, paths, strict=False)]
    for line, poses in zip(lines, paths.values(), strict=True):
        axes.lines(line, [poses.xyyaw[:, :2]])
        axes.mark(map_axes.START, poses.xyyaw[:1, :2])
    named: list[Sign] = [*lines[: len(SESSION_COLOURS)], map_axes.START]
    title, about = pluralize(len(paths), "session"), f"{sum(map(len, paths.values()))} scans"
    map_axes.finish_judged(axes, named, title, verdict, about, path)


TRUTH_MARGINS: Final = (100, 90, 50, 120)
"""Left, top, right and bottom of the map in the picture, in pixels."""
LEAST_SHARE: Final = 0.4
"""Of the shorter side of the map to the longer."""
ARROW_SHARE: Final = 0.07
"""Length of the heading's arrow, of the picture's longer side."""

WALL: Final = Style(canvas.INK, "wall", partial(stroke, width_pt=1.8))
TRUE_PATH: Final = Style(canvas.PATH_GREY, "", partial(stroke, width_pt=0.9))
HEADING: Final = Style(canvas.POSE_MAGENTA, "", partial(stroke, width_pt=1.8))
FIRST_HEADING: Final = Mark(canvas.POSE_MAGENTA, "heading at the start", partial(arrow, size_pt=15.0, width_pt=1.8))
ON_PATH: Final = Mark(canvas.PATH_GREY, "true path", partial(circle, size_pt=2.4, width_pt=1.2))


def write_true_map(run: RunResult, path: Path) -> None:
    """Draw the truth of a mission; the run must have one."""
    truth = require(run.truth, "the truth")
    measured = [map_axes.MEASURED_WALL] if truth.measured_by_hand else []
    named: list[Sign] = [WALL, *measured, ON_PATH, map_axes.START, FIRST_HEADING, map_axes.GOAL]
    points = np.vstack((truth.map_T_laser.xyyaw[:, :2], [truth.goal_xy_map_m], *map_axes.wall_lines(truth)))
    points = transform_points(Pose(yaw_rad=run.turn_rad), points)
    window = map_axes.window_around(points, 0.1, run.turn_rad).widen(LEAST_SHARE)
    axes = map_axes.framed_map(window, 7.0, TRUTH_MARGINS, least=(legend_room(named), 0))
    _draw_truth(axes, truth)
    map_axes.finish(axes, named, f"{run.name}: the true map", _truth_subtitle(truth), path, about_y=62)


def _draw_truth(axes: Axes, truth: Truth) -> None:
    xy_m = truth.map_T_laser.xyyaw[:, :2]
    axes.lines(WALL, map_axes.wall_lines(truth))
    if truth.measured_by_hand:
        axes.lines(map_axes.MEASURED_WALL, map_axes.wall_lines(truth.measured_by_hand))
    axes.lines(TRUE_PATH, [xy_m])
    axes.mark(ON_PATH, xy_m)
    _draw_heading(axes, truth)
    axes.mark(map_axes.START, xy_m[:1])
    axes.mark(map_axes.GOAL, np.array([truth.goal_xy_map_m]))


def _draw_heading(axes: Axes, truth: Truth) -> None:
    """Point a magenta arrow where the laser looks at the start."""
    arrow = np.array([[0.0, 0.0], [0.75, 0.0], [1.0, 0.0], [0.75, 0.12], [0.75, -0.12]])
    xy_m = transform_points(truth.map_T_laser[0], arrow * ARROW_SHARE * max(axes.size))
    axes.lines(HEADING, [xy_m[:2]])
    axes.canvas.smooth(axes.box, HEADING.colour, lambda on: on.polygon(axes.to_mask(xy_m[2:], axes.box), fill=255))


def _truth_subtitle(truth: Truth) -> str:
    path, goal = truth.map_T_laser, np.array(truth.goal_xy_map_m)
    left_m = float(np.hypot(*(goal - path.xyyaw[-1, :2])))
    ends = f"path {path.length_m:.2f} m in {len(path)} scans, ends {left_m:.2f} m from the goal"
    heights = "" if truth.slice_m is None else "; walls between {:g} and {:g} m".format(*truth.slice_m)
    return f"{ends}; frame: the laser's first pose{heights}"
