"""The tracker, the paper's Figure 1: predict, match, gate, insert."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavnav.slam.matching.relocalization import apart
from mavnav.slam.matching.steps import Step
from mavnav.slam.matching.track_state import MatchVerdict, TrackState

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mavnav.scan import Scan
    from mavnav.slam.matching.motion_model import Motion
    from mavnav.slam.matching.scan_matching import Match
    from mavnav.slam.methods.method import Method, Refiner

DOUBTFUL_SCANS, LONG_LOST_SCANS, RARELY_SCANS = 8, 16, 64
"""Numbers of scans without an accepted pose that decide when the whole map is searched.

Below the first, a search follows every probable match. From it on, it follows probable matches of a log without
odometry, if the last search is at least as many scans ago. At the second, and at every multiple of the third, it
follows any match that is not accepted.
"""


def track(scans: Iterable[Scan], method: Method, motion: Motion, first: int = 0) -> Iterator[Step]:
    """Track the laser through the scans, and insert each accepted scan into the method's map (paper, Figure 1).

    The first scan that the method can use begins the map, and its pose is the map frame. A later scan that does not
    match well enough changes neither map nor pose (paper, "Map Update"). Steps are numbered from ``first`` on.
    """
    state = None
    for index, scan in enumerate(scans, first):
        if state is None:
            match = method.first(scan)
            here, tracked = motion, match.converged
            state = TrackState(motion.started_at(match.map_T_laser, scan.stamp_ns)) if tracked else None
        else:
            state = state.before(scan.stamp_ns)
            here = state.here
            match = method.match(scan, here.predict(scan.stamp_ns), here)
            verdict = method.gate(match, scan, here)
            if method.refiner and state.trial is None and needs_whole_map_search(verdict, state):
                match, verdict, state = search_within_budget(scan, match, verdict, state, method.refiner)
            state = state.after(verdict, match.map_T_laser, scan.stamp_ns)
            tracked = state.missed == 0
        if tracked:
            method.insert(scan, match.map_T_laser, here)
        yield Step(index, scan.stamp_ns, match, tracked)


def search_within_budget(
    scan: Scan, match: Match, verdict: MatchVerdict, state: TrackState, refiner: Refiner
) -> tuple[Match, MatchVerdict, TrackState]:
    """Search the whole map if the budget covers it; else return the match with its verdict.

    After ``DOUBTFUL_SCANS`` missed scans, matches within as many scans of the last search are refused.
    """
    if state.missed >= DOUBTFUL_SCANS > state.missed - state.searched:
        return match, MatchVerdict.REFUSED, state
    if not refiner.reserve_whole_map_search(scan):
        return match, verdict, state
    best, verdict = search_whole_map(scan, match, verdict, state.here, refiner)
    return best, verdict, state._replace(searched=state.missed)


def search_whole_map(
    scan: Scan, match: Match, verdict: MatchVerdict, here: Motion, refiner: Refiner
) -> tuple[Match, MatchVerdict]:
    """Search the whole map for the scan; refuse it unless exactly one pose fits.

    A probable match at that pose becomes sure. Any other pose found is probable.
    """
    best = refiner.relocalize(scan, match, here)
    if best is None:
        return match, MatchVerdict.REFUSED
    agree = verdict is MatchVerdict.PROBABLE and not apart(best.map_T_laser, match.map_T_laser)
    return best, MatchVerdict.SURE if agree else MatchVerdict.PROBABLE


def needs_whole_map_search(verdict: MatchVerdict, state: TrackState) -> bool:
    """Return whether to search the whole map: for probable matches, and rarely for others when lost.

    With odometry, after a long gap, the next scans confirm a probable match instead.
    """
    missed = state.missed
    if verdict is MatchVerdict.PROBABLE and (missed < DOUBTFUL_SCANS or state.motion.odometry is None):
        return True
    return missed > 0 and verdict is not MatchVerdict.SURE and (missed == LONG_LOST_SCANS or missed % RARELY_SCANS == 0)
