"""Maps on axes of one scale: the part that is shown, cells, laser hits, and the marks that all pictures share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from math import ceil, cos, pi, prod, sin
from pathlib import Path
from textwrap import wrap
from typing import Any, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from PIL import Image

from mavnav.mapping.occupancy_grid import FREE, Grid
from mavnav.mapping.tiled_arrays import CellFunction, max_pool, where
from mavnav.outputs.documents.verdict import Verdict
from mavnav.outputs.pictures import canvas, plot
from mavnav.outputs.pictures.canvas import DPI, FREE_GREY, Box, Canvas, draw_dashes, ramp, rgb_of, stroke
from mavnav.outputs.pictures.plot import Area, Axes, Mark, Sign, Style
from mavnav.outputs.run import Walls
from mavnav.pose import Pose, transform_points
from mavnav.units import DEG

HIT_COLOURS: Final = ramp(("#35b779", "#1f9e89", "#26828e", "#31688e", "#3e4989", "#482878", "#440154"))
"""Viridis without its light end, on which a wall that was hit once would be hard to see."""
FRAME_GREY: Final = "#cccccc"
HIT_TICKS: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000)

TICK_ROOM: Final = (60, 30)
"""Of a label in x and in y, in pixels."""

JUDGED_MARGINS: Final = (100, 150, 130, 120)
"""Left, top, right and bottom of a map with a scale of hits and its verdict in its picture, in pixels."""

CHARACTER: Final = 9
"""Width of a character of the text below a title, in pixels."""

VERDICT_COLOURS: Final = {"good": "#2e7d32", "suspect": "#b26a00", "wrong": "#c62828", "lost": "#c62828"}

START: Final = Mark(canvas.START_BLUE, "start", partial(plot.cross, size_pt=10.0, width_pt=2.4))
END: Final = Mark(canvas.GOAL_RED, "end", partial(plot.square, size_pt=9.0, width_pt=1.8))
GOAL: Final = Mark(canvas.GOAL_RED, "goal", partial(plot.crossed_circle, size_pt=13.0, width_pt=1.4))
POSE: Final = Mark(canvas.POSE_MAGENTA, "estimated pose", partial(plot.circle, size_pt=4.0, width_pt=0.8))
TRUE_POSE: Final = Mark("#000000", "true pose", partial(plot.cross, size_pt=3.5, width_pt=0.7))
LOOP: Final = Style(canvas.INK, "closed loop", partial(stroke, width_pt=0.72))
DOUBTFUL: Final = Style(canvas.DOUBT_RED, "doubtful", partial(stroke, width_pt=2.4))
TRUE_WALL: Final = Style(canvas.TRUE_ORANGE, "true wall", draw_dashes)
KNOWN: Final = (Area(FREE_GREY, "free"), Area("#ffffff", "unknown"))
GRATICULE: Final = Style(canvas.MUTED, "", partial(stroke, width_pt=0.5, opacity=0.35))
MEASURED_WALL: Final = Style(canvas.MEASURED_BLUE, "measured by hand", draw_dashes)

LEAST_IN, MOST_IN = 3.0, 11.0
"""A long narrow map is shown larger, until its shorter side has the one or its longer side the other, in inches."""

STRAY_SHARE: Final = 5e-4
FAR_SHARE: Final = 0.01
WORTH_IT: Final = 0.4
"""Share of the area below which a picture shows the well seen part of a map alone."""

ARC_STEP_RAD: Final = pi / 90.0


class Viewport(Struct, frozen=True):
    """A rectangle in metres, of the map turned about its origin by ``turn_rad``: what a picture shows."""

    x0_m: float
    x1_m: float
    y0_m: float
    y1_m: float
    turn_rad: float = 0.0

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height."""
        return self.x1_m - self.x0_m, self.y1_m - self.y0_m

    def ends_in_map(self) -> NDArray[np.float64]:
        """Return the least and the greatest x and y in the map, (2, 2)."""
        corners = np.array([(x, y) for x in (self.x0_m, self.x1_m) for y in (self.y0_m, self.y1_m)])
        xy_m = transform_points(Pose(yaw_rad=-self.turn_rad), corners)
        return np.array((xy_m.min(axis=0), xy_m.max(axis=0)))

    def cells_of(self, grid: Grid) -> tuple[int, int, int, int]:
        """Return the first and the end column, and the first and the end row, of the grid's cells inside.

        At least one of each: of a grid beside the window, the nearest.
        """
        (x0, y0), (rows, cols), ends_m = grid.origin_xy_m, grid.hits.shape, self.ends_in_map()
        ends = [(x - x0, cols) for x in ends_m[:, 0]] + [(y - y0, rows) for y in ends_m[:, 1]]
        a, b, c, d = (min(max(int(distance / grid.cell_m), 0), count) for distance, count in ends)
        a, c = min(a, cols - 1), min(c, rows - 1)
        return a, max(b, a + 1), c, max(d, c + 1)

    def size_pixels(self, longest_in: float, least_in: float = 0.0) -> tuple[int, int]:
        """Return width and height in pixels that show the rectangle undistorted.

        The shorter side has ``least_in``, if the longer one has no more than `MOST_IN` by that.
        """
        width, height = self.size_m
        scale = max(longest_in / max(width, height), min(least_in / min(width, height), MOST_IN / max(width, height)))
        return round(width * scale * DPI), round(height * scale * DPI)

    def widen(self, least_share: float) -> Viewport:
        """Return it with the shorter side at least this share of the longer, about the same middle."""
        width, height = self.size_m
        dx, dy = (max(0.0, least_share * max(width, height) - side) / 2 for side in (width, height))
        return Viewport(self.x0_m - dx, self.x1_m + dx, self.y0_m - dy, self.y1_m + dy, self.turn_rad)


def window_of(grid: Grid, xy_m: NDArray[np.float64], turn_rad: float = 0.0) -> Viewport:
    """Frame the hit cells and the points ``xy_m`` (n, 2) of a map, turned about its origin, with a margin.

    On each side the outermost `STRAY_SHARE` of the cells may fall outside: single far returns through a window
    would otherwise shrink the map to a spot. If that saves much, so may the half of the cells that was hit least, and
    `FAR_SHARE` of the others.
    """
    hit = where(grid.hits, lambda hits: hits > 0)
    counts = grid.hits[tuple(hit.T)]
    seen = hit[counts >= np.median(counts)] if len(hit) else hit
    whole = _window(grid, hit, STRAY_SHARE, xy_m, turn_rad)
    near = _window(grid, seen, FAR_SHARE, xy_m, turn_rad)
    return near if prod(near.size_m) < WORTH_IT * prod(whole.size_m) else whole


def _window(grid: Grid, cells: NDArray[np.intp], share: float, xy_m: NDArray[np.float64], turn_rad: float) -> Viewport:
    """Frame points and cells (n, 2) as row and column, of which a share may fall outside on each side."""
    turn = partial(transform_points, Pose(yaw_rad=turn_rad))
    corners = [turn(xy_m if len(xy_m) or len(cells) else np.array([grid.origin_xy_m]))]
    if len(cells):
        at = turn(cells[:, ::-1] + 0.5 + np.array(grid.origin_xy_m) / grid.cell_m)
        ends = np.quantile(at, (share, 1.0 - share), axis=0, method="nearest")
        ends[0], ends[1] = ends[0] - 0.5, ends[1] + 0.5  # whole cells
        corners.append(ends * grid.cell_m)
    return window_around(np.vstack(corners), 5 * grid.cell_m, turn_rad)


def window_around(xy_m: NDArray[np.float64], least_margin_m: float, turn_rad: float = 0.0) -> Viewport:
    """Frame points (n, 2) of the turned map, with a margin."""
    (x0, y0), (x1, y1) = xy_m.min(axis=0), xy_m.max(axis=0)
    margin = max(0.04 * max(x1 - x0, y1 - y0), least_margin_m)
    return Viewport(float(x0 - margin), float(x1 + margin), float(y0 - margin), float(y1 + margin), turn_rad)


def wall_lines(walls: Walls) -> list[NDArray[np.float64]]:
    """Return the true walls as lines (k, 2) in the map frame, m; arcs in steps of `ARC_STEP_RAD` at most."""
    return [*walls.segments_map.reshape(-1, 2, 2), *map(_arc_line, walls.arcs_map)]


def _arc_line(arc: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, radius, start, sweep = arc.tolist()
    angles = start + np.linspace(0.0, sweep, max(2, ceil(abs(sweep) / ARC_STEP_RAD) + 1))
    return np.column_stack((x + radius * np.cos(angles), y + radius * np.sin(angles)))


def map_axes(picture: Canvas, window: Viewport, box: Box) -> Axes:
    """Show a window of the map in a box of its shape; a metre is as long in x as in y."""
    per_m = (box[2] - box[0]) / window.size_m[0]
    limits = window.x0_m, window.x1_m, window.y0_m, window.y1_m
    return Axes(picture, box, limits, (per_m, per_m), window.turn_rad)


def framed_map(window: Viewport, longest_in: float, margins: Box, least: tuple[int, int] = (0, 0)) -> Axes:
    """Begin a picture of ``least`` width and height with the map in the middle of what the margins leave."""
    left, top, right, bottom = margins
    width, height = window.size_pixels(longest_in, LEAST_IN)
    picture = Canvas.of(max(width + left + right, least[0]), max(height + top + bottom, least[1]))
    first = (picture.width - width - right + left) // 2
    return map_axes(picture, window, (first, top, first + width, top + height))


def draw_cells(
    axes: Axes, grid: Grid, cells: NDArray[Any], colour_of: CellFunction, value_of: CellFunction = np.asarray
) -> None:
    """Show an array of the grid's shape; zeros are transparent, ``colour_of`` gives (n, 3) or (3,) for the others.

    Where cells are smaller than pixels, the largest ``value_of`` several cells is shown. A pixel shows the cell that
    its middle lies in.
    """
    first_col, end_col, first_row, end_row = Viewport(*axes.limits, axes.turn_rad).cells_of(grid)
    factor = max(1, ceil(1.0 / (grid.cell_m * axes.per_unit[0] * axes.canvas.density)))
    shown = max_pool(cells[first_row:end_row, first_col:end_col], factor, value_of=value_of)
    some, pixels = shown > 0, np.zeros((*shown.shape, 3), np.uint8)
    pixels[some] = colour_of(shown[some])
    left, top, right, bottom = (v * axes.canvas.density for v in axes.box)
    first_m = grid.origin_xy_m + np.array([first_col, first_row]) * grid.cell_m
    to_squares = _to_squares(axes, first_m, factor * grid.cell_m)

    def on_axes(squares: NDArray[Any]) -> Image.Image:
        size, affine = (right - left, bottom - top), Image.Transform.AFFINE
        return Image.fromarray(squares).transform(size, affine, to_squares, Image.Resampling.NEAREST)

    axes.canvas.image.paste(on_axes(pixels), (left, top), on_axes(some))


def _to_squares(axes: Axes, first_m: NDArray[np.float64], edge_m: float) -> tuple[float, ...]:
    """Return Pillow's transform from pixels of axes to columns and rows of squares of the map from a corner (2,)."""
    x0_m, y0_m = axes.limits[0], axes.limits[2]
    top_left_m = np.array([[x0_m, y0_m + (axes.box[3] - axes.box[1]) / axes.per_unit[1]]])
    col, row = ((transform_points(Pose(yaw_rad=-axes.turn_rad), top_left_m)[0] - first_m) / edge_m).tolist()
    per_pixel = 1.0 / (edge_m * axes.per_unit[0] * axes.canvas.density)
    c, s = per_pixel * cos(axes.turn_rad), per_pixel * sin(axes.turn_rad)
    return c, -s, col, -s, -c, row


def draw_free(axes: Axes, grid: Grid, occupancy: NDArray[np.int8]) -> None:
    """Shade the cells that are known to be free."""
    grey = np.array(rgb_of(FREE_GREY), np.uint8)
    draw_cells(axes, grid, occupancy, lambda _: grey, value_of=lambda cells: cells == FREE)


def draw_hits(axes: Axes, grid: Grid, top: float) -> None:
    """Colour the hit cells on a logarithmic scale from 1 to ``top``."""

    def colour_of(hits: NDArray[Any]) -> NDArray[np.uint8]:
        share = np.minimum(np.log(hits, dtype=np.float64) / np.log(top), 1.0)
        return np.asarray(HIT_COLOURS[np.round(share * (len(HIT_COLOURS) - 1)).astype(np.intp)])

    draw_cells(axes, grid, grid.hits, colour_of)


def draw_counts(axes: Axes, grid: Grid, occupancy: NDArray[np.int8]) -> None:
    """Draw free cells and hits of a map, and the scale of its hits at the right."""
    top = top_of_scale([grid])
    draw_free(axes, grid, occupancy)
    draw_hits(axes, grid, top)
    plot.colour_bar(axes, HIT_COLOURS, hit_ticks(top), "laser hits per cell")


def top_of_scale(grids: Iterable[Grid]) -> float:
    """Return the end of the scale of hits, at least 10: few crowded cells do not change it."""
    cells = [(grid, *where(grid.hits, lambda hits: hits > 0).T) for grid in grids]
    counts = np.concatenate([grid.hits[row, col] for grid, row, col in cells])
    return max(float(np.quantile(counts, 0.995)) if counts.size else 1.0, 10.0)


def hit_ticks(top: float) -> list[tuple[float, str]]:
    """Return the ticks of the scale of hits, as shares of it."""
    return [(float(np.log(tick) / np.log(top)), str(tick)) for tick in HIT_TICKS if tick <= top]


def draw_axes(axes: Axes, most: tuple[int, int] = (9, 9)) -> None:
    """Draw border and ticks, at most so many in x and y; in a turned map they are where lines of the map's x and y end.

    x is labelled at the lower border, y at the left one; fewer where there is no room for the labels.
    """
    (x0, x1, y0, y1), c, s = axes.limits, cos(axes.turn_rad), sin(axes.turn_rad)
    (left, top, right, bottom), (width, height) = axes.box, TICK_ROOM
    in_x = c * x0 + s * y0, c * x1 + s * y0, max(1, min(most[0], (right - left) // width))
    in_y = c * y0 - s * x0, c * y1 - s * x0, max(1, min(most[1], (bottom - top) // height))
    if axes.turn_rad:
        _draw_graticule(axes, (plot.tick_step(*in_x), plot.tick_step(*in_y)))
    axes.canvas.rectangle(axes.box, outline=FRAME_GREY)
    at_x, at_y = plot.ticks(*in_x), plot.ticks(*in_y)
    axes.ticks([((x - s * y0) / c, f"{x:g}") for x in at_x], [((y + s * x0) / c, f"{y:g}") for y in at_y])


def _draw_graticule(axes: Axes, steps: tuple[float, float]) -> None:
    """Draw the lines of equal x and y of a turned map at the distance of its ticks."""
    (low_x, low_y), (high_x, high_y) = ends = Viewport(*axes.limits, axes.turn_rad).ends_in_map()
    at_x, at_y = (np.arange(ceil(low / step) * step, high, step) for low, high, step in zip(*ends, steps, strict=True))
    upright = [np.array([(x, low_y), (x, high_y)]) for x in at_x]
    axes.lines(GRATICULE, [*upright, *(np.array([(low_x, y), (high_x, y)]) for y in at_y)])


def finish(axes: Axes, named: Sequence[Sign], title: str, about: str, path: Path, **style: Any) -> None:  # noqa: ANN401
    """Draw axes, legend and heading of a picture of a map, and write it; lines that are too long are broken.

    ``style`` is that of `plot.heading`.
    """
    draw_axes(axes)
    name_axes(axes)
    plot.centred_legend(axes.canvas, named)
    width = axes.canvas.width // CHARACTER
    lines = [part for line in about.split("\n") for part in wrap(line, width)]
    plot.heading(axes.canvas, title, "\n".join(lines), **style)
    axes.canvas.save(path)


def finish_judged(axes: Axes, named: Sequence[Sign], name: str, verdict: Verdict, about: str, path: Path) -> None:
    """Do the same with the verdict in the title and its reason below, for a picture with `JUDGED_MARGINS`."""
    title, colour = f"{name}: {verdict.word}", VERDICT_COLOURS[verdict.word]
    finish(axes, named, title, f"{verdict.reason}\n{about}", path, about_y=94, colour=colour)


def name_axes(axes: Axes) -> None:
    """Write what the axes show, and whether the picture is turned."""
    turn = f" along the grey lines; picture turned by {axes.turn_rad / DEG:.1f}° to the walls" if axes.turn_rad else ""
    axes.names(f"x [m]{turn}", "y [m]")
