"""How thick the walls of a run are: metres of wall over thickness."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.metrics.wall_thickness import wall_sections
from mavnav.outputs.canvas import stroke
from mavnav.outputs.plot import Line, labelled, ticks
from mavnav.outputs.report.panels import CHART, chart
from mavnav.outputs.wall_picture import BAR_COLOUR, P95_COLOUR
from mavnav.units import MM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from PIL.Image import Image

    from mavnav.metrics.wall_thickness import Sections
    from mavnav.outputs.plot import Axes
    from mavnav.outputs.report.entry import Entry

P95: Final = Line(P95_COLOUR, "", partial(stroke, width_pt=1.6))
MIN_HITS: Final = 2
"""The middle one of the thresholds that are reported."""


def thickness_panels(entries: Sequence[Entry]) -> list[Image]:
    """Draw a histogram for each run, all on the same scale."""
    sections = [wall_sections(e.grid.hits, e.grid.cell_m, MIN_HITS) for e in entries]
    longest_mm = max((_thickness_mm(s, e).max(initial=0.0) for s, e in zip(sections, entries, strict=True)), default=0)
    counts = [_metres(s, e, longest_mm) for s, e in zip(sections, entries, strict=True)]
    most_m = max(float(metres.max(initial=0.0)) for _, metres in counts)
    return [_panel(e, *bars, longest_mm, most_m) for e, bars in zip(entries, counts, strict=True)]


def _thickness_mm(sections: Sections, entry: Entry) -> NDArray[np.float64]:
    return sections.thickness_cells * (entry.grid.cell_m / MM)


def _metres(sections: Sections, entry: Entry, longest_mm: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the middle of each whole number of cells, mm, and the metres of wall of that thickness."""
    cell_mm = entry.grid.cell_m / MM
    cells = np.arange(1, max(3, round(longest_mm / cell_mm)) + 1)
    metres, _ = np.histogram(
        sections.thickness_cells, np.append(cells - 0.5, cells[-1] + 0.5), weights=sections.length_m
    )
    return (cells * cell_mm).astype(np.float64), metres.astype(np.float64)


def _panel(
    entry: Entry, middle_mm: NDArray[np.float64], metres: NDArray[np.float64], longest_mm: float, most_m: float
) -> Image:
    cell_mm = entry.grid.cell_m / MM
    limits = (0.0, max(longest_mm, 3 * cell_mm) + cell_mm, 0.0, max(most_m * 1.12, 0.1))
    axes = chart(entry.name, limits, ("thickness [mm]", "wall [m]"), 60)
    axes.bars(middle_mm[:, None] + np.array([-0.43, 0.43]) * cell_mm, metres, BAR_COLOUR)
    p95_mm = ((entry.document.get("wall_thickness") or {}).get(str(MIN_HITS)) or {}).get("p95_mm")
    if p95_mm is None:
        axes.canvas.text((axes.box[0] + CHART[0] / 2, axes.box[1] + CHART[1] / 2), "no straight wall to measure", 9.0)
    else:
        _mark(axes, p95_mm)
    axes.borders()
    axes.ticks(labelled(ticks(*limits[:2])), labelled(ticks(*limits[2:], 6)))
    return axes.canvas.image


def _mark(axes: Axes, p95_mm: float) -> None:
    """Draw a line at the p95 with its number on the side that has room."""
    line = np.column_stack(((p95_mm, p95_mm), axes.limits[2:]))
    axes.lines(P95, [line])
    x, y = axes.to_canvas(line)[1]
    beside, anchor = (-10, "ra") if p95_mm > axes.limits[1] / 2 else (10, "la")
    axes.canvas.text((x + beside, y + 3), f"p95 {p95_mm:.0f} mm", 8.0, P95.colour, anchor)
