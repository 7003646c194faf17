"""Distance of a map from the true one: of occupied cells from true walls, and the share of true walls mapped."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
from msgspec import Struct, field

from mavnav.metrics.fields import Measured, number
from mavnav.units import MM

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

COVERED_M: Final = 0.1


class TrueMap(Struct, frozen=True):
    """The true walls in the map frame.

    ``distance_m`` returns the distance of points (n, 2) to the nearest wall, (n,) in m. ``xy_m`` (m, 2) are points
    along all walls. ``alignment`` names how they were transformed to the map frame. ``segments_map`` (k, 4) and
    ``arcs_map`` (l, 5) are the walls for drawing, as in `Truth`; a map file has none.
    """

    distance_m: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    xy_m: NDArray[np.float64]
    alignment: str
    segments_map: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4)))
    arcs_map: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 5)))


START_POSE: Final = "start pose"
"""Alignment of the walls of a scenario, which are relative to the laser's pose at the first scan of the mission."""


class MapDistance(Struct, frozen=True):
    """Distances of the occupied cells to the nearest true wall; null without any."""

    alignment: str
    cells: Annotated[int, number("occupied cells")]
    mean_mm: Annotated[Measured, number("how far the walls lie from the true ones", title="map error", better="lower")]
    median_mm: Annotated[Measured, number("half of the occupied cells are not farther from a true wall")]
    p95_mm: Annotated[Measured, number("95 % of the occupied cells are not farther from a true wall")]
    max_mm: Annotated[Measured, number("distance of the farthest occupied cell from a true wall")]
    covered_share: Annotated[
        Measured,
        number("part of the true walls that has an occupied cell within 0.1 m; null if no wall is at flight height"),
    ]


def map_distance(occupied_xy_m: NDArray[np.float64], truth: TrueMap) -> MapDistance:
    """Return the distances of occupied cells with centres (n, 2), map frame, m, to the true walls."""
    from scipy.spatial import cKDTree  # noqa: PLC0415  takes 0.3 s to load

    n = len(occupied_xy_m)
    if n == 0:
        return MapDistance(truth.alignment, 0, np.nan, np.nan, np.nan, np.nan, 0.0)
    distance_mm = truth.distance_m(occupied_xy_m) / MM
    gap_m, _ = cKDTree(occupied_xy_m).query(truth.xy_m)
    return MapDistance(
        alignment=truth.alignment,
        cells=n,
        mean_mm=float(distance_mm.mean()),
        median_mm=float(np.quantile(distance_mm, 0.5)),
        p95_mm=float(np.quantile(distance_mm, 0.95)),
        max_mm=float(distance_mm.max()),
        covered_share=float((gap_m <= COVERED_M).mean()) if len(gap_m) else np.nan,
    )
