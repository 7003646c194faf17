"""Second matching of rejected scans: between their accepted neighbours, and before the beginning of the map."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from mavnav.slam.matching.budget import is_lost
from mavnav.slam.matching.motion_model import LONGEST_S, Motion, motion_at
from mavnav.slam.matching.scan_matching import Match, MatchVerdict, with_effort
from mavnav.slam.matching.steps import LOST_SCANS, Step, Steps
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavnav.pose import Pose
    from mavnav.scan import Scan
    from mavnav.slam.methods.registry import Refiner
    from mavnav.slam.track import Track


def rematch_rejected(track: Track, refiner: Refiner) -> Track:
    """Match the rejected scans again between their accepted neighbours.

    The scans of a gap are matched backwards from the next accepted pose. Those accepted enter trajectory and map; the
    others stay without a pose. ``LOST_SCANS`` in a row without a match end that: the laser was elsewhere or blocked.
    """
    steps = track.steps
    before = between_accepted(steps)
    if not before:
        return track
    scans = {index: scan for index, scan in enumerate(track.log_scans()) if index in before}
    updated, after, failed = Steps(steps), steps[-1], 0
    for step in reversed(steps):
        if step.index in scans and failed < LOST_SCANS and (after.stamp_ns - step.stamp_ns) * NS <= LONGEST_S:
            updated[step.index] = rematch_between(scans[step.index], step, before[step.index], after, track, refiner)
            failed += 1
        if updated[step.index].tracked:
            after, failed = updated[step.index], 0
    return replace(track, steps=updated)


def between_accepted(steps: Steps) -> dict[int, Step]:
    """Return the last accepted step before each rejected scan that has accepted scans on both sides, by scan number."""
    tracked = steps.column("tracked")
    accepted, rejected = np.flatnonzero(tracked), np.flatnonzero(~tracked)
    after = np.searchsorted(accepted, rejected)
    between = (after > 0) & (after < len(accepted))
    pairs = zip(rejected[between].tolist(), accepted[after[between] - 1].tolist(), strict=True)
    return {index: steps[before] for index, before in pairs}


def rematch_between(scan: Scan, step: Step, before: Step, after: Step, track: Track, refiner: Refiner) -> Step:
    """Match a scan between two accepted ones; return its step, tracked if the match is accepted."""
    here = motion_at(track.motion, after, before)
    short = not is_lost(here.elapsed_s(before.stamp_ns), here.period_s)
    return rematch(scan, step, here, track, track.method.match if short else refiner.match_between)


def rematch_beginning(track: Track, _refiner: Refiner) -> Track:
    """Match the scans before the beginning of the map against it, backwards from the first accepted pose."""
    tracked = np.flatnonzero(track.steps.column("tracked"))
    if not track.begin or len(tracked) < 2:
        return track
    steps, (first, second) = Steps(track.steps), tracked[:2].tolist()
    scans = list(islice(track.log_scans(), first))
    after, later = steps[first], steps[second]
    for scan, step in zip(reversed(scans), reversed(steps[: len(scans)]), strict=True):
        if (after.stamp_ns - step.stamp_ns) * NS > LONGEST_S:
            break
        here = motion_at(track.motion, later, after)
        here = here._replace(map_T_laser=after.match.map_T_laser, stamp_ns=after.stamp_ns)
        earlier = rematch(scan, step, here, track, track.method.match)
        if not earlier.tracked:  # farther back the search would be so wide that a blocked scan fits somewhere
            break
        steps[step.index], after, later = earlier, earlier, after
    return replace(track, steps=steps)


def rematch(
    scan: Scan, step: Step, here: Motion, track: Track, match_scan: Callable[[Scan, Pose, Motion], Match]
) -> Step:
    """Match a scan from the motion at an accepted one; return its step, tracked and inserted if the match is sure."""
    match = match_scan(scan, here.predict(scan.stamp_ns), here)
    if track.method.gate(match, scan, here) is not MatchVerdict.SURE:
        return step
    track.method.insert(scan, match.map_T_laser, here)
    return step._replace(match=with_effort(match, step.match, match), tracked=True)
