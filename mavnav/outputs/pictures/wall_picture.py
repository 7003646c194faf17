"""wall_thickness.png: where the walls are thick, and how much of the wall is."""

from __future__ import annotations

from math import ceil
from pathlib import Path
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.metrics.wall_spread import WallCuts, WallSpread
from mavnav.metrics.walls import Sections, WallThickness
from mavnav.outputs.pictures.canvas import INK, MUTED, WALL_GREY, Box, Canvas, font, ramp, rgb_of
from mavnav.outputs.pictures.map_axes import draw_axes, draw_cells, draw_free, map_axes, name_axes, window_of
from mavnav.outputs.pictures.plot import Axes, colour_bar, ticks
from mavnav.outputs.run import RunResult
from mavnav.units import MM

BAR_COLOUR: Final = "#5b8db8"
P95_COLOUR: Final = "#c0392b"
THICKNESS: Final = ramp(("#fdca26", "#fb9f3a", "#ed7953", "#d8576b", "#bd3786", "#9c179e", "#7201a8", "#46039f"))
"""From thin to thick, ever darker: distinguishable with any color vision (plasma, without its ends)."""
LEFT, TOP, RIGHT, BOTTOM = 100, 90, 130, 80
"""Margins of the map in the picture, in pixels."""
WIDTH_BIN_MM: Final = 10.0
HISTOGRAM: Final = (560, 110)
"""Width and height of a histogram, in pixels."""
TITLE_PT: Final = 8.5
UNMEASURED: Final = "grey: not measured (no scan shows a straight wall there)"
EDGE: Final = 30
"""Free space on the right of the histograms and their titles, in pixels."""


def write(run: RunResult, path: Path) -> None:
    """Draw the cuts across the walls on the map, a histogram of their widths, and one for every hit threshold."""
    window = window_of(run.known, np.empty((0, 2)), run.turn_rad)
    width, height = window.size_pixels(longest_in=6.5)
    charts = _charts(run)
    tall = max(height, len(charts) * (HISTOGRAM[1] + 120))
    pitch, left = tall // len(charts), LEFT + width + RIGHT + 80
    longest = max(font(TITLE_PT).getlength(line) for chart in charts for line in chart.title.split("\n"))
    picture = Canvas.of(left + max(HISTOGRAM[0], ceil(longest)) + EDGE, TOP + tall + BOTTOM)
    top = TOP + (tall - height) // 2
    _draw_map(map_axes(picture, window, (LEFT, top, LEFT + width, top + height)), run)
    for k, chart in enumerate(charts):
        y = TOP + k * pitch
        picture.text((left, y), chart.title, TITLE_PT, INK, "la")
        _draw_bars(picture, (left, y + 56, left + HISTOGRAM[0], y + pitch - 64), chart)
    picture.text((picture.width / 2, 26), f"{run.name}: wall thickness", 12.0, INK, bold=True)
    picture.save(path)


def _draw_map(axes: Axes, run: RunResult) -> None:
    draw_free(axes, run.known, run.cells)
    grey = np.array(rgb_of(WALL_GREY), np.uint8)
    draw_cells(axes, run.known, run.known.hits, lambda _: grey)
    if run.measures.cuts is not None:
        _draw_cuts(axes, run.measures.cuts)
    draw_axes(axes)
    name_axes(axes)
    left, top, right, _ = axes.box
    lost = run.measures.cuts is not None and not np.isfinite(run.measures.cuts.width_m).all()
    marks = f"black: cannot be measured; {UNMEASURED}" if lost else UNMEASURED
    for line, y in (("width that holds 95 % of the hits of the ridge", 36), (marks, 14)):
        middle = max((left + right) / 2, EDGE + font(8.5).getlength(line) / 2)
        axes.canvas.text((middle, top - y), line, 8.5, MUTED)


def _draw_cuts(axes: Axes, cuts: WallCuts) -> None:
    """Draw each cut across its wall in the colour of its width, and the scale of these colours."""
    measured = np.isfinite(cuts.width_m)
    width_mm = cuts.width_m[measured] / MM
    widest_mm = float(np.quantile(width_mm, 0.99)) if len(width_mm) else 0.0
    top_mm = 10.0 * ceil(max(60.0, widest_mm) / 10.0)
    level = np.minimum(width_mm / top_mm, 1.0) * (len(THICKNESS) - 1)
    # at least a few pixels long wherever the map is large
    _draw_lines(axes, cuts, ~measured, np.zeros((int((~measured).sum()), 3), np.uint8))
    _draw_lines(axes, cuts, measured, THICKNESS[level.round().astype(int)])
    colour_bar(axes, THICKNESS, [(t / top_mm, f"{t:g}") for t in ticks(0.0, top_mm, 8)], "wall thickness [mm]")


def _draw_lines(axes: Axes, cuts: WallCuts, which: NDArray[np.bool_], colours: NDArray[np.uint8]) -> None:
    lines = cut_lines(cuts, 0.012 * max(axes.size))[which]
    first, last = (axes.to_canvas(ends) - axes.box[:2] for ends in (lines[:, 0], lines[:, 1]))
    inside = axes.canvas.part(axes.box)  # a window may leave far walls out
    for line, colour in zip(np.hstack((first, last)).round().astype(int).tolist(), colours.tolist(), strict=True):
        inside.line(line, tuple(colour), width=3)
    axes.canvas.image.paste(inside.image, axes.box[:2])


def cut_lines(cuts: WallCuts, least_m: float) -> NDArray[np.float64]:
    """Return each cut as a line across its wall in the map frame, (n, 2, 2) in metres."""
    half_m = 0.5 * np.fmax(cuts.width_m, least_m)[:, None]
    normal = np.column_stack((-np.sin(cuts.direction_rad), np.cos(cuts.direction_rad)))
    return np.stack((cuts.xy_m - half_m * normal, cuts.xy_m + half_m * normal), axis=1)


class _Chart(Struct, frozen=True):
    """A histogram: metres of wall by thickness in bins of ``bin_size``; ``p95`` is NaN where nothing was measured."""

    title: str
    name: str
    metres: NDArray[np.float64]
    bin_size: float
    p95: float


def _charts(run: RunResult) -> list[_Chart]:
    """Return the histogram of the widths, and below it those of the cells at each hit threshold, on one scale."""
    cell_m, walls = run.slam.grid.cell_m, {1: run.walls.hits_1, 2: run.walls.hits_2, 5: run.walls.hits_5}
    sections = dict(sorted(run.measures.sections.items()))
    most = ceil(max((s.thickness_cells.max() for s in sections.values() if len(s.row)), default=3.0)) + 1
    charts = [_width_chart(run.measures.cuts, run.walls.spread)] if run.measures.cuts is not None else []
    return [*charts, *(_cells_chart(hits, cut, walls[hits], most, cell_m) for hits, cut in sections.items())]


def _width_chart(cuts: WallCuts, spread: WallSpread) -> _Chart:
    width_mm, length_m = cuts.width_m / MM, cuts.length_m
    measured = np.isfinite(width_mm)
    bins = np.floor(width_mm[measured] / WIDTH_BIN_MM).astype(int)
    metres = np.bincount(bins, length_m[measured], minlength=6).astype(np.float64)
    if not measured.any():
        return _Chart("no straight wall to measure", "thickness [mm]", metres, WIDTH_BIN_MM, np.nan)
    title = (
        f"thickness: median {spread.median_mm:.0f} mm, p95 {spread.p95_mm:.0f} mm\n"
        f"{spread.length_m:.1f} m of wall, {100 * spread.measured_share:.0f} % of the straight walls in the scans"
    )
    return _Chart(title, "thickness [mm]", metres, WIDTH_BIN_MM, spread.p95_mm)


def _cells_chart(hits: int, sections: Sections, t: WallThickness, most: int, cell_m: float) -> _Chart:
    bins = np.round(sections.thickness_cells).astype(int)
    metres = np.bincount(bins, sections.length_m, minlength=most + 1)[: most + 1].astype(np.float64)
    numbers = "no straight wall"
    if t.sections:
        numbers = (
            f"median {t.median_cells:.1f}, p95 {t.p95_cells:.1f}, max {t.max_cells:.1f} cells of {cell_m / MM:g} mm\n"
            f"{t.length_m:.1f} m of wall in {t.sections} sections, {100 * t.share:.0f} % of the cells"
        )
    title = f"cells with \N{GREATER-THAN OR EQUAL TO} {hits} hit{'s' if hits > 1 else ''}: {numbers}"
    return _Chart(title, "thickness [cells]", metres, 1.0, t.p95_cells + 0.5)


def _draw_bars(picture: Canvas, box: Box, chart: _Chart) -> None:
    """Draw one histogram; one without a wall has no ticks in y."""
    bins, most = np.arange(len(chart.metres)), float(chart.metres.max())
    highest = most or 1.0
    axes = Axes.chart(picture, box, (0.0, float(len(bins)), 0.0, 1.0))
    axes.bars(np.column_stack((bins + 0.05, bins + 0.95)), chart.metres / highest, BAR_COLOUR)
    axes.borders()
    middle = 0.5 if chart.bin_size == 1.0 else 0.0  # whole cells stand below the middle of their bar
    top = (len(bins) - 1.0) * chart.bin_size
    in_x = [(t / chart.bin_size + middle, f"{t:g}") for t in ticks(0.0, top, 8) if (t / chart.bin_size).is_integer()]
    in_y = [(value / highest, f"{value:g}") for value in ticks(0.0, highest, 4)] if most else []
    axes.ticks(in_x, in_y, length=0, gap=8)
    axes.names(chart.name, "wall [m]")
    if not np.isnan(chart.p95):
        x, y = axes.to_canvas(np.array([[chart.p95 / chart.bin_size, 1.0]]))[0].tolist()
        picture.line((x, y, x, box[3]), P95_COLOUR, width=3)
        picture.text((x + 8, y + 8), "p95", 8.0, P95_COLOUR, "lm")
