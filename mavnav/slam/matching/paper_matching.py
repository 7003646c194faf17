"""The paper's scan matching: a polar search for the least range differences, coarse to fine."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from mavnav.pose import Pose, wrap_angle
from mavnav.profiling import timed
from mavnav.slam.matching.scan_matching import Match, with_effort
from mavnav.units import DEG, MM, MM2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.config.models import Config, GridSize
    from mavnav.scan import LaserSpec

GIVE_UP_RATIO = 2.5
"""Multiple of the acceptance threshold above which a match is not refined.

Such a pose is wrong: of 452 of them, none had a cost below the threshold on the finer grid.
"""


def match_polar(
    virtual_m: NDArray[np.float64], points: NDArray[np.float64], spec: LaserSpec, predicted: Pose, config: Config
) -> Match:
    """Match a scan against the virtual scan from the predicted pose (paper, "Scan Matching", minimisation i-v).

    ``virtual_m`` (beams,) are the virtual scan's ranges; ``points`` (n, 5) the real scan's, from ``polar_points``.
    The grid is refined only if the cost on the coarse one is too high, but not above ``GIVE_UP_RATIO`` times the
    threshold: a finer grid does not correct a wrong pose. A search that can only end above that bound ends early.
    """
    paper = config.paper
    level = acceptance_scale(points[:, 3], config)
    search = partial(_search_polar, virtual_m, points, spec, predicted, config, level)
    match = search(config.grid, config.azimuth)
    worth_it = paper.refine_above_mm2 < match.cost_m2 / MM2 / level <= _give_up_mm2(config)
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


def _give_up_mm2(config: Config) -> float:
    return max(config.paper.refine_above_mm2, GIVE_UP_RATIO * config.paper.gate_mm2)


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
    from mavnav.kernels.polar_search import cost as polar_cost  # noqa: PLC0415
    from mavnav.kernels.polar_search import search as polar_search  # noqa: PLC0415  loads in 0.2 s, only for paper

    paper = config.paper
    extensions = paper.max_extensions if paper.extend_border else 0
    samples = polar_search.SearchGrid(azimuth, grid.nx, grid.ny, extensions, prune=config.search == "pruned")
    schedule = polar_search.Schedule(
        half_m=paper.window_mm * MM,
        half_rad=paper.window_deg * DEG,
        shrink=paper.shrink,
        leave_no_gaps=paper.leave_no_gaps,
        stop_m=paper.stop_mm * MM,
        stop_rad=paper.stop_deg * DEG,
        give_up_m2=level * _give_up_mm2(config) * MM2 if paper.give_up else np.inf,
        occlusion_shrink=paper.occlusion_shrink,
        occlusion_least_m=paper.occlusion_least_mm * MM,
        about_laser=paper.pivot == "laser",
        either=paper.converged == "either",
    )
    limits = polar_cost.Limits(
        first_rad=spec.angle_min_rad,
        step_rad=spec.angle_step_rad,
        near_m=paper.near_mm * MM,
        far_m=paper.far_mm * MM,
        occlusion_m=paper.occlusion_mm * MM,
        edge_m=paper.mixed_pixel_mm * MM,
        fewest_beams=max(3.0, paper.min_beams_share * (len(points) if paper.min_beams_of == "valid" else spec.beams)),
        counted=paper.occluded == "counted",
    )
    x, y, yaw, cost, used, evaluations, iterations, converged = polar_search.search(
        virtual_m,
        points,
        np.array(samples, float),
        np.array(schedule, float),
        np.array(limits, float),
    )
    pose = predicted @ Pose(float(x), float(y), wrap_angle(float(yaw)))
    beams = int(used) if cost < np.inf else len(points)
    inliers = float(used) / max(len(points), 1)
    return Match(pose, float(cost), beams, inliers, int(evaluations), int(iterations), bool(converged))


@timed("cleaning")
def polar_points(ranges_m: NDArray[np.float64], spec: LaserSpec, mixed_pixel_m: float) -> NDArray[np.float64]:
    """Return the valid beams as rows x, y, beam number, range, bearing, (n, 5), without mixed pixels (cost step vii).

    A mixed pixel differs from both neighbouring beams by more than ``mixed_pixel_m``.
    """
    from mavnav.kernels.scans import beams  # noqa: PLC0415  the paper's alone

    return beams.good_beams(ranges_m, spec.directions, spec.angle_min_rad, spec.angle_step_rad, mixed_pixel_m)
