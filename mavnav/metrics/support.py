"""Support: the amount of map and the share of the log in it, without which other metrics are not meaningful."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
from msgspec import Struct

from mavnav.kernels.maps.hits import show_ends
from mavnav.mapping.occupancy_grid import OCCUPIED
from mavnav.mapping.tiled_arrays import bands
from mavnav.metrics.fields import Measured, number
from mavnav.metrics.journey import spread

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.metrics.journey import Journey, PlacedScans
    from mavnav.metrics.wall_thickness import Sections

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


def map_support(
    grid: Grid, occupied: NDArray[np.uint16], walls: Sections, journey: Journey | None, scans: PlacedScans | None
) -> Support:
    """Return the support of a map.

    ``occupied`` is 1 in its occupied cells, ``walls`` are the sections of its straight walls; ``scans`` are tracked
    scans of the journey, evenly spread.
    """
    return Support(
        wall_m=float(walls.length_m.sum()),
        sections=len(walls.length_m),
        mapped_share=np.nan if journey is None else journey.mapped_share,
        explained_share=np.nan if scans is None else explained_share(grid, occupied, scans),
    )


def reasons(support: Support, measured_share: float, journey: Journey | None = None) -> tuple[str, ...]:
    """Return why a map is not meaningful; empty if it is.

    ``measured_share`` is the measured share of the walls that the scans saw; NaN if unknown.
    """
    texts = []
    if journey and journey.lost_for_good:
        texts.append("the track was lost for good")
    if journey and not journey.planar:
        texts.append("the laser did not move in a plane")
    if support.wall_m < LEAST_WALL_M:
        texts.append(f"{support.wall_m:.1f} m of straight wall, {LEAST_WALL_M:g} m are needed")
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


def dilate(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (rows, cols) dilated by the eight neighbours of its cells."""
    around = np.pad(mask, 1)
    rows = around[:-2] | around[1:-1] | around[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]
