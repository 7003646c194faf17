"""wall_thickness.png: where the walls are thick, and how thick they are at every hit threshold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav.mapping.occupancy_grid import measured_part
from mavnav.outputs.canvas import Canvas, ramp, rgb_of
from mavnav.outputs.map_axes import draw_axes, draw_cells, draw_free, map_axes
from mavnav.outputs.plot import Axes, colour_bar, ticks
from mavnav.outputs.viewport import INK, MUTED, WALL_GREY, window_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.metrics.wall_thickness import Sections, WallThickness
    from mavnav.outputs.canvas import Box
    from mavnav.outputs.run import Run

BAR_COLOUR: Final = "#5b8db8"
P95_COLOUR: Final = "#c0392b"
TURBO: Final = (
    "#30123b", "#4662d7", "#36aaf9", "#1ae4b6", "#72fe5e", "#c8ef34", "#faba39", "#f66b19", "#cb2a04", "#7a0403",
)  # fmt: skip
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
    width, height = window.size_pixels(longest_in=6.5)
    tall = max(height, len(thresholds) * (HISTOGRAM[1] + 120))
    picture = Canvas.of(LEFT + width + RIGHT + 80 + HISTOGRAM[0] + 30, TOP + tall + BOTTOM)
    top = TOP + (tall - height) // 2
    _draw_map(map_axes(picture, window, (LEFT, top, LEFT + width, top + height)), run, shown)
    pitch = tall // len(thresholds)
    left = LEFT + width + RIGHT + 80
    _draw_histograms(picture, [(left, TOP + k * pitch, pitch - 120) for k in range(len(thresholds))], run, sections)
    picture.text((picture.image.width / 2, 26), f"{run.name}: wall thickness", 12.0, INK, bold=True)
    picture.save(path)


def _draw_map(axes: Axes, run: Run, min_hits: int) -> None:
    draw_free(axes, run.known, run.cells)
    grey = np.array(rgb_of(WALL_GREY), np.uint8)
    draw_cells(axes, run.known, run.known.hits, lambda _: grey, value_of=lambda hits: hits >= min_hits)
    _draw_sections(axes, measured_part(run.slam.grid), run.sections[min_hits])
    draw_axes(axes)
    axes.names("x [m]", "y [m]")
    left, top, right, _ = axes.box
    text = f"cells with ≥ {min_hits} hits; grey: not part of a straight wall"
    axes.canvas.text(((left + right) / 2, top - 22), text, 8.5, MUTED)


def _draw_sections(axes: Axes, grid: Grid, sections: Sections) -> None:
    """Draw each section across its wall in the colour of its thickness, and the scale of these colours."""
    top = max(3, int(np.ceil(np.quantile(sections.thickness_cells, 0.99))) if len(sections.row) else 3)
    step = -(-top // 12)  # cells a colour
    bounds = np.arange(0.5, top + step, step)
    colours = ramp(TURBO, len(bounds) - 1)
    # at least a few pixels long wherever the map is large
    lines = section_lines(grid, sections, 0.012 * max(axes.size))
    ends = np.hstack((axes.to_canvas(lines[:, 0]), axes.to_canvas(lines[:, 1]))).round().astype(int)
    level = np.clip(np.searchsorted(bounds, sections.thickness_cells) - 1, 0, len(colours) - 1)
    draw = axes.canvas.draw
    for line, colour in zip(ends.tolist(), colours[level].tolist(), strict=True):
        draw.line(line, fill=tuple(colour), width=3)
    shares = (np.arange(len(colours)) + 0.5) / len(colours)
    names = zip(shares.tolist(), _names(bounds), strict=True)
    colour_bar(axes, np.repeat(colours, 16, axis=0), names, "thickness [cells]", lines=False)


def _names(bounds: NDArray[np.float64]) -> list[str]:
    """Name the whole numbers of cells between two bounds: ``4``, or ``4-5``."""
    first, last = np.ceil(bounds[:-1]).astype(int), np.floor(bounds[1:]).astype(int)
    return [str(a) if a == b else f"{a}-{b}" for a, b in zip(first, last, strict=True)]


def section_lines(grid: Grid, sections: Sections, least_m: float) -> Any:  # noqa: ANN401
    """Return each section as a line in the map frame, (n, 2, 2) in metres, along its grid axis."""
    middle = np.column_stack((sections.col, sections.row)) + 0.5
    axis = np.where(sections.vertical[:, None], (0.0, 1.0), (1.0, 0.0))
    # the length that a section stands for gives its slant, and so its extent along the axis
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
        name = "thickness [cells]" if (left, top, height) == places[-1] else ""
        _draw_bars(picture, (left, top + 56, left + HISTOGRAM[0], top + 56 + height), metres, thickness, name)


def _draw_bars(picture: Canvas, box: Box, metres: NDArray[Any], thickness: WallThickness, name: str) -> None:
    """Draw one histogram: ``metres`` of wall of 0, 1, 2 ... cells."""
    cells, highest = np.arange(len(metres)), max(float(metres.max()), 1e-9)
    axes = Axes.chart(picture, box, (0.0, float(len(metres)), 0.0, 1.0))
    axes.bars(np.column_stack((cells + 0.05, cells + 0.95)), metres / highest, BAR_COLOUR)
    axes.borders()
    in_x = [(tick + 0.5, f"{tick:g}") for tick in ticks(0.0, len(metres) - 1.0, 8) if tick.is_integer()]
    axes.ticks(in_x, [(value / highest, f"{value:g}") for value in ticks(0.0, highest, 4)], length=0, gap=8)
    axes.names(name, "wall [m]")
    if thickness.sections:
        x, top = axes.to_canvas(np.array([[thickness.p95_cells + 0.5, 1.0]]))[0].tolist()
        picture.draw.line((x, top, x, box[3]), fill=P95_COLOUR, width=3)
        picture.text((x + 8, top + 8), "p95", 8.0, P95_COLOUR, "lm")


def _title(t: WallThickness, hits: int) -> str:
    numbers = "no straight wall"
    if t.sections:
        numbers = (
            f"p95 {t.p95_cells:.1f} cells = {t.p95_mm:.0f} mm, median {t.median_cells:.1f}, max {t.max_cells:.1f}\n"
            f"{t.length_m:.1f} m of wall in {t.sections} sections, {t.share:.0%} of the cells"
        )
    return f"≥ {hits} hit{'s' if hits > 1 else ''}: {numbers}"
