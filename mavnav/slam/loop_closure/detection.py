"""Closing loops: where the laser came back to a place after a long way, and what that says of the way (docs/method.md).

Key frames of the tracked way are laid on the old part of the map, on what was seen a long way before. One that fits
there in one place and in no other within the bounds of the drift, and that agrees with its neighbours on it, is a
closure (Olson 2009, "Recognizing places using spectrally clustered local matches", on why closures must agree). A pose
graph then spreads what the closures are off over the way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavnav.pose import Pose, Trajectory, blend
from mavnav.profiling import timed
from mavnav.slam.loop_closure.drift import DRIFT_RAD, Ways, drift_bound
from mavnav.slam.loop_closure.key_frames import KeyFrame, Part, Places, key_rows
from mavnav.slam.loop_closure.pose_graph import Edge, optimised
from mavnav.slam.relocalization import apart, around, candidates, firmness, judged, unrivalled
from mavnav.slam.scan_matching import Schedule, search_lines
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from mavnav.config.models import Config
    from mavnav.slam.scan_matching import Match

    Points = NDArray[np.float64]

LOOP_M = 8.0
"""What was seen a shorter way before is no loop: there the tracker itself keeps the map together."""

LOOK_M, FAR_LOOK_M = 0.25, 2.5
"""Way from one look for a loop to the next: at first; while the track holds, or looks tell nothing for long."""

HOLDING = 2
"""So many looks in a row that find the track where it should be tell that it holds."""

IN_VAIN = 40
"""After so many looks in a row that tell nothing they become rare."""

SIGHT_M = 4.0
"""Old key frames within this, and the drift, may have seen the same walls."""

LEAST_INLIERS = 0.5
"""Share of a closure's points that agree with the old part; the others may lie on what was not seen before."""

MOST_CONFLICTS = 0.05
"""Largest share of visibility conflicts of a closure's points with the old part."""

CLEAR_BY = 0.15
"""A closure is ambiguous if another place within the drift ranks nearer than this (``disagreement``)."""

PART_M = 1.0
"""A closure is measured against what was seen within so much way of its witness, because that is rigid."""

LEAST_FIRMNESS = 0.03
"""A closure is loose if it moves at less cost (``relocalization.firmness``): along a corridor it says nothing."""

WITNESS_M = 10.0
"""Closures testify on each other if the ways between them are no longer."""

AGREE_M, AGREE_RAD = (0.15, 0.05), (2 * DEG, 1 * DEG)
"""So far may two closures contradict each other: at no way between them, more a metre of it."""

WAY_SIGMA_M, WAY_SIGMA_RAD = 0.01, 0.5 * DEG
"""Standard deviations of the way from key frame to key frame."""

CLOSURE_SIGMA_M, CLOSURE_SIGMA_RAD = 0.03, 0.5 * DEG
"""Standard deviations of a closure."""

SMALL_M, SMALL_RAD = 0.06, 1 * DEG
"""Closures that are off by less tell that the track holds; it is left as it is."""

SMALL_SHARE, FAR_OFF = 0.95, 3.0
"""That is so if this share of them is off by less, and none by so many times as much: that may be one loop of many."""

ROUNDS = 3
"""A closed loop brings others within reach: the search is repeated so often at most."""


@dataclass(frozen=True, slots=True)
class Closure:
    """Key frame ``end`` saw again what key frame ``start`` saw (numbers of key frames); ``match`` is the evidence."""

    start: int
    end: int
    start_T_end: Pose
    match: Match

    def correction(self, keys: Sequence[KeyFrame]) -> Pose:
        """Return where ``end`` should be, seen from where it is."""
        return keys[self.end].map_T_laser.between(keys[self.start].map_T_laser @ self.start_T_end)


@dataclass(frozen=True, slots=True)
class Loop:
    """A closed loop: the scan of row ``end`` of the trajectory lies at ``start_T_end`` from that of row ``start``.

    ``correction`` is where the later one should have been, seen from where it was tracked; ``inliers`` is the share of
    its points that agree.
    """

    start: int
    end: int
    start_T_end: Pose
    correction: Pose
    inliers: float


@dataclass(frozen=True, slots=True)
class Loops:
    """The loops, the number of candidates that were refused, and the poses that follow.

    ``map_T_laser`` is None where the track holds as it is.
    """

    closed: tuple[Loop, ...] = ()
    refused: int = 0
    map_T_laser: Trajectory | None = None

    def dropped(self) -> Loops:
        """Return the same with every loop refused."""
        return Loops(refused=self.refused + len(self.closed))


@timed("loops")
def find_loops(map_T_laser: Trajectory, points_of: Callable[[list[int]], Iterable[Points]], config: Config) -> Loops:
    """Find the places that the laser came back to, and correct the way between.

    ``map_T_laser`` holds the tracked poses; ``points_of`` gives the points (n, 2) of the scans of some rows, thinned
    for matching, m, laser frame. Where the way never comes back it is not called, and where it gives fewer, because the
    run is being stopped, no loop is looked for.
    """
    rows, ways_m = key_rows(map_T_laser.xyyaw)
    xy_m = map_T_laser.xyyaw[rows, :2]
    if all(nearest_old(xy_m, np.array(ways_m), j) is None for j in range(len(rows))):
        return Loops()
    parts = zip(rows, ways_m, points_of(rows), strict=False)
    tracked = [KeyFrame(row, way_m, points, map_T_laser[row]) for row, way_m, points in parts]
    if len(tracked) < len(rows):
        return Loops()
    keys, closures, refused = find_closures(tracked, config)
    closed = tuple(
        Loop(tracked[c.start].row, tracked[c.end].row, c.start_T_end, c.correction(tracked), c.match.inliers)
        for c in closures
    )
    return Loops(closed, refused, None if keys is tracked else follow(map_T_laser, tracked, keys))


def find_closures(tracked: list[KeyFrame], config: Config) -> tuple[list[KeyFrame], list[Closure], int]:
    """Return the key frames where they should be, the closures that say so, and how many looks told nothing sure."""
    keys, closures, refused = tracked, list[Closure](), 0
    for _ in range(ROUNDS):
        found = list(returns(keys, config))
        agreed = agreeing([c for c in found if c], keys)
        if len(agreed) < len(closures):
            break
        closures, refused = agreed, len(found) - len(agreed)
        if holds([closure.correction(keys) for closure in closures]):
            break
        keys = bent(tracked, closures)
    return keys, closures, refused


def nearest_old(xy_m: NDArray[np.float64], ways_m: NDArray[np.float64], j: int) -> int | None:
    """Return the old key frame nearest to key frame ``j``, None where none may have seen the same walls."""
    old = int(np.searchsorted(ways_m, ways_m[j] - LOOP_M))
    if not old:
        return None
    off_m = np.hypot(*(xy_m[:old] - xy_m[j]).T)
    i = int(np.argmin(off_m))
    return i if off_m[i] <= SIGHT_M + drift_bound(ways_m[j] - ways_m[i])[0] else None


def returns(keys: Sequence[KeyFrame], config: Config) -> Iterator[Closure | None]:
    """Look from key frames for what was seen long before; None for each that sees no sure place.

    Looks are dense at first and sparse where the track holds; what is known to hold bounds the drift from there on.
    """
    old, places, ways, pace = Part(config), Places(keys), Ways(), Pace()
    xy_m = np.array([(k.map_T_laser.x_m, k.map_T_laser.y_m) for k in keys])
    ways_m = np.array([k.way_m for k in keys])
    for j, key in enumerate(keys):
        i = nearest_old(xy_m, ways_m, j) if key.way_m >= pace.next_m else None
        if i is None:
            continue
        count = int(np.searchsorted(ways_m, key.way_m - LOOP_M))
        old.grow(keys, count)
        match = the_place(key, old, drift_bound(ways.between(keys[i].way_m, key.way_m)), config)
        places.grow(count)
        found = None if match is None else measured(keys, j, match, places, config)
        pace = pace.after(key.way_m, found, holding=found is not None and is_small(found.correction(keys)))
        if found and pace.holding >= HOLDING:
            ways.join(keys[found.start].way_m, key.way_m)
        yield found


class Pace(NamedTuple):
    """When to look next: from ``next_m`` of the way on, after so many looks in a row that held or told nothing."""

    next_m: float = 0.0
    holding: int = 0
    in_vain: int = 0

    def after(self, way_m: float, found: Closure | None, *, holding: bool) -> Pace:
        """Return the pace after a look."""
        held, in_vain = (self.holding + 1 if holding else 0), (0 if found else self.in_vain + 1)
        step_m = FAR_LOOK_M if held >= HOLDING or in_vain >= IN_VAIN else LOOK_M
        return Pace(way_m + step_m, held, in_vain)


def the_place(key: KeyFrame, old: Part, bound: tuple[float, float], config: Config) -> Match | None:
    """Find where within the bounds of the drift a key frame fits; None where it fits nowhere, or in several places."""
    region = around(key.map_T_laser, *bound)
    found = candidates(key.points, old.lines, old.grid, region, config)
    best = unrivalled(found, CLEAR_BY, config)
    return best if best and fits(best) else None


def fits(match: Match) -> bool:
    """Return whether enough of a key frame agrees with the old part, with few visibility conflicts."""
    return match.inliers >= LEAST_INLIERS and match.conflicts <= MOST_CONFLICTS


def measured(keys: Sequence[KeyFrame], j: int, match: Match, places: Places, config: Config) -> Closure | None:
    """Measure key frame ``j`` against what was seen about that place; None where that speaks against it."""
    i = places.witness(replace(keys[j], map_T_laser=match.map_T_laser))
    old = range(places.count)
    part = Part(config)
    part.grow([keys[k] for k in old if abs(keys[k].way_m - keys[i].way_m) <= PART_M], places.count)
    robust, points = config.robust, keys[j].points
    first = Schedule.of(config, part.lines, (robust.truncate_mm * MM, DRIFT_RAD[0]))
    fine = search_lines(points, part.lines, match.map_T_laser, first)
    last = Schedule.of(config, part.lines, (robust.final_window_mm * MM, robust.final_window_deg * DEG), final=True)
    placed = search_lines(points, part.lines, fine.map_T_laser, last)
    fine = judged(fine._replace(map_T_laser=placed.map_T_laser), points, part.lines, part.grid)
    if apart(match.map_T_laser, fine.map_T_laser) or not fits(fine):
        return None
    if firmness(points, fine.map_T_laser, part.lines, config) < LEAST_FIRMNESS:
        return None
    return Closure(i, j, keys[i].map_T_laser.between(fine.map_T_laser), fine)


def agreeing(closures: Sequence[Closure], keys: Sequence[KeyFrame]) -> list[Closure]:
    """Keep the closures that more of their neighbours bear out than contradict."""
    kept, before = list(closures), len(closures) + 1
    while len(kept) < before:
        before = len(kept)
        verdicts = [[agree(a, b, keys) for b in kept if b is not a] for a in kept]
        kept = [a for a, said in zip(kept, verdicts, strict=True) if said.count(True) > said.count(False)]
    return kept


def agree(a: Closure, b: Closure, keys: Sequence[KeyFrame]) -> bool | None:
    """Tell whether two closures say the same of the way between; None where they are too far apart to tell."""
    way_m = sum(abs(keys[p].way_m - keys[q].way_m) for p, q in ((a.start, b.start), (a.end, b.end)))
    if way_m > WITNESS_M:
        return None
    starts, ends = (keys[p].map_T_laser.between(keys[q].map_T_laser) for p, q in ((a.start, b.start), (a.end, b.end)))
    off = (a.start_T_end @ ends).between(starts @ b.start_T_end)
    return off.distance_m <= AGREE_M[0] + AGREE_M[1] * way_m and abs(off.yaw_rad) <= AGREE_RAD[0] + AGREE_RAD[1] * way_m


def is_small(correction: Pose, times: float = 1.0) -> bool:
    """Tell whether a correction is so small, or so many times as large."""
    return correction.distance_m <= times * SMALL_M and abs(correction.yaw_rad) <= times * SMALL_RAD


def holds(corrections: Sequence[Pose]) -> bool:
    """Tell whether a track that is off by these had better be left as it is."""
    few = sum(not is_small(correction) for correction in corrections) <= (1.0 - SMALL_SHARE) * len(corrections)
    return few and all(is_small(correction, FAR_OFF) for correction in corrections)


def bent(keys: Sequence[KeyFrame], closures: Sequence[Closure]) -> list[KeyFrame]:
    """Return the key frames where way and closures agree best."""
    poses = [key.map_T_laser for key in keys]
    way = [Edge(k, k + 1, a.between(b), WAY_SIGMA_M, WAY_SIGMA_RAD) for k, (a, b) in enumerate(pairwise(poses))]
    loops = [Edge(c.start, c.end, c.start_T_end, CLOSURE_SIGMA_M, CLOSURE_SIGMA_RAD) for c in closures]
    return [replace(key, map_T_laser=pose) for key, pose in zip(keys, optimised(poses, way + loops), strict=True)]


def follow(map_T_laser: Trajectory, tracked: Sequence[KeyFrame], keys: Sequence[KeyFrame]) -> Trajectory:
    """Take all poses along with the key frames: each keeps its place between the two next to it."""
    rows = np.array([key.row for key in tracked])
    poses = []
    for row in range(len(map_T_laser)):
        a = int(np.searchsorted(rows, row, side="right")) - 1
        b = min(a + 1, len(rows) - 1)
        share = (row - rows[a]) / max(rows[b] - rows[a], 1)
        from_a, from_b = (keys[k].map_T_laser @ tracked[k].map_T_laser.between(map_T_laser[row]) for k in (a, b))
        poses.append(blend(from_a, from_b, float(share)))
    return Trajectory.of(map_T_laser.stamps_ns.tolist(), poses)
