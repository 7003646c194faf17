"""Wall thickness: the depth of the walls in the hit-count map in cells (paper, "Complex Mapping").

Ideally a wall is one cell thick; laser noise and bad matches make it thicker. The paper gives neither a hit threshold
nor a way to measure. The definition here, and its validation, are in docs/metrics.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Final

import numpy as np
from msgspec import Struct

from mavnav.kernels.walls.thickness import column_runs, run_moments
from mavnav.mapping.occupancy_grid import counts
from mavnav.mapping.tiled_arrays import bands, count
from mavnav.metrics.fields import Measured, number
from mavnav.units import MM

if TYPE_CHECKING:
    from numpy.typing import NDArray

RADIUS_M: Final = 0.3
RADIUS_CELLS: Final = 5.75
"""Minimum radius of a neighborhood: walls of up to three cells have `MIN_CELLS` and `MAX_RATIO` at any angle.

No cell lies exactly on it. With cells of up to 50 mm, `RADIUS_M` is more.
"""

MIN_CELLS: Final = 6
MIN_LENGTH_M: Final = 0.25
MAX_RATIO: Final = 0.1
MAX_GAP_CELLS: Final = 1

THRESHOLDS: Final = (1, 2, 5)
"""Hit thresholds at which wall thickness is reported, because it depends much on them."""


class Sections(Struct, frozen=True):
    """Cuts through straight walls, (n,) each, along the grid axis nearest to the wall's normal.

    ``row`` and ``col`` are the middle of the cut in cells (halves occur), ``thickness_cells`` its depth along the
    normal, ``length_m`` the length of wall that it represents. ``vertical`` cuts run along a column. ``direction_rad``
    is the wall's direction from the row's, modulo pi. ``share`` is the share of the map's occupied cells that lies in a
    section.
    """

    row: NDArray[np.float64]
    col: NDArray[np.float64]
    thickness_cells: NDArray[np.float64]
    length_m: NDArray[np.float64]
    vertical: NDArray[np.bool_]
    direction_rad: NDArray[np.float64]
    share: float


class WallThickness(Struct, frozen=True):
    """Summary of the sections at one hit threshold; quantiles are weighted by length of wall, null without sections."""

    max_cells: Annotated[Measured, number("the thickest section of a wall")]
    p95_cells: Annotated[Measured, number("95 % of the wall, by length, is not thicker")]
    median_cells: Annotated[Measured, number("half of the wall, by length, is not thicker")]
    max_mm: Annotated[Measured, number("the thickest section of a wall", title="wall max", better="lower")]
    p95_mm: Annotated[Measured, number("95 % of the wall, by length, is not thicker", title="wall p95", better="lower")]
    median_mm: Annotated[Measured, number("half of the wall, by length, is not thicker")]
    sections: Annotated[int, number("cuts through straight walls")]
    length_m: Annotated[float, number("length of the measured wall")]
    share: Annotated[float, number("part of the occupied cells that was measured; with few the rest says little")]


def summary(sections: Sections, cell_m: float) -> WallThickness:
    """Return the summary of the sections at one threshold; ``cell_m`` is the size of a cell."""
    thickness, weight = sections.thickness_cells, sections.length_m
    maximum, p95, median = quantiles(thickness, weight)
    return WallThickness(
        max_cells=maximum,
        p95_cells=p95,
        median_cells=median,
        max_mm=maximum * cell_m / MM,
        p95_mm=p95 * cell_m / MM,
        median_mm=median * cell_m / MM,
        sections=len(thickness),
        length_m=float(weight.sum()),
        share=sections.share,
    )


def quantiles(values: NDArray[np.float64], weights: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return maximum, 95 % quantile and median; NaN without values."""
    if not len(values):
        return np.nan, np.nan, np.nan
    median, p95 = np.quantile(values, (0.5, 0.95), weights=weights, method="inverted_cdf")
    return float(values.max()), float(p95), float(median)


def wall_sections(hits: NDArray[Any], cell_m: float, min_hits: int) -> Sections:
    """Return the sections of the straight walls of a map (docs/metrics.md).

    ``hits`` is (rows, cols); a cell is occupied from ``min_hits`` (1 or more) on; ``cell_m`` is the size of a cell.
    """
    if min_hits < 1:
        msg = f"a cell is occupied from 1 hit on, not {min_hits}"
        raise ValueError(msg)
    hits = counts(hits)
    down = _axis_cuts(hits, cell_m, min_hits, diagonal=True)
    col, row, *sizes, angle_rad, cells = _axis_cuts(hits.T, cell_m, min_hits, diagonal=False)
    across = (row, col, *sizes, np.pi / 2.0 - angle_rad, cells)
    row, col, depth, length_m, angle_rad, cells = (np.concatenate(pair) for pair in zip(down, across, strict=True))
    vertical = np.repeat((True, False), (len(down[0]), len(across[0])))
    occupied = count(hits, lambda some: some >= min_hits)
    return Sections(row, col, depth, length_m, vertical, angle_rad, share=float(cells.sum()) / max(occupied, 1))


def _axis_cuts(hits: NDArray[Any], cell_m: float, min_hits: int, *, diagonal: bool) -> tuple[NDArray[np.float64], ...]:
    """Return the cuts along the columns, for walls nearer to the rows; with ``diagonal`` also for walls at 45 degrees.

    Returns middle row, column, thickness in cells, length in metres, the wall's angle to the row in rad and the number
    of occupied cells of each cut, (n,) each.
    """
    runs = column_runs(hits, min_hits, MAX_GAP_CELLS)
    cells, var_x, cov, var_y = _moments(hits, runs, min_hits, max(RADIUS_M / cell_m, RADIUS_CELLS)).T
    mean, half = (var_x + var_y) / 2.0, np.hypot((var_x - var_y) / 2.0, cov)
    wide, thin = mean + half, mean - half
    straight = (cells >= MIN_CELLS) & (np.sqrt(12.0 * wide) * cell_m >= MIN_LENGTH_M) & (thin <= MAX_RATIO * wide)
    kept = straight & ((var_x >= var_y) if diagonal else (var_x > var_y))
    angle = 0.5 * np.arctan2(2.0 * cov[kept], (var_x - var_y)[kept])
    cos = np.cos(angle)  # component of the normal along the column
    col, first, last, occupied = runs[kept].T.astype(np.float64)
    return (first + last) / 2.0, col, (last - first) * cos + 1.0, cell_m / cos, angle, occupied


def _moments(hits: NDArray[np.uint16], runs: NDArray[np.int64], min_hits: int, radius: float) -> NDArray[np.float64]:
    """Return the moments of the wall around each run as `run_moments` does, for one band of the map at a time."""
    out, middle = np.empty((len(runs), 4)), (runs[:, 1] + runs[:, 2]) // 2
    for around, _, band in bands(hits.shape, margin=int(radius) + 2 + MAX_GAP_CELLS):
        here = (middle >= band.start) & (middle < band.stop)
        some = runs[here] - np.array([0, around.start, around.start, 0])
        out[here] = run_moments(hits[around], some, min_hits, MAX_GAP_CELLS, radius)
    return out
