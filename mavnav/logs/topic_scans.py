"""The scans of a topic: in which order they are used, which do not fit in, and whose stamps to trust."""

from __future__ import annotations

from array import array
from collections import Counter
from itertools import pairwise
from typing import Final

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.logs import stamps
from mavnav.logs.false_returns import ScanSample
from mavnav.logs.messages.definitions import LaserMessage
from mavnav.logs.preprocessing import KINDS, ScanFilter
from mavnav.logs.stamps import Clock, Stamps, StampSource, clock_of
from mavnav.scan import LaserSpec
from mavnav.units import NS

Window = tuple[float | None, float | None]

KEPT_BYTES: Final = 32 << 20
"""Scans of shorter logs are kept once they have been read: decoding costs more than the memory."""

REPEATED_SHARE: Final = 0.01
"""Share of scans that repeat the one before, above which a log is reported."""

_MOST_BACKWARD, _FEW_BACKWARD = 0.1, 10
"""Share and number of the scans that may have stamps before those of earlier ones, if the times of recording ascend."""

_CHANGES_SHARE, _FEW_CHANGES = 0.05, 4
"""Share and number of the scans whose frame may be another than that of the scan before, of one laser."""

_SUSPECT_OFFSET_NS: Final = 10_000_000_000
"""A suspect scan whose stamp is farther from its time of recording than usual, by this, is not plausible."""


class Timeline(Struct, frozen=True):
    """The usable scans of a topic, in the order of use, by one source of stamps.

    ``order`` (m,) holds their numbers in the file, ``stamps_ns`` (m,) ascends strictly, ``later_ns`` is the time from
    the first usable scan of the topic to the first in the window. ``cleaning`` (8,) counts their beams by
    ``preprocessing.KINDS``; ``repeated`` counts the scans with the ranges of the one before in the file; ``first`` is
    geometry and frame of the first. ``clock`` compares the stamps with the times of recording;
    ``distrust`` is why the scans' own are not used, empty where they are.
    """

    source: StampSource
    order: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    later_ns: int
    skipped: Counter[str]
    cleaning: NDArray[np.int64]
    suspect: int
    repeated: int
    first: tuple[LaserSpec, str] | None
    clock: Clock | None
    distrust: str


class TopicScans(Struct):
    """The scans of one topic: those that the filter admitted in the order of the file, and the number of all others.

    Some 50 bytes a scan. ``ranges`` are the admitted scans themselves, so that a short log is read once; None where
    they would take more than `KEPT_BYTES`. ``sample`` are some of all.
    """

    scan_filter: ScanFilter
    total: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    ranges: list[tuple[LaserSpec, NDArray[np.float64]]] | None = field(default_factory=list)
    sample: ScanSample = field(default_factory=ScanSample)
    _stamps: Stamps = field(default_factory=Stamps)
    _kind: array[int] = field(default_factory=lambda: array("I"))
    _suspect: bytearray = field(default_factory=bytearray)
    _content: array[int] = field(default_factory=lambda: array("q"))
    _cleaning: array[int] = field(default_factory=lambda: array("I"))
    _kinds: list[tuple[LaserSpec, str]] = field(default_factory=list)

    def refuse(self, reason: str) -> None:
        """Count a scan that is not used."""
        self.total += 1
        self.refused[reason] += 1

    def take(self, laser: LaserMessage, log_ns: int, suspect: bool) -> None:
        """Take in a scan recorded at ``log_ns`` if the filter admits it; keep it as long as there are few."""
        admitted = self.scan_filter.admit(laser)
        if isinstance(admitted, str):
            self.refuse(admitted)
            return
        self.total += 1
        spec, ranges_m, counts = admitted
        self._content.append(hash(ranges_m.tobytes()))  # NaN too
        self.sample.add(ranges_m)
        if self.ranges is not None:
            self.ranges.append((spec, ranges_m))
            if ranges_m.nbytes * len(self.ranges) > KEPT_BYTES:
                self.ranges = None
        kind = (spec, laser.frame_id)
        if not self._kinds or self._kinds[-1] != kind:
            self._kinds.append(kind)
        self._stamps.add(laser.stamp_ns, log_ns)
        self._kind.append(len(self._kinds) - 1)
        self._suspect.append(suspect)
        self._cleaning.extend(counts)

    def frames(self) -> list[str]:
        """Return the frames of the scans, each once, sorted."""
        return sorted({self._kinds[number][1] for number in set(self._kind)})

    def is_of_several_lasers(self) -> bool:
        """Return whether the frames of the scans change to and fro, as those of several lasers."""
        frames = [self._kinds[number][1] for number in self._kind]
        changes = sum(a != b for a, b in pairwise(frames))
        return changes > max(_FEW_CHANGES, _CHANGES_SHARE * len(frames))

    def of_frame(self, frame: str) -> TopicScans:
        """Return the scans of one laser; those that are not usable are of no frame."""
        numbers = [k for k, kind in enumerate(self._kind) if self._kinds[kind][1] == frame]
        own, beams, sample = Stamps(), np.array(self._cleaning, np.int64).reshape(-1, len(KINDS)), ScanSample()
        for k in numbers:
            own.add(self._stamps.header_ns[k], self._stamps.log_ns[k])
            if self.ranges:
                sample.add(self.ranges[k][1])
        return TopicScans(
            self.scan_filter,
            len(numbers),
            ranges=None if self.ranges is None else [self.ranges[k] for k in numbers],
            sample=sample,
            _stamps=own,
            _kind=array("I", [self._kind[k] for k in numbers]),
            _suspect=bytearray(self._suspect[k] for k in numbers),
            _content=array("q", [self._content[k] for k in numbers]),
            _cleaning=array("I", beams[numbers].ravel().tolist()),
            _kinds=self._kinds,
        )

    def timeline(self, window_s: Window = (None, None)) -> Timeline:
        """Choose the scans' own stamps, unless they keep less than half of the scans that the recorder's keep.

        So stamps that are all zero or constant are not trusted. A constant stamp above zero keeps one scan, which is
        half of two: two scans count as constant as well. Nor are those of a clock that is set back, where that costs
        ``_MOST_BACKWARD`` of the scans (scans recorded twice are not such), or forward, or that counts in another unit.
        The window's ends are in seconds from the first usable scan, both inclusive.
        """
        header, log = self._choose("header"), self._choose("log")
        distrust = self._distrust(header, log)
        return self._timeline(log if distrust else header, window_s, distrust)

    def _distrust(self, header: NDArray[np.int64], log: NDArray[np.int64]) -> str:
        """Return why the scans that are chosen by their own stamps are not used, but those by recording; else ""."""
        stamps_ns, log_ns = self._stamps.by("header")
        if not len(log):
            return ""
        if not len(header):
            return "they are no times"
        if stamps_ns[header[-1]] == 0:
            return "they are zero"
        if len(header) == 1 < len(log):
            return "they never change"
        backward = self._count_skipped("header", header)["backward_stamp"] if len(header) < len(log) else 0
        set_back = min(backward, len(log) - len(header)) > max(_MOST_BACKWARD * len(log), _FEW_BACKWARD)
        if set_back or 2 * len(header) < len(log):
            return stamps.set_back_text(stamps_ns[log], log_ns[log])
        chosen = stamps_ns[header], log_ns[header]
        return stamps.set_forward_text(*chosen) or stamps.other_unit_text(*chosen)

    def _choose(self, source: StampSource) -> NDArray[np.int64]:
        """Return the numbers of the scans to use, in the order of the file, or of recording where that keeps more."""
        stamps_ns, log_ns = self._stamps.by(source)
        possible = np.flatnonzero(~stamps.impossible_stamps(stamps_ns) & self._plausible())
        return stamps.better_order(possible, log_ns, lambda numbers: self._ascending(stamps_ns, numbers))

    def _ascending(self, stamps_ns: NDArray[np.int64], numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Choose the most scans of ascending stamps; no sound one is left out for a suspect one."""
        suspect = np.frombuffer(self._suspect, np.bool_)[numbers]
        if not suspect.any() or suspect.all():
            return numbers[stamps.ascending(stamps_ns[numbers])]
        (places,) = (~suspect).nonzero()
        places = places[stamps.ascending(stamps_ns[numbers[places]])]
        sound_ns = np.concatenate(([-1], stamps_ns[numbers[places]], [np.iinfo(np.int64).max]))
        behind = np.searchsorted(places, np.arange(len(numbers)))
        here_ns = stamps_ns[numbers]
        fits = suspect & (sound_ns[behind] < here_ns) & (here_ns < sound_ns[behind + 1])
        fits[places] = True
        kept = numbers[fits]
        return kept[stamps.ascending(stamps_ns[kept])]

    def _plausible(self) -> NDArray[np.bool_]:
        """Return which scans are sound, or suspect but like the sound ones in geometry and time."""
        suspect = np.frombuffer(self._suspect, np.bool_)
        if not suspect.any() or suspect.all():
            return np.ones(len(suspect), np.bool_)
        kinds = np.array(self._kind)
        header_ns, log_ns = self._stamps.by("header")
        offsets = header_ns - log_ns
        usual = float(np.median(offsets[~suspect]))
        known = {_geometry(self._kinds[kind]) for kind in np.unique(kinds[~suspect]).tolist()}
        like = np.array([_geometry(kind) in known for kind in self._kinds])
        plausible: NDArray[np.bool_] = like[kinds] & (np.abs(offsets - usual) < _SUSPECT_OFFSET_NS)
        return plausible | ~suspect

    def _timeline(self, chosen: NDArray[np.int64], window_s: Window, distrust: str) -> Timeline:
        source: StampSource = "log" if distrust else "header"
        stamps_ns, log_ns = (each[chosen] for each in self._stamps.by(source))
        inside = _inside(stamps_ns, window_s)
        order = chosen[inside]
        skipped = self._count_skipped(source, chosen)
        skipped["outside_window"] = len(chosen) - len(order)
        return Timeline(
            source=source,
            order=order,
            stamps_ns=stamps_ns[inside],
            later_ns=int(stamps_ns[inside][0] - stamps_ns[0]) if inside.any() else 0,
            skipped=+skipped,
            cleaning=np.array(self._cleaning, np.int64).reshape(-1, len(KINDS))[order].sum(axis=0),
            suspect=sum(self._suspect[k] for k in order.tolist()),
            repeated=int(self._repeats()[order].sum()),
            first=self._kinds[self._kind[order[0]]] if len(order) else None,
            clock=clock_of(stamps_ns, log_ns) if source == "header" else None,
            distrust=distrust,
        )

    def _repeats(self) -> NDArray[np.bool_]:
        """Return which scans have the ranges of the one before in the file."""
        content = np.array(self._content, np.int64)
        return np.concatenate((np.zeros(min(len(content), 1), np.bool_), content[1:] == content[:-1]))

    def _count_skipped(self, source: StampSource, chosen: NDArray[np.int64]) -> Counter[str]:
        """Count the scans that are not chosen by reason."""
        stamps_ns, _ = self._stamps.by(source)
        left = np.ones(len(stamps_ns), np.bool_)
        left[chosen] = False
        impossible = left & stamps.impossible_stamps(stamps_ns)
        implausible = left & ~impossible & ~self._plausible()
        rest = np.flatnonzero(left & ~impossible & ~implausible)
        twice = self._recorded_twice(source, rest, chosen)
        counts = (impossible.sum(), implausible.sum(), twice, len(rest) - twice)
        reasons = ("impossible_stamp", "implausible", "duplicate_stamp", "backward_stamp")
        return Counter(dict(zip(reasons, map(int, counts), strict=True)))

    def _recorded_twice(self, source: StampSource, rest: NDArray[np.int64], chosen: NDArray[np.int64]) -> int:
        """Count the scans of the rest that have the stamp of a chosen one, and its ranges or its time of recording."""
        if not len(chosen):
            return 0
        (stamps_ns, log_ns), content = self._stamps.by(source), np.array(self._content, np.int64)
        nearest = chosen[np.minimum(np.searchsorted(stamps_ns[chosen], stamps_ns[rest]), len(chosen) - 1)]
        together = np.abs(log_ns[nearest] - log_ns[rest]) <= 0.5 * np.ptp(log_ns) / len(log_ns)
        alike = together | (content[nearest] == content[rest])
        return int((alike & (stamps_ns[nearest] == stamps_ns[rest])).sum())


def _geometry(kind: tuple[LaserSpec, str]) -> tuple[LaserSpec, str]:
    """Return a kind of scan without its times, which some drivers measure anew for every scan."""
    spec, frame_id = kind
    return replace(spec, time_increment_s=0.0, scan_time_s=0.0), frame_id


def _inside(stamps_ns: NDArray[np.int64], window_s: Window) -> NDArray[np.bool_]:
    """Return which stamps lie in the window, ends included; the ends are rounded to nanoseconds."""
    start_s, end_s = window_s
    since_ns = stamps_ns - stamps_ns[:1]
    late_enough = np.ones(len(stamps_ns), np.bool_) if start_s is None else since_ns >= np.rint(start_s / NS)
    return late_enough if end_s is None else late_enough & (since_ns <= np.rint(end_s / NS))
