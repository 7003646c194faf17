"""Panels: small pictures of equal size, which a page arranges by its width, and sheets of panels as files.

The text of a panel is sized for a width of 300 to 600 pixels on a screen. A map has hits, path, doubtful stretches,
dashed true walls (paper, Figure 7), and rings around ghost walls.
"""

from __future__ import annotations

import io
from base64 import b64encode
from collections.abc import Sequence
from functools import partial
from itertools import compress
from math import hypot
from typing import Final

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray
from PIL import Image

from mavnav.mapping.occupancy_grid import occupancy
from mavnav.outputs.pictures import map_axes
from mavnav.outputs.pictures.canvas import GOAL_RED, INK, MUTED, POSE_MAGENTA, Box, Canvas, stroke
from mavnav.outputs.pictures.map_axes import Viewport, window_of
from mavnav.outputs.pictures.plot import Axes, Mark, Style, circle, legend
from mavnav.outputs.report.entry import Entry
from mavnav.pose import Pose, transform_points
from mavnav.units import DEG, MM

Boxes = Sequence[tuple[str, Viewport]]
"""Close-ups by their letters."""

COLOURS: Final = 256
"""Number of colors of a PNG file: a palette reduces its size to a third, and the octree method keeps rare colors, those
of ghost walls and true walls.
"""

DENSITY: Final = 2
"""Pictures of a page have twice the pixels of their size on the screen, for screens of that density."""

GAP_PIXELS: Final = 24 * DENSITY
SHEET_PIXELS: Final = 2800 * DENSITY
"""Maximum width of a sheet in pixels, unless a single panel is wider."""

FONT_PT: Final = 8.0

MAP_MARGINS: Final = (90, 40, 18, 63)
CHART_MARGINS: Final = (94, 40, 18, 63)
"""Left, top, right and bottom of the axes in a panel, in pixels."""
CHART: Final = (600, 255)
"""Width and height of a chart without its margins."""


def panel(size: tuple[int, int], title: str, margins: Box = MAP_MARGINS) -> tuple[Canvas, Box]:
    """Return a new panel and the box of its axes, for a size without the margins.

    The position of the axes does not depend on their labels, so that all panels have the same scale.
    """
    (width, height), (left, top, right, bottom) = size, margins
    canvas = Canvas.of(left + width + right, top + height + bottom, DENSITY)
    canvas.text((left, top - 11), title, FONT_PT + 1.5, anchor="ls")
    return canvas, (left, top, left + width, top + height)


def sheet(panels: Sequence[Image.Image], columns: int | None = None) -> Image.Image:
    """Return an image of panels in rows on white, with ``columns`` panels per row, by default as many as fit."""
    width, height = (max(p.size[k] for p in panels) + GAP_PIXELS for k in (0, 1))
    per_row = min(columns or max(1, SHEET_PIXELS // width), len(panels))
    rows = -(-len(panels) // per_row)
    canvas = Image.new("RGB", (per_row * width, rows * height), "white")
    for k, panel in enumerate(panels):
        canvas.paste(panel, (k % per_row * width + GAP_PIXELS // 2, k // per_row * height + GAP_PIXELS // 2))
    return canvas


def stack(sheets: Sequence[Image.Image]) -> Image.Image:
    """Return an image of pictures below one another."""
    canvas = Image.new("RGB", (max(s.width for s in sheets), sum(s.height for s in sheets)), "white")
    top = 0
    for one in sheets:
        canvas.paste(one, (0, top))
        top += one.height
    return canvas


def png(image: Image.Image) -> bytes:
    """Return the bytes of a PNG file with `COLOURS` colors, those of every second row and column: lines are wider."""
    sample = image.resize([max(side // 2, 1) for side in image.size], Image.Resampling.NEAREST)
    palette = sample.quantize(COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    buffer = io.BytesIO()
    image.quantize(palette=palette, dither=Image.Dither.NONE).save(buffer, format="PNG", compress_level=4)
    return buffer.getvalue()


def data_uri(image: Image.Image, max_bytes: int) -> str:
    """Return the picture as a data URI, scaled down until it has at most ``max_bytes`` or a side of 64 pixels."""
    content = png(image)
    while len(content) > max_bytes and min(image.size) > 64:
        image = image.resize((image.width * 3 // 4, image.height * 3 // 4), Image.Resampling.LANCZOS)
        content = png(image)
    return "data:image/png;base64," + b64encode(content).decode("ascii")


PATH: Final = Style(POSE_MAGENTA, "path of the laser", partial(stroke, width_pt=1.0, opacity=0.75))
RING: Final = Style(GOAL_RED, "", partial(stroke, width_pt=1.6))
GHOST: Final = Mark(GOAL_RED, "ghost wall", partial(circle, size_pt=11.0, width_pt=1.6))
MIN_RING_SHARE: Final = 0.05
"""Minimum length of the ring around a ghost wall, as a share of the window's longer side, so that it is visible."""

LONGEST_IN, WIDE_IN, CLOSEUP_IN = 5.0, 9.0, 2.6
MIN_ASPECT: Final = 0.25
"""Minimum ratio of the shorter to the longer side of a map panel."""
LETTER, LINE = 24, 30
"""Side of a letter's square, and height of a line in the legend, in pixels."""
WIDE, TALL = 2.2, 1.4
"""Ratio of width to height above which a map is wide, and of height to width above which it is tall."""


def common_window(entries: Sequence[Entry]) -> Viewport:
    """Return the window that contains the maps of all runs, their paths and the true walls."""
    points = (np.vstack((_path(e), *e.true_walls, e.goal_xy_m)) for e in entries)
    windows = [astuple(window_of(e.grid, xy_m)) for e, xy_m in zip(entries, points, strict=True)]
    x0, x1, y0, y1, _ = zip(*windows, strict=True)
    return Viewport(min(x0), max(x1), min(y0), max(y1))


def _path(entry: Entry) -> NDArray[np.float64]:
    """Return the positions of the scans that have one, (n, 2) in m."""
    return entry.scans.xy_m[np.isfinite(entry.scans.xy_m[:, 0])]


def shape(window: Viewport) -> str:
    """Return the shape of a map for the page layout: wide, tall, or neither (empty)."""
    width, height = window.size_m
    return "wide" if width > WIDE * height else "tall" if height > TALL * width else ""


def map_panel(entry: Entry, window: Viewport, top_hits: float, boxes: Boxes, *, ends: bool) -> Image.Image:
    """Draw the map of a run with its close-ups; ``ends`` marks start, end and goal."""
    longest_in, max_ticks = (WIDE_IN, 16) if shape(window) == "wide" else (LONGEST_IN, 11)
    axes = _panel(entry.name, window.widen(MIN_ASPECT), longest_in)
    draw_map(axes, entry, top_hits, max_ticks, boxes, ends=ends)
    return axes.canvas.image


def closeup_panel(entry: Entry, window: Viewport, top_hits: float, letter: str) -> Image.Image:
    """Draw a square part of the map of a run."""
    axes = _panel(f"{letter}  {entry.name}", window, CLOSEUP_IN)
    draw_map(axes, entry, top_hits, 5)
    return axes.canvas.image


def _panel(title: str, window: Viewport, longest_in: float) -> Axes:
    canvas, box = panel(window.size_pixels(longest_in), title)
    axes = map_axes.map_axes(canvas, window, box)
    axes.names("x [m]", "y [m]", FONT_PT, MAP_MARGINS[0] - 14)
    return axes


def draw_map(
    axes: Axes, entry: Entry, top_hits: float, max_ticks: int, boxes: Boxes = (), *, ends: bool = False
) -> None:
    """Draw map, path, walls and close-ups onto axes, with about ``max_ticks`` ticks along the longer side."""
    map_axes.draw_free(axes, entry.grid, occupancy(entry.grid))
    map_axes.draw_hits(axes, entry.grid, top_hits)
    axes.lines(map_axes.TRUE_WALL, entry.true_walls)
    axes.lines(PATH, [entry.scans.xy_m])
    axes.lines(map_axes.DOUBTFUL, [np.where(entry.scans.doubtful[:, None], entry.scans.xy_m, np.nan)])
    if ends:
        axes.mark(map_axes.START, _path(entry)[:1])
        axes.mark(map_axes.END, _path(entry)[-1:])
        axes.mark(map_axes.GOAL, entry.goal_xy_m)
    for letter, box in boxes:
        _draw_box(axes, letter, box)
    longest_m = max(axes.size)
    axes.lines(RING, [_ring(place, MIN_RING_SHARE * longest_m) for place in ghosts(entry)])
    in_x, in_y = (round(max_ticks * side_m / longest_m) for side_m in axes.size)
    map_axes.draw_axes(axes, (max(4, in_x), max(5, in_y)))


def ghosts(entry: Entry) -> list[dict[str, float]]:
    """Return the ghost walls of a run as in run.json; empty if they were not searched for."""
    quality = entry.document.get("map_quality") or {}
    places: list[dict[str, float]] = (quality.get("ghost_walls") or {}).get("places") or []
    return places


def _ring(place: dict[str, float], min_m: float) -> NDArray[np.float64]:
    """Return an ellipse around a wall and its ghost, points (n, 2) in m."""
    long_m = max(1.2 * place["length_m"], min_m)
    short_m = max(3.0 * place["offset_mm"] * MM, 0.35 * long_m, 0.6 * min_m)
    angle, yaw_rad = np.linspace(0.0, 2.0 * np.pi, 73), place["direction_deg"] * DEG
    points = np.column_stack((hypot(long_m, 0.5 * short_m) * np.cos(angle), short_m * np.sin(angle))) / 2.0
    return transform_points(Pose(place["x_m"], place["y_m"], yaw_rad), points)


def _draw_box(axes: Axes, letter: str, box: Viewport) -> None:
    """Draw the outline of a close-up with its letter at the upper left corner, left of it if the close-up is small."""
    corners = axes.to_canvas(np.array([[box.x0_m, box.y1_m], [box.x1_m, box.y0_m]]))
    (left, top), (right, bottom) = np.clip(corners, axes.box[:2], axes.box[2:]).round().astype(int).tolist()
    axes.canvas.rectangle((left, top, right, bottom), outline=INK, width=2)
    x = left if right - left > 3 * LETTER else max(left - LETTER, axes.box[0])
    axes.canvas.rectangle((x, top, x + LETTER, top + LETTER), INK)
    axes.canvas.text((x + LETTER / 2, top + LETTER / 2), letter, FONT_PT, "#ffffff", bold=True)


def legend_panel(entries: Sequence[Entry], top_hits: float, *, ends: bool) -> Image.Image:
    """Draw the color scale of hits that all maps share, and the legend of their lines; ``ends`` as in `map_panel`."""
    canvas, box = panel((390, 21), "", (15, 40, 375, 36))
    axes = Axes.chart(canvas, box, (0.0, 1.0, 0.0, 1.0))
    canvas.gradient(box, map_axes.HIT_COLOURS)
    axes.ticks(map_axes.hit_ticks(top_hits), length=5)
    canvas.text((box[0], box[1] - 8), "laser hits per cell", FONT_PT, MUTED, "ls")
    doubtful, truth = any(e.scans.doubtful.any() for e in entries), any(e.true_walls for e in entries)
    named = (PATH, map_axes.DOUBTFUL, map_axes.TRUE_WALL, GHOST)
    lines: list[Mark | Style] = list(compress(named, (True, doubtful, truth, any(map(ghosts, entries)))))
    goal = ends and any(len(e.goal_xy_m) for e in entries)
    places = list(compress((map_axes.START, map_axes.END, map_axes.GOAL), (ends, ends, goal)))
    for marks, left in ((lines, 24), (places, 250)):
        first = (canvas.height - (len(marks) - 1) * LINE) // 2
        for k, mark in enumerate(marks):
            legend(canvas, [mark], first + k * LINE, box[2] + left, FONT_PT)
    return canvas.image
