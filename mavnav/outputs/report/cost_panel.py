"""What the matches of a run cost over time, which scans were rejected, and where the track was lost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav.outputs import drawing
from mavnav.outputs.report.panels import CHART_FRAME, FONT_PT, Canvas

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from PIL.Image import Image

    from mavnav.outputs.report.entry import Entry

COST_BLUE: Final = "#2f6690"
LOST_ROSE: Final = "#f2c4c0"
LEAST_MM2: Final = 0.1
"""Costs below are drawn at it: the first scan of a map costs nothing, and a logarithmic scale has no nothing."""
LOW_SHARE: Final = 0.02
"""So many of the costs may lie below the scale's end."""
SHORT_SCALE: Final = 100.0
"""From its beginning to its end; a shorter scale may hold a single power of ten."""


def cost_panels(entries: Sequence[Entry]) -> list[Image]:
    """Draw the cost over time for each run, all on the same scale."""
    costs = np.concatenate([e.scans.cost_mm2[e.scans.cost_mm2 > LEAST_MM2] for e in entries])
    thresholds = [e.scans.threshold_mm2[np.isfinite(e.scans.threshold_mm2)].max(initial=0.0) for e in entries]
    low = float(np.quantile(costs, LOW_SHARE)) if costs.size else 1.0
    limits = (0.5 * low, 2.0 * max([float(costs.max(initial=10.0 * low)), *map(float, thresholds)]))
    end_s = max(float(e.scans.time_s.max(initial=0.1)) for e in entries)
    return [_panel(e, limits, end_s) for e in entries]


def _panel(entry: Entry, limits: tuple[float, float], end_s: float) -> Image:
    scans = entry.scans
    cost = np.maximum(scans.cost_mm2, LEAST_MM2)
    canvas = Canvas(4.0, 1.7, entry.name, CHART_FRAME)
    axes = canvas.axes
    _draw_lost(axes, entry)
    axes.plot(scans.time_s, cost, color=COST_BLUE, lw=0.8, label="cost")
    shown = rejected(entry) & np.isfinite(cost)
    if shown.any():
        axes.plot(scans.time_s[shown], cost[shown], "x", ms=4, color=drawing.GOAL_RED, label="rejected scan")
    if np.isfinite(scans.threshold_mm2).any():
        axes.plot(scans.time_s, scans.threshold_mm2, color=drawing.MUTED, lw=1.0, ls="--", label="acceptance threshold")
    scale(axes, limits)
    axes.set_xlim(0.0, end_s)
    axes.set_xlabel("time [s]", fontsize=FONT_PT)
    axes.set_ylabel("cost [mm²]", fontsize=FONT_PT)
    axes.spines[["top", "right"]].set_visible(False)
    known = cost[np.isfinite(cost)]
    low = len(known) > 0 and np.median(known) < np.sqrt(limits[0] * limits[1])
    where = "upper right" if low else "lower right"  # where the curve is not
    axes.legend(loc=where, ncols=4, fontsize=FONT_PT - 1, frameon=True, framealpha=0.8, edgecolor="none")
    return canvas.image()


def scale(axes: Any, limits: tuple[float, float]) -> None:  # noqa: ANN401
    """Make the scale logarithmic; powers of ten are named, on a short scale 2 and 5 times them as well."""
    axes.set_yscale("log")
    axes.set_ylim(*limits)
    axes.yaxis.set_minor_formatter("")
    if limits[1] < SHORT_SCALE * limits[0]:
        axes.yaxis.get_major_locator().set_params(subs=(1.0, 2.0, 5.0))
        axes.yaxis.set_major_formatter("{x:g}")


def _intervals(entry: Entry) -> list[dict[str, Any]]:
    return (entry.document.get("tracking") or {}).get("intervals") or []


def rejected(entry: Entry) -> NDArray[np.bool_]:
    """Tell which scans (n,) have no pose, but for those where the track was lost."""
    scans = entry.scans
    lost = np.zeros(len(scans.time_s), np.bool_)
    for interval in _intervals(entry):
        lost |= (scans.time_s > interval["start_s"] - 1e-6) & (scans.time_s < interval["end_s"] + 1e-6)
    return ~scans.tracked & ~lost


def _draw_lost(axes: Any, entry: Entry) -> None:  # noqa: ANN401
    """Shade where no scan has a pose; one scan wide at least."""
    period_s = float(np.median(np.diff(entry.scans.time_s))) if len(entry.scans.time_s) > 1 else 0.1
    for k, interval in enumerate(_intervals(entry)):
        label = None if k else "track lost"
        axes.axvspan(interval["start_s"], interval["end_s"] + period_s, color=LOST_ROSE, lw=0, label=label)
