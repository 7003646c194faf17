"""Scan matching: where in the map is this scan? Both methods search grids by brute force, coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavnav.kernels.line_search import search as line_search
from mavnav.pose import Pose, wrap_angle
from mavnav.stages import timed
from mavnav.units import DEG, MM, MM2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.config import Config, GridSize
    from mavnav.linemap import LineMap
    from mavnav.scan import LaserSpec


class Match(NamedTuple):
    """The best pose of a scan in the map, with its evidence.

    ``cost_m2`` is the mean squared distance over ``beams_used`` contributing beams (inf where too few
    contribute), ``inliers`` the share of the scan that agrees with the map, ``evaluations`` the number of
    candidate poses whose cost was asked for, ``iterations`` the number of grids searched. ``conflicts`` is the share
    that the map speaks against, ``surprise`` how far the place is from the expected one (1: as far as strong
    acceleration reaches), and ``ambiguous`` tells that another place would explain the scan about as well
    (``relocalise``).
    """

    map_T_laser: Pose
    cost_m2: float
    beams_used: int
    inliers: float
    evaluations: int
    iterations: int
    converged: bool
    conflicts: float = 0.0
    surprise: float = 0.0
    ambiguous: bool = False


def no_match(map_T_laser: Pose, beams: int = 0) -> Match:
    """Return the match of a scan that cannot be matched."""
    return Match(map_T_laser, np.inf, beams, 0.0, 0, 0, converged=False)


def first_match(beams: int) -> Match:
    """Return the match of the scan that begins the map: it lies where it lies."""
    return Match(Pose(), 0.0, beams, 1.0, 0, 0, converged=True)


HOPELESS = 2.5
"""Times the gate: what costs more is in a wrong place, and a finer grid brought none of 452 such under the gate."""

# ---- the paper's method: radius differences against a virtual scan -------------------------------------------------


def match_polar(
    virtual_m: NDArray[np.float64], points: NDArray[np.float64], spec: LaserSpec, predicted: Pose, config: Config
) -> Match:
    """Match a scan against the virtual scan from the predicted pose (paper, "Scan Matching", minimisation i-v).

    ``virtual_m`` (beams,) are the virtual scan's ranges; ``points`` (n, 5) the real scan's, from ``polar_points``.
    The grid is refined only where the cost on the coarse one stays too high, but not where it is hopeless: of a place
    that is wrong a finer grid makes no right one. A search that can only end there ends at once.
    """
    paper = config.paper
    level = acceptance_scale(points[:, 3], config)
    search = partial(_search_polar, virtual_m, points, spec, predicted, config, level)
    match = search(config.grid, config.azimuth)
    worth_it = paper.refine_above_mm2 < match.cost_m2 / MM2 / level <= _hopeless_mm2(config)
    if not worth_it or paper.refine_factor == 1:
        return match
    k = paper.refine_factor
    fine = search(config.grid.refined(k), config.azimuth * k)
    best = fine if fine.cost_m2 < match.cost_m2 else match
    return with_effort(best, match, fine)


def acceptance_scale(ranges_m: NDArray[np.float64], config: Config) -> float:
    """Return the factor on the acceptance threshold for a scan of these ranges (beams,), m, NaN without a return.

    A range's variance grows with its square (paper, "Laser Scan"), and the paper states its threshold for a typical
    range (paper, "Map Update"): ``gate_range_mm``. The mean is over the ranges between ``near_mm`` and ``far_mm``.
    """
    paper = config.paper
    if paper.gate_range_mm is None:
        return 1.0
    used = ranges_m[(paper.near_mm * MM < ranges_m) & (ranges_m < paper.far_mm * MM)]
    return float(np.mean(np.square(used / (paper.gate_range_mm * MM)))) if len(used) else 1.0


def _hopeless_mm2(config: Config) -> float:
    return max(config.paper.refine_above_mm2, HOPELESS * config.paper.gate_mm2)


@timed("search")
def _search_polar(
    virtual_m: NDArray[np.float64],
    points: NDArray[np.float64],
    spec: LaserSpec,
    predicted: Pose,
    config: Config,
    level: float,
    grid: GridSize,
    azimuth: int,
) -> Match:
    from mavnav.kernels.polar_search import search as polar_search  # noqa: PLC0415  takes 0.2 s to load, and is the paper's alone

    paper = config.paper
    extensions = paper.max_extensions if paper.extend_border else 0
    x, y, yaw, cost, used, evaluations, iterations, converged = polar_search.search(
        virtual_m,
        points,
        np.array([azimuth, grid.nx, grid.ny, extensions, config.search == "pruned"], float),
        np.array(
            [
                paper.window_mm * MM,
                paper.window_deg * DEG,
                paper.shrink,
                paper.leave_no_gaps,
                paper.stop_mm * MM,
                paper.stop_deg * DEG,
                level * _hopeless_mm2(config) * MM2 if paper.give_up else np.inf,
                paper.occlusion_shrink,
                paper.occlusion_least_mm * MM,
                paper.pivot == "laser",
                paper.converged == "either",
            ]
        ),
        np.array(
            [
                spec.angle_min_rad,
                spec.angle_step_rad,
                paper.near_mm * MM,
                paper.far_mm * MM,
                paper.occlusion_mm * MM,
                paper.mixed_pixel_mm * MM,
                max(3.0, paper.min_beams_share * (len(points) if paper.min_beams_of == "valid" else spec.beams)),
                paper.occluded == "counted",
            ]
        ),
    )
    pose = predicted @ Pose(float(x), float(y), wrap_angle(float(yaw)))
    share = float(used) / max(len(points), 1)
    return Match(pose, float(cost), int(used), share, int(evaluations), int(iterations), bool(converged))


@timed("cleaning")
def polar_points(ranges_m: NDArray[np.float64], spec: LaserSpec, mixed_pixel_m: float) -> NDArray[np.float64]:
    """Return the valid beams as rows x, y, beam number, range, bearing, (n, 5); mixed pixels left out (cost step vii).

    A mixed pixel differs from both neighbouring beams by more than ``mixed_pixel_m``.
    """
    from mavnav.kernels import beams  # noqa: PLC0415  the paper's alone

    return beams.good_beams(ranges_m, spec.directions, spec.angle_min_rad, spec.angle_step_rad, mixed_pixel_m)


ALTERNATIONS, FINAL_ALTERNATIONS = 2, 1
"""Joint searches of a level that holds lines, or turns of azimuth and plane; the final pass begins where it ends."""

FINAL_STOP = 0.5
"""Of the spacings at which a search ends, in the final pass: a trajectory of coarser steps is longer than the way."""

# ---- the robust method: distance to the map's local lines ----------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Schedule:
    """How a window of a line map is searched, level by level: ``grid`` and ``limits`` of ``line_search.search``."""

    grid: NDArray[np.float64]
    limits: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        config: Config,
        line_map: LineMap,
        window: tuple[float, float],
        *,
        prior: float = 0.0,
        final: bool = False,
    ) -> Schedule:
        """Schedule a search within ``window``: half-widths, m and rad.

        ``prior`` is what a squared metre away from the start adds to the cost; it decides where the walls do not. In
        the final pass, whose map is finished, points hold their lines on every level.
        """
        robust, grid = config.robust, config.grid
        finer = FINAL_STOP if final else 1.0
        limits = [
            *window,
            finer * robust.stop_mm * MM,
            finer * robust.stop_deg * DEG,
            (robust.final_truncate_mm if final else robust.truncate_mm) * MM,
            robust.first_level_points,
            FINAL_ALTERNATIONS if final else ALTERNATIONS,
            prior,
            robust.hold_below_mm * MM,
            0.0 if final else line_map.cell_m,
            line_map.closeness_at(robust.overlap_mm * MM) if robust.overlap_mm and not final else 0.0,
            line_map.known_points,
            robust.sparse_points,
        ]
        points = [config.azimuth, grid.nx, grid.ny, robust.max_extensions, config.search == "pruned"]
        return cls(np.array(points, float), np.array(limits))


@timed("search")
def search_lines(
    points: NDArray[np.float64], line_map: LineMap, start: Pose, schedule: Schedule, before: Match | None = None
) -> Match:
    """Search once around ``start`` for the place of points (n, 2), laser frame, m.

    A match of the same scan ``before``, which led here, is counted in the effort.
    """
    x, y, yaw, cost, inliers, evaluations, grids, converged = line_search.search(
        points,
        start.as_array(),
        schedule.grid,
        schedule.limits,
        line_map.nearest,
        line_map.lines,
        line_map.geometry,
    )
    if before:
        evaluations, grids = evaluations + before.evaluations, grids + before.iterations
    return Match(Pose(x, y, wrap_angle(yaw)), cost, len(points), inliers, evaluations, grids, converged)


def with_effort(best: Match, *tried: Match) -> Match:
    """Charge a match with the effort of all that were tried for it."""
    if len(tried) == 1 and tried[0] is best:
        return best
    return best._replace(evaluations=sum(m.evaluations for m in tried), iterations=sum(m.iterations for m in tried))
