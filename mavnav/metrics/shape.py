"""What a map looks like without a truth: occupied share, corners, enclosed areas.

After Filatov et al., "2D SLAM Quality Evaluation Methods", FRUCT 2017: of two maps of one place, the one with fewer
occupied cells, corners and enclosed areas is the better one; a wall that is drawn twice has more of each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy import ndimage

from mavnav.grid import OCCUPIED, UNKNOWN

if TYPE_CHECKING:
    from numpy.typing import NDArray

CORNER_RADIUS_M: Final = 0.15
"""Edges are collected within about this distance, and two corners are not nearer to one another."""

CORNER_SHARE: Final = 0.35
"""A corner has edges across its strongest direction, this strong compared to the walls of the map."""

LEAST_AREA_M2: Final = 0.01


@dataclass(frozen=True, slots=True)
class EnclosedAreas:
    """Areas that are not occupied, but closed in by occupied cells (8-connected)."""

    count: int
    area_m2: float


def occupied_share(cells: NDArray[np.int8]) -> float:
    """Return the part of the known cells that is occupied; NaN where nothing is known."""
    known = int(np.count_nonzero(cells != UNKNOWN))
    return np.count_nonzero(cells == OCCUPIED) / known if known else np.nan


def enclosed_areas(cells: NDArray[np.int8], cell_m: float) -> EnclosedAreas:
    """Count the areas of `LEAST_AREA_M2` or more from which no way leads out but across occupied cells."""
    labels, _ = ndimage.label(np.pad(cells != OCCUPIED, 1, constant_values=True))
    sizes_m2 = np.bincount(labels.ravel())[1:] * cell_m**2
    enclosed = np.delete(sizes_m2, labels[0, 0] - 1)
    enclosed = enclosed[enclosed >= LEAST_AREA_M2 - 1e-12]
    return EnclosedAreas(len(enclosed), float(enclosed.sum()))


def corners(cells: NDArray[np.int8], cell_m: float) -> int:
    """Count the corners: places where the image of the occupied cells changes in two directions.

    The smaller eigenvalue of the structure tensor (Shi and Tomasi 1994) has a local maximum there, compared with the
    larger one along the walls of the same map.
    """
    occupied = cells == OCCUPIED
    if not occupied.any():
        return 0
    radius = max(CORNER_RADIUS_M / cell_m, 2.0)
    image = np.pad(occupied.astype(np.float32), int(2 * radius))
    gx, gy = (ndimage.gaussian_filter(image, 1.5, order=order) for order in ((0, 1), (1, 0)))
    xx, xy, yy = (ndimage.gaussian_filter(g, radius / 2.0) for g in (gx * gx, gx * gy, gy * gy))
    mean, half = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
    weak, strong = mean - half, mean + half
    typical = float(np.median(strong[image > 0]))
    peaks = (weak == ndimage.maximum_filter(weak, 2 * int(radius) + 1)) & (weak >= CORNER_SHARE * typical)
    return int(ndimage.label(peaks, np.ones((3, 3)))[1])
