"""Segments of a turn, as some drivers publish them many times a turn: joined to sweeps."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from itertools import chain, pairwise
from math import pi, tau
from typing import Final, NamedTuple

import numpy as np

from mavnav.logs.messages.definitions import LaserMessage
from mavnav.logs.preprocessing import LONGEST_SWEEP_S, MOST_BEAMS
from mavnav.logs.records import Warn
from mavnav.scan import PLAUSIBLE_SWEEP
from mavnav.units import DEG, NS

LOOKED_AT: Final = 8
"""So many messages decide whether they are segments."""

WIDEST_RAD: Final = 1.05 * pi
"""A segment is at most half a turn."""

MOST_OVERLAP: Final = 0.5
"""Share of the beams of a segment that the next may repeat."""

LONGEST_PAUSE_NS: Final = 500_000_000
"""A segment that is later, ns, begins another sweep; stamps may be integers of any size."""

FEWEST_SHARE: Final = 0.5
"""Share of the messages that continue the one before, of segments; those with other angles are reported from it on."""


class Recorded(NamedTuple):
    """A scan message, its time of recording in ns, and whether it is suspect."""

    message: LaserMessage
    log_ns: int
    suspect: bool = False


class SweepJoiners:
    """The joiners of all frames of a topic."""

    def __init__(self, topic: str, warn: Warn) -> None:
        self._by_frame = defaultdict[str, SweepJoiner](partial(SweepJoiner, topic, warn))

    def push(self, scan: Recorded) -> Iterator[Recorded]:
        """Take in a message; yield the scans of its laser that are complete."""
        return self._by_frame[scan.message.frame_id].push(scan)

    def finish(self) -> Iterator[Recorded]:
        """Yield what is left; report segments that could not be joined."""
        return chain.from_iterable(joiner.finish() for joiner in self._by_frame.values())


class SweepJoiner:
    """The scans of one laser on a topic: segments of a turn are joined to sweeps, others pass as they are.

    The first messages wait until they show which they are. A sweep begins at the angle of the first of them, or after a
    sector that none covers. Beams of segments that are lost are NaN; such sweeps are counted and reported.
    """

    def __init__(self, topic: str, warn: Warn) -> None:
        self._topic, self._warn = topic, warn
        self._waiting: list[Recorded] = []
        self._joins: bool | None = None
        self._angle_rad, self._step_rad, self._beams, self._increment_s = 0.0, 0.0, 0, 0.0
        self._scans, self._elsewhere = 0, 0
        self._sweeps, self._incomplete = 0, 0
        self._last_rad: float | None = None

    def push(self, scan: Recorded) -> Iterator[Recorded]:
        """Take in a message; yield the scans that are complete."""
        if self._joins is None:
            self._waiting.append(scan)
            if len(self._waiting) == LOOKED_AT:
                yield from self._decide()
        elif self._joins:
            yield from self._join(scan)
        else:
            self._count(scan.message)
            yield scan

    def finish(self) -> Iterator[Recorded]:
        """Yield what is left; report segments that could not be joined."""
        if self._joins is None:
            yield from self._decide()
        if self._joins and self._waiting:
            yield self._sweep()
        if self._incomplete:
            sweeps = f"{self._incomplete} of {self._sweeps} sweeps, whose beams there have no return"
            advice = "see whether the recorder or the network drops messages"
            self._warn(f"{self._topic}: segments are missing in {sweeps}: {advice}")
        elif self._elsewhere > max(FEWEST_SHARE * self._scans, LOOKED_AT // 2):
            text = "the angles of the scans change from one to the next, as of segments that do not follow each other"
            self._warn(f"{self._topic}: {text}; they are used one by one: record the full frame of the laser")

    def _decide(self) -> Iterator[Recorded]:
        """Find out what the first messages are; yield those that are complete."""
        waiting, self._waiting = self._waiting, []
        following = [_follows(a.message, b.message) for a, b in pairwise(waiting)]
        self._joins = sum(following) > FEWEST_SHARE * max(len(following), 1)
        if self._joins:
            messages = [scan.message for scan in waiting if _is_segment(scan.message)]
            behind = (b for a, b in pairwise(messages) if not _follows(a, b))
            self._begin(next(behind, messages[0]), messages)
        for scan in waiting:
            yield from self.push(scan)

    def _begin(self, first: LaserMessage, messages: list[LaserMessage]) -> None:
        """Note the geometry of the sweeps, and how long a beam takes: as stated, or by the stamps of the segments."""
        self._angle_rad, self._step_rad = first.angle_min_rad, first.angle_step_rad
        self._beams = round(tau / abs(first.angle_step_rad))
        pairs = [pair for pair in pairwise(messages) if _follows(*pair)]
        each_s = [(b.stamp_ns - a.stamp_ns) * NS / (len(a.ranges_m) + _beams_between(a, b)) for a, b in pairs]
        by_stamps_s, stated_s = float(np.median(each_s)), first.time_increment_s
        low, high = PLAUSIBLE_SWEEP
        agrees = low * by_stamps_s <= abs(stated_s) <= high * by_stamps_s
        possible = abs(stated_s) * self._beams <= LONGEST_SWEEP_S  # False for NaN, too
        self._increment_s = stated_s if agrees or (possible and not by_stamps_s) else by_stamps_s
        wide = len(first.ranges_m) * abs(first.angle_step_rad) / DEG
        self._warn(f"{self._topic}: the scans are segments of {wide:.0f} deg, which are joined to sweeps")

    def _join(self, scan: Recorded) -> Iterator[Recorded]:
        """Add a segment to the sweep; yield the one before if it begins another. What is no segment passes."""
        if not (_is_segment(scan.message) and _same_step(scan.message.angle_step_rad, self._step_rad)):
            yield scan
            return
        if self._waiting:
            last = self._waiting[-1]
            late_ns = scan.message.stamp_ns - last.message.stamp_ns
            if self._place(scan) <= self._place(last) or not 0 <= late_ns <= LONGEST_PAUSE_NS:
                yield self._sweep()
        self._waiting.append(scan)

    def _place(self, scan: Recorded) -> int:
        """Return the number of the first beam of a segment in its sweep."""
        message = scan.message
        return round((message.angle_min_rad - self._angle_rad) / message.angle_step_rad) % self._beams

    def _sweep(self) -> Recorded:
        """Return the sweep of the segments that wait."""
        segments, self._waiting = self._waiting, []
        ranges_m, first = np.full(self._beams, np.nan), segments[0]
        end, missing = self._beams, False
        for scan in segments:
            place = self._place(scan)
            missing |= place > end + len(scan.message.ranges_m) // 2
            end = place + len(scan.message.ranges_m)
            part = scan.message.ranges_m[: self._beams - place]
            ranges_m[place : place + len(part)] = part
        self._sweeps, self._incomplete = self._sweeps + 1, self._incomplete + missing
        begin_ns = first.message.stamp_ns - round(self._place(first) * abs(self._increment_s) / NS)
        message = first.message._replace(
            stamp_ns=begin_ns,
            angle_min_rad=self._angle_rad,
            last_angle_rad=None,
            time_increment_s=self._increment_s,
            scan_time_s=self._beams * abs(self._increment_s),
            ranges_m=ranges_m,
        )
        return Recorded(message, first.log_ns, any(scan.suspect for scan in segments))

    def _count(self, message: LaserMessage) -> None:
        """Count the scans of a part of a turn whose angles are others than those before."""
        narrow = 0.0 < len(message.ranges_m) * abs(message.angle_step_rad) <= WIDEST_RAD
        self._scans += 1
        self._elsewhere += narrow and message.angle_min_rad != self._last_rad
        self._last_rad = message.angle_min_rad


def _is_segment(message: LaserMessage) -> bool:
    """Return whether a scan may be a part of a turn."""
    step_rad = abs(message.angle_step_rad)
    fine = tau <= step_rad * MOST_BEAMS and abs(message.angle_min_rad) <= 2 * tau  # False for NaN, too
    return fine and 0.0 < len(message.ranges_m) * step_rad <= WIDEST_RAD


def _same_step(a_rad: float, b_rad: float) -> bool:
    return abs(a_rad - b_rad) <= 1e-3 * abs(b_rad)


def _follows(before: LaserMessage, message: LaserMessage) -> bool:
    """Return whether a message begins where the one before ends, or within it, soon after it."""
    step_rad = before.angle_step_rad
    if not (_is_segment(before) and _is_segment(message) and _same_step(message.angle_step_rad, step_rad)):
        return False
    soon = 0 <= message.stamp_ns - before.stamp_ns <= LONGEST_PAUSE_NS
    return soon and -MOST_OVERLAP * len(before.ranges_m) <= _beams_between(before, message) <= 1.5


def _beams_between(before: LaserMessage, message: LaserMessage) -> float:
    """Return the number of beams that would fit between two segments; below 0, those that the second repeats."""
    step_rad = before.angle_step_rad
    off_rad = message.angle_min_rad - before.angle_min_rad - len(before.ranges_m) * step_rad
    return (off_rad - tau * round(off_rad / tau)) / step_rad
