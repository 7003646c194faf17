"""Slices: occupancy grids of what lies between two heights, of scans that were levelled."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from math import inf
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import Grid
from mavnav.pose import Trajectory, transform_points
from mavnav.scan import Scan

LEAST_SHARE: Final = 0.01
"""Slices with a smaller share of the hits are left out."""

MOST_SLICES: Final = 100
MOST_BYTES: Final = 1 << 30
"""Memory for the counts of all slices; the highest are left out where they take more."""


class PlacedScan(NamedTuple):
    """The returns of a levelled scan (n, 3) and its laser (3,), m, in the map frame with the height above the floor."""

    xyz_map_m: NDArray[np.float64]
    laser_xyz_m: NDArray[np.float64]


class Slice(Struct, frozen=True):
    """The map between two heights above the floor, m."""

    middle_m: float
    from_m: float
    to_m: float
    grid: Grid


class Slices(Struct, frozen=True):
    """The map by height: all ``layers``, the lowest first, and the path of the laser (n, 3), m, in the map frame."""

    layers: tuple[Slice, ...]
    path_m: NDArray[np.float64]


def slice_name(layer: Slice) -> str:
    """Name the map of a slice by the height of its middle, to 1 cm at most: ``map_0.3m``."""
    return f"map_{layer.middle_m:.2f}".rstrip("0").rstrip(".") + "m"


def scans_with_heights(
    scans: Iterable[Scan], trajectory: Trajectory, laser_height_m: Callable[[int], float]
) -> Iterator[PlacedScan]:
    """Yield the scans with a pose and heights, in the map; ``laser_height_m`` gives the laser's height at a stamp."""
    rows = {stamp_ns: row for row, stamp_ns in enumerate(trajectory.stamps_ns.tolist())}
    for scan in scans:
        row = rows.get(scan.stamp_ns)
        if row is None or scan.heights_m is None:
            continue
        pose = trajectory[row]
        xy_m, height_m = transform_points(pose, scan.points()), scan.heights_m[np.isfinite(scan.ranges_m)]
        laser = np.array([pose.x_m, pose.y_m, laser_height_m(scan.stamp_ns)])
        yield PlacedScan(np.column_stack((xy_m, height_m)), laser)


def slice_map(placed: Callable[[], Iterable[PlacedScan]], area: Grid, slice_m: float) -> Slices | None:
    """Cut the map of scans into slices of a thickness; None where all that was hit lies in one.

    The slices have the cells of ``area``. The middles are multiples of the thickness, from once it on: what is lower is
    the floor. A beam counts in a slice only where it crosses its heights. ``placed`` gives the scans, again at every
    call.
    """
    from mavnav.kernels.maps.height_slices import add_to_slices  # noqa: PLC0415  few logs need it

    shape = area.hits.shape
    most = int(min(MOST_SLICES, max(MOST_BYTES // (4 * area.hits.size), 1)))
    count = min(_highest(placed(), slice_m), most)
    if count < 2:
        return None
    hits, passes = np.zeros((2, count, *shape), np.uint16)
    levels_m, path = np.array([0.5 * slice_m, slice_m]), []
    for scan in placed():
        add_to_slices(scan.xyz_map_m, scan.laser_xyz_m, area.lattice, levels_m, hits, passes)
        path.append(scan.laser_xyz_m)
    totals = hits.sum(axis=(1, 2), dtype=np.int64)
    layers = tuple(
        Slice(k * slice_m, (k - 0.5) * slice_m, (k + 0.5) * slice_m, Grid(area.cell_m, area.origin_xy_m, *counts))
        for k, (*counts, total) in enumerate(zip(hits, passes, totals, strict=True), 1)
        if total >= max(LEAST_SHARE * totals.sum(), 1)
    )
    return Slices(layers, np.array(path)) if len(layers) > 1 else None


def _highest(placed: Iterable[PlacedScan], slice_m: float) -> int:
    """Return the number of the highest slice with a hit; the middle of slice k is k times the thickness high."""
    top_m = max((scan.xyz_map_m[:, 2].max(initial=-inf) for scan in placed), default=-inf)
    return int(np.floor(top_m / slice_m + 0.5)) if np.isfinite(top_m) else 0
