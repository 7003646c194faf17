"""Closures between a session and a group: they are searched as for loops, key frame by key frame.

Some must agree, at several places, and hardly any key frame may contradict the map of the group.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from mavnav.pose import Pose
from mavnav.sessions.following import end_of, track_across_cut
from mavnav.sessions.group import APART_M, SessionGroup, own_edges
from mavnav.slam.findings import Edge
from mavnav.slam.loop_closure.closure import KeyClosure, agree, find_closure
from mavnav.slam.loop_closure.detection import LOOP_M, SIGHT_M, consistent_closures, edges_of, track_confirmed
from mavnav.slam.loop_closure.key_frames import KEY_M, KeyFrame
from mavnav.slam.loop_closure.pose_graph import PATH_SIGMA_M, PATH_SIGMA_RAD, optimize, root_information
from mavnav.slam.matching.relocalization import with_conflicts
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.recovery.parts import evenly
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mavnav.config.models import Config
    from mavnav.sessions.following import Follows
    from mavnav.sessions.group import GroupMap, Join
    from mavnav.sessions.session import Session
    from mavnav.slam.loop_closure.key_frames import KeyFrameMap

LEAST_CLOSURES, LEAST_AT_END = 4, 3
"""So many closures that agree make a join; so many where the track of another session goes on."""

PLACES = 3
"""Closures that agree must be of so many stretches of ``KEY_M`` of the path: few of one place may all be wrong."""

BOUND = (0.6, 6 * DEG)
"""Closures are searched within this of where the witnesses place a key frame, m and rad."""

MOST_SEARCHED = 40
"""Closures are searched for so many key frames of a session at most: first for those near to key frames of the group,
then for others, evenly along its path."""

ROUNDS = 2
"""Closures are searched again from the poses that follow from the first ones, unless those are small corrections."""

CONTRADICTED, MOST_CONTRADICTING = 0.15, 0.1
"""Share of visibility conflicts at which a key frame contradicts the map of the group; largest share of such ones: 0
where five simulated sessions of one floor join, 0.3 and more where two of rooms alike would."""


def join_at_end(
    group: SessionGroup, session: Session, follows: Follows, here: GroupMap, join: Join, config: Config
) -> tuple[SessionGroup | None, Join]:
    """Join a session at the end of one of the group; None, and ``join``, if it does not fit there.

    Where one recording goes on, the track across the cut binds both, and no closures near it, as within a session.
    """
    member, tie = group.sessions[follows.number], None
    member_T_session = track_across_cut(member, session, config) if follows.soon else None
    if member_T_session is None:
        end = member.map_T_laser[len(member.map_T_laser) - 1]
        place = end_of(group, follows.number) @ end @ session.map_T_laser[0].inverse()
    else:
        place = end_of(group, follows.number) @ member_T_session
        tie = edge_across_cut(group, follows.number, place @ session.keys[0].map_T_laser)
    at_end = join._replace(why="", after=member.name)
    larger, result = join_session(group, session, place, here, at_end, config, tie)
    return larger, (result if larger else join)


def edge_across_cut(group: SessionGroup, number: int, group_T_key: Pose) -> Edge:
    """Bind the next key frame of a group, by its pose, to the last one of a session."""
    last = max(k for k in range(len(group.keys)) if group.owner(k) == number)
    start_T_end = group.keys[last].map_T_laser.between(group_T_key)
    return Edge(last, len(group.keys), start_T_end, root_information(PATH_SIGMA_M, PATH_SIGMA_RAD))


def join_session(
    group: SessionGroup,
    session: Session,
    group_T_session: Pose,
    here: GroupMap,
    join: Join,
    config: Config,
    tie: Edge | None = None,
) -> tuple[SessionGroup | None, Join]:
    """Search closures between a group and a session, and solve the pose graph of all; None if too few closures agree.

    ``tie`` binds the first key frame of the session to one of the group, where its track goes on.
    """
    first, offset_m = len(group.keys), len(group.sessions) * APART_M
    placed = ((key, group_T_session @ key.map_T_laser) for key in session.keys)
    new = [replace(key, map_T_laser=pose, path_m=key.path_m + offset_m) for key, pose in placed]
    edges, least = [*group.edges, *own_edges(session, first)], LEAST_AT_END if tie else LEAST_CLOSURES
    bound = [*edges, tie] if tie else edges
    solve = partial(optimize_new, first, bound) if session.doubtful else partial(optimize_all, bound)
    keys, closures, tested = search_closures([*group.keys, *new], first, here, config, least, tie, solve)
    join = join._replace(tested=len(tested), closures=len(closures))
    if len(closures) < least:
        return None, join._replace(why="too few closures agree")
    join = join._replace(contradicting=count_contradicting([keys[k] for k in tested], here.map))
    if join.contradicting > MOST_CONTRADICTING * len(tested):
        return None, join._replace(why="too many of its scans contradict the others' map")
    residual_m, residual_rad = residuals(closures, keys)
    to = [group.sessions[group.owner(closure.start)].name for closure in closures]
    join = join._replace(
        residual_m=residual_m,
        residual_rad=residual_rad,
        joined_to=tuple((name, to.count(name)) for name in dict.fromkeys(to)),
    )
    members = (*group.sessions, session)
    edges = [*bound, *edges_of(binding_closures(closures, keys, tie))]
    return SessionGroup(members, tuple(keys), tuple(edges), (*group.joins, join)), join


def search_closures(
    keys: list[KeyFrame],
    first: int,
    here: GroupMap,
    config: Config,
    least: int,
    tie: Edge | None,
    solve: Callable[[list[KeyFrame], list[KeyClosure]], list[Pose]],
) -> tuple[list[KeyFrame], list[KeyClosure], list[int]]:
    """Close key frames from number ``first`` on with those before; return all at the poses that follow.

    ``here`` is the map of those before. The closures that agree are returned too, and the numbers of the key frames
    that were searched.
    """
    moved, closures, tested = keys, list[KeyClosure](), list[int]()
    for _ in range(ROUNDS):
        here, numbers = here.with_keys(moved[:first]), keys_to_search(moved, first, config)
        matches = [find_closure(moved, k, here.map, here.seen, BOUND, config) for k in numbers]
        agreed_on = supported_closures(consistent_closures([c for c in matches if c], moved, moved), moved)
        if len(agreed_on) < max(len(closures), least):
            return moved, closures or agreed_on, tested or numbers
        closures, tested = agreed_on, numbers
        small = track_confirmed([closure.correction(moved) for closure in closures])
        poses = solve(keys, binding_closures(closures, keys, tie))
        moved = [replace(key, map_T_laser=pose) for key, pose in zip(keys, poses, strict=True)]
        if small:
            break
    return moved, closures, tested


def binding_closures(closures: list[KeyClosure], keys: Sequence[KeyFrame], tie: Edge | None) -> list[KeyClosure]:
    """Return the closures that enter the pose graph: not those a short path across a tie, which are no loops."""
    if tie is None:
        return closures
    paths_m = (
        keys[c.end].path_m - keys[tie.end].path_m + abs(keys[tie.start].path_m - keys[c.start].path_m) for c in closures
    )
    return [closure for closure, path_m in zip(closures, paths_m, strict=True) if path_m >= LOOP_M]


def optimize_all(edges: list[Edge], keys: list[KeyFrame], closures: list[KeyClosure]) -> list[Pose]:
    """Return the poses of all key frames that fit edges and closures best."""
    return optimize([key.map_T_laser for key in keys], [*edges, *edges_of(closures)])


def optimize_new(first: int, edges: list[Edge], keys: list[KeyFrame], closures: list[KeyClosure]) -> list[Pose]:
    """Return the same with all key frames before number ``first`` where they are: what binds to them, to the frame."""
    poses, ties = [key.map_T_laser for key in keys], list[Edge]()
    for edge in (edge for edge in (*edges, *edges_of(closures)) if edge.end >= first):
        start, turn, end = Pose(), np.eye(3), edge.end - first + 1
        if edge.start < first:
            start = poses[edge.start]
            c, s = np.cos(start.yaw_rad), np.sin(start.yaw_rad)
            turn[:2, :2] = (c, s), (-s, c)
        number = max(edge.start - first + 1, 0)
        ties.append(Edge(number, end, start @ edge.start_T_end, edge.sqrt_information @ turn))
    return [*poses[:first], *optimize([Pose(), *poses[first:]], ties)[1:]]


def supported_closures(closures: list[KeyClosure], keys: Sequence[KeyFrame]) -> list[KeyClosure]:
    """Keep the closures with which others agree, enough of them at other places of the path."""
    kept = [
        a
        for a in closures
        if len({keys[b.end].path_m // KEY_M for b in closures if b is a or agree(a, b, keys)}) >= PLACES
    ]
    return kept if len(kept) == len(closures) else supported_closures(kept, keys)


def residuals(closures: Sequence[KeyClosure], keys: Sequence[KeyFrame]) -> tuple[float, float]:
    """Return the RMS of the corrections that closures still ask for, m and rad."""
    left = np.array([closure.correction(keys) for closure in closures])
    return float(np.sqrt((left[:, :2] ** 2).sum(axis=1).mean())), float(np.sqrt((left[:, 2] ** 2).mean()))


def keys_to_search(keys: Sequence[KeyFrame], first: int, config: Config) -> list[int]:
    """Choose the key frames from number ``first`` on that are searched, and held against the map."""
    xy_m = np.array([key.map_T_laser[:2] for key in keys])
    usable = [k for k in range(first, len(keys)) if len(keys[k].points) >= config.robust.min_points]
    near = [k for k in usable if (np.hypot(*(xy_m[:first] - xy_m[k]).T) <= SIGHT_M).any()]
    chosen = [near[k] for k in evenly(len(near), MOST_SEARCHED)]
    others = [k for k in usable if k not in near]
    chosen += [others[k] for k in evenly(len(others), MOST_SEARCHED - len(chosen))]
    return sorted(chosen)


def count_contradicting(keys: Sequence[KeyFrame], known: KeyFrameMap) -> int:
    """Count the key frames that see through walls of a map, or walls where it is free."""
    matches = (with_conflicts(no_match(key.map_T_laser), key.points, known.lines, known.grid) for key in keys)
    return sum(match.conflicts > CONTRADICTED for match in matches)
