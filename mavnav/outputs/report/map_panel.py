"""The map of a run as a panel: hits, path, true walls dashed (paper, Figure 7), ghost walls circled."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Rectangle

from mavnav.outputs import drawing
from mavnav.outputs.map_picture import HIT_TICKS
from mavnav.outputs.report.panels import FONT_PT, Canvas, Frame
from mavnav.units import MM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from PIL.Image import Image

    from mavnav.outputs.report.entry import Entry
    from mavnav.outputs.viewport import Window

HITS: Final = LinearSegmentedColormap.from_list("hits", colormaps["viridis"](np.linspace(0.92, 0.0, 256)))
GHOST_RED: Final = drawing.GOAL_RED
LEAST_CIRCLE_SHARE: Final = 0.05
"""A ghost's circle is at least so long, of the window's longer side: one of 0.3 m is to be seen on a map of 50 m."""

LONGEST_IN, LEAST_IN, WIDE_IN, CLOSEUP_IN = 5.0, 2.0, 9.0, 2.6
WIDE, TALL = 2.2, 1.4
"""From these ratios of the longer side to the other on a map gets a row of its own, or less room than others."""


def common_window(entries: Sequence[Entry]) -> Window:
    """Frame the maps of all runs, their paths and the true walls."""
    windows = [drawing.window_of(e.grid, _framed(e)) for e in entries]
    return drawing.Window(
        min(w.x0_m for w in windows),
        max(w.x1_m for w in windows),
        min(w.y0_m for w in windows),
        max(w.y1_m for w in windows),
    )


def _framed(entry: Entry) -> Any:  # noqa: ANN401  numpy's stack of arrays
    tracked = entry.scans.xy_m[np.isfinite(entry.scans.xy_m[:, 0])]
    return np.vstack((tracked, *entry.true_walls))


def most_hits(entries: Sequence[Entry]) -> float:
    """Return the end of the scale of hits of all runs, which a few crowded cells cannot spoil."""
    counts = np.concatenate([e.grid.hits[e.grid.hits > 0] for e in entries])
    top = float(np.quantile(counts, 0.995)) if counts.size else 1.0
    return max(top, 10.0)


def shape(window: Window) -> str:
    """Name the shape of a map by what room it needs on a page: wide, tall, or neither (empty)."""
    width, height = window.size_m
    return "wide" if width > WIDE * height else "tall" if height > TALL * width else ""


def map_panel(entry: Entry, window: Window, top_hits: float, boxes: Sequence[tuple[str, Window]]) -> Image:
    """Draw the map of a run; ``boxes`` are the close-ups, by letter."""
    width, height = window.figure_size(WIDE_IN if shape(window) == "wide" else LONGEST_IN, LEAST_IN)
    canvas = Canvas(width, height, entry.name)
    draw_map(canvas.axes, entry, window, top_hits)
    for letter, box in boxes:
        _draw_box(canvas.axes, letter, box)
    return canvas.image()


def closeup_panel(entry: Entry, window: Window, top_hits: float, letter: str) -> Image:
    """Draw a square part of the map of a run."""
    canvas = Canvas(CLOSEUP_IN, CLOSEUP_IN, f"{letter}  {entry.name}")
    draw_map(canvas.axes, entry, window, top_hits)
    canvas.axes.locator_params(nbins=4)
    return canvas.image()


def draw_map(axes: Any, entry: Entry, window: Window, top_hits: float) -> None:  # noqa: ANN401
    """Draw what is known in the window onto axes."""
    drawing.draw_free(axes, entry.grid, window)
    drawing.draw_cells(axes, entry.grid, entry.grid.hits, window, cmap=HITS, norm=LogNorm(1.0, top_hits), zorder=1)
    axes.plot(*entry.scans.xy_m.T, color=drawing.POSE_MAGENTA, lw=0.8, alpha=0.7, zorder=3)
    for line in entry.true_walls:
        axes.plot(*line.T, color=drawing.TRUE_ORANGE, lw=1.0, ls=(0, (4, 3)), zorder=2)
    for place in ghosts(entry):
        axes.add_patch(_circle(place, LEAST_CIRCLE_SHARE * max(window.size_m)))
    drawing.dress(axes, window)
    axes.set_xlabel("")
    axes.set_ylabel("")
    axes.tick_params(labelsize=FONT_PT)


def ghosts(entry: Entry) -> list[dict[str, float]]:
    """Return where the ghost walls of a run are; none where they were not looked for."""
    quality = entry.document.get("map_quality") or {}
    places: list[dict[str, float]] = (quality.get("ghost_walls") or {}).get("places") or []
    return places


def _circle(place: dict[str, float], least_m: float) -> Ellipse:
    """Ring a wall and its ghost."""
    long_m = max(1.2 * place["length_m"], least_m)
    short_m = max(3.0 * place["offset_mm"] * MM, 0.35 * long_m, 0.6 * least_m)
    return Ellipse(
        (place["x_m"], place["y_m"]),
        hypot(long_m, 0.5 * short_m),
        short_m,
        angle=place["direction_deg"],
        fill=False,
        ec=GHOST_RED,
        lw=1.6,
        zorder=6,
    )


def _draw_box(axes: Any, letter: str, box: Window) -> None:  # noqa: ANN401
    axes.add_patch(Rectangle((box.x0_m, box.y0_m), *box.size_m, fill=False, ec=drawing.INK, lw=1.0, zorder=5))
    tag = {"boxstyle": "square,pad=0.15", "fc": drawing.INK, "ec": "none"}
    axes.text(
        box.x0_m, box.y1_m, letter, color="white", fontsize=FONT_PT, fontweight="bold", bbox=tag, va="top", zorder=7
    )


def legend_panel(top_hits: float, *, truth: bool, ghost: bool) -> Image:
    """Draw the scale of hits that all maps share, and what the lines on them are."""
    canvas = Canvas(2.6, 0.14, "laser hits per cell", Frame(left=0.1, right=2.5))
    axes = canvas.axes
    ramp = np.geomspace(1.0, top_hits, 256)[None]
    axes.imshow(ramp, cmap=HITS, norm=LogNorm(1.0, top_hits), aspect="auto", extent=(0.0, 1.0, 0.0, 1.0))
    ticks = [t for t in HIT_TICKS if t <= top_hits]
    axes.set_xticks([float(np.log(t) / np.log(top_hits)) for t in ticks], [str(t) for t in ticks])
    axes.set_yticks([])
    axes.set_title(axes.get_title(loc="left"), fontsize=FONT_PT, color=drawing.MUTED, loc="left", pad=4)
    axes.spines[:].set_visible(False)
    lines = [Line2D([], [], color=drawing.POSE_MAGENTA, lw=1.2, label="path of the laser")]
    if truth:
        lines.append(Line2D([], [], color=drawing.TRUE_ORANGE, ls=(0, (4, 3)), lw=1.2, label="true wall"))
    if ghost:
        lines.append(Line2D([], [], color=GHOST_RED, lw=1.6, label="ghost wall"))
    axes.legend(handles=lines, loc="center left", bbox_to_anchor=(1.04, 0.6), frameon=False, fontsize=FONT_PT)
    return canvas.image()
