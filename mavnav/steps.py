"""What became of the scans, one by one and on the whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mavnav.pose import Pose, Trajectory
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavnav.matcher import Match

LOST_SCANS = 5
"""So many scans in a row without a believed pose are called lost; fewer are rejected scans, unless a jump follows."""

JUMP_M, JUMP_RAD = 0.5, 45 * DEG
"""So much motion over scans without a believed pose is a gap in the track, however few they are."""

FASTEST_M_S, FASTEST_RAD_S = 3.0, 300 * DEG
"""A jump at more than this is a gap even where no scan is missing: the track was found again elsewhere."""


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
    """A stretch of scans without a believed pose, and whether the track was found again after it.

    It has no scans where the track jumped from one scan to the next.
    """

    start_ns: int
    end_ns: int
    scans: int
    recovered: bool


def tracked_way(steps: list[Step]) -> Trajectory:
    """Return the poses that are believed (map_T_laser)."""
    tracked = [s for s in steps if s.tracked]
    return Trajectory.of([s.stamp_ns for s in tracked], [s.match.map_T_laser for s in tracked])


def lost_intervals(steps: list[Step]) -> Iterator[LostInterval]:
    """Find the stretches without a believed pose: of ``LOST_SCANS`` or more scans, or with a jump across them.

    A jump that no vehicle makes is one even where no scan is missing.
    """
    run: list[Step] = []
    last: Step | None = None
    for step in steps:
        if not step.tracked:
            run.append(step)
            continue
        if len(run) >= LOST_SCANS or (run and last and jumped(last, step)):
            yield LostInterval(run[0].stamp_ns, run[-1].stamp_ns, len(run), recovered=True)
        elif last and not run and leapt(last, step):
            yield LostInterval(last.stamp_ns, step.stamp_ns, 0, recovered=True)
        run, last = [], step
    if run and len(run) >= min(LOST_SCANS, len(steps)):
        yield LostInterval(run[0].stamp_ns, run[-1].stamp_ns, len(run), recovered=False)


def jumped(before: Step, after: Step) -> bool:
    """Tell whether a reader of the trajectory would see a jump between two believed poses."""
    moved_m, turned_rad = before.match.map_T_laser.gap(after.match.map_T_laser)
    return moved_m > JUMP_M or turned_rad > JUMP_RAD


def leapt(before: Step, after: Step) -> bool:
    """Tell whether the way between two believed poses is a jump, and faster than any vehicle."""
    if not jumped(before, after):
        return False
    moved_m, turned_rad = before.match.map_T_laser.gap(after.match.map_T_laser)
    elapsed_s = (after.stamp_ns - before.stamp_ns) * NS
    return moved_m > FASTEST_M_S * elapsed_s or turned_rad > FASTEST_RAD_S * elapsed_s
