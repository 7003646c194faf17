"""Support: how much of a map there is, and of the log in it. A map of nothing has no thick walls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.lattice import bands
from mavnav.memory import blank
from mavnav.metrics.journey import spread

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.grid import Grid
    from mavnav.metrics.journey import Journey, PlacedScans
    from mavnav.metrics.wall_thickness import Sections

LEAST_WALL_M: Final = 2.0
LEAST_MAPPED_SHARE: Final = 0.6
LEAST_EXPLAINED_SHARE: Final = 0.5
"""What falls below one of these is no map to compare."""

SAMPLE_SCANS: Final = 200
"""So many scans, evenly over the run, are laid over the map to see what of them it explains."""

AT_A_TIME: Final = 10
"""So few scans are laid at a time that their points stay in the caches: less than half the time."""


@dataclass(frozen=True, slots=True)
class Support:
    """What vouches for a map; NaN where the scans behind it are not known.

    ``wall_m`` metres of straight wall in ``sections`` cuts; ``mapped_share`` of the usable scans went into the map;
    ``explained_share`` of the end points of all tracked scans lie within a cell of an occupied one.
    """

    wall_m: float
    sections: int
    mapped_share: float
    explained_share: float


def map_support(
    grid: Grid, occupied: NDArray[np.uint16], walls: Sections, journey: Journey | None, scans: PlacedScans | None
) -> Support:
    """Measure the support of a map.

    ``occupied`` is 1 in its occupied cells, ``walls`` are the sections of its straight walls; ``scans`` are tracked
    scans of the journey, evenly spread.
    """
    return Support(
        wall_m=float(walls.length_m.sum()),
        sections=len(walls.length_m),
        mapped_share=np.nan if journey is None else journey.mapped_share,
        explained_share=np.nan if scans is None else explained_share(grid, occupied, scans),
    )


def reasons(support: Support, *, lost_for_good: bool) -> tuple[str, ...]:
    """Say why a map means nothing; empty if it does."""
    found = []
    if lost_for_good:
        found.append("the track was lost for good")
    if support.wall_m < LEAST_WALL_M:
        found.append(f"{support.wall_m:.1f} m of straight wall, {LEAST_WALL_M:g} m are needed")
    if support.mapped_share < LEAST_MAPPED_SHARE:
        found.append(f"{support.mapped_share:.0%} of the scans are in the map, {LEAST_MAPPED_SHARE:.0%} are needed")
    if support.explained_share < LEAST_EXPLAINED_SHARE:
        share, least = support.explained_share, LEAST_EXPLAINED_SHARE
        found.append(f"{share:.0%} of what the laser saw lies on the map, {least:.0%} are needed")
    return tuple(found)


def explained_share(grid: Grid, occupied: NDArray[np.uint16], scans: PlacedScans) -> float:
    """Lay tracked scans over the map: the part of their end points within a cell of an occupied cell; NaN without any.

    A part of the map that was cut away, or scans that were tracked but are not in the map, lower it.
    """
    near, found, points = near_walls(occupied), 0, 0
    sample = spread(len(scans.poses), SAMPLE_SCANS)
    for first in range(0, len(sample), AT_A_TIME):
        xy_map_m = _ends(scans, sample[first : first + AT_A_TIME])
        places = np.floor((xy_map_m - np.array(grid.origin_xy_m)[:, None]) / grid.cell_m).astype(np.int64) + 1
        cols, rows = (np.clip(place, 0, size - 1) for place, size in zip(places, near.shape[::-1], strict=True))
        found, points = found + int(np.count_nonzero(near[rows, cols])), points + len(rows)
    return found / points if points else np.nan


def _ends(scans: PlacedScans, rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the end points of some scans in the map frame, x and y (2, n), m."""
    x, y = (scans.ranges_m[rows] * part for part in scans.spec.directions.T)
    x_m, y_m, yaw = scans.poses[rows].T[:, :, None]
    c, s = np.cos(yaw), np.sin(yaw)
    seen = np.isfinite(x)
    return np.stack(((x_m + c * x - s * y)[seen], (y_m + s * x + c * y)[seen]))


def near_walls(occupied: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Tell which cells (rows + 2, cols + 2), one more on each side, are occupied or have an occupied neighbour.

    Those on the edge do not count. Where there are none, the answer takes no memory.
    """
    rows, cols = occupied.shape
    near = blank((rows + 2, cols + 2), np.bool_)
    for around, inside, band in bands(occupied.shape, margin=1):
        wide = widened(occupied[around] > 0)[inside]
        near[1:-1, 1:-1][band][wide] = True
    return near


def widened(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (rows, cols) with the eight neighbours of its cells."""
    around = np.pad(mask, 1)
    rows = around[:-2] | around[1:-1] | around[2:]
    wide: NDArray[np.bool_] = rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]
    return wide
