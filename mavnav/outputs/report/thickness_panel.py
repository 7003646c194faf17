"""The thickness panel: histogram of the wall thickness of a run, in m of wall per bin."""

from __future__ import annotations

from functools import partial
from math import ceil
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.outputs.documents.quantities import number
from mavnav.outputs.pictures.canvas import stroke
from mavnav.outputs.pictures.plot import Style, label_ticks, ticks
from mavnav.outputs.pictures.wall_picture import BAR_COLOUR, P95_COLOUR
from mavnav.outputs.report.panels import CHART, chart
from mavnav.units import MM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from PIL.Image import Image

    from mavnav.outputs.pictures.plot import Axes
    from mavnav.outputs.report.entry import Entry

P95: Final = Style(P95_COLOUR, "", partial(stroke, width_pt=1.6))
BIN_MM: Final = 10.0


def thickness_panels(entries: Sequence[Entry]) -> list[Image]:
    """Draw a histogram for each run, all on the same scale."""
    widths = [e.cuts.width_m[np.isfinite(e.cuts.width_m)] / MM for e in entries]
    bins = max(6, ceil(max((w.max(initial=0.0) for w in widths), default=0.0) / BIN_MM))
    metres = [_metres(e, bins) for e in entries]
    max_m = max(float(m.max(initial=0.0)) for m in metres)
    return [_panel(e, m, max_m) for e, m in zip(entries, metres, strict=True)]


def _metres(entry: Entry, bins: int) -> NDArray[np.float64]:
    """Return the length of wall in each bin of thickness, (bins,), m."""
    measured = np.isfinite(entry.cuts.width_m)
    place = np.minimum(entry.cuts.width_m[measured] / (BIN_MM * MM), bins - 1).astype(np.intp)
    return np.bincount(place, entry.cuts.length_m[measured], bins).astype(np.float64)


def _panel(entry: Entry, metres: NDArray[np.float64], max_m: float) -> Image:
    limits = (0.0, len(metres) * BIN_MM, 0.0, max(max_m * 1.12, 0.1))
    axes = chart(entry.name, limits, ("thickness [mm]", "wall [m]"), 60)
    left_mm = np.arange(len(metres)) * BIN_MM
    axes.bars(np.column_stack((left_mm + 0.05 * BIN_MM, left_mm + 0.95 * BIN_MM)), metres, BAR_COLOUR)
    p95_mm = number(entry.document, "wall_thickness.spread.p95_mm")
    if p95_mm is None:
        axes.canvas.text((axes.box[0] + CHART[0] / 2, axes.box[1] + CHART[1] / 2), "no straight wall to measure", 9.0)
    else:
        _mark(axes, p95_mm)
    axes.borders()
    axes.ticks(label_ticks(ticks(*limits[:2])), label_ticks(ticks(*limits[2:], 6)))
    return axes.canvas.image


def _mark(axes: Axes, p95_mm: float) -> None:
    """Draw a line at the p95, with its value on the side with more space."""
    line = np.column_stack(((p95_mm, p95_mm), axes.limits[2:]))
    axes.lines(P95, [line])
    x, y = axes.to_canvas(line)[1]
    beside, anchor = (-10, "ra") if p95_mm > axes.limits[1] / 2 else (10, "la")
    axes.canvas.text((x + beside, y + 3), f"p95 {p95_mm:.0f} mm", 8.0, P95.colour, anchor)
