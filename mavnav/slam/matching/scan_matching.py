"""Scan matching: the record of a match, and the search of the robust method for the least point-to-line distance."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.kernels.line_search import search as line_search
from mavnav.kernels.maps.layout import SearchGrid
from mavnav.mapping.line_map import LineMap
from mavnav.pose import Pose, wrap_angle
from mavnav.profiling import as_stage


class Match(NamedTuple):
    """The best pose of a scan in the map, with its evidence.

    ``cost_m2`` is the mean squared distance over ``beams_used`` contributing beams. If too few contribute, it is inf
    and ``beams_used`` is the number of usable beams. ``inliers`` is the share of the scan that agrees with the map,
    ``evaluations`` the number of candidate poses whose cost was evaluated, ``iterations`` the number of grids searched.
    ``conflicts`` is the share of visibility conflicts. ``motion_cost`` is the distance from the motion prior (1: as far
    as strong acceleration reaches). ``ambiguous`` is true if another pose fits the scan about as well (``relocalize``).
    ``threshold_m2`` is the largest accepted cost, inf if acceptance does not depend on the cost. ``longer`` is the
    share by which the motion since the last pose is longer than wheels say where the match alone decides, and
    ``longer_weight`` the inverse of its variance; 0 without wheels.
    """

    map_T_laser: Pose
    cost_m2: float
    beams_used: int
    inliers: float
    evaluations: int
    iterations: int
    converged: bool
    conflicts: float = 0.0
    motion_cost: float = 0.0
    ambiguous: bool = False
    threshold_m2: float = np.inf
    longer: float = 0.0
    longer_weight: float = 0.0


class MatchVerdict(Enum):
    """Decision on a match: accept it at once, accept it once the next scans agree, or refuse it."""

    SURE = "sure"
    PROBABLE = "probable"
    REFUSED = "refused"


def no_match(map_T_laser: Pose, beams: int = 0) -> Match:
    """Return the match of a scan that cannot be matched."""
    return Match(map_T_laser, np.inf, beams, 0.0, 0, 0, converged=False)


def first_match(beams: int) -> Match:
    """Return the match of the scan that begins the map: its pose is the map frame."""
    return Match(Pose(), 0.0, beams, 1.0, 0, 0, converged=True)


def empty_line_map(
    config: Config, cell_m: float | None = None, *, known_points: float = 0.0, waiting_share: float = 0.0
) -> LineMap:
    """Return an empty map of lines as configured; ``cell_m`` is the edge of its cells if they are those of a grid."""
    robust = config.robust
    cell_m = robust.cell_m if cell_m is None else cell_m
    return LineMap(cell_m, robust.expert.line_sigma_m, robust.expert.line_noise_m, known_points, waiting_share)


ALTERNATIONS, FINAL_ALTERNATIONS = 2, 1
"""Number of searches of a level, also in the final pass, which starts close to its result.

A level with fixed correspondences searches yaw and plane jointly so often; other levels alternate between them.
"""

FINAL_STOP = 0.5
"""Factor on the spacings at which a search ends, in the final pass: coarser steps make the trajectory longer."""


class Schedule(Struct, frozen=True):
    """Parameters of the coarse-to-fine search of a window: ``grid`` and ``limits`` of ``line_search.search``."""

    grid: NDArray[np.float64]
    limits: NDArray[np.float64]

    @classmethod
    def of(
        cls, config: Config, line_map: LineMap, window: tuple[float, float], *, prior: float = 0.0, final: bool = False
    ) -> Schedule:
        """Return the schedule of a search within ``window``: half-widths, m and rad.

        ``prior`` is the additional cost of a squared metre of distance from the start; it decides where the walls leave
        a direction unobservable. In the final pass, whose map is finished, all levels use fixed correspondences.
        """
        robust, grid = config.robust, config.grid
        finer = FINAL_STOP if final else 1.0
        limits = line_search.SearchLimits(
            *window,
            stop_m=finer * robust.expert.stop_m,
            stop_rad=finer * robust.expert.stop_rad,
            truncate_m=robust.expert.final_truncate_m if final else robust.expert.truncate_m,
            few_points=robust.expert.first_level_points,
            alternations=FINAL_ALTERNATIONS if final else ALTERNATIONS,
            prior=prior,
            fixed_below_m=robust.expert.hold_below_m,
            within_below_m=0.0 if final else line_map.cell_m,
            closeness=line_map.closeness_at(robust.expert.overlap_m) if robust.expert.overlap_mm and not final else 0.0,
            known_points=line_map.known_points,
            dense_points=robust.expert.sparse_points,
        )
        most, pruned = robust.expert.max_extensions, config.search == "pruned"
        samples = SearchGrid(config.azimuth, grid.nx, grid.ny, most, prune=pruned)
        return cls(np.array(samples, float), np.array(limits, float))


@as_stage("search")
def search_lines(
    points: NDArray[np.float64], line_map: LineMap, start: Pose, schedule: Schedule, before: Match | None = None
) -> Match:
    """Search once around ``start`` for the pose of points (n, 2), laser frame, m.

    The effort of ``before``, a match of the same scan that provided the start, is added to that of the search.
    """
    x, y, yaw, cost, inliers, evaluations, grids, converged = line_search.search(
        points, start.as_array(), schedule.grid, schedule.limits, line_map.nearest, line_map.lines, line_map.geometry
    )
    if before:
        evaluations, grids = evaluations + before.evaluations, grids + before.iterations
    return Match(Pose(x, y, wrap_angle(yaw)), cost, len(points), inliers, evaluations, grids, converged)


def with_effort(best: Match, *tried: Match) -> Match:
    """Return the best match with the summed effort of all matches that were tried."""
    return best._replace(evaluations=sum(m.evaluations for m in tried), iterations=sum(m.iterations for m in tried))
