"""wall_thickness.png: where the walls are thick, and how thick they are at every hit threshold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from PIL import ImageDraw

from mavnav.mapping.occupancy_grid import measured_part
from mavnav.outputs import canvas
from mavnav.outputs.map_picture import draw_free
from mavnav.outputs.viewport import DPI, INK, MUTED, WALL_GREY, window_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.metrics.wall_thickness import Sections, WallThickness
    from mavnav.outputs.canvas import Canvas, Frame
    from mavnav.outputs.run import Run

BAR_COLOUR: Final = "#5b8db8"
P95_COLOUR: Final = "#c0392b"
LEFT, TOP, RIGHT, BOTTOM = 100, 90, 130, 80
"""Margins of the map in the picture, in pixels."""
HISTOGRAM: Final = (560, 110)
"""Width and height of a histogram, in pixels."""


def write(run: Run, path: Path) -> None:
    """Draw the sections of the middle threshold on the map, and a histogram for every threshold."""
    sections = dict(sorted(run.sections.items()))
    thresholds = list(sections)
    shown = thresholds[len(thresholds) // 2]
    window = window_of(run.known, np.empty((0, 2)))
    width, height = (round(v * DPI) for v in window.figure_size(longest_in=6.5, least_in=0.0))
    tall = max(height, len(thresholds) * (HISTOGRAM[1] + 120))
    picture = canvas.Canvas.of(LEFT + width + RIGHT + 80 + HISTOGRAM[0] + 30, TOP + tall + BOTTOM)
    frame = canvas.Frame(picture, window, LEFT, TOP + (tall - height) // 2, width, height)
    _draw_map(frame, run, shown)
    pitch = tall // len(thresholds)
    left = LEFT + width + RIGHT + 80
    _draw_histograms(picture, [(left, TOP + k * pitch, pitch - 120) for k in range(len(thresholds))], run, sections)
    picture.text((picture.image.width / 2, 26), f"{run.name}: wall thickness", 12.0, INK, bold=True)
    picture.save(path)


def _draw_map(frame: Frame, run: Run, min_hits: int) -> None:
    draw_free(frame, run)
    grid, sections = run.known, run.sections[min_hits]
    grey = np.array(canvas.rgb_of(WALL_GREY), np.uint8)
    frame.cells(grid, grid.hits, lambda _: grey, told=lambda hits: hits >= min_hits)
    top = max(3, int(np.ceil(np.quantile(sections.thickness_cells, 0.99))) if len(sections.row) else 3)
    step = -(-top // 12)  # cells a colour
    bounds = np.arange(0.5, top + step, step)
    colours = canvas.ramp(canvas.TURBO, len(bounds) - 1)
    # drawn across the wall, and at least a few pixels long wherever the map is large
    lines = section_lines(measured_part(run.slam.grid), sections, 0.012 * max(frame.window.size_m))
    ends = np.hstack((frame.to_canvas(lines[:, 0]), frame.to_canvas(lines[:, 1]))).round().astype(int)
    level = np.clip(np.searchsorted(bounds, sections.thickness_cells) - 1, 0, len(colours) - 1)
    draw = ImageDraw.Draw(frame.canvas.image)
    for line, colour in zip(ends.tolist(), colours[level].tolist(), strict=True):
        draw.line(line, fill=tuple(colour), width=3)
    bar = canvas.Bar(frame, frame.left + frame.width + 24)
    bar.gradient(np.repeat(colours, 16, axis=0))
    for k, name in enumerate(_names(bounds)):
        bar.tick((k + 0.5) / len(colours), name, line=False)
    bar.name("thickness [cells]")
    frame.dress()
    middle = frame.left + frame.width / 2
    text = f"cells with ≥ {min_hits} hits; grey: not part of a straight wall"
    frame.canvas.text((middle, frame.top - 22), text, 8.5, MUTED)


def _names(bounds: NDArray[np.float64]) -> list[str]:
    """Name the whole numbers of cells between two bounds: ``4``, or ``4-5``."""
    first, last = np.ceil(bounds[:-1]).astype(int), np.floor(bounds[1:]).astype(int)
    return [str(a) if a == b else f"{a}-{b}" for a, b in zip(first, last, strict=True)]


def section_lines(grid: Grid, sections: Sections, least_m: float) -> Any:  # noqa: ANN401
    """Return each section as a line in the map frame, (n, 2, 2) in metres, along its grid axis."""
    middle = np.column_stack((sections.col, sections.row)) + 0.5
    axis = np.where(sections.vertical[:, None], (0.0, 1.0), (1.0, 0.0))
    # what a section stands for in length tells its slant, and so its extent along the axis
    extent = (sections.thickness_cells - 1.0) * sections.length_m / grid.cell_m + 1.0
    half = 0.5 * np.maximum(extent, least_m / grid.cell_m)[:, None] * axis
    return (np.stack((middle - half, middle + half), axis=1)) * grid.cell_m + np.array(grid.origin_xy_m)


def _draw_histograms(
    picture: Canvas, places: list[tuple[int, int, int]], run: Run, sections: dict[int, Sections]
) -> None:
    """Draw metres of wall over thickness, one below the other on the same scale; places are left, top and height."""
    longest = max((s.thickness_cells.max() for s in sections.values() if len(s.row)), default=3.0)
    most = int(np.ceil(longest)) + 1
    for (left, top, height), (min_hits, found) in zip(places, sections.items(), strict=True):
        thickness = run.thickness[min_hits]
        picture.text((left, top), _title(thickness, min_hits), 8.5, INK, "la")
        bins = np.round(found.thickness_cells).astype(int)
        metres = np.bincount(bins, found.length_m, minlength=most + 1)[: most + 1]
        _draw_bars(picture, (left, top + 56, left + HISTOGRAM[0], top + 56 + height), metres, thickness)
    left, top, height = places[-1]
    picture.text((left + HISTOGRAM[0] / 2, top + 56 + height + 36), "thickness [cells]", 9.0, INK, "ma")


def _draw_bars(picture: Canvas, box: canvas.Box, metres: NDArray[Any], thickness: WallThickness) -> None:
    """Draw one histogram: ``metres`` of wall of 0, 1, 2 ... cells."""
    draw, (left, top, right, bottom) = ImageDraw.Draw(picture.image), box
    pitch, highest = (right - left) / len(metres), max(float(metres.max()), 1e-9)
    for cells, value in enumerate(metres.tolist()):
        if value > 0.0:
            x0, x1 = left + (cells + 0.05) * pitch, left + (cells + 0.95) * pitch
            draw.rectangle((x0, bottom - value / highest * (bottom - top), x1, bottom), fill=BAR_COLOUR)
    draw.line((left, top, left, bottom, right, bottom), fill=MUTED)
    for tick in canvas.ticks(0.0, len(metres) - 1.0, 8):
        if tick.is_integer():
            picture.text((left + (tick + 0.5) * pitch, bottom + 8), f"{tick:g}", colour=MUTED, anchor="ma")
    for value in canvas.ticks(0.0, highest, 4):
        picture.text((left - 8, bottom - value / highest * (bottom - top)), f"{value:g}", colour=MUTED, anchor="rm")
    picture.text((left - 62, (top + bottom) / 2), "wall [m]", 9.0, upright=True)
    if thickness.sections:
        x = left + (thickness.p95_cells + 0.5) * pitch
        draw.line((x, top, x, bottom), fill=P95_COLOUR, width=3)
        picture.text((x + 8, top + 8), "p95", 8.0, P95_COLOUR, "lm")


def _title(t: WallThickness, hits: int) -> str:
    numbers = "no straight wall"
    if t.sections:
        numbers = (
            f"p95 {t.p95_cells:.1f} cells = {t.p95_mm:.0f} mm, median {t.median_cells:.1f}, max {t.max_cells:.1f}\n"
            f"{t.length_m:.1f} m of wall in {t.sections} sections, {t.share:.0%} of the cells"
        )
    return f"≥ {hits} hit{'s' if hits > 1 else ''}: {numbers}"
