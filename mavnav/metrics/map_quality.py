"""The profile of map quality: a fixed set of numbers, and whether they are meaningful.

They are if there is enough map, and enough of the log in it: the support. A profile never changes: another definition
or threshold is another profile. Definitions: docs/metrics.md.
"""

from __future__ import annotations

from math import ceil, sqrt
from typing import Annotated, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.kernels.maps.hits import show_ends
from mavnav.mapping.occupancy_grid import OCCUPIED, UNKNOWN, Grid, occupancy, occupied_cells
from mavnav.mapping.tiled_arrays import bands, max_pool
from mavnav.metrics.doubled_walls import doubled_walls, key_rows
from mavnav.metrics.fields import Measured, number
from mavnav.metrics.ghost_walls import GhostWalls, ghost_walls
from mavnav.metrics.journey import Journey, PlacedScans, placed_scans, spread
from mavnav.metrics.revisits import Revisits, pairs_of, revisits
from mavnav.metrics.shape import Crispness, EnclosedAreas, corners, crispness, dilate, enclosed_areas, occupied_share
from mavnav.metrics.wall_spread import WALL_SCANS, WallCuts, cut_walls, wall_spread
from mavnav.metrics.walls import THRESHOLDS, Sections, StraightWall, straight_walls, wall_sections

PROFILE: Final = "map-quality/2"

LARGEST_CELLS: Final = 16_000_000
"""Maximum number of cells for corners and enclosed areas; larger maps are reduced to cells of 2, 3, ... times the size.
"""

LEAST_WALL_M: Final = 2.0
LEAST_MAPPED_SHARE: Final = 0.6
LEAST_EXPLAINED_SHARE: Final = 0.5
LEAST_MEASURED_SHARE: Final = 0.65
"""Minimum values of a meaningful map."""

SAMPLE_SCANS: Final = 200
"""Number of scans, evenly spread over the run, whose end points are compared with the map."""


class Support(Struct, frozen=True):
    """Amount of map, and share of the log in it; null if the scans of the map are unknown."""

    wall_m: Annotated[float, number("length of straight wall")]
    sections: Annotated[int, number("cuts through straight walls")]
    mapped_share: Annotated[Measured, number("share of the usable scans that were accepted")]
    explained_share: Annotated[
        Measured, number("part of the end points of tracked scans that lies within a cell of an occupied one")
    ]


class MapQuality(Struct, frozen=True):
    """Quality of a map; a number that cannot be known is null.

    Numbers of a map that is not ``meaningful`` must not be compared; ``why`` lists what is missing.
    """

    profile: str
    meaningful: Annotated[bool, number("whether the numbers may be compared", better="higher")]
    why: tuple[str, ...]
    ghost_walls: GhostWalls
    crispness: Crispness
    revisits: Revisits | None
    support: Support
    occupied_share: Annotated[Measured, number("part of the known cells that is occupied")]
    corners: Annotated[int, number("places where walls change their direction; coarse maps merge near ones")]
    enclosed_areas: EnclosedAreas
    walls: tuple[StraightWall, ...]


class MeasuredMap(Struct, frozen=True):
    """The measurements of a map.

    ``sections`` are the cuts through its walls at each hit threshold, ``published`` those through the walls of the
    published map, ``cuts`` those where its scans saw walls, None if unknown.
    """

    quality: MapQuality
    sections: dict[int, Sections]
    published: Sections
    cuts: WallCuts | None


def measure_map(grid: Grid, journey: Journey | None = None, *, counted: bool = True) -> MeasuredMap:
    """Measure a map.

    Parameters
    ----------
    grid
        The map. Walls, corners and areas are measured on its `occupancy`, so that a run and its map file agree. Hits
        and crossings give the entropy and, without scans, the ghost walls.
    journey
        The scans of the map with their poses, if known.
    counted
        Whether hits and crossings are counts; otherwise they are 0 and 1, as in a map file.
    """
    occupied = only_occupied(grid)
    published = wall_sections(occupied, grid.cell_m, 1)
    revisits, scans = (None, None) if journey is None else _compare_scans(journey)
    support = Support(
        wall_m=float(published.length_m.sum()),
        sections=len(published.length_m),
        mapped_share=np.nan if journey is None else journey.mapped_share,
        explained_share=np.nan if scans is None else explained_share(grid, occupied, scans),
    )
    ghosts = None if journey is None or scans is None else doubled_walls(journey.map_T_laser, scans, grid.cell_m)
    cuts = None if journey is None else cut_walls(grid, scans, len(journey.map_T_laser))
    measured_share = np.nan if cuts is None else wall_spread(cuts, grid.cell_m).measured_share
    del occupied, scans  # the arrays of a large map may not fit into memory together
    sections = {least: wall_sections(grid.hits, grid.cell_m, least) for least in (THRESHOLDS if counted else (1,))}
    if ghosts is None:
        ghosts = ghost_walls(grid, sections.values())  # noise may hide a ghost wall at some of the thresholds
    cells = occupancy(grid)
    why = reasons(support, measured_share, journey)
    crisp, share = crispness(grid, cells, support.wall_m, counted=counted), occupied_share(cells)
    shape = _at_most(cells, grid.cell_m)
    del cells  # the rest uses the reduced cells of a large map
    quality = MapQuality(
        profile=PROFILE,
        meaningful=not why,
        why=why,
        ghost_walls=ghosts,
        crispness=crisp,
        revisits=revisits,
        support=support,
        occupied_share=share,
        corners=corners(*shape),
        enclosed_areas=enclosed_areas(*shape),
        walls=straight_walls(published, grid),
    )
    return MeasuredMap(quality, sections, published, cuts)


def _compare_scans(journey: Journey) -> tuple[Revisits, PlacedScans | None]:
    """Return the revisits of a run, and the scans that any metric needs: they are read once."""
    trajectory = journey.map_T_laser
    pairs = pairs_of(trajectory)
    evenly = spread(len(trajectory), max(SAMPLE_SCANS, WALL_SCANS))
    scans = placed_scans(journey, np.unique(np.concatenate((*map(np.ravel, pairs), evenly, key_rows(trajectory)))))
    return revisits(trajectory, pairs, scans), scans


def _at_most(cells: NDArray[np.int8], cell_m: float) -> tuple[NDArray[np.int8], float]:
    """Return occupancy and cell size, reduced if there are more than `LARGEST_CELLS` cells."""
    factor = ceil(sqrt(cells.size / LARGEST_CELLS))
    return (cells, cell_m) if factor <= 1 else (max_pool(cells, factor, fill=UNKNOWN), cell_m * factor)


def only_occupied(grid: Grid) -> NDArray[np.uint16]:
    """Return an array with 1 in the occupied cells; the rest of it takes no memory."""
    out = np.zeros(grid.hits.shape, np.uint16)
    row, col = occupied_cells(grid).T
    out[row, col] = 1
    return out


def reasons(support: Support, measured_share: float, journey: Journey | None) -> tuple[str, ...]:
    """Return why a map is not meaningful; empty if it is.

    ``measured_share`` is the measured share of the walls that the scans saw; NaN if unknown.
    """
    texts = []
    if journey and journey.lost_for_good:
        texts.append("the track was lost for good")
    if journey and not journey.planar:
        texts.append("the laser did not move in a plane")
    if support.wall_m < LEAST_WALL_M:
        texts.append(
            f"{support.wall_m:.1f} m of its occupied cells lie on straight lines, {LEAST_WALL_M:g} m are needed"
        )
    shares = (
        (support.mapped_share, LEAST_MAPPED_SHARE, "of the scans were accepted"),
        (support.explained_share, LEAST_EXPLAINED_SHARE, "of what the laser saw lies on the map"),
        (measured_share, LEAST_MEASURED_SHARE, "of the walls that the laser saw can be measured"),
    )
    few = [(100 * share, what, 100 * least) for share, least, what in shares if share < least]
    texts += [f"{share:.0f} % {what}, {least:.0f} % are needed" for share, what, least in few]
    return tuple(texts)


def explained_share(grid: Grid, occupied: NDArray[np.uint16], scans: PlacedScans) -> float:
    """Return the share of end points of tracked scans within a cell of an occupied cell; NaN without any.

    It is low if a part of the map was cut off, or if scans were tracked but are not in the map.
    """
    near, lattice, explained, points = near_walls(occupied), grid.lattice, 0, 0
    for k in spread(len(scans.poses), SAMPLE_SCANS):
        ranges_m, directions = scans.recorded_beams(k)
        explained += show_ends(ranges_m, directions, scans.poses[k], lattice, near, near)
        points += int(np.count_nonzero(np.isfinite(ranges_m)))
    return explained / points if points else np.nan


def near_walls(occupied: NDArray[np.uint16]) -> NDArray[np.int8]:
    """Return `OCCUPIED` in the cells (rows, cols) that are occupied or have an occupied neighbour, else 0.

    Zeros take no memory.
    """
    near = np.zeros(occupied.shape, np.int8)
    for around, inside, band in bands(occupied.shape, margin=1):
        near[band][dilate(occupied[around] > 0)[inside]] = OCCUPIED
    return near
