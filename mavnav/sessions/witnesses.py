"""Where does a session lie in the map of others? Some of its key frames are searched everywhere, and must agree."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.sessions.group import Join
from mavnav.sessions.map_alignment import fit_transform
from mavnav.slam.loop_closure.closure import AMBIGUITY_MARGIN, fits
from mavnav.slam.matching.relocalization import apart, candidates, everywhere, unambiguous
from mavnav.slam.recovery.parts import LEAST_AGREEING, consensus, evenly

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from mavnav.config.models import Config
    from mavnav.pose import Pose
    from mavnav.sessions.session import Session
    from mavnav.slam.loop_closure.key_frames import KeyFrame, KeyFrameMap
    from mavnav.slam.matching.relocalization import Region
    from mavnav.slam.matching.scan_matching import Match

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
        few = (
            "too few of its scans fit in one place of the others' map"
            if len(pairs) < LEAST_AGREEING
            else "its scans disagree"
        )
        return join._replace(why=few), None
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
    best = unambiguous(
        candidates(key.points, known.lines, known.grid, region, config, MOST_PLACES), AMBIGUITY_MARGIN, config
    )
    return best if best and fits(best) else None
