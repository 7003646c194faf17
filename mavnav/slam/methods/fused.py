"""The robust method beside commands, whose errors are independent: each match is fused with them by its information."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from mavnav.slam.matching.fusion import Fusion, evidence_of
from mavnav.slam.matching.scan_matching import Match, MatchVerdict, Schedule, search_lines
from mavnav.slam.methods.robust import Robust

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mavnav.pose import Pose
    from mavnav.scan import Scan
    from mavnav.slam.matching.motion_model import Motion

PRIOR = 0.05
"""Cost of a square meter off the commands: it keeps a search from running along a wall, and decides little else."""


class Fused(Robust):
    """Fuse every match with the pose by the commands of a vehicle (`Fusion`); for simulated missions.

    Wheels of recorded logs have biases, which the filter takes for noise: there a fixed weight loses less.
    """

    def _begin(self) -> None:
        super()._begin()
        self._fusion = self._learnt = Fusion()
        self._periods = 1.0  # since the last accepted pose

    @cached_property
    def _guided(self) -> Schedule:
        """Schedule of the search near the prediction."""
        expert = self.config.robust.expert
        return Schedule.of(self.config, self.lines, (expert.near_window_m, expert.near_window_rad), prior=PRIOR)

    def _search_near(
        self, points: NDArray[np.float64], predicted: Pose, motion: Motion, elapsed_s: float
    ) -> tuple[list[Match], bool]:
        """Search close to the prediction, and again round a clear match; return whether it is enough."""
        expert, self._periods = self.config.robust.expert, elapsed_s / motion.period_s
        if not expert.near_window_mm:
            return [], False
        match, start = search_lines(points, self.lines, predicted, self._guided), predicted
        if match.inliers >= expert.retry_below and not self.acceptance.is_inside(match, start):
            start = self._fuse(match, points, predicted).map_T_laser
            match = search_lines(points, self.lines, start, self._guided, match)
        if not self.acceptance.is_inside(match, start):
            return [match], False
        match = self._with_conflicts(self._fuse(match, points, predicted), points)
        return [match], self.acceptance.is_acceptable(match, motion, elapsed_s)

    def _of_least_cost(self, tried: list[Match], points: NDArray[np.float64], predicted: Pose, _: Motion) -> Match:
        """Return the match of least cost, to which distance from the prediction adds, fused with that."""
        best = min(tried, key=lambda match: match.cost_m2 + PRIOR * predicted.gap(match.map_T_laser)[0] ** 2)
        return self._with_conflicts(self._fuse(best, points, predicted), points)

    def _fuse(self, match: Match, points: NDArray[np.float64], predicted: Pose) -> Match:
        """Return a match at the mean of its pose and the predicted one; what that shows is learnt if it is accepted."""
        evidence = evidence_of(points, match.map_T_laser, self.lines, self.config.robust.expert.truncate_m)
        pose, self._learnt = self._fusion.fuse(evidence, match.map_T_laser, predicted, self._periods)
        return match._replace(map_T_laser=pose)

    def gate(self, match: Match, scan: Scan, motion: Motion) -> MatchVerdict:
        """Decide whether to accept the match, from which the fusion learns then."""
        verdict = super().gate(match, scan, motion)
        if verdict is MatchVerdict.SURE:
            self._fusion = self._learnt
        return verdict
