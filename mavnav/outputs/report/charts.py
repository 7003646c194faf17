"""The charts of a report: cost of the matches, wall thickness, and the motion of a run.

Cost is over time, with rejected scans and intervals without a track; thickness is a histogram in m of wall per bin;
motion is position, heading and speed over time, and position error and attitude if they are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import compress
from math import ceil, floor, log10
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL.Image import Image

from mavnav.outputs.documents.quantities import number
from mavnav.outputs.pictures.canvas import GOAL_RED, MUTED, draw_dashes, stroke
from mavnav.outputs.pictures.plot import Axes, Mark, Style, cross, label_ticks, legend, ticks
from mavnav.outputs.pictures.wall_picture import BAR_COLOUR, P95_COLOUR
from mavnav.outputs.report.entry import Entry
from mavnav.outputs.report.panels import CHART, CHART_MARGINS, FONT_PT, panel
from mavnav.units import DEG, MM

Floats = NDArray[np.float64]

LEGEND_PT: Final = 7.0
LEGEND_ROW: Final = 28
"""Height of the row between title and axes, in pixels; the legend there covers no data."""
COST: Final = Style("#2f6690", "cost", partial(stroke, width_pt=1.0))
REJECTED: Final = Mark(GOAL_RED, "rejected scan", partial(cross, size_pt=4.0, width_pt=1.0))
THRESHOLD: Final = Style(MUTED, "acceptance threshold", draw_dashes)
LOST: Final = Style("#f2c4c0", "track lost", lambda on, points: on.line(points, fill=255, width=34))
MIN_COST_MM2: Final = 0.1
"""Minimum drawn cost, in mm2: the first scan of a map has cost 0, which a logarithmic scale cannot show."""
BELOW_SCALE_SHARE: Final = 0.02
"""Share of the costs that may be below the lower end of the scale."""
SHORT_SCALE: Final = 100.0
"""Ratio of largest to smallest cost under which a scale is short: it may contain only one power of ten."""
MAX_POWERS: Final = 7
"""Maximum number of powers of ten with a label."""

P95: Final = Style(P95_COLOUR, "", partial(stroke, width_pt=1.6))
BIN_MM: Final = 10.0

CURVE_HEIGHT, CURVE_GAP = 120, 28
"""Height of the axes of each curve, and gap between two of them, in pixels."""

CURVE: Final = Style("#2f6690", "", partial(stroke, width_pt=1.0))
MAX_PERIODS: Final = 2.5
"""Maximum time between poses for which a speed is computed, in scan periods."""


def cost_panels(entries: Sequence[Entry]) -> list[Image]:
    """Draw the cost over time for each run, all on the same scale."""
    costs = np.concatenate([e.scans.cost_mm2[e.scans.cost_mm2 > MIN_COST_MM2] for e in entries])
    thresholds = [e.scans.threshold_mm2[np.isfinite(e.scans.threshold_mm2)].max(initial=0.0) for e in entries]
    low = float(np.quantile(costs, BELOW_SCALE_SHARE)) if costs.size else 1.0
    limits = (0.5 * low, 2.0 * max([float(costs.max(initial=low)), *map(float, thresholds)]))
    end_s = max(float(e.scans.time_s.max(initial=0.1)) for e in entries)
    return [_cost_panel(e, limits, end_s) for e in entries]


def caption(entries: Sequence[Entry]) -> str:
    """Say what the signs in the panels mean, as far as there are some."""
    matched = [rejected_scans(e) & np.isfinite(e.scans.cost_mm2) for e in entries]
    unmatched = any((rejected_scans(e) & ~mask).any() for e, mask in zip(entries, matched, strict=True))
    sentences = {
        "Crosses: rejected scans that were matched.": any(mask.any() for mask in matched),
        "Rejected scans without a match are not drawn.": unmatched,
        "Shaded: stretches where the track was lost.": any(map(_intervals, entries)),
        "Costs compare within a method only.": len({e.document.get("method") for e in entries}) > 1,
    }
    return " ".join(compress(sentences, sentences.values()))


def _cost_panel(entry: Entry, limits: tuple[float, float], end_s: float) -> Image:
    canvas, (left, top, right, bottom) = panel((CHART[0], CHART[1] + LEGEND_ROW), entry.name, CHART_MARGINS)
    box = (left, top + LEGEND_ROW, right, bottom)
    axes = Axes.chart(canvas, box, (0.0, end_s, log10(limits[0]), log10(limits[1])))
    axes.names("time [s]", "cost [mm²]", FONT_PT, 80)
    marks = _draw_scans(axes, entry, np.maximum(entry.scans.cost_mm2, MIN_COST_MM2))
    axes.borders()
    axes.ticks(label_ticks(ticks(0.0, end_s)), [(log10(value), label) for value, label in named_costs(*limits)])
    axes.ticks(y=[(log10(value), "") for value in between_powers(*limits)], length=3)
    legend(canvas, marks, top + LEGEND_ROW // 2 - 3, left, LEGEND_PT)
    return canvas.image


def _draw_scans(axes: Axes, entry: Entry, cost: Floats) -> list[Mark | Style]:
    """Draw costs, rejected scans, acceptance thresholds and lost intervals; return the marks of the legend."""
    scans, shown = entry.scans, rejected_scans(entry) & np.isfinite(cost)
    points = np.column_stack((scans.time_s, np.log10(cost)))
    lost = _draw_lost(axes, entry)
    axes.lines(COST, [points])
    axes.mark(REJECTED, points[shown])
    threshold = np.log10(np.maximum(scans.threshold_mm2, MIN_COST_MM2))
    axes.lines(THRESHOLD, [np.column_stack((scans.time_s, threshold))])
    drawn = (lost, True, shown.any(), np.isfinite(threshold).any())
    return list(compress((LOST, COST, REJECTED, THRESHOLD), drawn))


def named_costs(low: float, high: float) -> list[tuple[float, str]]:
    """Return the ticks with labels: powers of ten, and on a short scale also 2 and 5 times these.

    All labels are written in one way: with an exponent if the largest is 1e5 or more.
    """
    factors = (1, 2, 5) if high < SHORT_SCALE * low else (1,)
    powers = range(floor(log10(low)), floor(log10(high)) + 1)
    every = ceil(len(powers) / MAX_POWERS)
    values = [factor * 10.0**k for k in powers if k % every == 0 for factor in factors]
    shown = [v for v in values if low <= v <= high]
    plain = max(shown, default=0.0) < 1e5
    return [(v, f"{v:g}" if plain else f"{v:.0e}".replace("e+0", "e").replace("e-0", "e-")) for v in shown]


def between_powers(low: float, high: float) -> list[float]:
    """Return the values with one significant digit between the powers of ten, for ticks without a label."""
    powers = range(floor(log10(low)), ceil(log10(high)))
    return [value for k in powers for digit in range(2, 10) if low <= (value := digit * 10.0**k) <= high]


def _intervals(entry: Entry) -> list[dict[str, Any]]:
    return (entry.document.get("tracking") or {}).get("intervals") or []


def rejected_scans(entry: Entry) -> NDArray[np.bool_]:
    """Return which scans (n,) have no pose, without those in intervals of lost tracking."""
    scans = entry.scans
    lost = np.zeros(len(scans.time_s), np.bool_)
    for interval in _intervals(entry):
        lost |= (scans.time_s > interval["start_s"] - 1e-6) & (scans.time_s < interval["end_s"] + 1e-6)
    return ~scans.tracked & ~lost


def _draw_lost(axes: Axes, entry: Entry) -> bool:
    """Shade the intervals of lost tracking, at least one scan wide; return whether there are any."""
    period_s = float(np.median(np.diff(entry.scans.time_s))) if len(entry.scans.time_s) > 1 else 0.1
    left, top, right, bottom = axes.box
    for interval in _intervals(entry):
        x0, x1 = (left + t_s * axes.per_unit[0] for t_s in (interval["start_s"], interval["end_s"] + period_s))
        if x0 < right:
            axes.canvas.rectangle((max(x0, left), top, min(x1, right), bottom), LOST.colour)
    return bool(_intervals(entry))


def thickness_panels(entries: Sequence[Entry]) -> list[Image]:
    """Draw a histogram for each run, all on the same scale."""
    widths = [e.cuts.width_m[np.isfinite(e.cuts.width_m)] / MM for e in entries]
    bins = max(6, ceil(max((w.max(initial=0.0) for w in widths), default=0.0) / BIN_MM))
    metres = [_metres(e, bins) for e in entries]
    max_m = max(float(m.max(initial=0.0)) for m in metres)
    return [_thickness_panel(e, m, max_m) for e, m in zip(entries, metres, strict=True)]


def _metres(entry: Entry, bins: int) -> Floats:
    """Return the length of wall in each bin of thickness, (bins,), m."""
    measured = np.isfinite(entry.cuts.width_m)
    place = np.minimum(entry.cuts.width_m[measured] / (BIN_MM * MM), bins - 1).astype(np.intp)
    return np.bincount(place, entry.cuts.length_m[measured], bins).astype(np.float64)


def _thickness_panel(entry: Entry, metres: Floats, max_m: float) -> Image:
    limits = (0.0, len(metres) * BIN_MM, 0.0, max(max_m * 1.12, 0.1))
    axes = Axes.chart(*panel(CHART, entry.name, CHART_MARGINS), limits)
    axes.names("thickness [mm]", "wall [m]", FONT_PT, 60)
    left_mm = np.arange(len(metres)) * BIN_MM
    axes.bars(np.column_stack((left_mm + 0.05 * BIN_MM, left_mm + 0.95 * BIN_MM)), metres, BAR_COLOUR)
    p95_mm = number(entry.document, "wall_thickness.spread.p95_mm")
    if p95_mm is None:
        axes.canvas.text((axes.box[0] + CHART[0] / 2, axes.box[1] + CHART[1] / 2), "no straight wall to measure", 9.0)
    else:
        _mark_p95(axes, p95_mm)
    axes.borders()
    axes.ticks(label_ticks(ticks(*limits[:2])), label_ticks(ticks(*limits[2:], 6)))
    return axes.canvas.image


def _mark_p95(axes: Axes, p95_mm: float) -> None:
    """Draw a line at the p95, with its value on the side with more space."""
    line = np.column_stack(((p95_mm, p95_mm), axes.limits[2:]))
    axes.lines(P95, [line])
    x, y = axes.to_canvas(line)[1]
    beside, anchor = (-10, "ra") if p95_mm > axes.limits[1] / 2 else (10, "la")
    axes.canvas.text((x + beside, y + 3), f"p95 {p95_mm:.0f} mm", 8.0, P95.colour, anchor)


def curves(entry: Entry) -> dict[str, Floats]:
    """Return the curves of a run over time: a value (n,) for each scan, NaN if there is none, by name with the unit."""
    scans = entry.scans
    known = np.isfinite(scans.yaw_rad)
    yaw = scans.yaw_rad.copy()
    yaw[known] = np.unwrap(yaw[known])
    x_m, y_m = scans.xy_m.T
    speed_m_s = speeds(scans.time_s, scans.xy_m)
    always = {"x [m]": x_m, "y [m]": y_m, "yaw [deg]": yaw / DEG, "speed [m/s]": speed_m_s}
    roll, pitch, height_m = scans.roll_pitch_height.T
    errors_mm = scans.error_m / MM
    more = {"error [mm]": errors_mm, "roll [deg]": roll / DEG, "pitch [deg]": pitch / DEG, "height [m]": height_m}
    return always | {name: values for name, values in more.items() if np.isfinite(values).any()}


def speeds(time_s: Floats, xy_m: Floats) -> Floats:
    """Return the speed at each scan, (n,), from the poses before and after it; NaN next to gaps."""
    out = np.full(len(time_s), np.nan)
    rows = np.flatnonzero(np.isfinite(xy_m[:, 0]))
    if len(rows) < 3:
        return out
    took_s = time_s[rows[2:]] - time_s[rows[:-2]]
    moved_m = np.hypot(*(xy_m[rows[2:]] - xy_m[rows[:-2]]).T)
    near = took_s <= 2.0 * MAX_PERIODS * np.median(np.diff(time_s[rows]))
    out[rows[1:-1]] = np.where(near, moved_m / took_s, np.nan)
    return out


def motion_panel(entry: Entry) -> Image:
    """Draw the curves of a run below one another, with a common time axis."""
    shown = curves(entry)
    height = len(shown) * (CURVE_HEIGHT + CURVE_GAP) - CURVE_GAP
    canvas, (left, top, right, _) = panel((CHART[0], height), entry.name, CHART_MARGINS)
    end_s = max(float(entry.scans.time_s.max(initial=0.1)), 0.1)
    in_x = ticks(0.0, end_s)
    for k, (name, values) in enumerate(shown.items()):
        y, last = top + k * (CURVE_HEIGHT + CURVE_GAP), k == len(shown) - 1
        in_y = _limits(values)
        axes = Axes.chart(canvas, (left, y, right, y + CURVE_HEIGHT), (0.0, end_s, *in_y))
        axes.borders()
        axes.ticks(label_ticks(in_x) if last else [(value, "") for value in in_x], label_ticks(ticks(*in_y, 5)))
        axes.lines(CURVE, [np.column_stack((entry.scans.time_s, values))])
        axes.names("time [s]" if last else "", name, FONT_PT, 72)
    return canvas.image


def _limits(values: Floats) -> tuple[float, float]:
    """Return the smallest and the largest value with a margin."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    margin = max(0.05 * (high - low), 1e-3)
    return low - margin, high + margin
