"""The tracker, the paper's Figure 1: predict, match, gate, insert."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavnav.slam.relocalization import apart
from mavnav.slam.steps import Step
from mavnav.slam.track_state import TrackState, Verdict

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mavnav.scan import Scan
    from mavnav.slam.method import Method, Refiner
    from mavnav.slam.motion_model import Motion
    from mavnav.slam.scan_matching import Match

DOUBTFUL_SCANS, LONG_LOST_SCANS, RARELY_SCANS = 8, 16, 64
"""The whole map is searched for a doubtful pose within the first so many scans without an accepted one, and later, of a
log without odometry, if the last search is so many scans ago; for any pose after the second number, then at one scan in
the third."""


def track(scans: Iterable[Scan], method: Method, motion: Motion, first: int = 0) -> Iterator[Step]:
    """Follow the laser through the scans while the method's map grows (paper, Figure 1).

    The first scan that the method can use becomes the map, and its pose the map frame. Afterwards a scan that does
    not match well enough moves neither map nor pose (paper, "Map Update"). Steps are numbered from ``first`` on.
    """
    state = None
    for index, scan in enumerate(scans, first):
        if state is None:
            match = method.first(scan)
            here, tracked = motion, match.converged
            state = TrackState(motion.started_at(match.map_T_laser, scan.stamp_ns)) if tracked else None
        else:
            here = state.here
            match = method.match(scan, here.predict(scan.stamp_ns), here)
            verdict = method.gate(match, scan, here)
            if method.refiner and state.trial is None and worth_a_search(verdict, state):
                match, verdict, state = search_if_paid(scan, match, verdict, state, method.refiner)
            state = state.after(verdict, match.map_T_laser, scan.stamp_ns)
            tracked = state.missed == 0
        if tracked:
            method.insert(scan, match.map_T_laser, here)
        yield Step(index, scan.stamp_ns, match, tracked)


def search_if_paid(
    scan: Scan, match: Match, verdict: Verdict, state: TrackState, refiner: Refiner
) -> tuple[Match, Verdict, TrackState]:
    """Search the whole map if the budget of work pays for it; else a doubtful pose is accepted on trial.

    After a long gap it is refused for the scans that follow a search.
    """
    if state.missed >= DOUBTFUL_SCANS > state.missed - state.searched:
        return match, Verdict.REFUSED, state
    if not refiner.pays_for_whole_map(scan):
        return match, verdict, state
    found, verdict = search_everywhere(scan, match, verdict, state.here, refiner)
    return found, verdict, state._replace(searched=state.missed)


def search_everywhere(
    scan: Scan, match: Match, verdict: Verdict, here: Motion, refiner: Refiner
) -> tuple[Match, Verdict]:
    """Search the whole map: a doubtful pose is accepted if no other explains the scan as well, another on trial."""
    found = refiner.relocalize(scan, match, here)
    if found is None:
        return match, Verdict.REFUSED
    agree = verdict is Verdict.PROBABLE and not apart(found.map_T_laser, match.map_T_laser)
    return found, Verdict.SURE if agree else Verdict.PROBABLE


def worth_a_search(verdict: Verdict, state: TrackState) -> bool:
    """Return whether to search the whole map: for doubtful poses, and rarely for others when lost.

    Where odometry leads after a long gap, the next scans are proof enough.
    """
    missed = state.missed
    if verdict is Verdict.PROBABLE and (missed < DOUBTFUL_SCANS or state.motion.odometry is None):
        return True
    return missed > 0 and verdict is not Verdict.SURE and (missed == LONG_LOST_SCANS or missed % RARELY_SCANS == 0)
