"""How thick the walls of a run are: metres of wall over thickness."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav.metrics.wall_thickness import wall_sections
from mavnav.outputs import drawing
from mavnav.outputs.report.panels import CHART_FRAME, FONT_PT, Canvas
from mavnav.outputs.wall_picture import BAR_COLOUR, P95_COLOUR
from mavnav.units import MM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from PIL.Image import Image

    from mavnav.metrics.wall_thickness import Sections
    from mavnav.outputs.report.entry import Entry

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
    canvas = Canvas(4.0, 1.7, entry.name, CHART_FRAME)
    axes = canvas.axes
    axes.bar(middle_mm, metres, width=0.86 * cell_mm, color=BAR_COLOUR)
    p95_mm = ((entry.document.get("wall_thickness") or {}).get(str(MIN_HITS)) or {}).get("p95_mm")
    if p95_mm is None:
        axes.text(0.5, 0.5, "no straight wall to measure", ha="center", transform=axes.transAxes, fontsize=9)
    else:
        _mark(axes, p95_mm, past_middle=p95_mm > longest_mm / 2)
    axes.set_xlim(0.0, max(longest_mm, 3 * cell_mm) + cell_mm)
    axes.set_ylim(0.0, max(most_m * 1.08, 0.1))
    axes.set_xlabel("thickness [mm]", fontsize=FONT_PT)
    axes.set_ylabel("wall [m]", fontsize=FONT_PT)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=drawing.MUTED)
    return canvas.image()


def _mark(axes: Any, p95_mm: float, *, past_middle: bool) -> None:  # noqa: ANN401
    """Draw a line at the p95 with its number on the side that has room."""
    axes.axvline(p95_mm, color=P95_COLOUR, lw=1.6)
    axes.annotate(
        f"p95 {p95_mm:.0f} mm",
        (p95_mm, 1.0),
        xycoords=("data", "axes fraction"),
        xytext=(-4 if past_middle else 4, -2),
        textcoords="offset points",
        ha="right" if past_middle else "left",
        va="top",
        color=P95_COLOUR,
        fontsize=FONT_PT,
    )
