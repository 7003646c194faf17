"""Pauses in the scans: how far the laser can have moved meanwhile, and whether it was found late after one."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from math import hypot

import numpy as np
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.slam.matching.motion_model import GAP_S, LONGEST_S, MOST_ERROR, Motion
from mavnav.slam.matching.odometry_fit import a_second_apart
from mavnav.slam.matching.steps import Step, Steps
from mavnav.units import NS

CARRIED_S, PAUSE_PERIODS = 2.5, 2.5
"""Time without a pose from which the laser may have been carried, s, and least time of a pause in scan periods.

A pause also takes ``LONGEST_S``, from which on the whole map is searched, or ``GAP_S`` with odometry.
"""

LEAST_SPEED_M_S, FASTER, SLACK_M = 0.3, 1.2, 0.5
"""Speed that every vehicle reaches, largest ratio of the mean speed in a pause to the highest before, and slack."""

LATE_SCANS = 32
"""Number of scans after a pause without a pose from which the next pose is doubtful: the laser moved on to new area."""


class Pauses:
    """The last pause in the scans that were matched, and the highest speed of the path."""

    def __init__(self) -> None:
        """Begin without a scan."""
        self._seen_ns: int | None = None
        self._end_ns: int | None = None
        self._fastest_m_s = LEAST_SPEED_M_S

    def note(self, stamp_ns: int, motion: Motion) -> None:
        """Take note of a scan and of the motion before it."""
        shortest_s = shortest_pause_s(motion.period_s, LONGEST_S if motion.odometry is None else GAP_S)
        if self._seen_ns is not None and (stamp_ns - self._seen_ns) * NS > shortest_s:
            self._end_ns = stamp_ns
        elif motion.stamp_ns == self._seen_ns:
            self._fastest_m_s = max(self._fastest_m_s, hypot(*motion.twist[:2]))
        self._seen_ns = stamp_ns

    def exclude(self, map_T_laser: Pose, motion: Motion, stamp_ns: int) -> bool:
        """Return whether a pose is not where odometry leads, or after a pause without it too far for the laser.

        A laser that is lost while its scans go on may have been carried, but not while its wheels drive; one whose
        scans pause has moved as before.
        """
        paused = self._end_ns is not None and motion.stamp_ns < self._end_ns <= stamp_ns
        ahead = motion.by_odometry(stamp_ns)
        if ahead is None:
            return paused and is_too_far(motion.map_T_laser, map_T_laser, motion.elapsed_s(stamp_ns), self._fastest_m_s)
        driven_m = ahead.gap(motion.map_T_laser)[0]
        return (paused or driven_m > SLACK_M) and ahead.gap(map_T_laser)[0] > MOST_ERROR * driven_m + SLACK_M


def is_too_far(a: Pose, b: Pose, elapsed_s: float, fastest_m_s: float) -> bool:
    """Return whether a laser of this highest speed cannot have moved so far in a pause."""
    return a.gap(b)[0] > FASTER * fastest_m_s * elapsed_s + SLACK_M


def highest_speeds(steps: Sequence[Step]) -> tuple[float, float]:
    """Return the highest usual speeds (0.99 quantile) over about a second between accepted poses, m/s and rad/s."""
    begins, ends = a_second_apart(np.array([step.stamp_ns for step in steps], np.int64))
    pairs = [(steps[begin], steps[end]) for begin, end in zip(begins.tolist(), ends.tolist(), strict=True)]
    moved = [np.divide(a.match.map_T_laser.gap(b.match.map_T_laser), (b.stamp_ns - a.stamp_ns) * NS) for a, b in pairs]
    usual = np.quantile(moved or [(0.0, 0.0)], 0.99, axis=0)
    fastest_m_s, fastest_rad_s = np.maximum(usual, LEAST_SPEED_M_S).tolist()
    return fastest_m_s, fastest_rad_s


def shortest_pause_s(period_s: float, least_s: float) -> float:
    """Return the time between two scans from which it is a pause."""
    return max(least_s, PAUSE_PERIODS * period_s)


def pauses(steps: Steps, period_s: float, least_s: float = LONGEST_S) -> list[int]:
    """Return the numbers of the scans before the pauses of a log, of a least time."""
    shortest_s = shortest_pause_s(period_s, least_s)
    before: list[int] = np.flatnonzero(np.diff(steps.column("stamp_ns")) * NS > shortest_s).tolist()
    return before


def first_found_late(steps: Steps, period_s: float) -> int | None:
    """Return the number of the first scan after the first pause after which the laser was found late; None without."""
    accepted = np.flatnonzero(steps.column("tracked")).tolist()
    for pause in pauses(steps, period_s):
        later = bisect_right(accepted, pause)
        if 0 < later < len(accepted) and accepted[later] - pause > LATE_SCANS:
            return pause + 1
    return None


def pause_warnings(steps: Steps, motion: Motion) -> Iterator[str]:
    """Yield a warning of a log without odometry if its scans pause between two poses, and one if it goes on blindly.

    That is: for longer than a pause, while its scans match nowhere. The laser may have been carried meanwhile, to a
    place that looks like an earlier one.
    """
    stamps_ns, tracked = steps.column("stamp_ns"), np.flatnonzero(steps.column("tracked"))
    before = np.array(pauses(steps, motion.period_s, CARRIED_S), np.intp)
    earlier = np.searchsorted(tracked, before, side="right")
    between = before[(earlier > 0) & (earlier < len(tracked))]
    if len(between) and motion.odometry is None:
        yield (
            f"the scans pause for {_longest_gap(stamps_ns, between, between + 1)}: without odometry, "
            "where the laser is afterwards is known from the scans alone; check the map there"
        )
    long = np.flatnonzero(np.diff(stamps_ns[tracked]) * NS > shortest_pause_s(motion.period_s, CARRIED_S))
    blind = [k for k in long.tolist() if not ((before >= tracked[k]) & (before < tracked[k + 1])).any()]
    if blind and motion.odometry is None:
        yield (
            f"no scan matches for {_longest_gap(stamps_ns, tracked[blind], tracked[1:][blind])}: without odometry, "
            "whether the laser was carried meanwhile is known from the scans alone; check the map there"
        )


def _longest_gap(stamps_ns: NDArray[np.int64], starts: NDArray[np.intp], ends: NDArray[np.intp]) -> str:
    """Write how long the longest of some gaps is, when it begins, and how many others there are."""
    gaps_s = (stamps_ns[ends] - stamps_ns[starts]) * NS
    longest = int(np.argmax(gaps_s))
    at_s = float(stamps_ns[starts[longest]] - stamps_ns[0]) * NS
    more = f", and {len(starts) - 1} more" if len(starts) > 1 else ""
    return f"{gaps_s[longest]:.1f} s ({at_s:.1f} s after the first{more})"
