"""true_map.png: the world as it is, start, goal and the way that was really taken (the paper's Figures 2 and 4)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav.outputs import drawing

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.outputs.run import Run, Truth
    from mavnav.pose import Pose

ARROW_SHARE: Final = 0.07
"""Length of the heading's arrow, of the picture's longer side."""


def write(run: Run, path: Path) -> None:
    """Draw the truth of a mission; the run must have one."""
    if run.truth is None:
        msg = "the truth is not known"
        raise ValueError(msg)
    window = _window(run.truth)
    width, height = window.figure_size(longest_in=7.0, least_in=3.0)
    fig = drawing.figure(max(width + 0.8, 5.0), height + 1.3)
    axes = fig.add_subplot()
    _draw(axes, run.truth, arrow_m=ARROW_SHARE * max(window.size_m))
    drawing.dress(axes, window)
    fig.suptitle(f"{run.name}: the true map", fontsize=12, fontweight="bold", color=drawing.INK)
    axes.set_title(_subtitle(run.truth), fontsize=8.5, color=drawing.MUTED)
    fig.legend(loc="outside lower center", ncols=5, frameon=False, fontsize=8.5)
    drawing.save(fig, path)


def _window(truth: Truth) -> drawing.Window:
    points = np.vstack((truth.map_T_laser.xyyaw[:, :2], [truth.goal_xy_map_m], *drawing.wall_lines(truth)))
    return drawing.window_around(points, least_margin_m=0.1)


def _draw(axes: Any, truth: Truth, arrow_m: float) -> None:  # noqa: ANN401
    xy_m = truth.map_T_laser.xyyaw[:, :2]
    drawing.draw_walls(axes, truth, color=drawing.INK, lw=1.8, solid_capstyle="round", zorder=2, label="wall")
    axes.plot(*xy_m.T, ".-", color=drawing.PATH_GREY, lw=0.9, ms=3, label="true path", zorder=3)
    _draw_heading(axes, truth.map_T_laser[0], arrow_m)
    drawing.draw_ends(axes, xy_m[0], truth.goal_xy_map_m, "goal")


def _draw_heading(axes: Any, start: Pose, length_m: float) -> None:  # noqa: ANN401
    """Point a magenta arrow where the laser looks at the start."""
    tip = (start.x_m + length_m * np.cos(start.yaw_rad), start.y_m + length_m * np.sin(start.yaw_rad))
    arrow = {"arrowstyle": "-|>", "color": drawing.POSE_MAGENTA, "lw": 1.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=tip, xytext=(start.x_m, start.y_m), arrowprops=arrow, zorder=4)


def _subtitle(truth: Truth) -> str:
    way, goal = truth.map_T_laser, np.array(truth.goal_xy_map_m)
    left_m = float(np.hypot(*(goal - way.xyyaw[-1, :2])))
    ends = f"path {way.length_m:.2f} m in {len(way) - 1} steps, ends {left_m:.2f} m from the goal"
    return f"{ends}; frame: the laser's first pose"
