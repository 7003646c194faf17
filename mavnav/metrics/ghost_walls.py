"""Ghost walls: one wall mapped twice (paper, "Corridor Mapping", Figure 8).

They are two parallel ridges with free space between them, both seen from the same side: a beam that ended at the rear
ridge passed through the front one. The two faces of a real wall are seen from opposite sides, with unknown cells
between them; the walls of a corridor face each other. Definition and validation: docs/metrics.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.kernels.walls.profiles import wall_profiles
from mavnav.mapping.occupancy_grid import Grid, cell_centres
from mavnav.metrics.fields import Measured, number
from mavnav.metrics.walls import Array, Sections, fit_line, link, members
from mavnav.units import DEG, MM

LEAST_OFFSET_CELLS: Final = 1.5
MAX_OFFSET_CELLS: Final = 13
MAX_OFFSET_M: Final = 0.3
"""Largest distance of the rear ridge that is searched: the larger of the two."""

STRETCH_M: Final = 0.15
"""Length of wall to either side of a station on which a ridge must be visible."""

SPACING_CELLS: Final = 3
LEAST_LENGTH_M: Final = 0.3
DIP: Final = 0.5
"""Largest number of hits between the ridges, as a share of the lower ridge."""

LEAST_HITS: Final = 0.25
LEAST_SHARE: Final = 0.08
"""Minimum number of hits a cell of a ridge, absolute and as a share of the other ridge."""

FREE_SHARE: Final = 0.5
"""Minimum number of beams that crossed a cell of free space, as a share of the hits a cell of the ridge behind it."""

AT_A_TIME: Final = 2_000
"""Number of stations whose profiles are in memory at a time."""

DRAWING: Final = "copy was drawn, from the first scan; null without scans"

OUTSIDE_CELLS: Final = (2.0, 5.0)
REACH_M, ACROSS_CELLS, TURN_RAD = 0.15, 3.0, 12.0 * DEG


class GhostWall(Struct, frozen=True):
    """A wall that is mapped twice, in the map frame."""

    x_m: Annotated[float, number("middle of the front ridge")]
    y_m: Annotated[float, number("middle of the front ridge")]
    direction_deg: Annotated[float, number("direction of the front ridge, 0 to 180 from x")]
    length_m: Annotated[float, number("length of the front ridge")]
    offset_mm: Annotated[float, number("distance from the front ridge to the rear one")]
    scan_pairs: Annotated[int | None, number("pairs of scans that show it; null without scans")] = None
    front_s: Annotated[float | None, number(f"when the front {DRAWING}")] = None
    rear_s: Annotated[float | None, number(f"when the rear {DRAWING}")] = None


class GhostWalls(Struct, frozen=True):
    """Walls that are mapped twice, the longest first."""

    count: Annotated[int, number("walls that are mapped twice")]
    length_m: Annotated[float, number("length of walls mapped twice", title="ghosts", better="lower")]
    worst_offset_mm: Annotated[Measured, number("largest distance between the two; null without one")]
    worst_offset_cells: Annotated[Measured, number("largest distance between the two; null without one")]
    places: tuple[GhostWall, ...]


def ghost_walls(grid: Grid, all_sections: Iterable[Sections]) -> GhostWalls:
    """Find the ghost walls of a map.

    ``all_sections`` are the cuts through its straight walls, at one hit threshold or several; a second ridge is
    searched on both sides of each.
    """
    stations = _stations(all_sections)
    reach = int(np.ceil(max(MAX_OFFSET_CELLS, MAX_OFFSET_M / grid.cell_m) + OUTSIDE_CELLS[1]))
    half_length = max(round(STRETCH_M / grid.cell_m), 3)
    left, right = [], []
    for first in range(0, max(len(stations), 1), AT_A_TIME):
        some = stations[first : first + AT_A_TIME]
        hits, passes = (wall_profiles(counts, some, half_length, reach) for counts in (grid.hits, grid.passes))
        left.append(_twins(some, hits, passes))
        reverse = some + np.array([0.0, 0.0, np.pi])  # which exchanges left and right
        right.append(_twins(reverse, hits[:, ::-1, ::-1], passes[:, ::-1, ::-1]))
    return as_ghost_walls(_places(np.hstack(left + right), grid), grid.cell_m)


def as_ghost_walls(walls: Iterable[GhostWall], cell_m: float) -> GhostWalls:
    """Return the summary of ghost walls of a map with cells of ``cell_m``."""
    places = tuple(sorted(walls, key=lambda p: (-p.length_m, p.x_m, p.y_m)))
    worst_mm = max((p.offset_mm for p in places), default=np.nan)
    length_m = float(sum(p.length_m for p in places))
    return GhostWalls(len(places), length_m, worst_mm, worst_mm * MM / cell_m, places)


def _stations(all_sections: Iterable[Sections]) -> Array:
    """Return column, row and direction of sections, (n, 3), thinned to one in `SPACING_CELLS` cells.

    Cells are counted from the outermost sections, so that the result does not depend on the extent of the map.
    """
    stations = [np.column_stack((s.col, s.row, s.direction_rad)) for s in all_sections]
    every = np.concatenate(stations) if stations else np.zeros((0, 3))
    first_cell = np.floor(every[:, :2].min(axis=0, initial=np.inf))
    _, first = np.unique(np.floor((every[:, :2] - first_cell) / SPACING_CELLS), axis=0, return_index=True)
    return np.ascontiguousarray(every[np.sort(first)])


def _twins(stations: Array, hits: Array, passes: Array) -> Array:
    """Return the stations with a second ridge to the left; profiles (n, 2, bins) as of `wall_profiles`.

    Returns (4, m): column and row of the front ridge, direction of the wall, offset of the rear ridge in cells.
    """
    ridge, twin, valley = _ridges(hits)
    number, centre = np.arange(len(stations)), hits.shape[2] // 2
    lower = hits.min(axis=1)
    h_ridge, h_twin = lower[number, ridge], lower[number, twin]
    crossed = passes.min(axis=1)[number, valley]
    right, left = _outside(passes, ridge, -1), _outside(passes, twin, 1)
    faces_right = (right >= FREE_SHARE * h_ridge) & (crossed >= FREE_SHARE * h_twin)
    faces_left = (left >= FREE_SHARE * h_twin) & (crossed >= FREE_SHARE * h_ridge)
    kept = (twin > ridge) & (faces_right | faces_left)
    front = np.where(faces_right & ~(faces_left & (left > right)), ridge, twin)[kept]
    side = 0.5 * (front - centre)
    (col, row), angle = stations[kept, :2].T, stations[kept, 2]
    return np.stack((col - side * np.sin(angle), row + side * np.cos(angle), angle, 0.5 * (twin - ridge)[kept]))


def _ridges(hits: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return the ridge at each station, the next one to its left, and the valley between them; bins, (n,) each.

    Both halves of the stretch must show both ridges, because a step in a wall is not a second ridge. Without a second
    ridge its bin is 0.
    """
    both, lower = hits.sum(axis=1) / 2.0, hits.min(axis=1)
    n, bins = both.shape
    row, centre = np.arange(n), bins // 2
    ridge = centre - 3 + both[:, centre - 3 : centre + 4].argmax(axis=1)
    height = lower[row, ridge][:, None]
    beyond = np.arange(bins) > ridge[:, None]
    lowest = np.minimum.accumulate(np.where(beyond, both, np.inf), axis=1)
    padded = np.pad(both, ((0, 0), (2, 2)))
    peak = (both >= padded[:, 1:-3]) & (both >= padded[:, 3:-1]) & (both >= padded[:, :-4]) & (both >= padded[:, 4:])
    strong = (lower >= LEAST_HITS) & (lower >= LEAST_SHARE * height) & (height >= LEAST_SHARE * lower)
    apart = lowest <= DIP * np.minimum(lower, height)
    offset = np.arange(bins) - ridge[:, None]
    reach = bins - 1 - centre - 2 * int(OUTSIDE_CELLS[1])
    fits = (offset >= 2 * LEAST_OFFSET_CELLS) & (offset <= reach) & (height >= LEAST_HITS)
    is_twin = beyond & peak & strong & apart & fits
    twin = np.where(is_twin.any(axis=1), is_twin.argmax(axis=1), 0)
    between = beyond & (np.arange(bins) < twin[:, None])
    valley = np.where(between, both, np.inf).argmin(axis=1)
    return ridge, twin, valley


def _outside(passes: Array, ridge: NDArray[np.intp], side: int) -> Array:
    """Return the mean crossings a cell (n,) in the free space next to a ridge."""
    near, far = (round(2 * d) for d in OUTSIDE_CELLS)
    both = passes.mean(axis=1)
    bins = np.clip(ridge[:, None] + side * np.arange(near, far + 1), 0, both.shape[1] - 1)
    return np.asarray(np.take_along_axis(both, bins, axis=1).mean(axis=1))


def _places(twins: Array, grid: Grid) -> list[GhostWall]:
    """Link stations along their direction; groups shorter than `LEAST_LENGTH_M` are chance."""
    col, row, direction_rad, offset_cells = twins
    xy_m = cell_centres(grid, row, col)
    groups = link(xy_m, direction_rad, reach_m=REACH_M, across_m=ACROSS_CELLS * grid.cell_m, turn_rad=TURN_RAD)
    places = []
    for here in members(groups):
        line = fit_line(xy_m[here], np.ones(len(here)), SPACING_CELLS * grid.cell_m)
        offset_mm = float(np.median(offset_cells[here])) * grid.cell_m / MM
        if line.length_m >= LEAST_LENGTH_M:
            places.append(GhostWall(line.x_m, line.y_m, line.direction_rad / DEG, line.length_m, offset_mm))
    return places
