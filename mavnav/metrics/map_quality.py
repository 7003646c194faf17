"""The profile of map quality: a fixed set of numbers, and whether they are meaningful.

A profile never changes: another definition or threshold is another profile. Definitions: docs/metrics.md.
"""

from __future__ import annotations

from math import ceil, sqrt
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
from msgspec import Struct

from mavnav.mapping.occupancy_grid import UNKNOWN, occupancy, occupied_cells
from mavnav.mapping.tiled_arrays import max_pool
from mavnav.metrics.doubled_walls import doubled_walls, key_rows
from mavnav.metrics.fields import Measured, number
from mavnav.metrics.ghost_walls import GhostWalls, ghost_walls
from mavnav.metrics.journey import placed_scans, spread
from mavnav.metrics.revisits import Revisits, pairs_of, revisits
from mavnav.metrics.shape import Crispness, EnclosedAreas, corners, crispness, enclosed_areas, occupied_share
from mavnav.metrics.support import SAMPLE_SCANS, Support, map_support, reasons
from mavnav.metrics.wall_spread import WALL_SCANS, cut_walls, wall_spread
from mavnav.metrics.wall_thickness import THRESHOLDS, wall_sections
from mavnav.metrics.walls import StraightWall, straight_walls

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.metrics.journey import Journey, PlacedScans
    from mavnav.metrics.wall_spread import WallCuts
    from mavnav.metrics.wall_thickness import Sections

PROFILE: Final = "map-quality/2"

LARGEST_CELLS: Final = 16_000_000
"""Maximum number of cells for corners and enclosed areas; larger maps are reduced to cells of 2, 3, ... times the size.
"""


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
    support = map_support(grid, occupied, published, journey, scans)
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


def map_quality(grid: Grid, journey: Journey | None = None, *, counted: bool = True) -> MapQuality:
    """Return the quality of a map; arguments as of `measure_map`."""
    return measure_map(grid, journey, counted=counted).quality


def _compare_scans(journey: Journey) -> tuple[Revisits, PlacedScans | None]:
    """Return the revisits of a run, and the scans that any metric needs: they are read once."""
    trajectory = journey.map_T_laser
    pairs = pairs_of(trajectory)
    rows = (pairs.rows, spread(len(trajectory), max(SAMPLE_SCANS, WALL_SCANS)), key_rows(trajectory))
    scans = placed_scans(journey, np.unique(np.concatenate(rows)))
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
