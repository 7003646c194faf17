"""Shape of a map, without a truth: crispness, occupied share, corners, enclosed areas.

Crispness is the number of occupied cells per metre of wall, and the entropy of these cells. The others are after
Filatov et al., "2D SLAM Quality Evaluation Methods", FRUCT 2017: of two maps of one place, the one with fewer occupied
cells, corners and enclosed areas is better, because a wall that is drawn twice has more of each.
"""

from __future__ import annotations

from typing import Annotated, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.kernels.maps.regions import region_sizes
from mavnav.kernels.walls.smoothing import smooth_image
from mavnav.mapping.occupancy_grid import OCCUPIED, UNKNOWN, Grid
from mavnav.mapping.tiled_arrays import bands, count, where
from mavnav.metrics.fields import Measured, number

CORNER_RADIUS_M: Final = 0.15
"""Approximate radius of the window of the structure tensor, and minimum distance of two corners."""

FINE_CELL_M, COARSE_RADIUS_CELLS = 0.02, 8.5
"""Size up to which cells are fine, and the radius in maps of larger ones, whose walls are widened by a cell first.

In a small window the steps of a slanted wall count as corners, and without widening a wall of one cell at 45 degrees is
half as strong as one of two.
"""

CORNER_SHARE: Final = 0.35
"""Minimum strength of the edge across the strongest direction of a corner, as a share of that of walls."""

SLOPE_CELLS: Final = 1.5
"""Standard deviation of the Gaussian whose derivatives are the slopes."""

LEAST_AREA_M2: Final = 0.01


class Crispness(Struct, frozen=True):
    """Occupied cells per metre of wall and entropy of the cells; null where unknown."""

    occupied_cells_per_m: Annotated[
        Measured, number("occupied cells per meter of wall", title="cells per m", better="lower")
    ]
    entropy_bits: Annotated[
        Measured, number("mean entropy of a hit cell; lower is crisper", title="entropy", better="lower")
    ]


class EnclosedAreas(Struct, frozen=True):
    """Areas that are not occupied, but enclosed by occupied cells (8-connected)."""

    count: Annotated[int, number("enclosed areas")]
    area_m2: Annotated[float, number("sum of the enclosed areas")]


def crispness(grid: Grid, cells: NDArray[np.int8], wall_m: float, *, counted: bool) -> Crispness:
    """Return the crispness of a map with occupancy ``cells``; ``counted``: hits and crossings are real counts."""
    occupied = count(cells, lambda some: some == OCCUPIED)
    return Crispness(
        occupied_cells_per_m=float(occupied / wall_m) if wall_m else np.nan,
        entropy_bits=entropy_bits(grid) if counted else np.nan,
    )


def entropy_bits(grid: Grid) -> float:
    """Return the mean entropy of the cells that were hit, with the share of beams that ended there as probability.

    It is 0 if every cell stops every beam that reaches it, and 1 at worst. Free space that was never hit is left out,
    because a large free area would hide blurred walls. NaN without any hit.
    """
    row, col = where(grid.hits, lambda some: some > 0).T
    hits = grid.hits[row, col].astype(np.float64)
    p = hits / (hits + grid.passes[row, col])
    if not len(p):
        return np.nan
    q = 1.0 - p
    log_q = np.log2(q, out=np.zeros_like(q), where=q > 0.0)
    return float(-(p * np.log2(p) + q * log_q).mean()) + 0.0


def occupied_share(cells: NDArray[np.int8]) -> float:
    """Return the share of the known cells that is occupied; NaN without known cells."""
    known = count(cells, lambda some: some != UNKNOWN)
    return count(cells, lambda some: some == OCCUPIED) / known if known else np.nan


def enclosed_areas(cells: NDArray[np.int8], cell_m: float) -> EnclosedAreas:
    """Return the areas of `LEAST_AREA_M2` or more that are enclosed by occupied cells."""
    sizes = region_sizes(np.pad(cells != OCCUPIED, 1, constant_values=True), False)
    areas_m2 = sizes[1:] * cell_m**2  # the first one is the area around the map
    enclosed = areas_m2[areas_m2 >= LEAST_AREA_M2 - 1e-12]
    return EnclosedAreas(len(enclosed), float(enclosed.sum()))


def corners(cells: NDArray[np.int8], cell_m: float) -> int:
    """Return the number of corners: points where the image of the occupied cells changes in two directions.

    There the smaller eigenvalue of the structure tensor (Shi and Tomasi 1994) has a local maximum; its threshold is
    relative to the larger eigenvalue along the walls of the same map.
    """
    coarse = cell_m > FINE_CELL_M
    radius = COARSE_RADIUS_CELLS if coarse else CORNER_RADIUS_M / cell_m
    occupied = np.pad(cells == OCCUPIED, int(2 * radius))
    if not occupied.any():
        return 0
    heights, peaks, walls = np.zeros(occupied.shape, np.float32), np.zeros_like(occupied), []
    reach = int(4.0 * SLOPE_CELLS + 0.5) + int(2.0 * radius + 0.5) + int(radius) + coarse
    for around, inside, band in bands(occupied.shape, margin=reach):
        image = dilate(occupied[around]) if coarse else occupied[around]
        weak, strong = edges(image.astype(np.float32), radius)
        walls.append(strong[inside][image[inside]])
        del image, strong  # bands of large maps have wide margins
        peaks[band] = (weak == highest(weak, int(radius)))[inside]
        some = peaks[band] & (weak[inside] != 0.0)
        heights[band][some] = weak[inside][some]
    least = CORNER_SHARE * float(np.median(np.concatenate(walls, dtype=np.float64)))
    for _, _, band in bands(occupied.shape):
        peaks[band] &= heights[band] >= least
    return len(region_sizes(peaks, True))


def dilate(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask (rows, cols) dilated by the eight neighbours of its cells."""
    around = np.pad(mask, 1)
    rows = around[:-2] | around[1:-1] | around[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]


def edges(image: NDArray[np.float32], radius: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the eigenvalues of an image's structure tensor (rows, cols): across the strongest direction, and along."""
    steep, wide = gaussian(SLOPE_CELLS), gaussian(radius / 2.0)
    slope = np.arange(len(steep)) / SLOPE_CELLS**2 * steep
    gx, gy = smooth_image(image, steep, slope, 1.0, -1.0), smooth_image(image, slope, steep, -1.0, 1.0)
    xx, xy, yy = (smooth_image(g, wide, wide, 1.0, 1.0) for g in (gx * gx, gx * gy, gy * gy))
    mean, half = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
    return mean - half, mean + half


def gaussian(sigma_cells: float) -> NDArray[np.float64]:
    """Return the weights of a normal distribution from the middle to four sigma; those of both sides sum to 1."""
    far = int(4.0 * sigma_cells + 0.5)
    weights = np.exp(-0.5 / sigma_cells**2 * np.arange(-far, far + 1) ** 2)
    return np.asarray((weights / weights.sum())[far:])


def highest(image: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Return the greatest value within ``reach`` cells of each cell (rows, cols), along the rows and the columns."""
    for _ in range(2):
        span, size = np.pad(image, ((reach, reach), (0, 0)), constant_values=-np.inf), 1
        while 2 * size <= 2 * reach + 1:
            span, size = np.maximum(span[:-size], span[size:]), 2 * size
        shift = 2 * reach + 1 - size
        image = (np.maximum(span[: len(image)], span[shift : shift + len(image)])).T
    return image
