"""Groups of sessions that are joined: how a session joins one, and the pose graph over all of their key frames.

A join must convince like a loop. Scans at different places of the session are searched in the whole map of the group;
at least three, and most of those that fit in one place only, must agree on one motion. From there closures are searched
as for loops, key frame by key frame; some must agree, and hardly any key frame may contradict the map.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavnav.slam.loop_closure.closure import SIGMA_M, SIGMA_RAD, Closure
from mavnav.slam.loop_closure.detection import LOOP_M, consistent, track_confirmed
from mavnav.slam.loop_closure.key_frames import Part, Visibility
from mavnav.slam.loop_closure.matching import AMBIGUITY_MARGIN, find_closure, fits
from mavnav.slam.loop_closure.path_edges import PATH_SIGMA_M, PATH_SIGMA_RAD
from mavnav.slam.loop_closure.pose_graph import Edge, optimized
from mavnav.slam.map_alignment import fitted
from mavnav.slam.parts import consensus
from mavnav.slam.relocalization import apart, candidates, everywhere, unambiguous, with_conflicts
from mavnav.slam.scan_matching import no_match
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from mavnav.config.models import Config
    from mavnav.pose import Pose
    from mavnav.slam.joining.session import Session
    from mavnav.slam.loop_closure.key_frames import KeyFrame
    from mavnav.slam.relocalization import Region
    from mavnav.slam.scan_matching import Match

WITNESSES = 24
"""So many key frames of a session, evenly along its path, are searched in the whole map of a group."""

FEW, AROUND_M = 6, 1.5
"""Where no more of them fit, all key frames this near along the path are searched too: sessions may meet at an end."""

MOST_PLACES = 12
"""So many places of a whole map are compared closely for each."""

LEAST_CLOSURES = 4
"""So many closures that agree make a join."""

BOUND = (0.6, 6 * DEG)
"""Closures are searched within this of where the witnesses place a key frame, m and rad."""

MOST_SEARCHED = 60
"""Closures are searched for so many key frames of a session at most, evenly along its path."""

ROUNDS = 2
"""Closures are searched again from the poses that follow from the first ones, unless those are small corrections."""

CONTRADICTED, MOST_CONTRADICTING = 0.15, 0.1
"""Share of visibility conflicts at which a key frame contradicts the map of the group; largest share of such ones: 0
where five simulated sessions of one floor join, 0.3 and more where two of rooms alike would."""

NEAR_M = 2.0
"""Key frames of one session that lie so near, a long path apart, are held together by its finished map."""

APART_M = 1e6
"""Between the paths of two sessions: nothing of one is near to the other along the path."""


class Join(NamedTuple):
    """How a session was joined to a group, or why not (``why``).

    ``searched`` witnesses, ``found`` of them fit in one place, and ``agreeing`` of those agree. Of ``tested`` key
    frames ``closures`` agree with the map and ``contradicting`` conflict with it. ``residual_m`` and ``residual_rad``
    are the RMS of what the pose graph leaves of the closures.
    """

    name: str
    searched: int = 0
    found: int = 0
    agreeing: int = 0
    tested: int = 0
    closures: int = 0
    contradicting: int = 0
    residual_m: float = 0.0
    residual_rad: float = 0.0
    joined_to: tuple[tuple[str, int], ...] = ()
    why: str = ""

    @property
    def agreeing_share(self) -> float:
        """Part of the witnesses that agree."""
        return self.agreeing / max(self.searched, 1)


@dataclass(frozen=True, slots=True)
class Group:
    """Sessions in one frame: their key frames, one session after another, what binds them, and how each was joined."""

    sessions: tuple[Session, ...]
    keys: tuple[KeyFrame, ...]
    edges: tuple[Edge, ...]
    joins: tuple[Join, ...]

    def owner(self, key: int) -> int:
        """Return the number of the session of a key frame."""
        return int(self.keys[key].path_m // APART_M)

    def keys_of(self, number: int) -> list[KeyFrame]:
        """Return the key frames of a session, in the frame of the group."""
        return [key for k, key in enumerate(self.keys) if self.owner(k) == number]


def group_of(session: Session) -> Group:
    """Begin a group with a session."""
    return Group((session,), session.keys, tuple(own_edges(session.keys, 0)), (Join(session.name),))


def own_edges(keys: Sequence[KeyFrame], first: int) -> Iterator[Edge]:
    """Bind the key frames of a session as its run placed them; ``first`` is the number of its first one."""
    poses = [key.map_T_laser for key in keys]
    path, near = (
        np.diag(1.0 / np.array(s)) for s in ((PATH_SIGMA_M,) * 2 + (PATH_SIGMA_RAD,), (SIGMA_M,) * 2 + (SIGMA_RAD,))
    )
    xy_m, paths_m = np.array([pose[:2] for pose in poses]), np.array([key.path_m for key in keys])
    for k, (a, b) in enumerate(pairwise(poses)):
        yield Edge(first + k, first + k + 1, a.between(b), path)
    for j, key in enumerate(keys):
        off_m = np.hypot(*(xy_m[: int(np.searchsorted(paths_m, key.path_m - LOOP_M))] - xy_m[j]).T)
        i = int(np.argmin(off_m)) if len(off_m) else 0
        if len(off_m) and off_m[i] <= NEAR_M:
            yield Edge(first + i, first + j, poses[i].between(poses[j]), near)


def grown(sessions: Sequence[Session], config: Config, report: Callable[[str], None]) -> tuple[Group, list[Join]]:
    """Join sessions to groups; return the largest, and for each session outside of it why it is there.

    ``report`` is called with the name of the session that is searched. There must be a session.
    """
    waiting = sorted(sessions, key=lambda session: -len(session.keys))
    groups: list[Group] = []
    refused: dict[str, Join] = {}
    while waiting and sum(len(s.keys) for s in waiting) > max((len(group.keys) for group in groups), default=0):
        group, waiting, tried = _grown(group_of(waiting[0]), waiting[1:], config, report)
        groups.append(group)
        refused |= {join.name: join for join in tried}
    best = max(groups, key=lambda group: len(group.keys))
    for group in groups:
        if group is not best:
            names = [session.name for session in group.sessions]
            refused |= {name: _left_out(name, names) for name in names}
    inside = {session.name for session in best.sessions}
    return best, [refused[session.name] for session in sessions if session.name not in inside]


def _left_out(name: str, group: list[str]) -> Join:
    others = ", ".join(other for other in group if other != name)
    why = f"it joins {others} alone, a smaller group" if others else "too few scans of the others fit in its map"
    return Join(name, why=why)


def _grown(
    group: Group, waiting: list[Session], config: Config, report: Callable[[str], None]
) -> tuple[Group, list[Session], list[Join]]:
    """Join sessions to a group until none joins any more, the best witnessed first; return what is left, and why."""
    while True:
        part, tried = Part(config), list[Join]()
        part.grow(group.keys, len(group.keys))
        places = []
        for session in waiting:
            report(session.name)
            places.append((session, *sought(session, part, config)))
        for session, join, place in sorted(places, key=lambda found: -found[1].agreeing_share):
            larger, result = joined(group, session, place, part, join, config) if place else (None, join)
            if larger:
                group, waiting = larger, [other for other in waiting if other is not session]
                break
            tried.append(result)
        else:
            return group, waiting, tried


def sought(session: Session, part: Part, config: Config) -> tuple[Join, Pose | None]:
    """Search a session in the map of a group; return the evidence, and its pose there, None if too few agree."""
    pairs, searched = witnesses(session, part, config)
    group_T_session, join = consensus(pairs), Join(session.name, searched, len(pairs))
    if group_T_session is None:
        few = "too few of its scans fit in one place of the others' map" if len(pairs) < 3 else "its scans disagree"
        return join._replace(why=few), None
    agreeing = [pair for pair in pairs if not apart(group_T_session @ pair[0], pair[1])]
    return join._replace(agreeing=len(agreeing)), fitted(agreeing)


def witnesses(session: Session, part: Part, config: Config) -> tuple[list[tuple[Pose, Pose]], int]:
    """Search key frames in the whole map of a group; return those that fit in one place, before and there.

    The number of key frames that were searched is returned too.
    """
    region = everywhere(part.grid)
    found: dict[int, Match | None] = {}

    def search(numbers: Iterable[int]) -> None:
        for k in numbers:
            if k not in found:
                found[k] = _only_place(session.keys[k], part, region, config)

    search(evenly(len(session.keys), WITNESSES))
    fitting = [session.keys[k].path_m for k, match in found.items() if match]
    if len(fitting) <= FEW:
        near = (any(abs(key.path_m - path_m) <= AROUND_M for path_m in fitting) for key in session.keys)
        search(np.flatnonzero(list(near)).tolist())
    return [(session.keys[k].map_T_laser, m.map_T_laser) for k, m in sorted(found.items()) if m], len(found)


def _only_place(key: KeyFrame, part: Part, region: Region, config: Config) -> Match | None:
    """Return where a key frame fits in a map; None where it fits nowhere, or elsewhere about as well."""
    if len(key.points) < config.robust.min_points:
        return None
    best = unambiguous(
        candidates(key.points, part.lines, part.grid, region, config, MOST_PLACES), AMBIGUITY_MARGIN, config
    )
    return best if best and fits(best) else None


def evenly(count: int, most: int) -> list[int]:
    """Choose numbers up to a count, so many at most, at even distances."""
    numbers: list[int] = np.unique(np.linspace(0, count - 1, most).astype(int)).tolist()
    return numbers


def joined(
    group: Group, session: Session, group_T_session: Pose, part: Part, join: Join, config: Config
) -> tuple[Group | None, Join]:
    """Search closures between a group and a session, and solve the pose graph of all; None if they do not convince."""
    first, offset_m = len(group.keys), len(group.sessions) * APART_M
    placed = ((key, group_T_session @ key.map_T_laser) for key in session.keys)
    new = [replace(key, map_T_laser=pose, path_m=key.path_m + offset_m) for key, pose in placed]
    edges = [*group.edges, *own_edges(session.keys, first)]
    keys, closures, tested = closed([*group.keys, *new], first, edges, config)
    join = join._replace(tested=tested, closures=len(closures))
    if len(closures) < LEAST_CLOSURES:
        return None, join._replace(why="too few closures agree")
    join = join._replace(contradicting=contradicting(keys[first:], part))
    if join.contradicting > MOST_CONTRADICTING * tested:
        return None, join._replace(why="too many of its scans contradict the others' map")
    residual_m, residual_rad = residuals(closures, keys)
    to = [group.sessions[group.owner(closure.start)].name for closure in closures]
    join = join._replace(
        residual_m=residual_m,
        residual_rad=residual_rad,
        joined_to=tuple((name, to.count(name)) for name in dict.fromkeys(to)),
    )
    members = (*group.sessions, session)
    return Group(members, tuple(keys), (*edges, *map(_edge, closures)), (*group.joins, join)), join


def closed(
    keys: list[KeyFrame], first: int, edges: list[Edge], config: Config
) -> tuple[list[KeyFrame], list[Closure], int]:
    """Close key frames from number ``first`` on with those before; return all at the poses that follow.

    The closures that agree are returned too, and the number of key frames that were searched.
    """
    moved, closures, tested = keys, list[Closure](), 0
    for _ in range(ROUNDS):
        found = list(_closures(moved, first, config))
        agreed_on = consistent([closure for closure in found if closure], moved, moved)
        if len(agreed_on) < max(len(closures), LEAST_CLOSURES):
            return moved, closures or agreed_on, len(found)
        closures, tested = agreed_on, len(found)
        small = track_confirmed([closure.correction(moved) for closure in closures])
        poses = optimized([key.map_T_laser for key in keys], [*edges, *map(_edge, closures)])
        moved = [replace(key, map_T_laser=pose) for key, pose in zip(keys, poses, strict=True)]
        if small:
            break
    return moved, closures, tested


def _edge(closure: Closure) -> Edge:
    return Edge(closure.start, closure.end, closure.start_T_end, closure.sqrt_information)


def residuals(closures: Sequence[Closure], keys: Sequence[KeyFrame]) -> tuple[float, float]:
    """Return the RMS of the corrections that closures still ask for, m and rad."""
    left = np.array([closure.correction(keys) for closure in closures])
    return float(np.sqrt((left[:, :2] ** 2).sum(axis=1).mean())), float(np.sqrt((left[:, 2] ** 2).mean()))


def _closures(keys: Sequence[KeyFrame], first: int, config: Config) -> Iterator[Closure | None]:
    """Search the key frames from number ``first`` on in the map of those before."""
    old, seen = Part(config), Visibility(keys)
    old.grow(keys, first)
    seen.grow(first)
    for k in evenly(len(keys) - first, MOST_SEARCHED):
        if len(keys[first + k].points) >= config.robust.min_points:
            yield find_closure(keys, first + k, old, seen, BOUND, config)


def contradicting(keys: Sequence[KeyFrame], part: Part) -> int:
    """Count the key frames that see through walls of a map, or walls where it is free, of those that are searched."""
    some = (keys[k] for k in evenly(len(keys), MOST_SEARCHED))
    matches = (with_conflicts(no_match(key.map_T_laser), key.points, part.lines, part.grid) for key in some)
    return sum(match.conflicts > CONTRADICTED for match in matches)
