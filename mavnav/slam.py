"""The paper's Figure 1 on recorded scans: predict, match, gate, insert."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mavnav.grid import Grid
    from mavnav.matcher import Match
    from mavnav.pose import Pose, Trajectory


@dataclass(frozen=True, slots=True)
class Step:
    """What became of one scan.

    ``tracked``: the match is believed and stands in the trajectory. ``accepted``: the scan was inserted into the map
    as well. ``predicted`` is where the search began.
    """

    index: int
    stamp_ns: int
    predicted: Pose
    match: Match
    tracked: bool
    accepted: bool


@dataclass(frozen=True, slots=True)
class LostInterval:
    """Scans without a believed pose: the first one's and the last one's stamp, their number, and whether the track
    was found again after them."""

    start_ns: int
    end_ns: int
    scans: int
    recovered: bool


@dataclass(frozen=True, slots=True)
class Slam:
    """The outcome: a step for every scan, the poses of the tracked ones (map_T_laser), the map, the lost stretches."""

    steps: tuple[Step, ...]
    trajectory: Trajectory
    grid: Grid
    lost: tuple[LostInterval, ...]

    @property
    def lost_for_good(self) -> bool:
        """Whether the track ended before the log did."""
        return bool(self.lost) and not self.lost[-1].recovered
