"""Straight walls: their thickness, cut by cut, and the lines through groups of cuts.

Thickness is the depth of the walls in the hit-count map in cells (paper, "Complex Mapping"). Ideally a wall is one cell
thick; laser noise and bad matches make it thicker. The paper gives neither a hit threshold nor a way to measure. The
definition here, and its validation, are in docs/metrics.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.kernels.maps.regions import link_groups
from mavnav.kernels.walls.thickness import column_runs, run_moments
from mavnav.mapping.occupancy_grid import Grid, cell_centres, counts
from mavnav.mapping.tiled_arrays import bands, count
from mavnav.metrics.fields import Measured, number
from mavnav.units import DEG, MM

Array = NDArray[np.float64]


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
    normal, ``length_m`` the length of wall that it represents. ``direction_rad`` is the direction of the wall from that
    of the row, modulo pi. ``share`` is the share of the map's occupied cells that lies in a section.
    """

    row: NDArray[np.float64]
    col: NDArray[np.float64]
    thickness_cells: NDArray[np.float64]
    length_m: NDArray[np.float64]
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
    cells, length_m = quantiles(sections.thickness_cells, sections.length_m), sections.length_m
    max_mm, p95_mm, median_mm = (size * cell_m / MM for size in cells)
    return WallThickness(*cells, max_mm, p95_mm, median_mm, len(length_m), float(length_m.sum()), sections.share)


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
        raise ValueError(f"a cell is occupied from 1 hit on, not {min_hits}")
    hits = counts(hits)
    down = _axis_cuts(hits, cell_m, min_hits, diagonal=True)
    col, row, *sizes, angle_rad, cells = _axis_cuts(hits.T, cell_m, min_hits, diagonal=False)
    across = (row, col, *sizes, np.pi / 2.0 - angle_rad, cells)
    row, col, depth, length_m, angle_rad, cells = (np.concatenate(pair) for pair in zip(down, across, strict=True))
    occupied = count(hits, lambda some: some >= min_hits)
    return Sections(row, col, depth, length_m, angle_rad, share=float(cells.sum()) / max(occupied, 1))


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


REACH_M: Final = 0.15
REACH_CELLS: Final = 2.0
"""Largest distance of two sections of one wall, the larger of the two: sections of large cells are farther apart."""

ACROSS_CELLS: Final = 3.0
TURN_RAD: Final = 10.0 * DEG
LEAST_LENGTH_M: Final = 0.3
STRAIGHT_CELLS: Final = 2.0
"""Largest spread of the sections of a straight wall about its line; a group with more is halved."""


class Line(Struct, frozen=True):
    """A straight line through points: its middle in m, direction in rad (0 to pi), length and spread across in m."""

    x_m: float
    y_m: float
    direction_rad: float
    length_m: float
    spread_m: float


class StraightWall(Struct, frozen=True):
    """A straight wall, in the map frame."""

    x_m: Annotated[float, number("middle of the wall")]
    y_m: Annotated[float, number("middle of the wall")]
    direction_deg: Annotated[float, number("direction of the wall, 0 to 180 from x")]
    length_m: Annotated[float, number("length of the wall")]
    p95_cells: Annotated[float, number("95 % of the wall, by length, is not thicker")]
    p95_mm: Annotated[float, number("95 % of the wall, by length, is not thicker")]


def link(xy_m: Array, direction_rad: Array, *, reach_m: float, across_m: float, turn_rad: float) -> NDArray[np.int32]:
    """Return the group number of each point (n,); points (n, 2) are linked along their direction.

    Two points are linked within ``reach_m`` if their directions differ by at most ``turn_rad`` (modulo pi) and neither
    lies more than ``across_m`` off the line through the other.
    """
    if len(xy_m) == 0:
        return np.zeros(0, np.int32)
    col, row = np.floor((xy_m - xy_m.min(axis=0)) / reach_m).astype(np.int64).T
    width = col.max() + 3  # so that no neighbour lies in the row before
    squares = row * width + col
    order = np.argsort(squares, kind="stable")
    below = squares[:, None] + width * np.arange(2)  # a pair in two rows is found from the lower one
    first = np.searchsorted(squares[order], below - 1)
    last = np.searchsorted(squares[order], below + 1, side="right")
    return link_groups(
        np.ascontiguousarray(xy_m),
        np.column_stack((np.cos(direction_rad), np.sin(direction_rad))),
        order,
        np.stack((first, last), axis=2),
        reach_m,
        across_m,
        float(np.sin(turn_rad)),
    )


def members(groups: NDArray[np.int32]) -> list[NDArray[np.intp]]:
    """Return the points of each group, as their numbers; ``groups`` (n,) are those of `link`."""
    order = np.argsort(groups, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(groups[order])) + 1) if len(order) else []


def half_turn(angle_rad: float) -> float:
    """Return a line's direction in [0, pi); a rounding error below 0 becomes 0, not pi."""
    angle_rad %= np.pi
    return angle_rad if angle_rad < np.pi - 1e-9 else 0.0


def fit_line(xy_m: Array, weight: Array, along_m: float) -> Line:
    """Fit a line to points (n, 2) by weighted total least squares; ``along_m`` is the length that one point covers."""
    middle = np.average(xy_m, axis=0, weights=weight)
    dx, dy = (xy_m - middle).T
    xx, xy, yy = (float(np.average(v, weights=weight)) for v in (dx * dx, dx * dy, dy * dy))
    angle = float(0.5 * np.arctan2(2.0 * xy, xx - yy))
    u, v = np.cos(angle) * dx + np.sin(angle) * dy, np.cos(angle) * dy - np.sin(angle) * dx
    low, high = float(u.min()), float(u.max())
    centre = middle + 0.5 * (low + high) * np.array([np.cos(angle), np.sin(angle)])
    spread = float(np.sqrt(np.average(v * v, weights=weight)))
    return Line(float(centre[0]), float(centre[1]), half_turn(angle), high - low + along_m, spread)


def straight_walls(sections: Sections, grid: Grid) -> tuple[StraightWall, ...]:
    """Group the sections of a map into straight walls of at least ``LEAST_LENGTH_M``, the longest first."""
    xy_m, cell_m = cell_centres(grid, sections.row, sections.col), grid.cell_m
    reach_m, across_m = max(REACH_M, REACH_CELLS * cell_m), ACROSS_CELLS * cell_m
    groups = link(xy_m, sections.direction_rad, reach_m=reach_m, across_m=across_m, turn_rad=TURN_RAD)
    pieces = [piece for group in members(groups) for piece in _straight_pieces(xy_m, sections.length_m, group, cell_m)]
    walls = [_wall(line, sections, group, cell_m) for line, group in pieces]
    return tuple(sorted(walls, key=lambda w: (-w.length_m, w.x_m, w.y_m)))


def _straight_pieces(
    xy_m: Array, weight: Array, group: NDArray[np.intp], cell_m: float
) -> Iterator[tuple[Line, NDArray[np.intp]]]:
    """Halve a group until its parts are straight; drop parts that are too short."""
    if len(group) < 2:
        return
    line = fit_line(xy_m[group], weight[group], cell_m)
    if line.length_m < LEAST_LENGTH_M:
        return
    if line.spread_m <= STRAIGHT_CELLS * cell_m:
        yield line, group
        return
    along = xy_m[group] @ np.array([np.cos(line.direction_rad), np.sin(line.direction_rad)])
    behind = along < 0.5 * (along.min() + along.max())
    for half in (group[behind], group[~behind]):
        yield from _straight_pieces(xy_m, weight, half, cell_m)


def _wall(line: Line, sections: Sections, group: NDArray[np.intp], cell_m: float) -> StraightWall:
    _, p95, _ = quantiles(sections.thickness_cells[group], sections.length_m[group])
    return StraightWall(line.x_m, line.y_m, line.direction_rad / DEG, line.length_m, p95, p95 * cell_m / MM)
