"""The profile of map quality: a fixed set of numbers, and whether they are meaningful.

They are if there is enough map, and enough of the log in it: the support. A profile never changes: another definition
or threshold is another profile. Definitions: docs/metrics.md.

The shape of a map, without a truth, is crispness, occupied share, corners, enclosed areas. Crispness is the number of
occupied cells per metre of wall, and the entropy of these cells. The others are after Filatov et al., "2D SLAM Quality
Evaluation Methods", FRUCT 2017: of two maps of one place, the one with fewer occupied cells, corners and enclosed areas
is better, because a wall that is drawn twice has more of each.
"""

from __future__ import annotations

from math import ceil, sqrt
from typing import Annotated, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.kernels.maps.hits import show_ends
from mavnav.kernels.maps.regions import region_sizes
from mavnav.kernels.walls.smoothing import smooth_image
from mavnav.mapping.occupancy_grid import OCCUPIED, UNKNOWN, Grid, occupancy, occupied_cells
from mavnav.mapping.tiled_arrays import bands, count, max_pool, where
from mavnav.metrics.doubled_walls import doubled_walls, key_rows
from mavnav.metrics.fields import Measured, number
from mavnav.metrics.ghost_walls import GhostWalls, ghost_walls
from mavnav.metrics.journey import Journey, PlacedScans, placed_scans, spread
from mavnav.metrics.revisits import Pairs, Revisits, long_pairs, revisits, short_pairs
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
    pairs = Pairs(short_pairs(trajectory.stamps_ns), long_pairs(trajectory))
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
