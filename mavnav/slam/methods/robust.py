"""The robust method: point-to-line matching against the whole map, and a correlative search where that fails."""

from __future__ import annotations

from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.kernels.scans.points import place_points, scan_points
from mavnav.kernels.scans.sweep_shift import sweep_shift
from mavnav.mapping.occupancy_grid import Grid, GridBuilder
from mavnav.mapping.tiled_arrays import Extent
from mavnav.pose import Pose
from mavnav.profiling import as_stage
from mavnav.scan import LONGEST_SWEEP, Scan
from mavnav.slam.matching import budget
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.relocalization import (
    CANDIDATES,
    REFINED,
    Region,
    around,
    best_of,
    candidates,
    everywhere,
    reached_by,
    refined_minima,
    with_conflicts,
    within_reach,
    within_reach_of,
)
from mavnav.slam.matching.scan_matching import (
    Match,
    MatchVerdict,
    Schedule,
    empty_line_map,
    first_match,
    no_match,
    search_lines,
    with_effort,
)
from mavnav.slam.methods.acceptance import FOUND_CONFLICTS, Acceptance
from mavnav.slam.methods.pauses import Pauses

Points = tuple[NDArray[np.float64], NDArray[np.float64]]
"""The valid end points (n, 2) of a scan and their voxel means (m, 2), m, laser frame."""


NEAR_MINIMA = 3
"""Number of separate minima near the prediction that are refined: the lowest one of a coarse grid may be wrong."""

FOUND_PERIODS = 1.5
"""Time since the last accepted pose, in periods, below which the work of the previous scan is returned."""

FOUND_COST, FOUND_ANYWHERE_COST = 0.4, 0.25
"""Maximum cost, as a share of the worst, of a minimum that is refined when the laser is lost, in a wide region and in
the whole map. Poses at which a lost laser was found cost up to 0.1 at 10 scans a second."""

AT_REST = np.zeros(3)
"""Twist of a laser at rest, for scans that are not de-skewed."""


class Robust:
    """Point-to-line matching against the whole map; hit counts are kept in ``grid`` for the outputs.

    ``known`` is the grid for visibility conflicts.
    """

    expects_rest = False
    uses_odometry = True
    builds_map = True
    own_kernels = (
        *("line_search.search", "maps.conflicts", "maps.linemap"),
        *("scans.correlative_search", "scans.observability", "scans.rts_smoother"),
    )
    """The modules of kernels that no other method needs."""
    found_conflicts = FOUND_CONFLICTS

    def __init__(self, config: Config) -> None:
        """Start with an empty map."""
        robust = config.robust
        self.config, self.acceptance = config, Acceptance(robust, self.found_conflicts)
        self._begin()
        self._limits_m = np.array([robust.near_m, robust.far_m, robust.voxel_m])
        self._deskewed: tuple[Scan, Motion, Points] | None = None
        self._free: Region | None = None  # the free area of the whole map, until it grows
        self._bounded = False  # whether cost bounds were computed since the map last grew
        self._wide_budget = budget.Budget(budget.WIDE_EACH, budget.WIDE_FIRST, budget.WIDE_MOST)
        self._whole_budget = budget.Budget(budget.WHOLE_EACH, budget.WHOLE_FIRST)
        self._pauses = Pauses()
        self._missed = 0, 0  # stamp of the last accepted pose, and number of scans matched since

    @property
    def refiner(self) -> Robust:
        """The method itself, which has all parts of the refiner."""
        return self

    @cached_property
    def _near(self) -> tuple[Schedule, Schedule]:
        """Schedules near the prediction, and of a minimum."""
        expert, schedule = self.config.robust.expert, partial(Schedule.of, self.config, self.lines)
        return schedule((expert.near_window_m, expert.near_window_rad)), schedule(REFINED)

    @cached_property
    def _final(self) -> Schedule:
        """Schedule of the search of the final pass."""
        expert = self.config.robust.expert
        return Schedule.of(self.config, self.lines, (expert.final_window_m, expert.final_window_rad), final=True)

    def _begin(self) -> None:
        """Start an empty map."""
        known, waiting = self.config.robust.expert.overlap_points, self.config.robust.expert.waiting_share
        self.lines = empty_line_map(self.config, known_points=known, waiting_share=waiting)
        self.known = self.grid = GridBuilder(self.lines.cell_m)

    def first(self, scan: Scan) -> Match:
        """Begin the map with any scan of enough points."""
        n = len(self._points(scan)[0])
        return first_match(n) if n >= self.config.robust.min_points else no_match(Pose(), n)

    def match(self, scan: Scan, predicted: Pose, motion: Motion) -> Match:
        """Match the de-skewed scan close to the prediction; search wider regions unless that match is acceptable."""
        points, elapsed_s = self.match_points(scan, motion), motion.elapsed_s(scan.stamp_ns)
        self._pauses.note(scan.stamp_ns, motion)
        if len(points) < self.config.robust.min_points:
            return no_match(predicted, len(points))
        self._wide_budget.earn(found=elapsed_s < FOUND_PERIODS * motion.period_s)
        self._whole_budget.earn()
        if self._missed_before(motion) >= budget.RARELY_SCANS and motion.odometry is None:
            return self._search_rarely(points, predicted, motion, scan.stamp_ns)
        tried, good = self._search_near(points, predicted, motion, elapsed_s)
        if good:
            return tried[0]
        expected, lost = motion.expected_poses(predicted, scan.stamp_ns), budget.is_lost(elapsed_s, motion.period_s)
        regions = self._lost_region(points, expected, elapsed_s) if lost else []
        given_up = lost and not regions
        if given_up and tried and motion.odometry is None:
            return self._with_conflicts(tried[0], points)
        tried += self._search_around(points, predicted)
        best = self._of_least_cost(tried, points, predicted)
        if given_up or self.acceptance.is_acceptable(best, motion, elapsed_s):
            return with_effort(best, *tried)
        tried = [self._with_conflicts(match, points) for match in tried]
        for region in regions or [within_reach(pose, elapsed_s) for pose in expected]:
            if lost or self._wide_budget.spend(self._work(points, region), refundable=True):
                tried += self._search_wide(points, region, FOUND_COST if lost else np.inf)
        return best_of(tried, expected, elapsed_s, self.config)

    def _missed_before(self, motion: Motion) -> int:
        """Return how many scans before this one had the same last accepted pose."""
        last_ns, missed = self._missed
        self._missed = motion.stamp_ns, missed + 1 if last_ns == motion.stamp_ns else 0
        return self._missed[1]

    def _search_rarely(self, points: NDArray[np.float64], predicted: Pose, motion: Motion, stamp_ns: int) -> Match:
        """Search for a laser that has been lost for long, if the budget covers a wide region."""
        expected, elapsed_s = motion.expected_poses(predicted, stamp_ns), motion.elapsed_s(stamp_ns)
        regions = self._lost_region(points, expected, elapsed_s)
        if not regions:
            return no_match(predicted, len(points))
        tried, good = self._search_near(points, predicted, motion, elapsed_s)
        if good:
            return tried[0]
        tried = [self._with_conflicts(match, points) for match in tried]
        tried += self._search_wide(points, regions[0], FOUND_COST)
        return best_of(tried, expected, elapsed_s, self.config) if tried else no_match(predicted, len(points))

    def _lost_region(self, points: NDArray[np.float64], expected: tuple[Pose, ...], elapsed_s: float) -> list[Region]:
        """Return the region of a lost laser, around all expected poses; none if the budget does not cover a search."""
        if not self._wide_budget.is_ready:
            return []
        region = within_reach_of(expected, elapsed_s)
        return [region] if self._wide_budget.spend(self._work(points, region)) else []

    def _of_least_cost(self, tried: list[Match], points: NDArray[np.float64], _: Pose) -> Match:
        """Return the match of least cost."""
        return self._with_conflicts(min(tried, key=lambda match: match.cost_m2), points)

    def _search_around(self, points: NDArray[np.float64], predicted: Pose) -> list[Match]:
        """Search the second window around the prediction; the visibility conflicts are not counted yet."""
        region = around(predicted, self.config.robust.expert.window_m, self.config.robust.expert.window_rad)
        return refined_minima(points, self.lines, region, self.config, most=NEAR_MINIMA)

    def _search_near(
        self, points: NDArray[np.float64], predicted: Pose, motion: Motion, elapsed_s: float
    ) -> tuple[list[Match], bool]:
        """Search close to the prediction, unless the configuration disables that; also return whether it is enough.

        A clear match near the edge is refined first. Conflicts may be uncounted if it is not enough.
        """
        expert = self.config.robust.expert
        if not expert.near_window_mm:
            return [], False
        near, again = self._near
        match, start = search_lines(points, self.lines, predicted, near), predicted
        is_clear = len(points) >= expert.sparse_points and match.inliers >= expert.retry_below
        if is_clear and not self.acceptance.is_inside(match, start):
            start = match.map_T_laser
            match = search_lines(points, self.lines, start, again, match)
        if not self.acceptance.is_inside(match, start):
            return [match], False
        match = self._with_conflicts(match, points)
        return [match], self.acceptance.is_acceptable(match, motion, elapsed_s)

    def _work(self, points: NDArray[np.float64], region: Region) -> float:
        """Return the work of a search of a region; that of cost bounds counts once until the map grows."""
        (xy_m, yaws_rad), some = region, points[: self.config.robust.expert.first_level_points]
        cells = 0.0 if self._bounded or not len(xy_m) else self.lines.cells_within(reached_by(some, xy_m))
        return budget.search_work(len(xy_m) * len(yaws_rad), cells, CANDIDATES)

    def _search_wide(self, points: NDArray[np.float64], region: Region, limit: float) -> list[Match]:
        """Search a region that the laser can have reached."""
        self._bounded = True
        return candidates(points, self.lines, self.known, region, self.config, limit=limit)

    @as_stage("gate")
    def gate(self, match: Match, scan: Scan, motion: Motion) -> MatchVerdict:
        """Decide whether to accept the match."""
        if self._pauses.exclude(match.map_T_laser, motion, scan.stamp_ns):
            return MatchVerdict.REFUSED
        return self.acceptance.verdict(match, motion, motion.elapsed_s(scan.stamp_ns))

    def reserve_whole_map_search(self, scan: Scan) -> bool:
        """Spend the work of a search of the whole map if the budget covers it."""
        points = self.match_points(scan)
        if not self._whole_budget.is_ready or len(points) < self.config.robust.min_points:
            return False
        self._free = self._free or everywhere(self.known)
        return self._whole_budget.spend(self._work(points, self._free))

    def relocalize(self, scan: Scan, match: Match, motion: Motion) -> Match | None:
        """Find the scan anywhere in the map; None unless exactly one pose fits."""
        points = self.match_points(scan)
        if len(points) < self.config.robust.min_points:
            return None
        elapsed_s = motion.elapsed_s(scan.stamp_ns)
        self._free, self._bounded = self._free or everywhere(self.known), True
        limit = FOUND_ANYWHERE_COST if budget.is_lost(elapsed_s, motion.period_s) else np.inf
        matches = [match, *candidates(points, self.lines, self.known, self._free, self.config, limit=limit)]
        expected = motion.expected_poses(motion.predict(scan.stamp_ns), scan.stamp_ns)
        best = best_of(matches, expected, elapsed_s, self.config)
        if best.ambiguous or self.acceptance.conflicts_after_gap(best, motion, elapsed_s):
            return None
        excluded = self._pauses.exclude(best.map_T_laser, motion, scan.stamp_ns)
        return best if self.acceptance.is_good(best) and not excluded else None

    def insert(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> None:
        """Insert every valid point of the de-skewed scan into lines and grid."""
        self._bounded, self._free = False, None
        xy_map_m, extent_m = self.placed_points(scan, map_T_laser, motion)
        self.grid.insert(map_T_laser, xy_map_m, extent_m)  # first: it refuses maps that are too large
        self.lines.insert(xy_map_m, extent_m)
        self.lines.insert_between(self._points(scan, motion)[0], scan.spec.angle_step_rad, map_T_laser)

    def placed_points(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> tuple[NDArray[np.float64], Extent]:
        """Return every valid point (n, 2) of the de-skewed scan, m, map frame, and their extent."""
        points = self._points(scan, motion)[0]
        xy_map_m = np.empty_like(points)
        return xy_map_m, place_points(points, map_T_laser.as_array(), xy_map_m)

    def remove_dynamic_cells(self) -> None:
        """Remove the hits of people and other moving things from grid and lines."""
        self.lines.remove(self.grid.remove_dynamic_cells())

    def refine(self, points: NDArray[np.float64], match: Match) -> Match:
        """Match points (n, 2), m, laser frame, against the finished map, close to an earlier match."""
        return search_lines(points, self.lines, match.map_T_laser, self._final, match)

    def observability(self, points: NDArray[np.float64], match: Match) -> tuple[float, NDArray[np.float64]]:
        """Return the observability by the lines at the points, and the Hessian."""
        return self.lines.observability(points, match.map_T_laser)

    def conflicts(self, points: NDArray[np.float64], match: Match) -> float:
        """Return the share of visibility conflicts of a sample of the points."""
        return self._with_conflicts(match, points).conflicts

    def _with_conflicts(self, match: Match, points: NDArray[np.float64]) -> Match:
        return with_conflicts(match, points, self.lines, self.known)

    def release_map(self) -> Grid:
        """Return the map, and free its working copy and its lines: a large map may not fit into memory twice."""
        counts = self.grid
        self._begin()
        return counts.by_rows()

    @as_stage("cleaning")
    def match_points(self, scan: Scan, motion: Motion | None = None) -> NDArray[np.float64]:
        """Return the points (n, 2) that are matched, m, laser frame; de-skewed if the motion is given."""
        return self._points(scan, motion)[1]

    def _points(self, scan: Scan, motion: Motion | None = None) -> Points:
        """Return the valid points (n, 2), laser frame, m, and their voxel means; at mid-sweep if the motion is given.

        The result of the last motion is kept: the scan that is inserted was matched just before.
        """
        if (last := self._deskewed) and last[0] is scan and last[1] is motion:
            return last[2]
        spec, twist = scan.spec, self._twist(scan, motion)
        seen = (scan.ranges_m, spec.directions) if scan.times_s is None else scan.seen_at_mid_sweep(twist)
        ends, means = np.empty((spec.beams, 2)), np.empty((spec.beams, 2))
        n, m = scan_points(*seen, twist, spec.time_increment_s, self._limits_m, ends, means)
        points = ends[:n], means[:m]
        if motion:
            self._deskewed = scan, motion, points
        return points

    def _twist(self, scan: Scan, motion: Motion | None) -> NDArray[np.float64]:
        """Return the twist (3,) by which a scan is de-skewed."""
        longest = LONGEST_SWEEP + (scan.times_s is not None)  # one of merged lasers may start half a period later
        if self.config.robust.deskew == "off" or motion is None or scan.sweep_s > longest * motion.period_s:
            return AT_REST
        return np.array(motion.twist_at(scan.stamp_ns))

    @as_stage("cleaning")
    def sweep_T_mid(self, scan: Scan, motion: Motion) -> Pose:
        """Return the pose of the laser at mid-sweep, seen from that at which the scan as recorded fits best."""
        twist, equations = self._twist(scan, motion), np.empty((3, 4))
        if not scan.sweep_s or not twist.any():
            return Pose()
        sweep_shift(scan.ranges_m, scan.spec.directions, scan.late_s, twist, self._limits_m, equations)
        return Pose(*np.linalg.solve(equations[:, :3], equations[:, 3]).tolist())
