"""The rules by which the robust method accepts a match, at once or once the next scans agree."""

from __future__ import annotations

from mavnav.config.models import RobustConfig
from mavnav.pose import Pose
from mavnav.slam.matching.motion_model import GAP_S, LONGEST_S, Motion
from mavnav.slam.matching.scan_matching import Match, MatchVerdict
from mavnav.slam.methods.pauses import CARRIED_S

INNER_SHARE = 0.5
"""Share of the near window within which a match is accepted: nearer to its edge, the pose may be outside of it."""

REACHABLE = 1.0
"""Largest ``motion_cost`` that the acceleration of a vehicle explains."""

EXPECTED = 0.01
"""Largest ``motion_cost`` with which fewer inliers are enough after a gap."""

FOUND_CONFLICTS = 0.05
"""Largest share of visibility conflicts of a pose after a gap of more than ``CARRIED_S``; odometry shows no lifting.

Measured: 0.11 to 0.25 where the laser was carried into another room, up to 0.01 where it stayed; after shorter gaps of
urg_exp1 up to 0.1 at the right pose.
"""


class Acceptance:
    """Rules on the matches of one configuration; ``elapsed_s`` is the time since the last accepted pose."""

    def __init__(self, config: RobustConfig, found_conflicts: float = FOUND_CONFLICTS) -> None:
        """Take the thresholds of a configuration, and the share of conflicts allowed after a long gap."""
        self.config, self.found_conflicts = config, found_conflicts

    def is_inside(self, near: Match, predicted: Pose) -> bool:
        """Return whether a match lies well inside the near window, so that the pose is not outside of it."""
        config, (off_m, off_rad) = self.config, predicted.gap(near.map_T_laser)
        half_m, half_rad = config.expert.near_window_m, config.expert.near_window_rad
        return off_m <= INNER_SHARE * half_m and off_rad <= INNER_SHARE * half_rad

    def is_good(self, match: Match) -> bool:
        """Return whether a match has many inliers and few visibility conflicts."""
        return match.inliers >= self.config.expert.retry_below and match.conflicts <= self.config.expert.conflicts_below

    def is_acceptable(self, match: Match, motion: Motion, elapsed_s: float) -> bool:
        """Return whether a match is good, and its pose possible."""
        return self.is_good(match) and self.is_possible(match, motion, elapsed_s)

    def is_possible(self, match: Match, motion: Motion, elapsed_s: float) -> bool:
        """Return whether a vehicle can have moved so far in the elapsed time."""
        config, (moved_m, turned_rad) = self.config, motion.map_T_laser.gap(match.map_T_laser)
        return moved_m <= config.max_speed_m_s * elapsed_s and turned_rad <= config.max_turn_rad_s * elapsed_s

    def conflicts_after_gap(self, match: Match, motion: Motion, elapsed_s: float) -> bool:
        """Return whether a pose after a long gap has too many visibility conflicts."""
        return elapsed_s > max(CARRIED_S, motion.period_s) and match.conflicts > self.found_conflicts

    def verdict(self, match: Match, motion: Motion, elapsed_s: float) -> MatchVerdict:
        """Accept a match with many inliers and few visibility conflicts, at a possible speed.

        After a gap or a jump, more inliers are required, and the match is only probable.
        """
        limits, good = self.config.expert, self.is_good(match)
        if match.ambiguous or match.inliers < limits.track_above or not self.is_possible(match, motion, elapsed_s):
            return MatchVerdict.REFUSED
        if match.conflicts > limits.conflicts_below and match.inliers < limits.retry_below:
            return MatchVerdict.REFUSED
        if (match.motion_cost > REACHABLE and not good) or self.conflicts_after_gap(match, motion, elapsed_s):
            return MatchVerdict.REFUSED
        if elapsed_s <= max(LONGEST_S if good else GAP_S, motion.period_s) and match.motion_cost <= REACHABLE:
            return MatchVerdict.SURE
        expected = match.motion_cost <= EXPECTED
        return MatchVerdict.PROBABLE if expected or match.inliers >= limits.regain_above else MatchVerdict.REFUSED
