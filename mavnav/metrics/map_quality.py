"""The profile of map quality: one frozen set of numbers, and whether they mean anything.

A profile never changes: another definition or threshold is another profile. Definitions: docs/metrics.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.mapping.occupancy_grid import UNKNOWN, occupancy, occupied_cells
from mavnav.mapping.tiled_arrays import pooled
from mavnav.memory import blank
from mavnav.metrics.crispness import Crispness, crispness
from mavnav.metrics.doubled_walls import doubled_walls, key_rows
from mavnav.metrics.ghost_walls import GhostWalls, ghost_walls
from mavnav.metrics.journey import placed_scans, spread
from mavnav.metrics.revisits import Revisits, pairs_of, revisits
from mavnav.metrics.shape import EnclosedAreas, corners, enclosed_areas, occupied_share
from mavnav.metrics.support import SAMPLE_SCANS, Support, map_support, reasons
from mavnav.metrics.wall_thickness import THRESHOLDS, sections_by_hits, wall_sections
from mavnav.metrics.walls import Wall, straight_walls

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.metrics.journey import Journey, PlacedScans
    from mavnav.metrics.wall_thickness import Sections

PROFILE: Final = "map-quality/2"

LARGEST_CELLS: Final = 16_000_000
"""Of maps with more, corners and enclosed areas are counted in cells of twice the size, or thrice, ..."""


@dataclass(frozen=True, slots=True)
class MapQuality:
    """How good a map is; NaN or None where a number cannot be known.

    Numbers of a map that is not ``meaningful`` must not be compared; ``why`` says in a few words each what is missing.
    """

    profile: str
    meaningful: bool
    why: tuple[str, ...]
    ghost_walls: GhostWalls
    crispness: Crispness
    revisits: Revisits | None
    support: Support
    occupied_share: float
    corners: int
    enclosed_areas: EnclosedAreas
    walls: tuple[Wall, ...]


def map_quality(
    grid: Grid,
    journey: Journey | None = None,
    *,
    counted: bool = True,
    sections: dict[int, Sections] | None = None,
) -> MapQuality:
    """Measure a map.

    Parameters
    ----------
    grid
        The map. What a map file shows as well (walls, corners, areas) is measured on its `occupancy`, so that a run and
        its map file agree; hits and crossings give the entropy, and without scans the ghost walls.
    journey
        The scans behind it with their poses, where they are known.
    counted
        Whether hits and crossings are counts; otherwise they are 0 and 1, as a map file tells them.
    sections
        The cuts through the grid's walls at each of the thresholds, where they were made already.
    """
    occupied = only_occupied(grid)
    walls = wall_sections(occupied, grid.cell_m, 1)
    found, scans = (None, None) if journey is None else _seen_again(journey)
    support = map_support(grid, occupied, walls, journey, scans)
    ghosts = None if journey is None or scans is None else doubled_walls(journey.map_T_laser, scans, grid.cell_m)
    del occupied, scans  # of a large map there is no room for all beside each other
    if ghosts is None:
        # Noise may hide a ghost wall at the lower thresholds, few hits at the higher ones.
        cuts = sections or sections_by_hits(grid.hits, grid.cell_m, THRESHOLDS if counted else (1,))
        ghosts = ghost_walls(grid, cuts.values())
    cells = occupancy(grid)
    why = reasons(support, lost_for_good=journey is not None and journey.lost_for_good)
    crisp, share, shape = (
        crispness(grid, cells, support.wall_m, counted=counted),
        occupied_share(cells),
        _at_most(cells, grid.cell_m),
    )
    del cells  # what follows takes larger cells of a large map
    return MapQuality(
        profile=PROFILE,
        meaningful=not why,
        why=why,
        ghost_walls=ghosts,
        crispness=crisp,
        revisits=found,
        support=support,
        occupied_share=share,
        corners=corners(*shape),
        enclosed_areas=enclosed_areas(*shape),
        walls=straight_walls(walls, grid.cell_m, grid.origin_xy_m),
    )


def _seen_again(journey: Journey) -> tuple[Revisits, PlacedScans | None]:
    """Compare the scans with one another, and keep them for other uses: they are read once."""
    trajectory = journey.map_T_laser
    pairs = pairs_of(trajectory)
    rows = (pairs.rows, spread(len(trajectory), SAMPLE_SCANS), key_rows(trajectory))
    scans = placed_scans(journey, np.unique(np.concatenate(rows)))
    return revisits(trajectory, pairs, scans), scans


def _at_most(cells: NDArray[np.int8], cell_m: float) -> tuple[NDArray[np.int8], float]:
    """Return occupancy and cell for what takes much memory a cell: larger cells where there are too many."""
    factor = ceil(sqrt(cells.size / LARGEST_CELLS))
    return (cells, cell_m) if factor <= 1 else (pooled(cells, factor, fill=UNKNOWN), cell_m * factor)


def only_occupied(grid: Grid) -> NDArray[np.uint16]:
    """Return a map of one hit where a cell is occupied; the rest of it takes no memory."""
    out = blank(grid.hits.shape, np.uint16)
    row, col = occupied_cells(grid).T
    out[row, col] = 1
    return out
