"""map.png: hits in colour, the estimated poses, start and end (after the paper's Figure 3).

Where the truth is known, true walls and poses lie on top (Figure 7), and the goal takes the place of the end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LinearSegmentedColormap, LogNorm

from mavnav.outputs import drawing
from mavnav.outputs.gridmap import known_part
from mavnav.units import MM

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.grid import Grid
    from mavnav.metrics.wall_thickness import WallThickness
    from mavnav.outputs.run import Run, Truth
    from mavnav.pose import Trajectory

CIRCLE_SPACING: Final = 0.018
"""Between two circles along the path, of the picture's longer side: so that they touch at most."""


def write(run: Run, path: Path) -> None:
    """Draw the map of a run."""
    grid, trajectory = known_part(run.slam.grid), run.slam.trajectory
    window = drawing.window_of(grid, framed(run))
    width, height = window.figure_size(longest_in=7.5, least_in=3.0)
    fig = drawing.figure(max(width + 1.7, 6.4), height + 1.6)
    axes = fig.add_subplot()
    drawing.draw_free(axes, grid, window)
    _draw_hits(axes, grid, window)
    some = thinned(trajectory.xyyaw[:, :2], CIRCLE_SPACING * max(window.size_m))
    _draw_poses(axes, trajectory, some)
    if run.truth:
        _draw_truth(axes, run.truth, trajectory.stamps_ns[some].tolist())
    elif len(trajectory):
        drawing.draw_ends(axes, trajectory.xyyaw[0, :2], trajectory.xyyaw[-1, :2], "end")
    drawing.dress(axes, window)
    fig.suptitle(run.name, fontsize=12, fontweight="bold", color=drawing.INK)
    axes.set_title(_subtitle(run), fontsize=8.5, color=drawing.MUTED)
    if len(trajectory) or run.truth:
        fig.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8.5)
    drawing.save(fig, path)


def _draw_hits(axes: Any, grid: Grid, window: drawing.Window) -> None:  # noqa: ANN401
    """Colour the hit cells on a logarithmic scale that a few crowded cells cannot spoil."""
    counts = grid.hits[grid.hits > 0]
    top = max(float(np.quantile(counts, 0.995)) if counts.size else 1.0, 10.0)
    colours = LinearSegmentedColormap.from_list("hits", colormaps["viridis"](np.linspace(0.92, 0.0, 256)))
    image = drawing.draw_cells(axes, grid, grid.hits, window, cmap=colours, norm=LogNorm(1.0, top), zorder=1)
    bar = axes.figure.colorbar(image, ax=axes, extend="max", fraction=0.04, pad=0.02, aspect=28)
    ticks = [t for t in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000) if t <= top]
    bar.set_ticks(ticks, labels=[str(t) for t in ticks])
    bar.ax.minorticks_off()
    bar.set_label("laser hits per cell", fontsize=9)
    bar.outline.set_visible(False)


def framed(run: Run) -> NDArray[np.float64]:
    """Return the points (n, 2) that the picture has to show besides the map."""
    xy_m, truth = run.slam.trajectory.xyyaw[:, :2], run.truth
    if truth is None:
        return xy_m
    return np.vstack((xy_m, truth.map_T_laser.xyyaw[:, :2], [truth.goal_xy_map_m], *drawing.wall_lines(truth)))


def _draw_poses(axes: Any, trajectory: Trajectory, some: NDArray[np.intp]) -> None:  # noqa: ANN401
    """Mark some of the estimated poses by magenta circles, on the line of all."""
    xy_m = trajectory.xyyaw[:, :2]
    colour = drawing.POSE_MAGENTA
    if len(xy_m):
        axes.plot(*xy_m.T, color=colour, lw=0.6, alpha=0.6, zorder=3)
        axes.plot(*xy_m[some].T, "o", ms=4, mfc="none", mec=colour, mew=0.8, label="estimated pose", zorder=3)


def _draw_truth(axes: Any, truth: Truth, stamps_ns: list[int]) -> None:  # noqa: ANN401
    """Draw the walls dashed, the true poses at the stamps of the circles as black x, start and goal."""
    drawing.draw_walls(axes, truth, color=drawing.TRUE_ORANGE, lw=0.9, ls=(0, (4, 3)), zorder=2, label="true wall")
    rows = np.flatnonzero(np.isin(truth.map_T_laser.stamps_ns, stamps_ns))
    xy_m = truth.map_T_laser.xyyaw[:, :2]
    axes.plot(*xy_m[rows].T, "x", ms=3.5, color="black", mew=0.7, label="true pose", zorder=4)
    drawing.draw_ends(axes, xy_m[0], truth.goal_xy_map_m, "goal")


def thinned(xy_m: NDArray[np.float64], spacing_m: float) -> NDArray[np.intp]:
    """Choose points of a path (n, 2), evenly spread along its length; the first and the last are among them."""
    if not len(xy_m):
        return np.empty(0, np.intp)
    along = np.concatenate(([0.0], np.hypot(*np.diff(xy_m, axis=0).T).cumsum()))
    circles = max(2, int(along[-1] / spacing_m) + 1)
    return np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], circles)))


def _subtitle(run: Run) -> str:
    config, steps = run.config, run.slam.steps
    accepted = sum(s.accepted for s in steps)
    scans = f"{accepted} of {len(steps)} scans mapped ({accepted / max(len(steps), 1):.0%})"
    lost = "   LOST before the end" if run.slam.lost_for_good else ""
    cell_mm = run.slam.grid.cell_m / MM
    how = f"method {config.method}, search grid {config.azimuth} / {config.grid}, cell {cell_mm:g} mm"
    return f"{how}\n{scans}{lost}, {thickness_text(run.thickness)}"


def thickness_text(thickness: dict[int, WallThickness]) -> str:
    """Say how thick the walls are, at the middle one of the thresholds."""
    if not thickness:
        return ""
    t = thickness[sorted(thickness)[len(thickness) // 2]]
    if not t.sections:
        return "no straight wall to measure"
    return f"wall thickness p95 {t.p95_cells:.1f}, max {t.max_cells:.1f} cells at ≥ {t.hits} hits"
