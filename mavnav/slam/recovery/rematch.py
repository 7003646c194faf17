"""Second matching: rejected scans between their accepted neighbours, and all scans against the finished map."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from mavnav.slam.matching.motion_model import LONGEST_S
from mavnav.slam.matching.scan_matching import with_effort
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.matching.track_state import MatchVerdict
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mavnav.scan import Scan
    from mavnav.slam.track import Track

SHORT_SCANS = 8
"""Longest interval between accepted scans, in periods, within which rejected ones are searched in wide regions."""

MOST_FAILED = 5
"""Number of successive scans without a match that ends the rematching of a gap: the laser was elsewhere or blocked."""


def rematch_rejected(track: Track) -> Track:
    """Match the rejected scans again between their accepted neighbours.

    The scans of a gap are matched backwards from the next accepted pose. Those accepted enter trajectory and map; the
    others stay without a pose.
    """
    steps = track.steps
    before = {} if track.refiner is None or steps.column("tracked").all() else between_accepted(steps)
    if not before:
        return track
    scans = {index: scan for index, scan in enumerate(track.log_scans()) if index in before}
    updated, after, failed = Steps(steps), steps[-1], 0
    for step in reversed(steps):
        if step.index in scans and failed < MOST_FAILED and (after.stamp_ns - step.stamp_ns) * NS <= LONGEST_S:
            updated[step.index] = rematch(scans[step.index], step, before[step.index], after, track)
            failed += 1
        if updated[step.index].tracked:
            after, failed = updated[step.index], 0
    return replace(track, steps=updated)


def between_accepted(steps: Iterable[Step]) -> dict[int, Step]:
    """Return the last accepted step before each rejected scan that has accepted scans on both sides, by scan number."""
    before: dict[int, Step] = {}
    between: dict[int, Step] = {}
    last: Step | None = None
    for step in steps:
        if step.tracked:
            before.update(between)
            between, last = {}, step
        elif last:
            between[step.index] = last
    return before


def rematch(scan: Scan, step: Step, before: Step, after: Step, track: Track) -> Step:
    """Match a scan between two accepted ones; return its step, tracked if the match is accepted."""
    here = track.motion.started_at(after.match.map_T_laser, after.stamp_ns)
    here = here.coming_from(before.match.map_T_laser, before.stamp_ns)
    short = here.elapsed_s(before.stamp_ns) <= SHORT_SCANS * here.period_s
    match_it = track.method.match if short or track.refiner is None else track.refiner.match_between
    match = match_it(scan, here.predict(scan.stamp_ns), here)
    if track.method.gate(match, scan, here) is not MatchVerdict.SURE:
        return step
    track.method.insert(scan, match.map_T_laser, here)
    return step._replace(match=with_effort(match, step.match, match), tracked=True)


def remove_dynamic_cells(track: Track) -> Track:
    """Remove the hits of people and other moving things from the map."""
    if track.refiner:
        track.refiner.remove_dynamic_cells()
    return track
