"""The robust method beside odometry or commands: each match is fused with what they predict, by its information."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.slam.matching.fusion import WHEELS, Fusion, evidence_of, longer_than_predicted
from mavnav.slam.matching.motion_model import MOST_ERROR, Motion
from mavnav.slam.matching.scan_matching import Match, MatchVerdict, Schedule, no_match, search_lines
from mavnav.slam.methods.robust import Robust
from mavnav.units import DEG

PRIOR = 0.05
"""Cost of a square meter off the prediction: it keeps a search from running along a wall, and decides little else."""

LEAST_UNITS = 0.005
"""Least motion of wheels over a scan period of which the error counts, m and rad: their stamps err, too."""

LEAST_DRIVEN = 0.01
"""Motion by wheels since the last pose, m and rad, from which a scan that repeats the one before does not show rest."""

VELOCITY = Fusion(yaw_rad2=(2 * DEG) ** 2)
"""What is known of constant velocity, which bridges gaps of the odometry."""


class Fused(Robust):
    """Fuse every match with the pose that odometry or commands predict, if any do (`Fusion`)."""

    def _begin(self) -> None:
        super()._begin()
        self._fusion = self._used = self._learnt = Fusion()
        self._units = 0.0  # of the motion since the last accepted pose, see `Fusion`; 0 if nothing predicts it
        self._last_m, self._before = np.zeros(0), Pose()

    @cached_property
    def _guided(self) -> Schedule:
        """Schedule of the search near the prediction."""
        expert = self.config.robust.expert
        return Schedule.of(self.config, self.lines, (expert.near_window_m, expert.near_window_rad), prior=PRIOR)

    def match(self, scan: Scan, predicted: Pose, motion: Motion) -> Match:
        """Match the scan as `Robust` does, fused with the prediction; a repeat only where wheels lead."""
        self._used, self._units = self._prediction(scan, predicted, motion)
        self._learnt, self._before = self._fusion, motion.map_T_laser
        on_wheels = self._used.inherited > 0.0
        repeats = on_wheels and np.array_equal(self._last_m, scan.ranges_m, equal_nan=True)
        self._last_m, driven = scan.ranges_m, sum(predicted.gap(motion.map_T_laser))
        match = super().match(scan, predicted, motion)
        if not repeats or driven < LEAST_DRIVEN:
            return match
        moved = sum(match.map_T_laser.gap(predicted)) < MOST_ERROR * driven
        return match if moved else no_match(predicted, match.beams_used)

    def _prediction(self, scan: Scan, predicted: Pose, motion: Motion) -> tuple[Fusion, float]:
        """Return what is known of the prediction of a scan, and the motion to it in units of that."""
        periods = motion.elapsed_s(scan.stamp_ns) / motion.period_s
        if motion.odometry is None:
            return self._fusion, 0.0
        if motion.by_odometry(scan.stamp_ns) is None:
            return VELOCITY, periods
        if motion.commanded:
            return self._fusion, periods
        wheels = self._fusion if self._fusion.scans else WHEELS
        return wheels, max(sum(motion.map_T_laser.gap(predicted)), LEAST_UNITS * periods)

    def _search_near(
        self, points: NDArray[np.float64], predicted: Pose, motion: Motion, elapsed_s: float
    ) -> tuple[list[Match], bool]:
        """Search close to the prediction, and again round a clear match; return whether it is enough."""
        expert = self.config.robust.expert
        if not self._units or not expert.near_window_mm:
            return super()._search_near(points, predicted, motion, elapsed_s)
        match, start = search_lines(points, self.lines, predicted, self._guided), predicted
        if match.inliers >= expert.retry_below and not self.acceptance.is_inside(match, start):
            start = self._fuse(match, points, predicted).map_T_laser
            match = search_lines(points, self.lines, start, self._guided, match)
        if not self.acceptance.is_inside(match, start):
            return [match], False
        match = self._with_conflicts(self._fuse(match, points, predicted), points)
        return [match], self.acceptance.is_acceptable(match, motion, elapsed_s)

    def _of_least_cost(self, tried: list[Match], points: NDArray[np.float64], predicted: Pose) -> Match:
        """Return the match of least cost, to which distance from the prediction adds, fused with that."""
        if not self._units:
            return super()._of_least_cost(tried, points, predicted)
        best = min(tried, key=lambda match: match.cost_m2 + PRIOR * predicted.gap(match.map_T_laser)[0] ** 2)
        return self._with_conflicts(self._fuse(best, points, predicted), points)

    def _fuse(self, match: Match, points: NDArray[np.float64], predicted: Pose) -> Match:
        """Return a match at the mean of its pose and the predicted one; what that shows is learnt if it is accepted."""
        used, truncate_m = self._used, self.config.robust.expert.truncate_m
        evidence = evidence_of(points, match.map_T_laser, self.lines, truncate_m, used.apparent)
        pose, learnt = self._used.fuse(evidence, match.map_T_laser, predicted, self._units)
        self._learnt = self._fusion if self._used is VELOCITY else learnt
        if not self._used.inherited:
            return match._replace(map_T_laser=pose)
        longer, weight = longer_than_predicted(evidence, match.map_T_laser, predicted, self._before)
        return match._replace(map_T_laser=pose, longer=longer, longer_weight=weight)

    def gate(self, match: Match, scan: Scan, motion: Motion) -> MatchVerdict:
        """Decide whether to accept the match, from which the fusion learns then."""
        verdict = super().gate(match, scan, motion)
        if verdict is MatchVerdict.SURE:
            self._fusion = self._learnt
        return verdict
