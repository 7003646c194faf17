"""Support: how much of a map there is, and of the log in it. A map of nothing has no thick walls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy import ndimage

from mavnav.grid import OCCUPIED
from mavnav.metrics.journey import placed_scans
from mavnav.pose import Pose, transform_points
from mavnav.scan import Scan

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.grid import Grid
    from mavnav.metrics.journey import Journey
    from mavnav.metrics.wall_thickness import Sections

LEAST_WALL_M: Final = 2.0
LEAST_MAPPED_SHARE: Final = 0.6
LEAST_EXPLAINED_SHARE: Final = 0.5
"""What falls below one of these is no map to compare."""

SAMPLE_SCANS: Final = 200
"""So many scans, evenly over the run, are laid over the map to see what of them it explains."""


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


def map_support(grid: Grid, cells: NDArray[np.int8], walls: Sections, journey: Journey | None) -> Support:
    """Measure the support of a map; ``cells`` is its occupancy, ``walls`` are the sections of its straight walls."""
    return Support(
        wall_m=float(walls.length_m.sum()),
        sections=len(walls.length_m),
        mapped_share=np.nan if journey is None else journey.mapped_share,
        explained_share=np.nan if journey is None else explained_share(grid, cells, journey),
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


def explained_share(grid: Grid, cells: NDArray[np.int8], journey: Journey) -> float:
    """Lay tracked scans over the map: the part of their end points within a cell of an occupied cell; NaN without any.

    A part of the map that was cut away, or scans that were tracked but are not in the map, lower it.
    """
    n = len(journey.map_T_laser)
    wanted = np.unique(np.linspace(0, n - 1, min(n, SAMPLE_SCANS)).round().astype(np.intp))
    placed = placed_scans(journey, wanted)
    if placed is None:
        return np.nan
    near = np.pad(ndimage.binary_dilation(cells == OCCUPIED, np.ones((3, 3))), 1)
    on_map = total = 0
    for stamp_ns, xyyaw, ranges_m in zip(placed.stamps_ns.tolist(), placed.poses, placed.ranges_m, strict=True):
        xy_m = transform_points(Pose(*xyyaw.tolist()), Scan(stamp_ns, ranges_m, placed.spec).points())
        col, row = np.floor((xy_m - grid.origin_xy_m) / grid.cell_m).astype(np.int64).T + 1
        rows, cols = (np.clip(at, 0, most - 1) for at, most in zip((row, col), near.shape, strict=True))
        on_map += int(np.count_nonzero(near[rows, cols]))
        total += len(xy_m)
    return on_map / total if total else np.nan
