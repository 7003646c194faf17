"""Wall spread: the width of the hits across a wall, which does not depend on the number of scans.

Single scans show the position and direction of straight walls even if the map is blurred. There the hits of the map are
summed along the wall, and the width that holds 95 % of those in its ridge is measured. Definition: docs/metrics.md. The
section ``wall_thickness`` of run.json begins with it; the `wall_thickness` in cells follows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.kernels.walls.profiles import wall_profiles
from mavnav.kernels.walls.straight_beams import straight_beams
from mavnav.mapping.occupancy_grid import Grid
from mavnav.metrics.fields import ABSENT, OPTIONAL, Measured, number, text
from mavnav.metrics.journey import PlacedScans, spread
from mavnav.metrics.walls import Array, Sections, WallThickness, link, quantiles, summary
from mavnav.units import DEG, MM

WALL_SCANS: Final = 200
SPACING_M: Final = 0.02
RADII_M: Final = np.array((0.25, 0.5, 1.0))
LEAST_REACH, MAX_RATIO, MIN_POINTS = 0.7, 0.1, 6

TILE_M: Final = 0.05
DIRECTIONS: Final = 8
MIN_SEEN: Final = 2.0
"""Minimum number of beams that saw a straight wall in a tile that counts as wall."""

LINK_M, ACROSS_M, TURN_RAD = 0.2, 0.06, 15.0 * DEG
"""Largest distances along and across, and largest difference of direction, of linked cuts of one wall."""

HALF_LENGTH_M, REACH_M = 0.15, 0.75
NEAR_M: Final = 0.1
PEAK_SHARE: Final = 0.2
GAP_M: Final = 0.04
MIN_HITS: Final = 10
MAX_WIDTH_M: Final = 0.6
HELD: Final = (0.025, 0.975)

AT_A_TIME: Final = 2000

WIDTH: Final = "width that holds 95 % of the hits of the ridge"

PAPER_MIN_HITS: Final = 2
"""Hit threshold of the paper's count: the paper names none, and this one leaves out single stray hits."""


class WallSpread(Struct, frozen=True):
    """Summary of all measured walls, weighted by length of wall; NaN if none was measured.

    ``measured_share`` is the share, by length, of the walls that the scans saw which could be measured in the map.
    """

    median_mm: Annotated[
        Measured, number(f"{WIDTH}; half of the wall length is at most this thick", title="wall median", better="lower")
    ]
    p95_mm: Annotated[
        Measured, number(f"{WIDTH}; 95 % of the wall length is at most this thick", title="wall p95", better="lower")
    ]
    median_cells: Annotated[Measured, number("the median in cells of the map")]
    p95_cells: Annotated[Measured, number("the p95 in cells of the map")]
    length_m: Annotated[float, number("length of the measured wall")]
    measured_share: Annotated[
        Measured, number("part of the walls that the scans saw which could be measured on the map", better="higher")
    ]


class WallCuts(Struct, frozen=True):
    """Cuts across the walls that the scans saw, (n,) each.

    ``xy_m`` (n, 2) is the middle of the wall in the map frame, ``direction_rad`` its direction. ``width_m`` is the
    width that holds 95 % of the hits of its ridge, NaN if the map has no measurable wall there. ``length_m`` is the
    length of wall that the cut represents.
    """

    xy_m: Array
    direction_rad: Array
    width_m: Array
    length_m: Array


class PaperCells(Struct, frozen=True):
    """The paper's count: cells from the first to the last occupied cell across a wall, of at least ``min_hits``."""

    min_hits: Annotated[int, number("a cell is occupied from so many hits on")]
    median: Annotated[Measured, number("half of the wall length is at most so many cells thick", unit="cells")]
    p95: Annotated[Measured, number("95 % of the wall length is at most so many cells thick", unit="cells")]
    max: Annotated[
        Measured, number("cells of the thickest section of a wall", title="wall max", unit="cells", better="lower")
    ]


class WallThicknessReport(Struct, frozen=True, rename=lambda name: name.removeprefix("hits_")):
    """Wall thickness: the spread of hits across the walls, the paper's count of cells, and the published map's walls.

    The sections under a number use that hit threshold.
    """

    spread: WallSpread = OPTIONAL
    paper_cells: PaperCells = OPTIONAL
    hits_1: Annotated[WallThickness, text("cells of at least 1 hit")] = OPTIONAL
    hits_2: Annotated[WallThickness, text("cells of at least 2 hits")] = OPTIONAL
    hits_5: Annotated[WallThickness, text("cells of at least 5 hits")] = OPTIONAL
    published_map: Annotated[WallThickness, text("occupied cells of map.pgm, as of any tool's map file")] = OPTIONAL


def wall_report(
    sections: Mapping[int, Sections], published: Sections | None, cuts: WallCuts | None, cell_m: float
) -> WallThicknessReport:
    """Return the summary of the sections at each hit threshold, of the published map, and of the cuts, unless None."""
    by_hits = {hits: summary(cut, cell_m) for hits, cut in sections.items()}
    paper = by_hits.get(PAPER_MIN_HITS)
    sizes = (paper.median_cells, paper.p95_cells, paper.max_cells) if paper else ()
    return WallThicknessReport(
        spread=ABSENT if cuts is None else wall_spread(cuts, cell_m),
        paper_cells=PaperCells(PAPER_MIN_HITS, *sizes) if sizes else ABSENT,
        **{f"hits_{hits}": thickness for hits, thickness in by_hits.items()},
        published_map=ABSENT if published is None else summary(published, cell_m),
    )


def wall_spread(cuts: WallCuts, cell_m: float) -> WallSpread:
    """Return the summary of cuts through a map with cells of that size."""
    measured = np.isfinite(cuts.width_m)
    _, p95_m, median_m = quantiles(cuts.width_m[measured], cuts.length_m[measured])
    length_m, wanted_m = float(cuts.length_m[measured].sum()), float(cuts.length_m.sum())
    share = length_m / wanted_m if wanted_m else np.nan
    return WallSpread(median_m / MM, p95_m / MM, median_m / cell_m, p95_m / cell_m, length_m, share)


def cut_walls(grid: Grid, scans: PlacedScans | None, tracked: int) -> WallCuts:
    """Cut a map across where its scans saw straight walls.

    ``scans`` are some of the ``tracked`` scans of the run, evenly spread; None without any.
    """
    stations, seen = _stations(*wall_points(scans)) if scans is not None else (np.zeros((0, 3)), np.zeros(0))
    sampled = 0 if scans is None else min(len(scans.poses), WALL_SCANS)
    stations = stations[seen * tracked >= MIN_SEEN * sampled]
    middle_m, width_m = _widths(grid, stations)
    normals = np.column_stack((-np.sin(stations[:, 2]), np.cos(stations[:, 2])))
    xy_m = stations[:, :2] + middle_m[:, None] * normals
    return WallCuts(xy_m, stations[:, 2], width_m, _lengths(xy_m, stations[:, 2]))


def wall_points(scans: PlacedScans) -> tuple[Array, Array]:
    """Return the end points (n, 2) on straight walls, map frame, and the walls' directions there (n,), rad."""
    xy_m, direction = [np.zeros((0, 2))], [np.zeros(0)]
    c, s = np.cos(scans.poses[:, 2]), np.sin(scans.poses[:, 2])
    turns = np.stack((c, s, -s, c), axis=1).reshape(-1, 2, 2)
    for k in spread(len(scans.poses), WALL_SCANS):
        ranges_m, directions = scans.recorded_beams(k)
        ends = ranges_m[:, None] * directions
        angles_rad = straight_beams(ends, SPACING_M, RADII_M, LEAST_REACH, MAX_RATIO, MIN_POINTS)
        on_wall = np.isfinite(angles_rad)
        xy_m.append(ends[on_wall] @ turns[k] + scans.poses[k, :2])
        direction.append(angles_rad[on_wall] + scans.poses[k, 2])
    return np.concatenate(xy_m), np.concatenate(direction)


def _stations(xy_m: Array, direction: Array) -> tuple[Array, Array]:
    """Return the means of the points of each tile and direction, (n, 3) x, y and direction, and their numbers (n,)."""
    sector = np.round(direction / (np.pi / DIRECTIONS)) % DIRECTIONS
    col, row = np.floor(xy_m / TILE_M).T
    key = (row * (np.ptp(col) + 1.0 if len(col) else 1.0) + col) * DIRECTIONS + sector  # whole numbers
    _, tile, seen = np.unique(key, return_inverse=True, return_counts=True)

    def total(values: Array) -> Array:
        return np.bincount(tile, values, len(seen)).astype(np.float64)

    x, y = total(xy_m[:, 0]) / seen, total(xy_m[:, 1]) / seen
    mean = 0.5 * np.arctan2(total(np.sin(2.0 * direction)), total(np.cos(2.0 * direction)))
    return np.column_stack((x, y, mean)), seen.astype(np.float64)


def _lengths(xy_m: Array, direction: Array) -> Array:
    """Return the length of wall that each cut (n,) represents, m: halfway to the next cuts along the wall.

    Cuts next to each other across a blurred wall share the length.
    """
    wall = link(xy_m, direction, reach_m=LINK_M, across_m=ACROSS_M, turn_rad=TURN_RAD)
    c, s = (np.bincount(wall, turn(2.0 * direction)) for turn in (np.cos, np.sin))
    mean = 0.5 * np.arctan2(s, c)[wall]
    along = xy_m[:, 0] * np.cos(mean) + xy_m[:, 1] * np.sin(mean)
    order = np.lexsort((along, wall))
    same = np.diff(wall[order]) == 0
    halves = np.where(same, np.minimum(np.diff(along[order]), LINK_M), TILE_M) / 2.0
    edge = np.full(min(len(xy_m), 1), TILE_M / 2.0)
    length_m = np.zeros(len(xy_m))
    length_m[order] = np.concatenate((edge, halves)) + np.concatenate((halves, edge))
    return length_m


def _widths(grid: Grid, stations: Array) -> tuple[Array, Array]:
    """Return the offset of the middle of the wall to the left of each station, m, and its width, m.

    Without a wall the offset is 0 and the width NaN.
    """
    half_length, reach = (max(round(size_m / grid.cell_m), 1) for size_m in (HALF_LENGTH_M, REACH_M))
    cells = np.column_stack(((stations[:, :2] - grid.origin_xy_m) / grid.cell_m - 0.5, stations[:, 2]))
    parts = [
        _ridges(wall_profiles(grid.hits, cells[k : k + AT_A_TIME], half_length, reach), grid.cell_m / 2.0)
        for k in range(0, max(len(cells), 1), AT_A_TIME)
    ]
    middle, width, mean_hits = (np.concatenate(part) for part in zip(*parts, strict=True))
    measured = (mean_hits * half_length >= MIN_HITS) & (width <= MAX_WIDTH_M)
    return middle, np.where(measured, width, np.nan)


def _ridges(halves: Array, bin_m: float) -> tuple[Array, Array, Array]:
    """Measure the ridge of hits at the middle of each profile.

    ``halves`` (n, 2, bins) are the mean hits a cell on either half of a stretch of wall, every half cell across it.
    Returns (n,) each: the offset of the mean of the hits to the left of the profile's middle, m, the width that holds
    95 % of them, m, and the hits of the ridge per cell along the wall. The width is inf if a ridge has no end.
    """
    total = halves.sum(axis=1)
    smooth = [_smooth(part) for part in (total, halves[:, 0], halves[:, 1])]
    bins, rows = total.shape[1], np.arange(len(total))
    near = int(NEAR_M / bin_m)
    peak = bins // 2 - near + np.argmax(smooth[0][:, bins // 2 - near : bins // 2 + near + 1], axis=1)
    for _ in range(3):  # the peak of the ridge may lie farther away than `NEAR_M`
        first, last = _extents(smooth, peak, bin_m)
        inside = (np.arange(bins) >= first[:, None]) & (np.arange(bins) <= last[:, None])
        before, peak = peak, np.argmax(np.where(inside, smooth[0], -1.0), axis=1)
        if (peak == before).all():
            break
    hits = np.where(inside, total, 0.0)
    low, high = (_quantile(hits, share) for share in HELD)
    count = hits.sum(axis=1)
    middle = (hits @ np.arange(bins)) / np.maximum(count, 1e-12) - bins // 2
    ended = (first > 0) & (last < bins - 1) & (smooth[0][rows, peak] > 0.0)
    return (np.where(count > 0.0, middle, 0.0) * bin_m, np.where(ended, (high - low) * bin_m, np.inf), 0.5 * count)


def _smooth(profile: Array) -> Array:
    """Return the mean of each bin and its two neighbours."""
    padded = np.pad(profile, ((0, 0), (1, 1)))
    return (padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]) / 3.0


def _extents(smooth: list[Array], peak: NDArray[np.intp], bin_m: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first and last bin of the ridge around each peak.

    The ridge is where the profile exceeds a share of the peak, on both halves of the stretch: a wall that ends at this
    one lies on one half only. Short gaps are bridged.
    """
    total, behind, ahead = smooth
    rows, bins, gap = np.arange(len(total)), total.shape[1], int(GAP_M / bin_m + 0.5)
    least = PEAK_SHARE * total[rows, peak][:, None]
    above = (total > least) & (np.minimum(behind, ahead) > 0.25 * least)
    above[rows, peak] = True
    at = np.arange(bins, dtype=np.int16)  # a quarter of the memory of int64
    before = np.maximum.accumulate(np.where(above, at, np.int16(-bins)), axis=1)
    after = np.minimum.accumulate(np.where(above, at, np.int16(2 * bins))[:, ::-1], axis=1)[:, ::-1]
    outside = after - before - 1 > gap
    first = np.maximum.accumulate(np.where(outside, at, np.int16(-1)), axis=1)[rows, peak] + 1
    last = np.minimum.accumulate(np.where(outside, at, np.int16(bins))[:, ::-1], axis=1)[:, ::-1][rows, peak] - 1
    return first.astype(np.intp), last.astype(np.intp)


def _quantile(hits: Array, share: float) -> Array:
    """Return the position below which a share of the hits of each profile lies, in bins from the edge of the first."""
    below = np.cumsum(hits, axis=1)
    wanted = share * below[:, -1]
    at = np.argmax((below >= wanted[:, None]) & (hits > 0.0), axis=1)
    rows = np.arange(len(hits))
    inside = hits[rows, at]
    return np.asarray(at + 1.0 - (below[rows, at] - wanted) / np.where(inside > 0.0, inside, 1.0))
