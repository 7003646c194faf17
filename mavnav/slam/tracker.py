"""The tracker, the paper's Figure 1: predict, match, gate, insert; and its state between scans."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from time import perf_counter
from typing import NamedTuple

from mavnav.pose import Pose
from mavnav.profiling import add_scan
from mavnav.scan import Scan
from mavnav.slam.matching.budget import DOUBTFUL_SCANS, LONG_LOST_SCANS, RARELY_SCANS
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.relocalization import AGREEING_SCANS, apart
from mavnav.slam.matching.scan_matching import Match, MatchVerdict
from mavnav.slam.matching.steps import Step
from mavnav.slam.methods.registry import Method, Refiner


class TrackState(NamedTuple):
    """The last accepted motion, and the motion on trial, if any, on which the last ``confirmations`` scans agree.

    ``missed`` counts the scans since the last accepted one; ``searched`` is its value at the last search of the whole
    map, long ago without one.
    """

    motion: Motion
    trial: Motion | None = None
    confirmations: int = 0
    missed: int = 0
    searched: int = -DOUBTFUL_SCANS

    @property
    def here(self) -> Motion:
        """Motion from which the next scan is predicted."""
        return self.trial or self.motion

    def after(self, verdict: MatchVerdict, map_T_laser: Pose, stamp_ns: int) -> TrackState:
        """Return the state after a scan; the scan was accepted if ``missed`` is 0."""
        if self.trial is None and verdict is MatchVerdict.SURE:
            return TrackState(self.motion.moved_to(map_T_laser, stamp_ns))
        if verdict is MatchVerdict.REFUSED:
            return self._replace(trial=None, confirmations=0, missed=self.missed + 1)
        far = verdict is MatchVerdict.PROBABLE and not self.trial
        moved = (self.here.started_at if far else self.here.moved_to)(map_T_laser, stamp_ns)
        if self.trial and self.confirmations + 1 >= AGREEING_SCANS:
            return TrackState(moved)
        return self._replace(trial=moved, confirmations=self.confirmations + 1, missed=self.missed + 1)


def track(scans: Iterable[Scan], method: Method, motion: Motion, first: int = 0) -> Iterator[Step]:
    """Track the laser through the scans, and insert each accepted scan into the method's map (paper, Figure 1).

    The first scan that the method can use begins the map, and its pose is the map frame. A later scan that does not
    match well enough changes neither map nor pose (paper, "Map Update"). Steps are numbered from ``first`` on. A motion
    with a stamp goes on in the method's map.
    """
    state = TrackState(motion) if motion.stamp_ns else None
    for index, scan in enumerate(scans, first):
        began_s = perf_counter()
        if state is None:
            match = method.first(scan)
            here, tracked = motion, match.converged
            state = TrackState(motion.started_at(match.map_T_laser, scan.stamp_ns)) if tracked else None
        else:
            here = state.here
            match = method.match(scan, here.predict(scan.stamp_ns), here)
            verdict = method.gate(match, scan, here)
            if method.refiner and state.trial is None and needs_whole_map_search(verdict, state):
                match, verdict, state = search_whole_map(scan, match, verdict, state, method.refiner)
            state = state.after(verdict, match.map_T_laser, scan.stamp_ns)
            tracked = state.missed == 0
        if tracked:
            method.insert(scan, match.map_T_laser, here)
        add_scan(began_s)
        yield Step(index, scan.stamp_ns, match, tracked)


def search_whole_map(
    scan: Scan, match: Match, verdict: MatchVerdict, state: TrackState, refiner: Refiner
) -> tuple[Match, MatchVerdict, TrackState]:
    """Search the whole map for the scan if the budget covers it; refuse it unless exactly one pose fits.

    A probable match at that pose becomes sure. Any other pose found is probable. After ``DOUBTFUL_SCANS`` missed scans,
    matches within as many scans of the last search are refused.
    """
    if state.missed >= DOUBTFUL_SCANS > state.missed - state.searched:
        return match, MatchVerdict.REFUSED, state
    if not refiner.reserve_whole_map_search(scan):
        return match, verdict, state
    best, state = refiner.relocalize(scan, match, state.here), state._replace(searched=state.missed)
    if best is None:
        return match, MatchVerdict.REFUSED, state
    agree = verdict is MatchVerdict.PROBABLE and not apart(best.map_T_laser, match.map_T_laser)
    return best, MatchVerdict.SURE if agree else MatchVerdict.PROBABLE, state


def needs_whole_map_search(verdict: MatchVerdict, state: TrackState) -> bool:
    """Return whether to search the whole map: for probable matches, and for others when lost for long, then rarely.

    With odometry, after ``DOUBTFUL_SCANS``, the next scans confirm a probable match instead.
    """
    missed = state.missed
    if verdict is MatchVerdict.PROBABLE and (missed < DOUBTFUL_SCANS or state.motion.odometry is None):
        return True
    return missed > 0 and verdict is not MatchVerdict.SURE and (missed == LONG_LOST_SCANS or missed % RARELY_SCANS == 0)
