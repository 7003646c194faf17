"""Closures: key frames matched against the old part of the map, what they constrain, and whether they agree."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Sequence
from math import cos, sin
from operator import attrgetter

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.pose import Pose, transform_points, wrap_angle
from mavnav.slam.loop_closure.key_frames import DRIFT_RAD, PART_M, KeyFrame, KeyFrameMap, Points, Visibility
from mavnav.slam.matching.relocalization import (
    Region,
    apart,
    around,
    candidates,
    least_growth,
    misfit,
    reaches,
    unambiguous,
    unobservable_direction,
    with_conflicts,
)
from mavnav.slam.matching.scan_matching import Match, Schedule, search_lines
from mavnav.units import DEG

SIGMA_M = 0.015
"""Standard deviation of a closure in a direction that half of its points show."""

NEIGHBOR_M = 10.0
"""Longest path between two closures that are compared."""

AGREE_M, AGREE_RAD = (0.15, 0.05), (2 * DEG, 1 * DEG)
"""Largest difference of two closures that agree: a constant, and the increase per metre of path between them."""

PARALLEL_RAD = 20 * DEG
"""Largest angle between the weak directions of two closures that are compared."""

SMALL_M, SMALL_RAD = 0.06, 1 * DEG
"""Largest correction by a closure that confirms the track, which then does not change."""


class KeyClosure(Struct, frozen=True):
    """Key frame ``end`` saw the same walls as key frame ``start`` (numbers of key frames); ``match`` is the evidence.

    ``information`` (6,) is that of the points about the pose, a share of a point: `kernels.scans.observability`.
    ``weak_rad`` is the direction, frame of ``start``, in which the pose is not observable (along a plain corridor);
    None if all directions are observable.
    """

    start: int
    end: int
    start_T_end: Pose
    match: Match
    information: NDArray[np.float64]
    weak_rad: float | None = None

    def correction(self, keys: Sequence[KeyFrame]) -> Pose:
        """Return the corrected pose of ``end`` in its present frame, without the direction that is not observable."""
        off = keys[self.end].map_T_laser.between(keys[self.start].map_T_laser @ self.start_T_end)
        if self.weak_rad is None:
            return off
        return Pose(*across_direction(off, self.weak_rad - self.start_T_end.yaw_rad + off.yaw_rad), off.yaw_rad)

    @property
    def sqrt_information(self) -> NDArray[np.float64]:
        """Square root (3, 3) of the information matrix of x, y and yaw, frame of ``start``; 1/m, 1/m and 1/rad."""
        xx, xy, yy, xr, yr, rr = self.information
        shown = np.array([(xx, xy, xr), (xy, yy, yr), (xr, yr, rr)])
        if self.weak_rad is not None:
            weak = np.array((cos(self.weak_rad), sin(self.weak_rad), 0.0))
            shown -= np.outer(shown @ weak, shown @ weak) / max(weak @ shown @ weak, 1e-9)
        values, vectors = np.linalg.eigh(shown)
        return np.asarray(np.sqrt(2.0 * np.maximum(values, 0.0))[:, None] * vectors.T / SIGMA_M)


def across_direction(offset: Pose, direction_rad: float) -> tuple[float, float]:
    """Return the translation (x, y) of an offset, m, without its component along a direction."""
    c, s = cos(direction_rad), sin(direction_rad)
    across_m = -s * offset.x_m + c * offset.y_m
    return -s * across_m, c * across_m


def agreeing_closures(
    closures: Sequence[KeyClosure], keys: Sequence[KeyFrame], accepted: Sequence[KeyClosure] = ()
) -> list[KeyClosure]:
    """Return the closures that agree with more of each other, and of the accepted ones, than they contradict."""
    kept, before = list(closures), len(closures) + 1
    while len(kept) < before:
        before = len(kept)
        kept = [a for a in kept if is_confirmed(a, [*accepted, *kept], keys)]
    return kept


def is_confirmed(a: KeyClosure, others: Sequence[KeyClosure], keys: Sequence[KeyFrame]) -> bool:
    """Return whether a closure agrees with more of the others than it contradicts."""
    verdicts = [agree(a, b, keys) for b in others if b is not a]
    return verdicts.count(True) > verdicts.count(False)


def agree(a: KeyClosure, b: KeyClosure, keys: Sequence[KeyFrame]) -> bool | None:
    """Return whether two closures agree in the directions that both constrain; None if they cannot be compared."""
    path_m = sum(abs(keys[p].path_m - keys[q].path_m) for p, q in ((a.start, b.start), (a.end, b.end)))
    if path_m > NEIGHBOR_M:
        return None
    starts, ends = (keys[p].map_T_laser.between(keys[q].map_T_laser) for p, q in ((a.start, b.start), (a.end, b.end)))
    end_by_a = a.start_T_end @ ends
    off = end_by_a.between(starts @ b.start_T_end)
    weak = [c.weak_rad + turn for c, turn in ((a, 0.0), (b, starts.yaw_rad)) if c.weak_rad is not None]
    if len(weak) > 1 and abs(sin(weak[0] - weak[1])) > sin(PARALLEL_RAD):
        return None
    for direction_rad in weak:
        off = Pose(*across_direction(off, direction_rad - end_by_a.yaw_rad), off.yaw_rad)
    most_m, most_rad = (constant + increase * path_m for constant, increase in (AGREE_M, AGREE_RAD))
    return off.distance_m <= most_m and abs(off.yaw_rad) <= most_rad


def is_small(correction: Pose, times: float = 1.0) -> bool:
    """Return whether a correction is within ``times`` the bounds of a small one."""
    return correction.distance_m <= times * SMALL_M and abs(correction.yaw_rad) <= times * SMALL_RAD


LEAST_INLIERS, LEAST_WEAK_INLIERS = 0.5, 0.7
"""Minimum share of inliers of a closure, and of a weak one; the other points may lie on new area."""

MOST_CONFLICTS = 0.05
"""Largest share of visibility conflicts of a closure's points with the old part."""

AMBIGUITY_MARGIN = 0.15
"""Minimum difference in rank (``misfit``) to another pose within the drift bound; below, a closure is ambiguous."""

MOST_COST = 0.65
"""Least cost on the coarse grid, as a share of the worst, above which a key frame fits nowhere."""

LEAST_GROWTH = 0.03
"""Least cost of a step (``relocalization.least_growth``) in a direction that is observable."""

STRIP_M = 0.15
"""Half-width of the strip across a corridor that is searched for a weak closure."""

MOST_WEAK_M, MOST_WEAK_RAD = 0.8, 10 * DEG
"""Largest correction by a weak closure: a parallel corridor with similar walls is farther away."""


def find_closure(
    keys: Sequence[KeyFrame],
    j: int,
    old: KeyFrameMap | None,
    seen: Visibility,
    bound: tuple[float, float],
    config: Config,
) -> KeyClosure | None:
    """Return the closure of key frame ``j`` with the old part, within the drift bound, m and rad.

    Without the map of the ``old`` part, in the frame of the key frames, the local map is searched of what the key frame
    seems to see. In a plain corridor the closure is weak. None if the key frame fits nowhere, or at several poses.
    """
    map_T_here, here = (Pose(), old) if old else seen.local_map(keys[j])
    key = replace(keys[j], map_T_laser=map_T_here.between(keys[j].map_T_laser))
    region = around(key.map_T_laser, *bound)
    if not reaches(key.points, here.lines, region, config, MOST_COST):
        return None
    matches = candidates(key.points, here.lines, here.grid, region, config)
    best = unambiguous(matches, AMBIGUITY_MARGIN, config)
    closure = measure_closure(keys, j, map_T_here, best, seen, config) if best and fits(best) else None
    if closure and closure.weak_rad is None:
        return closure
    best = min(matches, key=lambda match: misfit(match, config), default=None)
    if best is None or not fits(best, LEAST_WEAK_INLIERS):
        return None
    across = corridor_match(key, best, here, region, config)
    return weak_closure(measure_closure(keys, j, map_T_here, across, seen, config), keys) if across else None


def corridor_match(key: KeyFrame, match: Match, here: KeyFrameMap, region: Region, config: Config) -> Match | None:
    """Search across the corridor of a match, at the tracked position along it, all in the frame of the map ``here``.

    The ``region`` is that within the drift bound. None if there is no corridor, or if the key frame fits nowhere else.
    """
    along_rad = unobservable_direction(key.points, match.map_T_laser, here.lines, LEAST_GROWTH, config)
    if along_rad is None:
        return None
    xy_m, yaws_rad = region
    off_m = (xy_m - key.map_T_laser[:2]) @ (cos(along_rad), sin(along_rad))
    matches = candidates(key.points, here.lines, here.grid, (xy_m[abs(off_m) <= STRIP_M], yaws_rad), config)
    best = unambiguous(matches, AMBIGUITY_MARGIN, config)
    return best if best and fits(best, LEAST_WEAK_INLIERS) else None


def weak_closure(closure: KeyClosure | None, keys: Sequence[KeyFrame]) -> KeyClosure | None:
    """Return a closure in a corridor if it is weak, and its correction small enough; else None."""
    if closure is None or closure.weak_rad is None or closure.match.inliers < LEAST_WEAK_INLIERS:
        return None
    correction = closure.correction(keys)
    return closure if correction.distance_m <= MOST_WEAK_M and abs(correction.yaw_rad) <= MOST_WEAK_RAD else None


def fits(match: Match, least_inliers: float = LEAST_INLIERS) -> bool:
    """Return whether enough points of a key frame are inliers, and few are visibility conflicts."""
    return match.inliers >= least_inliers and match.conflicts <= MOST_CONFLICTS


def measure_closure(
    keys: Sequence[KeyFrame], j: int, map_T_here: Pose, match: Match, seen: Visibility, config: Config
) -> KeyClosure | None:
    """Match key frame ``j`` against the local map of what it sees at a match; None if it does not fit there.

    The ``match`` is in a frame ``here``. The closure is weak if one direction is not observable; None if none is.
    """
    place, points = map_T_here @ match.map_T_laser, keys[j].points
    i = seen.reference(replace(keys[j], map_T_laser=place))
    middle, part = seen.local.part_at(i)
    start = keys[middle].map_T_laser.between(place)
    fine = match_closely(points, points_around(keys, j), part, start, config)
    if apart(start, fine.map_T_laser) or not fits(fine):
        return None
    information = part.lines.observability(points, fine.map_T_laser)[1] / len(points)
    closure = KeyClosure(middle, j, fine.map_T_laser, fine, information)
    if least_growth(points, fine.map_T_laser, part.lines, config) >= LEAST_GROWTH:
        return closure
    along_rad = unobservable_direction(points, fine.map_T_laser, part.lines, LEAST_GROWTH, config)
    return None if along_rad is None else replace(closure, weak_rad=wrap_angle(along_rad))


def points_around(keys: Sequence[KeyFrame], j: int) -> Points:
    """Return the points of key frame ``j``, and at most twice as many of the path around, (n, 2), its laser frame, m.

    Seen through a door, one scan shows a short wall at a grazing angle; the path around shows more of the walls.
    """
    here = keys[j]
    first, end = (bisect(keys, here.path_m + off_m, key=attrgetter("path_m")) for off_m in (-PART_M, PART_M))
    others = [key for key in keys[first:end] if key is not here]
    to_here = (transform_points(here.map_T_laser.between(key.map_T_laser), key.points) for key in others)
    around = np.concatenate([np.zeros((0, 2)), *to_here])
    return np.concatenate((here.points, around[:: max(len(around) // max(len(here.points), 1), 1)]))


def match_closely(points: Points, nearby: Points, part: KeyFrameMap, start: Pose, config: Config) -> Match:
    """Return the match of points (n, 2), laser frame, m, in a map, near a start in its frame.

    Its pose is that at which the points ``nearby`` (m, 2) of `points_around` fit best.
    """
    expert, lines = config.robust.expert, part.lines
    coarse = Schedule.of(config, lines, (expert.truncate_m, DRIFT_RAD[0]))
    fine = search_lines(points, lines, start, coarse)
    last = Schedule.of(config, lines, (expert.final_window_m, expert.final_window_rad), final=True)
    placed = search_lines(nearby, lines, fine.map_T_laser, last)
    return with_conflicts(fine._replace(map_T_laser=placed.map_T_laser), points, lines, part.grid)
