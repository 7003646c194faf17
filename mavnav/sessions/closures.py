"""Closures between a session and a group: they are searched as for loops, key frame by key frame.

Some must agree, at several places, and hardly any key frame may contradict the map of the group.

Where a recording goes on after a cut, the scans on both sides of it are tracked together.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain, islice
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory
from mavnav.sessions.group import APART_M, GroupMap, Join, Session, SessionGroup, frame_of, own_edges
from mavnav.slam.findings import Edge
from mavnav.slam.loop_closure.closure import KeyClosure, agree, find_closure
from mavnav.slam.loop_closure.detection import LOOP_M, SIGHT_M, consistent_closures, edges_of, track_confirmed
from mavnav.slam.loop_closure.key_frames import KEY_M, KeyFrame, KeyFrameMap
from mavnav.slam.loop_closure.pose_graph import PATH_SIGMA_M, PATH_SIGMA_RAD, optimize, root_information
from mavnav.slam.matching.relocalization import with_conflicts
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.matching.steps import Steps, evenly, lost_intervals, tracked_trajectory
from mavnav.slam.methods.robust import Robust
from mavnav.slam.tracker import track
from mavnav.units import DEG, NS

SOON_S = 5.0
"""Time between two parts of one recording."""

SIDE_M, MOST_SCANS = 3.0, 300
"""So much of the path on each side of a cut is tracked, and so many scans at most."""


class Follows(NamedTuple):
    """A session of a group at whose end another one begins: the pause between them, s, and its number."""

    pause_s: float
    number: int

    @property
    def soon(self) -> bool:
        """Whether both may be parts of one recording."""
        return self.pause_s <= SOON_S


def ended_before(group: SessionGroup, session: Session, pause_s: float) -> Follows | None:
    """Return the session of a group that ended last before another one begins; None if the pause is longer."""
    pauses_s = ((pause_between_s(session, member, pause_s), k) for k, member in enumerate(group.sessions))
    return min((Follows(pause, k) for pause, k in pauses_s if pause is not None), default=None)


def pause_between_s(session: Session, other: Session, pause_s: float) -> float | None:
    """Return the pause after which a session begins at the end of another one, s; None if it is longer, or before."""
    if other is session or len(session.map_T_laser) < 2:
        return None
    left_s = (int(session.map_T_laser.stamps_ns[0]) - int(other.map_T_laser.stamps_ns[-1])) * NS
    return left_s if 0.0 <= left_s <= pause_s else None


def end_of(group: SessionGroup, number: int) -> Pose:
    """Return the frame of a session in that of its group, as it is at the end of the session."""
    return group.keys_of(number)[-1].map_T_laser @ group.sessions[number].keys[-1].map_T_laser.inverse()


def track_across_cut(member: Session, session: Session, config: Config) -> Pose | None:
    """Return the frame of a session in that of another one which ended before; None where the track does not go on."""
    before, after = member.map_T_laser, session.map_T_laser
    first, last = _rows_within(before.xyyaw[::-1]), _rows_within(after.xyyaw)
    scans = chain(islice(member.scans(), len(before) - first, None), islice(session.scans(), last))
    method = Robust(config)
    steps = Steps(track(scans, method, session.at_rest._replace(expects_rest=method.expects_rest)))
    if not steps.column("tracked").all() or any(lost_intervals(steps)):
        return None
    local = tracked_trajectory(steps)
    member_T_local = frame_of([_rows(local, slice(first))], [_rows(before, slice(len(before) - first, None))])
    local_T_session = frame_of([_rows(after, slice(last))], [_rows(local, slice(first, None))])
    return member_T_local @ local_T_session


def _rows(path: Trajectory, rows: slice) -> Trajectory:
    return Trajectory(path.stamps_ns[rows], path.xyyaw[rows])


def _rows_within(xyyaw: np.ndarray) -> int:
    """Count the poses (n, 3) up to ``SIDE_M`` of the path."""
    path_m = np.hypot(*np.diff(xyyaw[:MOST_SCANS, :2], axis=0).T).cumsum()
    return 1 + int(np.searchsorted(path_m, SIDE_M))


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
    to = Counter(group.sessions[group.owner(closure.start)].name for closure in closures)
    join = join._replace(residual_m=residual_m, residual_rad=residual_rad, joined_to=tuple(to.items()))
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
    start_m, end_m = keys[tie.start].path_m, keys[tie.end].path_m
    paths_m = (keys[c.end].path_m - end_m + abs(start_m - keys[c.start].path_m) for c in closures)
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
    supporting = [(a, [b for b in closures if b is a or agree(a, b, keys)]) for a in closures]
    kept = [a for a, others in supporting if len({keys[b.end].path_m // KEY_M for b in others}) >= PLACES]
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
