"""The result of SLAM on a log: what the writers, the metrics and the simulation take."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mavnav.slam.loop_closure.detection import Loops
from mavnav.slam.steps import LostInterval, Steps, lost_intervals, tracked_trajectory

if TYPE_CHECKING:
    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.pose import Trajectory
    from mavnav.slam.track import Track

LEAST_TRACKED_SHARE = 0.5
"""With poses for fewer of its scans a log is lost for good: what is found again at its end by chance tracks no log."""


@dataclass(frozen=True, slots=True)
class SlamResult:
    """The outcome: a step for every scan, the poses of the tracked ones (map_T_laser), map, lost stretches, loops.

    ``warnings`` are lines for the user: what of the log was not taken as it stands there. ``tracks_compared``
    counts the tracks of which the sharpest was kept.
    """

    steps: Steps
    trajectory: Trajectory
    grid: Grid
    lost: tuple[LostInterval, ...]
    loops: Loops = field(default_factory=Loops)
    warnings: tuple[str, ...] = ()
    tracks_compared: int = 1

    @property
    def tracked_share(self) -> float:
        """The part of the scans that have a pose; 0 where there are no scans."""
        return len(self.trajectory) / max(len(self.steps), 1)

    @property
    def lost_for_good(self) -> bool:
        """Whether the track ended before the log did, or has fewer than ``LEAST_TRACKED_SHARE`` of its scans."""
        ended = bool(self.lost) and not self.lost[-1].recovered
        return ended or (bool(self.steps) and self.tracked_share < LEAST_TRACKED_SHARE)


def summarize(track: Track) -> SlamResult:
    """Return the result of a finished track; its map is taken from the method."""
    steps = track.steps
    return SlamResult(
        steps,
        tracked_trajectory(steps),
        track.method.finished(),
        tuple(lost_intervals(steps)),
        track.loops,
        track.warnings,
        track.tracks_compared,
    )
