"""Closures: key frames matched against the old part of the map, what they constrain, and whether they agree."""

from __future__ import annotations

from bisect import bisect
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.pose import Pose, transform_points
from mavnav.slam.loop_closure.key_frames import DRIFT_RAD, PART_M, KeyFrameMap
from mavnav.slam.matching.relocalization import apart, around, candidates, least_growth, unambiguous, with_conflicts
from mavnav.slam.matching.scan_matching import Match, Schedule, search_lines
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mavnav.config.models import Config
    from mavnav.slam.loop_closure.key_frames import KeyFrame, Points, Visibility


SIGMA_M = 0.015
"""Standard deviation of a closure in a direction that half of its points show."""

NEIGHBOR_M = 10.0
"""Longest path between two closures that are compared."""

AGREE_M, AGREE_RAD = (0.15, 0.05), (2 * DEG, 1 * DEG)
"""Largest difference of two closures that agree: a constant, and the increase per metre of path between them."""

SMALL_M, SMALL_RAD = 0.06, 1 * DEG
"""Largest correction by a closure that confirms the track, which then does not change."""


class KeyClosure(Struct, frozen=True):
    """Key frame ``end`` saw the same walls as key frame ``start`` (numbers of key frames); ``match`` is the evidence.

    ``information`` (6,) is that of the points about the pose, a share of a point: `kernels.scans.observability`.
    """

    start: int
    end: int
    start_T_end: Pose
    match: Match
    information: NDArray[np.float64]

    def correction(self, keys: Sequence[KeyFrame]) -> Pose:
        """Return the corrected pose of ``end`` in its present frame."""
        return keys[self.end].map_T_laser.between(keys[self.start].map_T_laser @ self.start_T_end)

    @property
    def sqrt_information(self) -> NDArray[np.float64]:
        """Square root (3, 3) of the information matrix of x, y and yaw, frame of ``start``; 1/m, 1/m and 1/rad."""
        xx, xy, yy, xr, yr, rr = self.information
        shown = np.array([(xx, xy, xr), (xy, yy, yr), (xr, yr, rr)])
        values, vectors = np.linalg.eigh(shown)
        return np.asarray(np.sqrt(2.0 * np.maximum(values, 0.0))[:, None] * vectors.T / SIGMA_M)


def agreeing_closures(closures: Sequence[KeyClosure], keys: Sequence[KeyFrame]) -> list[KeyClosure]:
    """Return the closures that agree with more of each other than they contradict, in order."""
    kept, before = sorted(closures, key=attrgetter("end")), len(closures) + 1
    while len(kept) < before:
        before = len(kept)
        kept = [a for a in kept if is_confirmed(a, kept, keys)]
    return kept


def is_confirmed(a: KeyClosure, others: Sequence[KeyClosure], keys: Sequence[KeyFrame]) -> bool:
    """Return whether a closure agrees with more of the others than it contradicts."""
    verdicts = [agree(a, b, keys) for b in others if b is not a]
    return verdicts.count(True) > verdicts.count(False)


def agree(a: KeyClosure, b: KeyClosure, keys: Sequence[KeyFrame]) -> bool | None:
    """Return whether two closures agree; None if they cannot be compared."""
    path_m = sum(abs(keys[p].path_m - keys[q].path_m) for p, q in ((a.start, b.start), (a.end, b.end)))
    if path_m > NEIGHBOR_M:
        return None
    starts, ends = (keys[p].map_T_laser.between(keys[q].map_T_laser) for p, q in ((a.start, b.start), (a.end, b.end)))
    off = (a.start_T_end @ ends).between(starts @ b.start_T_end)
    most_m, most_rad = (constant + increase * path_m for constant, increase in (AGREE_M, AGREE_RAD))
    return off.distance_m <= most_m and abs(off.yaw_rad) <= most_rad


def is_small(correction: Pose) -> bool:
    """Return whether a correction is small."""
    return correction.distance_m <= SMALL_M and abs(correction.yaw_rad) <= SMALL_RAD


LEAST_INLIERS = 0.5
"""Minimum share of inliers of a closure; the other points may lie on new area."""

MOST_CONFLICTS = 0.05
"""Largest share of visibility conflicts of a closure's points with the old part."""

AMBIGUITY_MARGIN = 0.15
"""Minimum difference in rank (``misfit``) to another pose within the drift bound; below, a closure is ambiguous."""

LEAST_GROWTH = 0.03
"""Least cost of a step (``relocalization.least_growth``) in a direction that is observable."""


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
    seems to see. None if the key frame fits nowhere, or at several poses, as in a plain corridor.
    """
    map_T_here, here = (Pose(), old) if old else seen.local_map(keys[j])
    key = replace(keys[j], map_T_laser=map_T_here.between(keys[j].map_T_laser))
    region = around(key.map_T_laser, *bound)
    matches = candidates(key.points, here.lines, here.grid, region, config)
    best = unambiguous(matches, AMBIGUITY_MARGIN, config)
    return measure_closure(keys, j, map_T_here, best, seen, config) if best and fits(best) else None


def fits(match: Match) -> bool:
    """Return whether enough points of a key frame are inliers, and few are visibility conflicts."""
    return match.inliers >= LEAST_INLIERS and match.conflicts <= MOST_CONFLICTS


def measure_closure(
    keys: Sequence[KeyFrame], j: int, map_T_here: Pose, match: Match, seen: Visibility, config: Config
) -> KeyClosure | None:
    """Match key frame ``j`` against the local map of what it sees at a match, which is in a frame ``here``.

    None if it does not fit there, or if a direction is not observable.
    """
    place, points = map_T_here @ match.map_T_laser, keys[j].points
    i = seen.reference(replace(keys[j], map_T_laser=place))
    middle, part = seen.local.part_at(i)
    start = keys[middle].map_T_laser.between(place)
    fine = match_closely(points, points_around(keys, j), part, start, config)
    if apart(start, fine.map_T_laser) or not fits(fine):
        return None
    if least_growth(points, fine.map_T_laser, part.lines, config) < LEAST_GROWTH:
        return None
    information = part.lines.observability(points, fine.map_T_laser)[1] / len(points)
    return KeyClosure(middle, j, fine.map_T_laser, fine, information)


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
