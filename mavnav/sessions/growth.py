"""Groups grow: each session is searched in the map of those that are joined, and joins if the evidence suffices.

A join needs the evidence of a loop. Scans at different places of the session are searched in the whole map of the
group. At least three, and most of those that fit in one place only, must agree on one transform. Closures are searched
from there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from mavnav.config.models import Config
from mavnav.pose import Pose
from mavnav.sessions.closures import SOON_S, ended_before, join_at_end, join_session, pause_between_s
from mavnav.sessions.group import GroupMap, Join, Session, SessionGroup, group_in_frame
from mavnav.sessions.map_alignment import fit_transform
from mavnav.slam.loop_closure.closure import AMBIGUITY_MARGIN, fits
from mavnav.slam.loop_closure.key_frames import KeyFrame, KeyFrameMap
from mavnav.slam.matching.relocalization import AGREEING_SCANS, Region, apart, candidates, everywhere, unambiguous
from mavnav.slam.matching.scan_matching import Match
from mavnav.slam.matching.steps import evenly
from mavnav.slam.recovery.parts import consensus

Report = Callable[[str], None]
"""Called with the name of the session that is searched."""

WITNESSES, IN_TURN = 24, 3
"""So many key frames of a session, evenly along its path, are searched in the whole map of a group, a third at once."""

ENOUGH, ENOUGH_SHARE = 4, 0.8
"""No more are searched once so many agree, and so large a share of those that fit in one place."""

FEW, AROUND_M = 6, 1.5
"""Where no more of them fit, all key frames this near along the path are searched too: sessions may meet at an end."""

MOST_PLACES = 12
"""So many places of a whole map are compared closely for each."""


def locate_session(session: Session, known: KeyFrameMap, config: Config) -> tuple[Join, Pose | None]:
    """Search a session in the map of a group; return the evidence, and its pose there, None if too few agree."""
    pairs, searched = witnesses(session, known, config)
    group_T_session, join = consensus(pairs), Join(session.name, searched, len(pairs))
    if group_T_session is None:
        few = "too few of its scans fit in one place of the others' map"
        return join._replace(why=few if len(pairs) < AGREEING_SCANS else "its scans disagree"), None
    agreeing = [pair for pair in pairs if not apart(group_T_session @ pair[0], pair[1])]
    return join._replace(agreeing=len(agreeing)), fit_transform(agreeing)


def witnesses(session: Session, known: KeyFrameMap, config: Config) -> tuple[list[tuple[Pose, Pose]], int]:
    """Search key frames in the whole map of a group; return those that fit in one place, before and there.

    The number of key frames that were searched is returned too.
    """
    region, numbers = everywhere(known.grid), evenly(len(session.keys), WITNESSES)
    match_of: dict[int, Match | None] = {}

    def search(some: Iterable[int]) -> list[tuple[Pose, Pose]]:
        for k in some:
            if k not in match_of:
                match_of[k] = _only_place(session.keys[k], known, region, config)
        return [(session.keys[k].map_T_laser, m.map_T_laser) for k, m in sorted(match_of.items()) if m]

    for turn in range(IN_TURN):
        pairs = search(numbers[turn::IN_TURN])
        if are_enough(pairs):
            return pairs, len(match_of)
    if len(pairs) <= FEW:
        fitting = [session.keys[k].path_m for k, match in match_of.items() if match]
        near = (any(abs(key.path_m - path_m) <= AROUND_M for path_m in fitting) for key in session.keys)
        pairs = search(np.flatnonzero(list(near)).tolist())
    return pairs, len(match_of)


def are_enough(pairs: Sequence[tuple[Pose, Pose]]) -> bool:
    """Return whether witnesses agree so well that no more are needed."""
    place = consensus(list(pairs))
    count = 0 if place is None else sum(not apart(place @ before, after) for before, after in pairs)
    return count >= ENOUGH and count >= ENOUGH_SHARE * len(pairs)


def _only_place(key: KeyFrame, known: KeyFrameMap, region: Region, config: Config) -> Match | None:
    """Return where a key frame fits in a map; None where it fits nowhere, or elsewhere about as well."""
    if len(key.points) < config.robust.min_points:
        return None
    places = candidates(key.points, known.lines, known.grid, region, config, MOST_PLACES)
    best = unambiguous(places, AMBIGUITY_MARGIN, config)
    return best if best and fits(best) else None


MOST_ALIKE = 0.5
"""A session with a larger share of the scans of another one is the same recording."""


def join_sessions(sessions: Sequence[Session], config: Config, report: Report) -> tuple[SessionGroup, list[Join]]:
    """Join sessions to groups; return the largest, and for each session outside of it why it is there.

    There must be a session. Those whose track is doubtful come last.
    """
    refused = {again: Join(again, why=f"it has the scans of {name}") for again, name in find_repeats(sessions)}
    waiting = [session for session in sessions if session.name not in refused]
    waiting.sort(key=lambda session: (session.doubtful, -len(session.keys)))
    groups: list[SessionGroup] = []
    while waiting and sum(len(s.keys) for s in waiting) > max((len(group.keys) for group in groups), default=0):
        first = first_of_recording(waiting[0], waiting)
        others = [session for session in waiting if session is not first]
        group, waiting, tried = extend_group(group_in_frame([first]), others, config, report)
        groups.append(group)
        refused |= {join.name: join for join in tried}
    best = max(groups, key=lambda group: len(group.keys))
    for group in groups:
        if group is not best:
            names = [session.name for session in group.sessions]
            refused |= {name: _left_out(name, names) for name in names}
    inside = {session.name for session in best.sessions}
    return best, [refused[session.name] for session in sessions if session.name not in inside]


def first_of_recording(session: Session, others: Sequence[Session]) -> Session:
    """Return the first part of the recording that a session goes on with; itself, if it is not known to."""
    before = [other for other in others if not other.doubtful and pause_between_s(session, other, SOON_S) is not None]
    return first_of_recording(before[0], others) if before else session


def find_repeats(sessions: Sequence[Session]) -> Iterator[tuple[str, str]]:
    """Find sessions that have the scans of another one: their names, and those of the others, which are longer."""
    longest = sorted(sessions, key=lambda session: -len(session.scan_hashes))
    for k, session in enumerate(longest):
        for other in longest[:k]:
            if alike(session, other):
                yield session.name, other.name
                break


def alike(session: Session, other: Session) -> bool:
    """Return whether most scans of a session are those of another one."""
    return len(session.scan_hashes & other.scan_hashes) > MOST_ALIKE * len(session.scan_hashes)


def _left_out(name: str, group: list[str]) -> Join:
    others = ", ".join(other for other in group if other != name)
    why = f"it joins {others} alone, a smaller group" if others else "too few scans of the others fit in its map"
    return Join(name, why=why)


def extend_group(
    group: SessionGroup, waiting: Sequence[Session], config: Config, report: Report, pause_s: float = SOON_S
) -> tuple[SessionGroup, list[Session], list[Join]]:
    """Join sessions to a group until none joins any more, the best witnessed first; return what is left, and why.

    One that begins within ``pause_s`` after one of the group ended is also tried at its end.
    """
    here, left = GroupMap(group.keys, config), sorted(waiting, key=lambda session: session.doubtful)
    while True:
        before = group
        group, here = _join_following(group, here, left, config)
        left = [session for session in left if session not in group.sessions]
        group, here, tried = _join_witnessed(group, here, left, config, report, pause_s)
        left = [session for session in left if session not in group.sessions]
        if not left or group is before:
            return group, left, tried


def _join_following(
    group: SessionGroup, here: GroupMap, waiting: Sequence[Session], config: Config
) -> tuple[SessionGroup, GroupMap]:
    """Join the sessions with which a recording goes on, one after another."""
    for session in sorted(waiting, key=lambda each: (each.doubtful, each.map_T_laser.stamps_ns[0])):
        cut = ended_before(group, session, SOON_S)
        larger = join_at_end(group, session, cut, here, Join(session.name), config)[0] if cut else None
        if larger:
            group, here = larger, here.with_keys(larger.keys)
    return group, here


def _join_witnessed(
    group: SessionGroup, here: GroupMap, waiting: Sequence[Session], config: Config, report: Report, pause_s: float
) -> tuple[SessionGroup, GroupMap, list[Join]]:
    """Join the sessions that are found in the map, or lie at the end of another; return also why others do not join."""
    places: list[tuple[Session, Join, Pose | None]] = []
    for session in waiting:
        report(session.name)
        places.append((session, *locate_session(session, here.map, config)))
    tried = list[Join]()
    for session, join, place in sorted(places, key=lambda each: (each[0].doubtful, -each[1].agreeing_share)):
        larger, result = join_session(group, session, place, here, join, config) if place else (None, join)
        cut = ended_before(group, session, pause_s)
        if larger is None and cut and not cut.soon:
            larger, result = join_at_end(group, session, cut, here, result, config)
        if larger is None:
            tried.append(result)
        else:
            group, here = larger, here.with_keys(larger.keys)
    return group, here, tried
