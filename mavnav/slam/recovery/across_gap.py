"""The pose of a part of a log across the gap beside it: what was seen before the gap against what was seen after it.

A scan after a gap sees walls that are not mapped yet, so that a wrong pose may cost less than the right one. Several
scans of either side, each judged in a map of the other side alone, tell them apart: at the right pose hardly any point
conflicts, however few of them agree.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavnav.slam.matching.motion_model import MOST_ERROR, motion_by, motions_along
from mavnav.slam.matching.relocalization import apart, around, candidates
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Step, Steps, evenly, tracked_trajectory
from mavnav.slam.methods.pauses import FASTER, SLACK_M
from mavnav.slam.methods.robust import Robust
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from mavnav.pose import Pose
    from mavnav.scan import Scan
    from mavnav.slam.track import Track

    Scans = dict[int, Scan]
    """Scans by their numbers."""

LONGEST_GAP_S = 5.0
"""Longest time across which two sides are compared: beyond, the laser can be anywhere."""

SLACK_RAD = 20 * DEG
"""Error of the expected heading across a gap, besides the turn."""

LOCAL_SCANS, NEXT_SCANS, COMPARED = 40, 12, 4
"""Numbers of scans: of a side's map; next to the gap; of these searched in the map of the other side, and compared."""

MINIMA = 12
"""Number of poses at which each is tried: where most walls are new, the right one seldom costs least."""

CONFLICT_WEIGHT = 3.0
"""Points that must agree for each that conflicts."""

LEAST_AGREEMENT = 0.15
"""Least agreement of the pose of a part; that of any other pose must be less by as much."""


class Side(NamedTuple):
    """Steps with poses on one side of a gap, the nearest first, with their scans, and the map that these make."""

    steps: Sequence[Step]
    scans: Scans
    map: Robust

    def some(self) -> list[tuple[Pose, NDArray[np.float64]]]:
        """Return the poses and points of some of the scans next to the gap, at even distances."""
        near = self.steps[:NEXT_SCANS]
        chosen = [near[k] for k in evenly(len(near), COMPARED)]
        return [(step.match.map_T_laser, self.map.match_points(self.scans[step.index])) for step in chosen]


class Reach(NamedTuple):
    """Where the first pose beyond a gap can be: the expected one, and by how much it can be off, m and rad."""

    expected: Pose
    off_m: float
    off_rad: float

    def includes(self, pose: Pose) -> bool:
        """Return whether a pose can be reached."""
        off_m, off_rad = self.expected.gap(pose)
        return off_m <= self.off_m and off_rad <= self.off_rad


def reach_across(here: Step, beyond: Step, track: Track, fastest: tuple[float, float]) -> Reach:
    """Return where the laser can be beyond a gap: near where odometry leads, else as far as its highest speed does."""
    pose, elapsed_s = here.match.map_T_laser, abs(beyond.stamp_ns - here.stamp_ns) * NS
    odometry = track.motion.odometry
    moved = motion_by(odometry, here.stamp_ns, beyond.stamp_ns) if odometry else None
    if moved is None:
        off_m, off_rad = (FASTER * speed * elapsed_s for speed in fastest)
        return Reach(pose, off_m + SLACK_M, min(pi, off_rad + SLACK_RAD))
    off_m = MOST_ERROR * moved.distance_m + SLACK_M
    return Reach(pose @ moved, off_m, min(pi, MOST_ERROR * abs(moved.yaw_rad) + SLACK_RAD))


def pose_across_gap(
    here: Sequence[Step], beyond: Sequence[Step], scans: Scans, track: Track, fastest: tuple[float, float]
) -> Pose | None:
    """Return the pose of a part's map in the map of a track; None unless exactly one is likely.

    Parameters
    ----------
    here, beyond : steps of the track and of the part beside the gap, all with a pose, the nearest first
    scans : the scans of these steps by number
    track : its odometry and configuration
    fastest : the highest speeds of the laser, m/s and rad/s
    """
    if abs(beyond[0].stamp_ns - here[0].stamp_ns) * NS > LONGEST_GAP_S:
        return None
    ours, theirs = (Side(steps, scans, _map_of(steps, scans, track)) for steps in (here, beyond))
    end, reach = beyond[0].match.map_T_laser, reach_across(here[0], beyond[0], track, fastest)
    expected = reach.expected @ end.inverse()
    poses = [*_fits(ours, theirs, expected, reach)]
    poses += [pose.inverse() for pose in _fits(theirs, ours, expected.inverse(), reach)]
    ranked = [(agreement(ours, theirs, pose), pose) for pose in poses if reach.includes(pose @ end)]
    most, best = max(ranked, default=(0.0, expected))
    rivals = (value for value, pose in ranked if apart(best @ end, pose @ end))
    return best if most >= max(0.0, *rivals) + LEAST_AGREEMENT else None


def _map_of(steps: Sequence[Step], scans: Scans, track: Track) -> Robust:
    """Return a map of some scans at their poses."""
    method, in_order = Robust(track.config), sorted(steps)
    for step, motion in zip(in_order, motions_along(tracked_trajectory(Steps(in_order)), track.motion), strict=True):
        method.insert(scans[step.index], step.match.map_T_laser, motion)
    return method


def _fits(known: Side, other: Side, known_T_other: Pose, reach: Reach) -> Iterator[Pose]:
    """Yield poses of a side's map in the map of the other side, at each of which one scan fits."""
    for pose, points in other.some():
        off_m = reach.off_m + other.steps[0].match.map_T_laser.gap(pose)[0]
        region, there = around(known_T_other @ pose, off_m, reach.off_rad), known.map
        for match in candidates(points, there.lines, there.known, region, there.config, MINIMA):
            yield match.map_T_laser @ pose.inverse()


def agreement(ours: Side, theirs: Side, map_T_part: Pose) -> float:
    """Return the share of points of either side that agree with the map of the other, less those that conflict."""
    pairs = ((ours.map, theirs, map_T_part), (theirs.map, ours, map_T_part.inverse()))
    return float(np.mean([_agreement(known, *some, pose) for known, side, pose in pairs for some in side.some()]))


def _agreement(known: Robust, side_T_laser: Pose, points: NDArray[np.float64], known_T_side: Pose) -> float:
    """Return the share of points that agree with a map, less those that conflict."""
    match = known.refine(points, no_match(known_T_side @ side_T_laser))
    return match.inliers - CONFLICT_WEIGHT * known.conflicts(points, match)
