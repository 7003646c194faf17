"""Match a key frame against the old part of the map: one closure, or none (docs/method.md, steps 2 and 3)."""

from __future__ import annotations

from math import cos, sin
from typing import TYPE_CHECKING

from msgspec.structs import replace

from mavnav.pose import wrap_angle
from mavnav.slam.loop_closure.closure import Closure
from mavnav.slam.loop_closure.drift import DRIFT_RAD
from mavnav.slam.loop_closure.key_frames import Part
from mavnav.slam.matching.relocalization import (
    apart,
    around,
    candidates,
    least_growth,
    misfit,
    unambiguous,
    unobservable_direction,
    with_conflicts,
)
from mavnav.slam.matching.scan_matching import Schedule, search_lines
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.config.models import Config
    from mavnav.slam.loop_closure.key_frames import KeyFrame, Visibility
    from mavnav.slam.matching.scan_matching import Match

LEAST_INLIERS, LEAST_WEAK_INLIERS = 0.5, 0.7
"""Minimum share of inliers of a closure, and of a weak one; the other points may lie on new area."""

MOST_CONFLICTS = 0.05
"""Largest share of visibility conflicts of a closure's points with the old part."""

AMBIGUITY_MARGIN = 0.15
"""Minimum difference in rank (``misfit``) to another pose within the drift bound; below, a closure is ambiguous."""

PART_M = 1.0
"""Path length around the reference key frame whose scans a closure is measured against; these are nearly rigid."""

LEAST_GROWTH = 0.03
"""Least cost of a step (``relocalization.least_growth``) in a direction that is observable."""

STRIP_M = 0.15
"""Half-width of the strip across a corridor that is searched for a weak closure."""

MOST_WEAK_M, MOST_WEAK_RAD = 0.8, 10 * DEG
"""Largest correction by a weak closure: a parallel corridor with similar walls is farther away."""


def find_closure(
    keys: Sequence[KeyFrame], j: int, old: Part, seen: Visibility, bound: tuple[float, float], config: Config
) -> Closure | None:
    """Return the closure of key frame ``j`` with the old part, within the drift bound, m and rad.

    In a plain corridor the closure is weak. None if the key frame fits nowhere, or at several poses.
    """
    region = around(keys[j].map_T_laser, *bound)
    found = candidates(keys[j].points, old.lines, old.grid, region, config)
    best = unambiguous(found, AMBIGUITY_MARGIN, config)
    closure = measured(keys, j, best, seen, config) if best and fits(best) else None
    if closure and closure.weak_rad is None:
        return closure
    best = min(found, key=lambda match: misfit(match, config), default=None)
    return weak_closure(keys, j, best, old, seen, bound, config) if best and fits(best, LEAST_WEAK_INLIERS) else None


def weak_closure(
    keys: Sequence[KeyFrame],
    j: int,
    match: Match,
    old: Part,
    seen: Visibility,
    bound: tuple[float, float],
    config: Config,
) -> Closure | None:
    """Search across the corridor of a match, at the tracked position along it; return the weak closure or None."""
    key = keys[j]
    along_rad = unobservable_direction(key.points, match.map_T_laser, old.lines, LEAST_GROWTH, config)
    if along_rad is None:
        return None
    xy_m, yaws_rad = around(key.map_T_laser, *bound)
    off_m = (xy_m - key.map_T_laser[:2]) @ (cos(along_rad), sin(along_rad))
    found = candidates(key.points, old.lines, old.grid, (xy_m[abs(off_m) <= STRIP_M], yaws_rad), config)
    best = unambiguous(found, AMBIGUITY_MARGIN, config)
    closure = measured(keys, j, best, seen, config) if best and fits(best, LEAST_WEAK_INLIERS) else None
    if closure is None or closure.weak_rad is None or closure.match.inliers < LEAST_WEAK_INLIERS:
        return None
    correction = closure.correction(keys)
    return closure if correction.distance_m <= MOST_WEAK_M and abs(correction.yaw_rad) <= MOST_WEAK_RAD else None


def fits(match: Match, least_inliers: float = LEAST_INLIERS) -> bool:
    """Return whether enough points of a key frame are inliers, and few are visibility conflicts."""
    return match.inliers >= least_inliers and match.conflicts <= MOST_CONFLICTS


def measured(keys: Sequence[KeyFrame], j: int, match: Match, seen: Visibility, config: Config) -> Closure | None:
    """Match key frame ``j`` against the scans near its reference key frame; None if it does not fit there.

    The closure is weak if one direction is not observable; None if no direction is.
    """
    i = seen.reference(replace(keys[j], map_T_laser=match.map_T_laser))
    old = range(seen.count)
    part = Part(config)
    part.grow([keys[k] for k in old if abs(keys[k].path_m - keys[i].path_m) <= PART_M], seen.count)
    robust, points = config.robust, keys[j].points
    first = Schedule.of(config, part.lines, (robust.expert.truncate_m, DRIFT_RAD[0]))
    fine = search_lines(points, part.lines, match.map_T_laser, first)
    last = Schedule.of(config, part.lines, (robust.expert.final_window_m, robust.expert.final_window_rad), final=True)
    placed = search_lines(points, part.lines, fine.map_T_laser, last)
    fine = with_conflicts(fine._replace(map_T_laser=placed.map_T_laser), points, part.lines, part.grid)
    if apart(match.map_T_laser, fine.map_T_laser) or not fits(fine):
        return None
    start, place = keys[i].map_T_laser, fine.map_T_laser
    if least_growth(points, place, part.lines, config) >= LEAST_GROWTH:
        return Closure(i, j, start.between(place), fine)
    along_rad = unobservable_direction(points, place, part.lines, LEAST_GROWTH, config)
    if along_rad is None:
        return None
    return Closure(i, j, start.between(place), fine, wrap_angle(along_rad - start.yaw_rad))
