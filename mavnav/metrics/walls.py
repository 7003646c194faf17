"""Straight walls: points with a direction, linked along it, and the lines through such groups of sections."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
from msgspec import Struct

from mavnav.kernels.maps.regions import link_groups
from mavnav.mapping.occupancy_grid import cell_centres
from mavnav.metrics.fields import number
from mavnav.metrics.wall_thickness import Sections, quantiles
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid

    Array = NDArray[np.float64]

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
