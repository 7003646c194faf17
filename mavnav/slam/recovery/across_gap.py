"""The pose of a part of a log across the gap beside it: what was seen before the gap against what was seen after it.

A scan after a gap sees walls that are not mapped yet, so that a wrong pose may cost less than the right one. Several
scans of either side, each judged in a map of the other side alone, tell them apart: at the right pose hardly any point
conflicts, however few of them agree. The likelier motion counts as well: the velocity seldom changes at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import log1p, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.slam.matching.motion_model import GAP_S, MOST_ERROR, motion_by, motions_along
from mavnav.slam.matching.relocalization import apart, around, candidates
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Step, Steps, evenly, tracked_trajectory
from mavnav.slam.methods.pauses import FASTER, SLACK_M
from mavnav.slam.methods.robust import Robust
from mavnav.slam.track import Track
from mavnav.units import DEG, NS

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

LEAST_AGREEMENT = 0.07
"""Least agreement of the pose of a part, less the cost of its motion; any other pose must have less by as much."""

MOTION_WEIGHT, USUAL_SHARE = 0.1, 0.2
"""Weight of the cost of a motion, and its usual error as a share of how far the laser can be off."""


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
    """Where the first pose beyond a gap can be: the expected one, and by how much it can be off, m and rad.

    ``measured``: by odometry.
    """

    expected: Pose
    off_m: float
    off_rad: float
    measured: bool

    def includes(self, pose: Pose) -> bool:
        """Return whether a pose can be reached."""
        off_m, off_rad = self.expected.gap(pose)
        return off_m <= self.off_m and off_rad <= self.off_rad

    def motion_cost(self, likely: Pose, pose: Pose) -> float:
        """Return the cost of a motion to another pose than the likely one, by Student's t: 0.7 at the usual errors."""
        off_m, off_rad = likely.gap(pose)
        return log1p(0.5 * ((off_m / self.off_m) ** 2 + (off_rad / self.off_rad) ** 2) / USUAL_SHARE**2)


def reach_across(here: Step, beyond: Step, track: Track, fastest: tuple[float, float]) -> Reach:
    """Return where the laser can be beyond a gap: near where odometry leads, else as far as its highest speed does."""
    pose, elapsed_s = here.match.map_T_laser, abs(beyond.stamp_ns - here.stamp_ns) * NS
    odometry = track.motion.odometry
    moved = motion_by(odometry, here.stamp_ns, beyond.stamp_ns) if odometry else None
    if moved is None:
        off_m, off_rad = (FASTER * speed * elapsed_s for speed in fastest)
        return Reach(pose, off_m + SLACK_M, min(pi, off_rad + SLACK_RAD), measured=False)
    off_m = MOST_ERROR * moved.distance_m + SLACK_M
    return Reach(pose @ moved, off_m, min(pi, MOST_ERROR * abs(moved.yaw_rad) + SLACK_RAD), measured=True)


def motion_across(here: Sequence[Step], beyond: Sequence[Step]) -> Pose:
    """Return the likely motion across a gap: half of the time at the velocity on this side, then at that beyond.

    Both sides have the step nearest to the gap first. The velocities are means over ``GAP_S``.
    """
    half_ns = 0.5 * (beyond[0].stamp_ns - here[0].stamp_ns)
    return _drift(_within(here)[-1], here[0], half_ns) @ _drift(beyond[0], _within(beyond)[-1], half_ns)


def _within(steps: Sequence[Step]) -> Sequence[Step]:
    """Return the first steps, up to ``GAP_S`` from the first one, at least two of several."""
    near = [step for step in steps if abs(step.stamp_ns - steps[0].stamp_ns) * NS <= GAP_S]
    return steps[: max(len(near), 2)]


def _drift(start: Step, end: Step, time_ns: float) -> Pose:
    """Return how far the laser moves in a time at the velocity from one step to another; not at all if both are one."""
    if start.stamp_ns == end.stamp_ns:
        return Pose()
    moved, times = start.match.map_T_laser.between(end.match.map_T_laser), time_ns / (end.stamp_ns - start.stamp_ns)
    x_m, y_m, _ = Pose(yaw_rad=-0.5 * moved.yaw_rad) @ moved  # seen from half of the turn
    half = Pose(yaw_rad=0.5 * times * moved.yaw_rad)
    return half @ Pose(times * x_m, times * y_m) @ half


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
    ours, theirs = side_of(here, scans, track), side_of(beyond, scans, track)
    end, reach = beyond[0].match.map_T_laser, reach_across(here[0], beyond[0], track, fastest)
    likely = reach.expected if reach.measured else here[0].match.map_T_laser @ motion_across(here, beyond)
    ranked = places(ours, theirs, reach, likely)
    most, best = max(ranked, default=(0.0, reach.expected @ end.inverse()))
    rivals = (value for value, pose in ranked if apart(best @ end, pose @ end))
    return best if most >= max((0.0, *rivals)) + LEAST_AGREEMENT else None


def places(ours: Side, theirs: Side, reach: Reach, likely: Pose) -> list[tuple[float, Pose]]:
    """Return poses of the map of their side in that of ours which can be reached, each with what speaks for it.

    That is its agreement less the cost of the motion; ``likely`` is the likely pose of their nearest step.
    """
    end = theirs.steps[0].match.map_T_laser
    expected = reach.expected @ end.inverse()
    poses = [*_fits(ours, theirs, expected, reach)]
    poses += [pose.inverse() for pose in _fits(theirs, ours, expected.inverse(), reach)]
    return [(support(ours, theirs, reach, likely, pose), pose) for pose in poses if reach.includes(pose @ end)]


def support(ours: Side, theirs: Side, reach: Reach, likely: Pose, map_T_part: Pose) -> float:
    """Return the agreement of both sides at a pose, less the cost of the motion."""
    end = theirs.steps[0].match.map_T_laser
    return agreement(ours, theirs, map_T_part) - MOTION_WEIGHT * reach.motion_cost(likely, map_T_part @ end)


def side_of(steps: Sequence[Step], scans: Scans, track: Track) -> Side:
    """Return the side of a gap with some steps, the nearest first."""
    return Side(steps, scans, _map_of(steps, scans, track))


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
