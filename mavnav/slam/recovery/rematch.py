"""Second matching of rejected scans, backwards from the next accepted pose."""

from __future__ import annotations

from bisect import bisect

import numpy as np
from msgspec.structs import replace

from mavnav.scan import Scan
from mavnav.slam.matching.motion_model import LONGEST_S, Motion, motion_at
from mavnav.slam.matching.scan_matching import MatchVerdict, with_effort
from mavnav.slam.matching.steps import LOST_SCANS, Step, Steps
from mavnav.slam.methods.registry import Refiner
from mavnav.slam.track import Track
from mavnav.units import NS


def rematch_rejected(track: Track, _refiner: Refiner) -> Track:
    """Match the rejected scans again, backwards from the next accepted pose; also those before the map begins.

    Those accepted enter trajectory and map; the others stay without a pose. ``LOST_SCANS`` in a row without a match end
    that: the laser was elsewhere or blocked.
    """
    accepted = np.flatnonzero(track.steps.column("tracked")).tolist()
    rejected = set(range(accepted[-1])).difference(accepted) if len(accepted) > 1 else set()
    if not rejected:
        return track
    scans = {index: scan for index, scan in enumerate(track.log_scans()) if index in rejected}
    updated, (after, later), failed = Steps(track.steps), (track.steps[k] for k in accepted[:-3:-1]), 0
    for step in reversed(track.steps[: accepted[-1]]):
        if step.index in scans and failed < LOST_SCANS and (after.stamp_ns - step.stamp_ns) * NS <= LONGEST_S:
            before = bisect(accepted, step.index)
            here = motion_at(track.motion, *((after, track.steps[accepted[before - 1]]) if before else (later, after)))
            here = here._replace(map_T_laser=after.match.map_T_laser, stamp_ns=after.stamp_ns)
            updated[step.index] = rematch(scans[step.index], step, here, track)
            failed += 1
        if updated[step.index].tracked:
            after, later, failed = updated[step.index], after, 0
    return replace(track, steps=updated)


def rematch(scan: Scan, step: Step, here: Motion, track: Track) -> Step:
    """Match a scan from the motion at an accepted one; return its step, tracked and inserted if the match is sure."""
    match = track.method.match(scan, here.predict(scan.stamp_ns), here)
    if track.method.gate(match, scan, here) is not MatchVerdict.SURE:
        return step
    track.method.insert(scan, match.map_T_laser, here)
    return step._replace(match=with_effort(match, step.match, match), tracked=True)
