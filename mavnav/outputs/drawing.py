"""What the pictures share: a figure without global state, the map as an image in metres, bytes that repeat."""

from __future__ import annotations

import warnings
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from mavnav.mapping.occupancy_grid import FREE, occupancy
from mavnav.mapping.tiled_arrays import pooled
from mavnav.outputs.viewport import (
    DPI,
    FREE_GREY,
    GOAL_RED,
    GOAL_SIGN,
    INK,
    MAX_CELLS,
    MUTED,
    PATH_GREY,
    POSE_MAGENTA,
    START_BLUE,
    TRUE_ORANGE,
    Window,
    wall_lines,
    window_around,
    window_of,
)

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.outputs.run import Truth

__all__ = [
    "GOAL_RED",
    "INK",
    "MUTED",
    "PATH_GREY",
    "POSE_MAGENTA",
    "TRUE_ORANGE",
    "Window",
    "draw_cells",
    "draw_ends",
    "draw_free",
    "draw_walls",
    "dress",
    "figure",
    "save",
    "wall_lines",
    "window_around",
    "window_of",
]


def figure(width_in: float, height_in: float) -> Any:  # noqa: ANN401  matplotlib has no types for us
    """Return an empty figure that draws without a window system."""
    fig = Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(fig)
    return fig


def save(fig: Any, path: Path) -> None:  # noqa: ANN401
    """Write a PNG whose bytes follow from the picture alone."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # a log's name may be in any script
        fig.savefig(path, format="png", metadata={"Software": None})


def draw_cells(axes: Any, grid: Grid, cells: NDArray[Any], window: Window, **style: Any) -> Any:  # noqa: ANN401
    """Draw the part of an array of the grid's shape that the window shows; zeros are transparent. Returns the image."""
    first_col, end_col, first_row, end_row = window.cells_of(grid)
    factor = max(1, ceil(max(window.size_m) / grid.cell_m / MAX_CELLS))
    shown = pooled(cells[first_row:end_row, first_col:end_col], factor)
    rows, cols = shown.shape
    x0, y0 = grid.origin_xy_m[0] + first_col * grid.cell_m, grid.origin_xy_m[1] + first_row * grid.cell_m
    extent = (x0, x0 + cols * factor * grid.cell_m, y0, y0 + rows * factor * grid.cell_m)
    masked = np.ma.masked_equal(shown, 0)
    return axes.imshow(masked, origin="lower", extent=extent, interpolation="nearest", **style)


def draw_free(axes: Any, grid: Grid, window: Window) -> None:  # noqa: ANN401
    """Shade the cells that are known to be free."""
    free = (occupancy(grid) == FREE).astype(np.uint8)
    draw_cells(axes, grid, free, window, cmap=ListedColormap([FREE_GREY]), vmin=0, vmax=1, zorder=0)


def draw_walls(axes: Any, truth: Truth, **style: Any) -> None:  # noqa: ANN401
    """Draw the true walls; the first alone bears the label."""
    label = style.pop("label", None)
    for line in wall_lines(truth):
        axes.plot(*line.T, label=label, **style)
        label = None


def draw_ends(axes: Any, start_xy_m: Any, end_xy_m: Any, end: str) -> None:  # noqa: ANN401
    """Mark the start by a blue x, the end or goal by a red circle with an x."""
    axes.plot(*start_xy_m, "x", ms=10, color=START_BLUE, mew=2.4, label="start", zorder=5)
    axes.plot(*end_xy_m, marker=GOAL_SIGN, ls="none", ms=13, color=GOAL_RED, mew=0.3, label=end, zorder=5)


def dress(axes: Any, window: Window) -> None:  # noqa: ANN401
    """Set limits, equal aspect, labels and quiet spines."""
    axes.set_xlim(window.x0_m, window.x1_m)
    axes.set_ylim(window.y0_m, window.y1_m)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.tick_params(colors=MUTED, labelsize=8)
    for spine in axes.spines.values():
        spine.set_color("#cccccc")
