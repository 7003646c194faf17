"""Straight walls: groups of linked sections, each with its thickness."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
from msgspec import Struct

from mavnav.metrics.fields import number
from mavnav.metrics.lines import Line, fit_line, link, members
from mavnav.metrics.wall_thickness import Sections, quantiles
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

REACH_M: Final = 0.15
REACH_CELLS: Final = 2.0
"""Largest distance of two sections of one wall, the larger of the two: sections of large cells are farther apart."""

ACROSS_CELLS: Final = 3.0
TURN_RAD: Final = 10.0 * DEG
LEAST_LENGTH_M: Final = 0.3
STRAIGHT_CELLS: Final = 2.0
"""Largest spread of the sections of a straight wall about its line; a group with more is halved."""


class StraightWall(Struct, frozen=True):
    """A straight wall, in the map frame."""

    x_m: Annotated[float, number("middle of the wall")]
    y_m: Annotated[float, number("middle of the wall")]
    direction_deg: Annotated[float, number("direction of the wall, 0 to 180 from x")]
    length_m: Annotated[float, number("length of the wall")]
    p95_cells: Annotated[float, number("95 % of the wall, by length, is not thicker")]
    p95_mm: Annotated[float, number("95 % of the wall, by length, is not thicker")]


def straight_walls(sections: Sections, cell_m: float, origin_xy_m: tuple[float, float]) -> tuple[StraightWall, ...]:
    """Group sections into straight walls of at least ``LEAST_LENGTH_M``, the longest first."""
    xy_m = section_places(sections, cell_m, origin_xy_m)
    reach_m, across_m = max(REACH_M, REACH_CELLS * cell_m), ACROSS_CELLS * cell_m
    groups = link(xy_m, sections.direction_rad, reach_m=reach_m, across_m=across_m, turn_rad=TURN_RAD)
    pieces = [piece for group in members(groups) for piece in _straight_pieces(xy_m, sections.length_m, group, cell_m)]
    walls = [_wall(line, sections, group, cell_m) for line, group in pieces]
    return tuple(sorted(walls, key=lambda w: (-w.length_m, w.x_m, w.y_m)))


def section_places(sections: Sections, cell_m: float, origin_xy_m: tuple[float, float]) -> NDArray[np.float64]:
    """Return the centres of sections in the map frame, (n, 2) in m."""
    xy_m: NDArray[np.float64] = (np.column_stack((sections.col, sections.row)) + 0.5) * cell_m + np.array(origin_xy_m)
    return xy_m


def _straight_pieces(
    xy_m: NDArray[np.float64], weight: NDArray[np.float64], group: NDArray[np.intp], cell_m: float
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
