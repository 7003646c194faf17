"""The paper's method: a polar search for the least range differences from a virtual scan, coarse to fine."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.kernels.maps.layout import SearchGrid
from mavnav.mapping.occupancy_grid import Grid, GridBuilder
from mavnav.pose import Pose, transform_points, wrap_angle
from mavnav.profiling import as_stage
from mavnav.scan import LaserSpec, Scan
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import Match, MatchVerdict, first_match, no_match, with_effort

Floats = NDArray[np.float64]


LEAST_BEAMS_SHARE = 0.1
"""Minimum share of valid beams of a scan to be matched, if ``min_beams_of`` is not ``scan``."""


class Paper:
    """The paper's method in all its steps; its map is the plain grid of hit counts, and it has no refiner."""

    uses_odometry = False
    refiner = None
    own_kernels = ("polar_search.cost", "polar_search.search", "maps.raycast")
    """The modules of kernels that no other method needs."""

    def __init__(self, config: Config) -> None:
        """Start with an empty map."""
        self.config = config
        self.expects_rest = config.paper.expert.predict == "rest"
        self.grid = GridBuilder(config.paper.cell_m)
        self._seen: tuple[Pose, LaserSpec, Floats] | None = None

    def first(self, scan: Scan) -> Match:
        """Begin the map with any scan that has enough beams to be matched later."""
        beams = int(np.isfinite(scan.ranges_m).sum())
        return first_match(beams) if beams >= max(3.0, self._least_beams(scan.spec)) else no_match(Pose(), beams)

    def _least_beams(self, spec: LaserSpec) -> float:
        """Return the number of valid beams below which a scan is not matched."""
        expert = self.config.paper.expert
        return (expert.min_beams_share if expert.min_beams_of == "scan" else LEAST_BEAMS_SHARE) * spec.beams

    def match(self, scan: Scan, predicted: Pose, motion: Motion) -> Match:
        """Match against a virtual scan from the predicted pose (cost steps i, ii)."""
        points = polar_points(scan.ranges_m, scan.spec, self.config.paper.expert.mixed_pixel_m)
        if len(points) < self._least_beams(scan.spec):
            match = no_match(predicted, len(points))
        else:
            virtual_m = self._virtual_scan(predicted, scan.spec)
            match = match_polar(virtual_m, points, scan.spec, predicted, self.config)
        return match._replace(threshold_m2=self._threshold_m2(scan))

    def _virtual_scan(self, predicted: Pose, spec: LaserSpec) -> Floats:
        """Return the virtual scan (beams,), m; the last one is reused while neither map nor prediction change."""
        if self._seen is None or self._seen[:2] != (predicted, spec):
            far_m, expert = self.config.paper.far_m, self.config.paper.expert
            middle = expert.equal_cells == "middle"
            seen_m = self.grid.virtual_scan(predicted, spec.directions, far_m, expert.cluster_gap_cells, middle=middle)
            self._seen = predicted, spec, seen_m
        return self._seen[2]

    @as_stage("gate")
    def gate(self, match: Match, scan: Scan, motion: Motion) -> MatchVerdict:
        """Accept a match whose cost is at most the threshold (paper, "Map Update")."""
        return MatchVerdict.SURE if match.cost_m2 <= self._threshold_m2(scan) else MatchVerdict.REFUSED

    def _threshold_m2(self, scan: Scan) -> float:
        """Return the acceptance threshold for a scan."""
        return acceptance_scale(scan.ranges_m, self.config) * self.config.paper.gate_m2

    def insert(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> None:
        """Count the hits of every valid beam."""
        self._seen = None
        self.grid.insert(map_T_laser, transform_points(map_T_laser, scan.points()))

    def release_map(self) -> Grid:
        """Return the map."""
        return self.grid.by_rows()


GIVE_UP_RATIO = 2.5
"""Multiple of the acceptance threshold above which a match is not refined.

Such a pose is wrong: of 452 of them, none had a cost below the threshold on the finer grid.
"""


def match_polar(virtual_m: Floats, points: Floats, spec: LaserSpec, predicted: Pose, config: Config) -> Match:
    """Match a scan against the virtual scan from the predicted pose (paper, "Scan Matching", minimisation i-v).

    ``virtual_m`` (beams,) are the virtual scan's ranges; ``points`` (n, 5) the real scan's, from ``polar_points``.
    The grid is refined only if the cost on the coarse one is too high, but not above ``GIVE_UP_RATIO`` times the
    threshold: a finer grid does not correct a wrong pose. A search that can only end above that bound ends early.
    """
    paper = config.paper
    level = acceptance_scale(points[:, 3], config)
    search = partial(_search_polar, virtual_m, points, spec, predicted, config, level)
    match = search(1)
    worth_it = paper.expert.refine_above_m2 < match.cost_m2 / level <= _give_up_m2(config)
    if worth_it and paper.expert.refine_factor > 1:
        fine = search(paper.expert.refine_factor)
        match = with_effort(fine if fine.cost_m2 < match.cost_m2 else match, match, fine)
    return _at_gate(match, virtual_m, points, spec, predicted, config)


def acceptance_scale(ranges_m: Floats, config: Config) -> float:
    """Return the factor on the acceptance threshold for a scan of these ranges (beams,), m, NaN without a return.

    A range's variance grows with its square (paper, "Laser Scan"), and the paper states its threshold for a typical
    range (paper, "Map Update"): ``gate_range_mm``. The mean is over the ranges between ``near_mm`` and ``far_mm``.
    """
    paper = config.paper
    if paper.gate_range_mm is None:
        return 1.0
    used = ranges_m[(paper.near_m < ranges_m) & (ranges_m < paper.far_m)]
    return float(np.mean(np.square(used / paper.gate_range_m))) if len(used) else 1.0


def _give_up_m2(config: Config) -> float:
    return max(config.paper.expert.refine_above_m2, GIVE_UP_RATIO * config.paper.gate_m2)


@as_stage("search")
def _search_polar(
    virtual_m: Floats, points: Floats, spec: LaserSpec, predicted: Pose, config: Config, level: float, factor: int
) -> Match:
    """Search the grid, refined by a factor; ``level`` is the factor on the acceptance threshold."""
    from mavnav.kernels.polar_search import search as polar_search  # noqa: PLC0415  loads in 0.2 s, only for paper

    paper, grid, azimuth = config.paper, config.grid.refine(factor), config.azimuth * factor
    extensions = paper.expert.max_extensions if paper.expert.extend_border else 0
    samples = SearchGrid(azimuth, grid.nx, grid.ny, extensions, prune=config.search == "pruned")
    schedule = polar_search.Schedule(
        half_m=paper.window_m,
        half_rad=paper.window_rad,
        shrink=paper.expert.shrink,
        leave_no_gaps=paper.expert.leave_no_gaps,
        stop_m=paper.expert.stop_m,
        stop_rad=paper.expert.stop_rad,
        give_up_m2=level * _give_up_m2(config) if paper.expert.give_up else np.inf,
        occlusion_shrink=paper.expert.occlusion_shrink,
        occlusion_least_m=paper.expert.occlusion_least_m,
        about_laser=paper.expert.pivot == "laser",
        either=paper.expert.converged == "either",
    )
    all_beams = len(points) if paper.expert.min_beams_of == "valid" else spec.beams
    fewest = max(3.0, paper.expert.min_beams_share * all_beams)
    limits = _limits(spec, config, paper.expert.occlusion_m, fewest)
    x, y, yaw, cost, used, evaluations, iterations, converged = polar_search.search(
        virtual_m, points, np.array(samples, float), np.array(schedule, float), limits
    )
    pose = predicted @ Pose(float(x), float(y), wrap_angle(float(yaw)))
    return Match(pose, float(cost), int(used), 0.0, int(evaluations), int(iterations), bool(converged))


def _limits(spec: LaserSpec, config: Config, occlusion_m: float, fewest_beams: float) -> Floats:
    """Return the limits of the beams in the cost, (8,)."""
    from mavnav.kernels.polar_search.cost import Limits  # noqa: PLC0415  the paper's alone

    paper, counted = config.paper, config.paper.expert.occluded == "counted"
    edge_m, first_rad, step_rad = paper.expert.mixed_pixel_m, spec.angle_min_rad, spec.angle_step_rad
    limits = Limits(first_rad, step_rad, paper.near_m, paper.far_m, occlusion_m, edge_m, fewest_beams, counted)
    return np.array(limits, float)


def _at_gate(
    match: Match, virtual_m: Floats, points: Floats, spec: LaserSpec, predicted: Pose, config: Config
) -> Match:
    """Return a match with the cost and the share of the beams by which it is accepted, at one occlusion threshold.

    The last threshold of the search leaves out whatever does not fit, so that a wrong pose costs as little as a right
    one. A search that gave up keeps its higher cost.
    """
    from mavnav.kernels.polar_search.cost import polar_cost  # noqa: PLC0415  the paper's alone

    expert, (x, y, yaw) = config.paper.expert, predicted.between(match.map_T_laser)
    limits = _limits(spec, config, expert.gate_occlusion_m, expert.gate_share * len(points))
    cost, used = polar_cost(virtual_m, points.T.copy(), x, y, yaw, limits)
    cost, share = max(cost, match.cost_m2), used / max(len(points), 1)
    return match._replace(cost_m2=cost, inliers=share, beams_used=int(used) if cost < np.inf else len(points))


@as_stage("cleaning")
def polar_points(ranges_m: Floats, spec: LaserSpec, mixed_pixel_m: float) -> Floats:
    """Return the valid beams as rows x, y, beam number, range, bearing, (n, 5), without mixed pixels (cost step vii).

    A mixed pixel differs from both neighbouring beams by more than ``mixed_pixel_m``.
    """
    from mavnav.kernels.polar_search.cost import good_beams  # noqa: PLC0415  the paper's alone

    return good_beams(ranges_m, spec.directions, spec.angle_min_rad, spec.angle_step_rad, mixed_pixel_m)
