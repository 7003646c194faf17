"""Drawings of lines: map.svg, and floor plans.

map.svg has the occupied cells as areas, the path, and a bar that shows the scale. A floor plan is an SVG, true to scale
on paper, or a DXF in meters.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from mavnav.errors import UsageError
from mavnav.mapping.occupancy_grid import OCCUPIED
from mavnav.metrics.floor_plan import FloorPlan
from mavnav.outputs.pictures.canvas import GOAL_RED, INK, MUTED, POSE_MAGENTA, START_BLUE
from mavnav.outputs.run import RunResult
from mavnav.slam.result import parts_of_path

BAR_SHARE: Final = 0.25
"""The scale bar is at most so long, of the picture's width."""

MARGIN_SHARE: Final = 0.03
LETTERS_SHARE: Final = 0.025
LEAST_LETTERS: Final = 4.0
NICE: Final = (1.0, 2.0, 5.0)

RATIO: Final = 100.0
"""A metre of the map is a centimetre of the picture."""


def _template(name: str) -> str:
    """Return the text of a drawing, with names in braces for what is filled in."""
    return (Path(__file__).parent / "templates" / name).read_text(encoding="utf-8")


def write(run: RunResult, path: Path) -> None:
    """Write the known part of the map, with one unit a cell, y upwards on the screen."""
    grid, cells = run.known, run.cells[::-1] == OCCUPIED
    rows, cols = cells.shape
    letters = max(LEAST_LETTERS, LETTERS_SHARE * max(rows, cols))
    margin = MARGIN_SHARE * max(rows, cols) + 1.0
    width, height = cols + 2 * margin, rows + 3 * margin + letters
    xy = [_on_picture(part, run) for part in parts_of_path(run.slam) if len(part)]
    bar_cells, label = scale_bar(BAR_SHARE * width, grid.cell_m)
    bar_y, mm = rows + margin + letters, grid.cell_m * 1000.0 / RATIO
    text = _template("map.svg").format(
        x=-margin, y=-margin, width=width, height=height, width_mm=width * mm, height_mm=height * mm,
        title=escape(run.name), cell_m=grid.cell_m, ratio=RATIO, ink=INK, walls=outlines(cells), stroke=letters / 6.0,
        path_colour=POSE_MAGENTA, path="".join(map(_line, xy)), ends=_ends(xy, letters / 2.0), letters=letters,
        bar=f"M0 {bar_y:.1f}v{letters / 3:.1f}h{bar_cells:.2f}v{-letters / 3:.1f}", text_x=bar_cells + letters / 2,
        text_y=bar_y + letters / 3, label=label,
    )  # fmt: skip
    path.write_text(text, encoding="utf-8", errors="backslashreplace")


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


MARGIN_MM: Final = 12.0
LAYERS: Final = {"WALLS": 7, "OPENINGS": 8}
"""Layers of a DXF and their colours: black or white, and grey."""


def write_svg(plan: FloorPlan, title: str, ratio: float, path: Path) -> None:
    """Write a floor plan at 1:``ratio``, with the length of the scale bar and the size of the place below."""
    mm = 1000.0 / ratio
    ends = plan.walls.reshape(-1, 2)
    low, high = ends.min(axis=0), ends.max(axis=0)
    size = (high - low) * mm
    bar_m, label = scale_bar(max(float(size[0]) / 2.0, 10.0) / mm, 1.0)
    base = MARGIN_MM + float(size[1]) + 4.0
    text = _template("plan.svg").format(
        width=max(float(size[0]), bar_m * mm + 60.0) + 2 * MARGIN_MM, height=base + 12.0, title=escape(title),
        ratio=ratio, yaw_deg=np.degrees(plan.plan_T_map.yaw_rad), ink=INK, muted=MUTED,
        walls=_strokes(plan.walls, low, high, mm), openings=_strokes(plan.openings, low, high, mm), bar=bar_m * mm,
        bar_x=MARGIN_MM, bar_y=base, text_x=MARGIN_MM + bar_m * mm + 2.0, text_y=base + 2.0,
        label=f"{label}, 1:{ratio:g}; {high[0] - low[0]:.2f} m x {high[1] - low[1]:.2f} m",
    )  # fmt: skip
    path.write_text(text, encoding="utf-8", errors="backslashreplace")


def _strokes(lines: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], mm: float) -> str:
    """Return lines (n, 4) as a path, with y downwards."""
    x, y = (lines[:, ::2] - low[0]) * mm + MARGIN_MM, (high[1] - lines[:, 1::2]) * mm + MARGIN_MM
    rows = np.column_stack((x[:, 0], y[:, 0], x[:, 1], y[:, 1])).tolist()
    return "".join(f"M{x0:.2f} {y0:.2f}L{x1:.2f} {y1:.2f}" for x0, y0, x1, y1 in rows)


def write_dxf(plan: FloorPlan, path: Path) -> None:
    """Write a floor plan as lines in m on two layers; the same plan gives the same bytes.

    Raises UsageError where ezdxf is missing.
    """
    try:
        from ezdxf import options, units  # noqa: PLC0415  an optional extra
        from ezdxf.filemanagement import new  # noqa: PLC0415
    except ImportError as error:
        raise UsageError("a DXF needs ezdxf; install it with pip install 'mavnav[dxf]', or write an .svg") from error
    options.write_fixed_meta_data_for_testing = True  # no time and no random names
    drawing = new("R2000", units=units.M)
    for (layer, colour), lines in zip(LAYERS.items(), (plan.walls, plan.openings), strict=True):
        drawing.layers.add(layer, color=colour)
        for x0, y0, x1, y1 in lines.round(4).tolist():
            drawing.modelspace().add_line((x0, y0), (x1, y1), {"layer": layer})
    drawing.saveas(path)
