"""wall_thickness.png: where the walls are thick, and how thick they are at every hit threshold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap

from mavnav.metrics.wall_thickness import wall_sections
from mavnav.outputs import drawing
from mavnav.outputs.gridmap import known_part

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.grid import Grid
    from mavnav.metrics.wall_thickness import Sections, WallThickness
    from mavnav.outputs.run import Run

BAR_COLOUR: Final = "#5b8db8"
P95_COLOUR: Final = "#c0392b"


def write(run: Run, path: Path) -> None:
    """Draw the sections of the middle threshold on the map, and a histogram for every threshold."""
    grid, thresholds = known_part(run.slam.grid), sorted(run.thickness)
    sections = {k: wall_sections(grid.hits, grid.cell_m, k) for k in thresholds}
    shown = thresholds[len(thresholds) // 2]
    window = drawing.window_of(grid, np.empty((0, 2)))
    width, height = window.figure_size(longest_in=6.5, least_in=3.2)
    fig = drawing.figure(width + 6.6, max(height + 1.2, 5.8))
    cells = fig.add_gridspec(len(thresholds), 2, width_ratios=(width + 1.4, 4.6))
    _draw_map(fig.add_subplot(cells[:, 0]), grid, sections[shown], window, shown)
    _draw_histograms([fig.add_subplot(cells[k, 1]) for k in range(len(thresholds))], run, sections)
    fig.suptitle(f"{run.name}: wall thickness", fontsize=12, fontweight="bold", color=drawing.INK)
    drawing.save(fig, path)


def _draw_map(
    axes: Any,  # noqa: ANN401
    grid: Grid,
    sections: Sections,
    window: drawing.Window,
    min_hits: int,
) -> None:
    drawing.draw_free(axes, grid, window)
    occupied = (grid.hits >= min_hits).astype(np.uint8)
    drawing.draw_cells(axes, grid, occupied, window, cmap=ListedColormap([drawing.WALL_GREY]), vmin=0, vmax=1)
    top = max(3, int(np.ceil(np.quantile(sections.thickness_cells, 0.99))) if len(sections.row) else 3)
    step = -(-top // 12)  # cells a colour
    bounds = np.arange(0.5, top + step, step)
    # drawn across the wall, and at least a few pixels long wherever the map is large
    least_m = 0.012 * max(window.size_m)
    lines = LineCollection(
        section_lines(grid, sections, least_m),
        cmap=colormaps["turbo"],
        norm=BoundaryNorm(bounds, 256),
        linewidths=1.6,
        zorder=2,
    )
    lines.set_array(sections.thickness_cells)
    axes.add_collection(lines)
    bar = axes.figure.colorbar(lines, ax=axes, extend="max", fraction=0.04, pad=0.02, aspect=28)
    bar.set_ticks(bounds[:-1] + step / 2, labels=_names(bounds))
    bar.ax.minorticks_off()
    bar.set_label("thickness [cells]", fontsize=9)
    bar.outline.set_visible(False)
    drawing.dress(axes, window)
    axes.set_title(f"cells with ≥ {min_hits} hits; grey: not part of a straight wall", fontsize=9, color=drawing.MUTED)


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


def _draw_histograms(all_axes: list[Any], run: Run, sections: dict[int, Sections]) -> None:
    """Draw metres of wall over thickness, one below the other on the same scale."""
    longest = max((s.thickness_cells.max() for s in sections.values() if len(s.row)), default=3.0)
    bins = np.arange(0.5, np.ceil(longest) + 1.5)
    for axes, (min_hits, found) in zip(all_axes, sections.items(), strict=True):
        axes.hist(found.thickness_cells, bins, weights=found.length_m, color=BAR_COLOUR, rwidth=0.9)
        _describe(axes, run.thickness[min_hits])
        axes.set_xlim(bins[0], bins[-1])
        axes.xaxis.get_major_locator().set_params(integer=True)
    all_axes[-1].set_xlabel("thickness [cells]")


def _describe(axes: Any, t: WallThickness) -> None:  # noqa: ANN401
    axes.set_ylabel("wall [m]", fontsize=9)
    axes.tick_params(colors=drawing.MUTED, labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    numbers = "no straight wall"
    if t.sections:
        axes.axvline(t.p95_cells, color=P95_COLOUR, lw=1.4, label="p95")
        axes.legend(loc="upper right", frameon=False, fontsize=8)
        numbers = (
            f"p95 {t.p95_cells:.1f} cells = {t.p95_mm:.0f} mm, median {t.median_cells:.1f}, max {t.max_cells:.1f}\n"
            f"{t.length_m:.1f} m of wall in {t.sections} sections, {t.share:.0%} of the cells"
        )
    title = f"≥ {t.hits} hit{'s' if t.hits > 1 else ''}: {numbers}"
    axes.set_title(title, fontsize=8.5, color=drawing.INK, loc="left")
