"""Gaps in the poses beyond which the laser may be elsewhere: it was blind, or its scans paused, while it moved on.

The scans after a gap are matched where they fit, and a place that looks like another one is as good. What was seen on
both sides of the gap is compared once more, for all poses within reach. A vehicle at rest has to see what it saw.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.slam.loop_closure.key_frames import key_rows
from mavnav.slam.matching.motion_model import motion_by
from mavnav.slam.matching.relocalization import apart
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Step
from mavnav.slam.methods.pauses import CARRIED_S, highest_speeds, shortest_pause_s
from mavnav.slam.recovery.across_gap import (
    LEAST_AGREEMENT,
    LOCAL_SCANS,
    Side,
    motion_across,
    places,
    reach_across,
    side_of,
    support,
)
from mavnav.slam.recovery.parts import accepted_steps, is_lost
from mavnav.slam.track import Track
from mavnav.units import DEG, NS

MOST_GAPS = 4
"""Maximum number of gaps that are looked at, the longest ones."""

REACH_M = 10.0
"""Largest distance at which the laser is searched beyond a gap."""

KEY_M, KEY_RAD = 0.15, 7.5 * DEG
"""Motion between the scans of a side."""

STILL_M, STILL_RAD = 0.1, 5 * DEG
"""Motion of a vehicle that stands."""

SAME_VIEW = 0.8
"""Least share of the points of a scan of a laser at rest that agree with what was seen before.

Measured: 0.85 and more after up to 12 s at rest; 0.05 to 0.74 where it was carried, past alike doors up to 0.92.
"""


def beside_doubtful_gaps(track: Track) -> NDArray[np.float64]:
    """Return which tracked scans (n,) are beside a gap beyond which the laser may be elsewhere, as 1 and 0.

    None is in a log that is lost for good, which is said anyway.
    """
    steps = accepted_steps(track)
    beside, gaps_s = np.zeros(len(steps)), np.diff([step.stamp_ns for step in steps]) * NS
    long = np.flatnonzero(gaps_s > shortest_pause_s(track.motion.period_s, CARRIED_S))
    if not len(long) or not track.builds_map or is_lost(track.steps):
        return beside
    longest = sorted(long.tolist(), key=lambda k: -gaps_s[k])[:MOST_GAPS]
    sides = {k: (_some(steps[k::-1]), _some(steps[k + 1 :])) for k in longest}
    wanted = {step.index for here, beyond in sides.values() for step in (*here, *beyond)}
    scans = {k: scan for k, scan in enumerate(track.log_scans()) if k in wanted}
    fastest = highest_speeds(steps)
    for k, (here, beyond) in sides.items():
        ours, theirs = side_of(here, scans, track), side_of(beyond, scans, track)
        likely = motion_across(steps[k::-1][:LOCAL_SCANS], steps[k + 1 :][:LOCAL_SCANS])
        if _may_be_elsewhere(ours, theirs, likely, track, fastest):
            beside[k : k + 2] = 1.0
    return beside


def _may_be_elsewhere(ours: Side, theirs: Side, likely: Pose, track: Track, fastest: tuple[float, float]) -> bool:
    """Return whether the laser may be elsewhere beyond a gap than the track has it; ``likely`` is its likely motion."""
    here, beyond, odometry = ours.steps[0], theirs.steps[0], track.motion.odometry
    start, end = here.match.map_T_laser, beyond.match.map_T_laser
    driven = motion_by(odometry, here.stamp_ns, beyond.stamp_ns) if odometry else None
    if _stands(driven or start.between(end)):
        return _seen_again(ours, theirs) < SAME_VIEW
    if driven:
        return False
    reach = reach_across(here, beyond, track, fastest)
    reach = reach._replace(off_m=min(reach.off_m, REACH_M))
    ranked = places(ours, theirs, reach, start @ likely)
    rivals = [value for value, pose in ranked if apart(pose @ end, end)]
    return support(ours, theirs, reach, start @ likely, Pose()) < max(rivals, default=-np.inf) + LEAST_AGREEMENT


def _some(steps: Sequence[Step]) -> list[Step]:
    """Return some steps of a side, at even distances."""
    rows, _ = key_rows(np.array([step.match.map_T_laser for step in steps]), KEY_M, KEY_RAD)
    return [steps[k] for k in rows[:LOCAL_SCANS]]


def _stands(moved: Pose) -> bool:
    return moved.distance_m < STILL_M and abs(moved.yaw_rad) < STILL_RAD


def _seen_again(ours: Side, theirs: Side) -> float:
    """Return the share of the points of the first scan beyond a gap that agree with what was seen before."""
    first = theirs.steps[0]
    points = ours.map.match_points(theirs.scans[first.index])
    return ours.map.refine(points, no_match(first.match.map_T_laser)).inliers
