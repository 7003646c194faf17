"""Alignment of two maps: virtual scans of one are searched in the other, one by one or together, and must agree."""

from __future__ import annotations

import math
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.mapping.occupancy_grid import FREE, OCCUPIED, Grid, GridBuilder, cell_centres, occupancy
from mavnav.mapping.tiled_arrays import farther, in_strips
from mavnav.pose import Pose, rigid_fit, transform_points
from mavnav.slam.matching import relocalization
from mavnav.slam.matching.placement import PosedScan, place_together
from mavnav.slam.matching.prior_map import PriorMap
from mavnav.slam.matching.scan_matching import Schedule, empty_line_map, search_lines
from mavnav.slam.matching.steps import NEARLY_ALL
from mavnav.slam.methods.acceptance import Acceptance
from mavnav.slam.recovery.parts import consensus
from mavnav.units import DEG

Placed = tuple[Pose, Pose]
"""The pose of a virtual scan in its own map ``b``, and in map ``a``."""

VIEWPOINTS = 12
"""Number of positions of virtual scans, each as far as possible from the others."""

CLEARANCE_M = 0.3
"""These positions are farther from walls and unknown cells."""

MOST_CELLS = 4000
"""Maximum number of points of a sample: of free cells for the positions, of walls for the refinement."""

LARGE_CELLS = 1 << 22
"""Number of cells from which not every one of them is a possible position."""

BEAMS, FAR_M = 360, 15.0
"""Number of beams of a virtual scan, over a full turn, and their maximum range, m."""

NEAR_M, NEAR_RAD = 1.0, 15 * DEG
"""Half-widths of the first search, which assumes that both maps have nearly the same frame."""

MOST_SEEN = 0.8
"""Share of the free cells that fewer beams crossed than those from which a coarse map is searched.

The others lie in rooms that were only looked into, of which another map may show another part.
"""

LEAST_INLIERS = 0.5
"""Minimum share of inliers of a virtual scan; the others may lie on changes, or beyond the other map."""

CLEARLY_LESS = 0.5
"""Ratio of costs from which another place is taken than the one near the same frame that most scans agree on."""

REFINED_M, REFINED_RAD = 0.2, 2 * DEG
"""Half-widths of the search that refines the alignment."""


class Alignment(NamedTuple):
    """The pose of map ``b`` in map ``a``, the number of virtual scans, and how many of them agree on it.

    ``cost_m2`` is the mean squared distance of the walls of ``b`` from those of ``a``, truncated.
    """

    a_T_b: Pose
    taken: int
    agreeing: int
    cost_m2: float


def align(a: PriorMap, b: PriorMap, config: Config) -> tuple[Alignment | None, bool]:
    """Find map ``b`` in map ``a`` near the same frame, or unless nearly all scans agree there, anywhere.

    Where most agree near it, walls must fit clearly better elsewhere. None unless at least three virtual scans of
    ``b``, and most of those that are found in ``a``, agree, or all scans fit together at just one place: in a coarse
    map each of them fits at many. Where not most of all scans agree, those of ``a`` must agree in ``b``, too. Also
    returns whether the searches came to their end, of which each has a credit.
    """
    credit, credit_together = relocalization.search_credit(), relocalization.search_credit()
    alignment = _one_by_one(a, b, config, credit)
    if alignment and 2 * alignment.agreeing <= alignment.taken and not _is_mutual(alignment, a, b, config):
        alignment = None
    alignment = alignment or _together(a, b, config, credit_together)
    return alignment, bool(credit[0] and credit_together[0])


def _is_mutual(alignment: Alignment, a: PriorMap, b: PriorMap, config: Config) -> bool:
    """Return whether map ``a`` is found in map ``b`` where an alignment of ``b`` has it."""
    back, middle = _one_by_one(b, a, config, relocalization.search_credit()), Pose(*b.walls_xy_m.mean(axis=0).tolist())
    return back is not None and not relocalization.apart(alignment.a_T_b @ middle, back.a_T_b.inverse() @ middle)


def _one_by_one(a: PriorMap, b: PriorMap, config: Config, credit: relocalization.Credit) -> Alignment | None:
    """Return the better alignment on which virtual scans of ``b`` agree; None if too few do."""
    target, scans = _Target(a, config, credit), virtual_scans(b, config)
    near = _alignment(target, target.place_scans(scans, anywhere=False), b, len(scans))
    if near and near.agreeing >= NEARLY_ALL * near.taken:
        return near
    far = _alignment(target, target.place_scans(scans, anywhere=True), b, len(scans))
    if near and 2 * near.agreeing > near.taken and far and far.cost_m2 > CLEARLY_LESS * near.cost_m2:
        return near
    return min((alignment for alignment in (near, far) if alignment), key=attrgetter("cost_m2"), default=None)


def _alignment(target: _Target, pairs: list[Placed], b: PriorMap, taken: int) -> Alignment | None:
    """Return the refined alignment on which the virtual scans agree; None if too few agree."""
    a_T_b = consensus(pairs)
    if a_T_b is None:
        return None
    agreeing = [pair for pair in pairs if not relocalization.apart(a_T_b @ pair[0], pair[1])]
    refined, cost_m2 = target.refine(fit_transform(agreeing), b)
    return Alignment(refined, taken, len(agreeing), cost_m2)


def _together(a: PriorMap, b: PriorMap, config: Config, credit: relocalization.Credit) -> Alignment | None:
    """Return the alignment at which scans of the finer map, from where it was seen most, fit the coarser one together.

    None if they do not fit, fit at another place about as well, or the credit ends.
    """
    if not credit[0]:
        return None
    if a.grid.cell_m < b.grid.cell_m:
        swapped = _together(b, a, config, credit)
        return swapped and swapped._replace(a_T_b=swapped.a_T_b.inverse())
    target, scans = _Target(a, config, credit), virtual_scans(b, config, MOST_SEEN)
    match = place_together(scans, target.lines, target.grid, config, credit=credit)
    if match is None or not Acceptance(config.robust).is_good(match):
        return None
    refined, cost_m2 = target.refine(match.map_T_laser, b)
    return Alignment(refined, len(scans), len(scans), cost_m2)


class _Target:
    """The map in which another map is searched."""

    def __init__(self, known: PriorMap, config: Config, credit: relocalization.Credit) -> None:
        self.config, self.credit, self.grid = config, credit, _for_look_ups(known.grid, known.grid.hits)
        self.lines = empty_line_map(config, known.grid.cell_m)
        self.lines.insert(known.walls_xy_m)

    def place_scans(self, scans: list[PosedScan], *, anywhere: bool) -> list[Placed]:
        """Return the poses of those scans that fit the map at exactly one pose."""
        all_over = relocalization.everywhere(self.grid) if anywhere else None
        places = (
            (pose, self._place(points, all_over or relocalization.around(pose, NEAR_M, NEAR_RAD)))
            for pose, points in scans
        )
        return [(pose, place) for pose, place in places if place]

    def _place(self, points: NDArray[np.float64], region: relocalization.Region) -> Pose | None:
        matches = relocalization.candidates(
            points, self.lines, self.grid, region, self.config, relocalization.MAP_CANDIDATES, credit=self.credit
        )
        best = relocalization.unambiguous(matches, relocalization.AMBIGUITY_MARGIN, self.config)
        return best.map_T_laser if best and best.inliers >= LEAST_INLIERS else None

    def refine(self, a_T_b: Pose, b: PriorMap) -> tuple[Pose, float]:
        """Refine an alignment by the least distance of the walls of ``b``; return it with its cost, m2."""
        walls_xy_m = _sample(b.walls_xy_m)
        middle = Pose(*walls_xy_m.mean(axis=0).tolist())
        schedule = Schedule.of(self.config, self.lines, (REFINED_M, REFINED_RAD))
        points = transform_points(middle.inverse(), walls_xy_m)
        match = search_lines(points, self.lines, a_T_b @ middle, schedule)
        return match.map_T_laser @ middle.inverse(), match.cost_m2


def fit_transform(pairs: list[Placed]) -> Pose:
    """Return the transform from the positions of the first poses to those of the second, by least squares."""
    return rigid_fit(*(np.array([pair[k][:2] for pair in pairs]) for k in (0, 1)))


def virtual_scans(known: PriorMap, config: Config, seen_above: float = 0.0) -> list[PosedScan]:
    """Return virtual scans of a map: poses, and points (n, 2) in their frames, m, in shuffled order.

    They are taken from the free cells that are crossed by more beams than ``seen_above``, a share, of them.
    """
    cells, angles_rad = occupancy(known.grid), np.arange(BEAMS) * (2 * np.pi / BEAMS)
    seen, free = _for_look_ups(known.grid, (cells == OCCUPIED).astype(np.uint16)), cells == FREE
    directions, scans = np.column_stack((np.cos(angles_rad), np.sin(angles_rad))), []
    if free.any():
        free &= known.grid.passes >= np.quantile(known.grid.passes[free], seen_above, method="higher")
    for x_m, y_m in viewpoints(known.grid, free).tolist():
        pose = Pose(x_m, y_m, 0.0)
        points = seen.virtual_scan(pose, directions, FAR_M, 0)[:, None] * directions
        points = _sample(points[np.isfinite(points).all(axis=1)])
        if len(points) >= config.robust.min_points:
            scans.append((pose, points))
    return scans


def viewpoints(grid: Grid, free: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Choose up to ``VIEWPOINTS`` positions (n, 2), m, in free space, each as far as possible from those before it."""
    clear = farther(free, CLEARANCE_M, grid.cell_m, outside=False)
    step = 1 + math.isqrt(clear.size // LARGE_CELLS)
    row, col = step * np.argwhere(clear[::step, ::step]).T
    xy_m = _sample(cell_centres(grid, row, col))
    chosen, away_m = list[int](), np.full(len(xy_m), np.inf)
    for _ in range(min(VIEWPOINTS, len(xy_m))):
        chosen.append(int(np.argmax(away_m)))
        away_m = np.minimum(away_m, np.hypot(*(xy_m - xy_m[chosen[-1]]).T))
    return xy_m[chosen]


def _for_look_ups(grid: Grid, hits: NDArray[np.uint16]) -> GridBuilder:
    """Return other hits in strips, with the crossings of a grid."""
    return GridBuilder(grid.cell_m, grid.origin_xy_m, in_strips(hits), np.ascontiguousarray(grid.passes))


def _sample(xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return up to ``MOST_CELLS`` of the points (n, 2), shuffled, so that any prefix is a fair sample."""
    return np.asarray(xy_m[np.random.default_rng(0).permutation(len(xy_m))[:MOST_CELLS]])
