"""State of the tracker: the last accepted motion, or a relocalized pose on trial."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from mavnav.pose import Pose
    from mavnav.slam.motion_model import Motion

PROOFS = 3
"""So many scans in a row must agree on a place before it is accepted after a gap."""

NEVER = -1000
"""A number of scans so long ago that it does not matter."""


class Verdict(Enum):
    """What a match is worth: accepted at once, accepted once the next scans agree, or nothing."""

    SURE = "sure"
    PROBABLE = "probable"
    REFUSED = "refused"


class TrackState(NamedTuple):
    """The last accepted motion, and perhaps a trial: a motion that ``proofs`` scans in a row agreed on.

    ``missed`` counts the scans since the last accepted one, ``searched`` those up to the last search of the whole map.
    """

    motion: Motion
    trial: Motion | None = None
    proofs: int = 0
    missed: int = 0
    searched: int = NEVER

    @property
    def here(self) -> Motion:
        """The motion that predicts the next scan."""
        return self.trial or self.motion

    def after(self, verdict: Verdict, map_T_laser: Pose, stamp_ns: int) -> TrackState:
        """Return the state after a scan; the scan was accepted if ``missed`` is 0."""
        if self.trial is None and verdict is Verdict.SURE:
            return TrackState(self.motion.moved_to(map_T_laser, stamp_ns))
        if verdict is Verdict.REFUSED:
            return self._replace(trial=None, proofs=0, missed=self.missed + 1)
        far = verdict is Verdict.PROBABLE and not self.trial
        moved = (self.here.started_at if far else self.here.moved_to)(map_T_laser, stamp_ns)
        if self.trial and self.proofs + 1 >= PROOFS:
            return TrackState(moved)
        return self._replace(trial=moved, proofs=self.proofs + 1, missed=self.missed + 1)
