"""map_3d.png: the walls of all slices as columns, seen from above at an angle, and the path of the laser over them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import product
from math import cos, pi, sin
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import FREE, OCCUPIED, occupancy
from mavnav.mapping.slices import Slices
from mavnav.mapping.tiled_arrays import max_pool
from mavnav.outputs.pictures.canvas import FREE_GREY, INK, MUTED, POSE_MAGENTA, SMOOTH, Canvas, ramp, rgb_of, stroke
from mavnav.outputs.pictures.map_axes import END, START
from mavnav.outputs.pictures.plot import Style, centred_legend, heading, stamp
from mavnav.outputs.run import RunResult, require

Floats = NDArray[np.float64]

HEIGHTS: Final = ramp(("#30408f", "#2a7fb8", "#2fb5a5", "#8bd067", "#f5d04c", "#f28a3c", "#cf3f3f"))
TURN_RAD, ABOVE_RAD = -pi / 5.5, pi / 3.6
"""How far the map is turned clockwise, and the angle of the view above the floor."""

LONGEST_PIXELS, MARGIN, TITLE, SCALE = 1150, 70, 120, 190
LEAST_HITS: Final = 2
MOST_BLOCKS: Final = 160
"""Columns along the longer side of the map at most: cells are pooled."""

SIDE_SHADE, FRONT_SHADE = 0.62, 0.8
PATH: Final = Style(POSE_MAGENTA, "path of the laser", partial(stroke, width_pt=1.0))


class _Blocks(Struct, frozen=True):
    """Blocks of cells: ``walls`` (layers, rows, cols), ``free`` (rows, cols), corner and edge in m; ``levels_m``.

    The layers lie between successive ``levels_m`` (layers + 1,); those without a slice are empty.
    """

    walls: NDArray[np.bool_]
    free: NDArray[np.bool_]
    corner_m: tuple[float, float]
    edge_m: float
    levels_m: Floats


class _Projection(Struct, frozen=True):
    """From metres in space to pixels on the enlarged picture."""

    per_m: float
    left: float
    top: float

    def __call__(self, xyz_m: Floats) -> Floats:
        """Project points (..., 3)."""
        u, v = _project(xyz_m)
        return np.stack(((u - self.left) * self.per_m, (self.top - v) * self.per_m), axis=-1)


def _project(xyz_m: Floats) -> tuple[Floats, Floats]:
    x, y, z = np.moveaxis(xyz_m, -1, 0)
    across = x * cos(TURN_RAD) - y * sin(TURN_RAD)
    away = x * sin(TURN_RAD) + y * cos(TURN_RAD)
    return across, away * sin(ABOVE_RAD) + z * cos(ABOVE_RAD)


def write(run: RunResult, path: Path) -> None:
    """Draw the slices of a run that has some."""
    slices = require(run.slices, "the map by height")
    blocks = _blocks(slices)
    view, size = _fit_view(blocks)
    enlarged = Canvas.of(*size)
    _draw_floor(enlarged.draw, view, blocks)
    _draw_columns(enlarged.draw, view, blocks)
    _draw_path(enlarged.draw, view, slices.path_m)
    drawn = enlarged.image.reduce(SMOOTH)
    canvas = Canvas.of(drawn.width + SCALE, drawn.height + TITLE + MARGIN)
    canvas.image.paste(drawn, (MARGIN // 2, TITLE))
    _draw_scale(canvas, blocks.levels_m)
    _mark_ends(canvas, view, slices.path_m)
    heading(canvas, run.name, _subtitle(slices))
    canvas.save(path)


def _subtitle(slices: Slices) -> str:
    low_m, high_m = slices.path_m[:, 2].min(), slices.path_m[:, 2].max()
    layers = f"{len(slices.layers)} slices from {slices.layers[0].from_m:.2f} to {slices.layers[-1].to_m:.2f} m"
    return f"{layers}; path of the laser at {low_m:.2f} to {high_m:.2f} m; lines on the floor every meter"


def _blocks(slices: Slices) -> _Blocks:
    """Pool the cells of all slices; cells of a single hit are left out."""
    layers, grid = slices.layers, slices.layers[0].grid
    thick_m = layers[0].to_m - layers[0].from_m
    first, last = (round(layer.middle_m / thick_m) for layer in (layers[0], layers[-1]))
    factor = max(-(-max(grid.hits.shape) // MOST_BLOCKS), 1)
    walls, free = (np.zeros((last - first + 1, *max_pool(grid.hits > 0, factor).shape), np.bool_) for _ in range(2))
    for layer in layers:
        k, cells = round(layer.middle_m / thick_m) - first, occupancy(layer.grid)
        walls[k] = max_pool((cells == OCCUPIED) & (layer.grid.hits >= LEAST_HITS), factor)
        free[k] = max_pool(cells == FREE, factor)
    levels_m = np.arange(first - 0.5, last + 1.0) * thick_m
    return _Blocks(walls, np.asarray(free.any(axis=0)), grid.origin_xy_m, grid.cell_m * factor, levels_m)


def _corners(blocks: _Blocks) -> tuple[Floats, Floats]:
    """Return x and y of the corners of the blocks, (cols + 1,) and (rows + 1,)."""
    rows, cols = blocks.free.shape
    return tuple(c + blocks.edge_m * np.arange(n + 1) for c, n in zip(blocks.corner_m, (cols, rows), strict=True))  # type: ignore[return-value]


def _fit_view(blocks: _Blocks) -> tuple[_Projection, tuple[int, int]]:
    """Fit what is known into the enlarged picture; return its size too."""
    (x, y), (row, col) = _corners(blocks), np.nonzero(blocks.free | blocks.walls.any(axis=0))
    corners = product((0, 1), (0, 1), (0.0, blocks.levels_m[-1]))
    ends = [np.column_stack((x[col + a], y[row + b], np.full(len(row), z))) for a, b, z in corners]
    u, v = _project(np.concatenate(ends))
    per_m = SMOOTH * LONGEST_PIXELS / max(float(np.ptp(u)), float(np.ptp(v)))
    width, height = (int(np.ptp(w) * per_m) // SMOOTH * SMOOTH + SMOOTH for w in (u, v))
    return _Projection(per_m, float(u.min()), float(v.max())), (width, height)


def _draw_floor(draw: Any, view: _Projection, blocks: _Blocks) -> None:  # noqa: ANN401  Pillow's
    """Draw what was seen free in any slice, and lines every meter."""
    x, y = _corners(blocks)
    for row, free in enumerate(blocks.free):
        edges = np.flatnonzero(np.diff(np.pad(free, 1).astype(np.int8)))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            corners = ((start, row), (stop, row), (stop, row + 1), (start, row + 1))
            _area(draw, view, [(x[c], y[r], 0.0) for c, r in corners], rgb_of(FREE_GREY))
    for a, b in _meter_lines(x, y, blocks.free):
        draw.line([tuple(p) for p in view(np.array((a, b)))], fill=rgb_of("#dfe3e8"), width=SMOOTH)


def _meter_lines(x: Floats, y: Floats, free: NDArray[np.bool_]) -> Iterator[tuple[tuple[float, float, float], ...]]:
    """Yield lines across the floor (rows, cols) at round coordinates, from its first block to its last."""
    step_m = 1.0 if max(np.ptp(x), np.ptp(y)) < 40.0 else 10.0
    for at in np.arange(np.ceil(x[0] / step_m) * step_m, x[-1], step_m):
        rows = np.flatnonzero(free[:, min(int((at - x[0]) / (x[1] - x[0])), len(x) - 2)])
        if len(rows):
            yield (at, y[rows[0]], 0.0), (at, y[rows[-1] + 1], 0.0)
    for at in np.arange(np.ceil(y[0] / step_m) * step_m, y[-1], step_m):
        cols = np.flatnonzero(free[min(int((at - y[0]) / (y[1] - y[0])), len(y) - 2)])
        if len(cols):
            yield (x[cols[0]], at, 0.0), (x[cols[-1] + 1], at, 0.0)


def _draw_columns(draw: Any, view: _Projection, blocks: _Blocks) -> None:  # noqa: ANN401  Pillow's
    """Draw the faces of the blocks that are seen, the farthest block first and from below."""
    (x, y), z, walls = _corners(blocks), blocks.levels_m, np.pad(blocks.walls, 1)
    colours = height_colours(len(z) - 1).astype(float)
    filled = np.argwhere(blocks.walls)
    for k, row, col in filled[np.lexsort((filled[:, 0], filled[:, 2], -filled[:, 1]))].tolist():
        x0, x1, y0, y1, z0, z1 = x[col], x[col + 1], y[row], y[row + 1], z[k], z[k + 1]
        at = (k + 1, row + 1, col + 1)
        if not walls[at[0], at[1], at[2] + 1]:
            _area(draw, view, [(x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1)], _shade(colours[k], SIDE_SHADE))
        if not walls[at[0], at[1] - 1, at[2]]:
            _area(draw, view, [(x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)], _shade(colours[k], FRONT_SHADE))
        if not walls[at[0] + 1, at[1], at[2]]:
            _area(draw, view, [(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)], _shade(colours[k], 1.0))


def height_colours(levels: int) -> NDArray[np.uint8]:
    """Return the colours of the slices (levels, 3), the lowest first."""
    return np.asarray(HEIGHTS[np.linspace(0, len(HEIGHTS) - 1, levels).round().astype(int)])


def _shade(colour: Floats, shade: float) -> tuple[int, ...]:
    return tuple((colour * shade).round().astype(int).tolist())


def _area(draw: Any, view: _Projection, corners: list[tuple[float, float, float]], colour: tuple[int, ...]) -> None:  # noqa: ANN401
    draw.polygon([tuple(p) for p in view(np.array(corners)).tolist()], fill=colour)


def _draw_path(draw: Any, view: _Projection, path_m: Floats) -> None:  # noqa: ANN401  Pillow's
    """Draw the path at its height, with stems to the floor at its ends."""
    points = [tuple(p) for p in view(path_m).tolist()]
    for end in (path_m[0], path_m[-1]):
        foot = view(np.array((end, (end[0], end[1], 0.0)))).tolist()
        draw.line([tuple(p) for p in foot], fill=rgb_of(MUTED), width=SMOOTH)
    draw.line(points, fill=rgb_of(PATH.colour), width=2 * SMOOTH, joint="curve")


def _mark_ends(canvas: Canvas, view: _Projection, path_m: Floats) -> None:
    """Mark start and end of the path, and name them below."""
    for mark, end in ((START, path_m[0]), (END, path_m[-1])):
        x, y = (view(end) / SMOOTH).round().astype(int).tolist()
        stamp(canvas, mark, MARGIN // 2 + x, TITLE + y)
    centred_legend(canvas, (PATH, START, END))


def _draw_scale(canvas: Canvas, levels_m: Floats) -> None:
    """Draw the scale of heights at the right, with a mark at every level."""
    height = min(420, canvas.image.height - TITLE - 2 * MARGIN)
    left, top = canvas.image.width - SCALE + 70, TITLE + MARGIN // 2
    box = (left, top, left + 24, top + height)
    n = len(levels_m) - 1
    canvas.gradient(box, height_colours(n), upwards=True)
    for k in range(0, n + 1, max(-(-n // 10), 1)):
        canvas.text((left + 32, top + height * (1 - k / n)), f"{levels_m[k]:.2f}", 7.5, INK, "lm")
    canvas.text((left - 24, top + height / 2), "height above the floor [m]", 7.5, INK, upright=True)
