"""State of the tracker: the last accepted motion, or a relocalized pose on trial."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from mavnav.pose import Pose
    from mavnav.slam.matching.motion_model import Motion

CONFIRMATIONS = 3
"""Number of successive scans that must agree on a pose before it is accepted after a gap."""

NEVER = -1000
"""Scan number of the last search if there was none: long before any interval between searches."""


class MatchVerdict(Enum):
    """Decision on a match: accept it at once, accept it once the next scans agree, or refuse it."""

    SURE = "sure"
    PROBABLE = "probable"
    REFUSED = "refused"


class TrackState(NamedTuple):
    """The last accepted motion, and the motion on trial, if any, on which the last ``confirmations`` scans agree.

    ``missed`` counts the scans since the last accepted one; ``searched`` is its value at the last search of the whole
    map.
    """

    motion: Motion
    trial: Motion | None = None
    confirmations: int = 0
    missed: int = 0
    searched: int = NEVER

    @property
    def here(self) -> Motion:
        """Motion from which the next scan is predicted."""
        return self.trial or self.motion

    def before(self, stamp_ns: int) -> TrackState:
        """Return the state with the odometry that is used for a scan."""
        motion, trial = self.motion.before(stamp_ns), self.trial and self.trial.before(stamp_ns)
        return self if motion is self.motion else self._replace(motion=motion, trial=trial)

    def after(self, verdict: MatchVerdict, map_T_laser: Pose, stamp_ns: int) -> TrackState:
        """Return the state after a scan; the scan was accepted if ``missed`` is 0."""
        if self.trial is None and verdict is MatchVerdict.SURE:
            return TrackState(self.motion.moved_to(map_T_laser, stamp_ns))
        if verdict is MatchVerdict.REFUSED:
            return self._replace(trial=None, confirmations=0, missed=self.missed + 1)
        far = verdict is MatchVerdict.PROBABLE and not self.trial
        moved = (self.here.started_at if far else self.here.moved_to)(map_T_laser, stamp_ns)
        if self.trial and self.confirmations + 1 >= CONFIRMATIONS:
            return TrackState(moved)
        return self._replace(trial=moved, confirmations=self.confirmations + 1, missed=self.missed + 1)
