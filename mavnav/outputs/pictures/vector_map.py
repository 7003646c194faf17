"""map.svg: the occupied cells as areas, the path, and a bar that shows the scale."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final
from xml.sax.saxutils import escape

import numpy as np

from mavnav.mapping.occupancy_grid import OCCUPIED
from mavnav.outputs.pictures.viewport import GOAL_RED, INK, POSE_MAGENTA, START_BLUE
from mavnav.slam.result import parts_of_path

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.outputs.run import RunResult

BAR_SHARE: Final = 0.25
"""The scale bar is at most so long, of the picture's width."""

MARGIN_SHARE: Final = 0.03
LETTERS_SHARE: Final = 0.025
LEAST_LETTERS: Final = 4.0
NICE: Final = (1.0, 2.0, 5.0)

_SVG: Final = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="{x:g} {y:g} {width:g} {height:g}" width="{width_mm:.1f}mm" \
height="{height_mm:.1f}mm">
<title>{title}</title>
<desc>One unit is a cell of {cell_m:g} m; drawn at 1:{ratio:g}.</desc>
<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" fill="#fff"/>
<path fill="{ink}" d="{walls}"/>
<g fill="none" stroke-linejoin="round" stroke-linecap="round" stroke-width="{stroke:.2f}">
<path stroke="{path_colour}" d="{path}"/>
{ends}</g>
<path fill="none" stroke="{ink}" stroke-width="{stroke:.2f}" d="{bar}"/>
<text x="{text_x:.1f}" y="{text_y:.1f}" font-family="sans-serif" font-size="{letters:.1f}" fill="{ink}">{label}</text>
</svg>
"""
RATIO: Final = 100.0
"""A metre of the map is a centimetre of the picture."""


def write(run: RunResult, path: Path) -> None:
    """Write the known part of the map, with one unit a cell, y upwards on the screen."""
    path.write_text(svg(run), encoding="utf-8", errors="backslashreplace")


def svg(run: RunResult) -> str:
    """Return the picture."""
    grid, cells = run.known, run.cells[::-1] == OCCUPIED
    rows, cols = cells.shape
    letters = max(LEAST_LETTERS, LETTERS_SHARE * max(rows, cols))
    margin = MARGIN_SHARE * max(rows, cols) + 1.0
    width, height = cols + 2 * margin, rows + 3 * margin + letters
    xy = [_on_picture(part, run) for part in parts_of_path(run.slam) if len(part)]
    bar_cells, label = scale_bar(BAR_SHARE * width, grid.cell_m)
    bar_y, mm = rows + margin + letters, grid.cell_m * 1000.0 / RATIO
    return _SVG.format(
        x=-margin, y=-margin, width=width, height=height, width_mm=width * mm, height_mm=height * mm,
        title=escape(run.name), cell_m=grid.cell_m, ratio=RATIO, ink=INK, walls=outlines(cells), stroke=letters / 6.0,
        path_colour=POSE_MAGENTA, path="".join(map(_line, xy)), ends=_ends(xy, letters / 2.0), letters=letters,
        bar=f"M0 {bar_y:.1f}v{letters / 3:.1f}h{bar_cells:.2f}v{-letters / 3:.1f}", text_x=bar_cells + letters / 2,
        text_y=bar_y + letters / 3, label=label,
    )  # fmt: skip


def outlines(cells: NDArray[np.bool_]) -> str:
    """Return the true cells (rows, cols) as a path of rectangles, from above: runs of a row, as tall as they repeat."""
    padded = np.pad(cells.astype(np.int8), ((0, 1), (1, 1)))
    row, start = np.nonzero(np.diff(padded, axis=1) == 1)
    end = np.nonzero(np.diff(padded, axis=1) == -1)[1]
    runs_of_row: list[dict[tuple[int, int], None]] = [{} for _ in range(len(cells) + 1)]
    for y, x0, x1 in zip(row.tolist(), start.tolist(), end.tolist(), strict=True):
        runs_of_row[y][x0, x1] = None
    open_runs: dict[tuple[int, int], int] = {}
    shapes = []
    for y, runs in enumerate(runs_of_row):
        for run in [run for run in open_runs if run not in runs]:
            (x0, x1), y0 = run, open_runs.pop(run)
            shapes.append(f"M{x0} {y0}h{x1 - x0}v{y - y0}h{x0 - x1}z")
        for run in runs:
            open_runs.setdefault(run, y)
    return "".join(shapes)


def scale_bar(most_cells: float, cell_m: float) -> tuple[float, str]:
    """Return the length of the bar in cells, at most so many, and its label: 1, 2 or 5 times a power of ten of 1 m."""
    most_m = most_cells * cell_m
    power = 10.0 ** np.floor(np.log10(most_m))
    length_m = max(nice * power for nice in NICE if nice * power <= most_m)
    return float(length_m / cell_m), f"{length_m:g} m"


def _on_picture(xy_m: NDArray[np.float64], run: RunResult) -> NDArray[np.float64]:
    """Bring points (n, 2) of the map frame, m, to cells from the upper left corner."""
    off = (xy_m - np.array(run.known.origin_xy_m)) / run.known.cell_m
    return np.column_stack((off[:, 0], run.known.hits.shape[0] - off[:, 1]))


def _line(xy: NDArray[np.float64]) -> str:
    """Return a line through points (n, 2) as a path; points nearer than half a cell to the last are left out."""
    kept = [xy[0]]
    for point in xy[1:]:
        if np.abs(point - kept[-1]).max() >= 0.5:
            kept.append(point)
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in kept)


def _ends(parts: list[NDArray[np.float64]], radius: float) -> str:
    """Return circles at the start and the end of the path."""
    ends = [(parts[0][0], START_BLUE, "start"), (parts[-1][-1], GOAL_RED, "end")] if parts else []
    return "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" stroke="{colour}"><title>{name}</title></circle>\n'
        for (x, y), colour, name in ends
    )
