"""Time in a log: which scans come in order, and whether to believe the scans' own stamps or the recorder's."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from mavnav.logs.door import KINDS
from mavnav.logs.records import Gap
from mavnav.units import NS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.scan import LaserSpec

StampSource = Literal["header", "log"]

_LATEST_NS: Final = 1 << 62
_GAP_PERIODS: Final = 3.0


@dataclass
class StampGate:
    """Lets stamps pass that are later than all before, and in the window.

    The window's ends are in seconds from the first usable scan, both inclusive; None is open.
    """

    start_s: float | None = None
    end_s: float | None = None
    first_ns: int | None = None
    last_ns: int = -1

    def refusal(self, stamp_ns: int) -> str | None:
        """Return the reason why a scan of this time is skipped; None where it is used."""
        if not 0 <= stamp_ns < _LATEST_NS:
            return "impossible_stamp"
        if stamp_ns <= self.last_ns:
            return "duplicate_stamp" if stamp_ns == self.last_ns else "backward_stamp"
        self.last_ns = stamp_ns
        if self.first_ns is None:
            self.first_ns = stamp_ns
        since_s = (stamp_ns - self.first_ns) * NS
        early = self.start_s is not None and since_s < self.start_s
        late = self.end_s is not None and since_s > self.end_s
        return "outside_window" if early or late else None


@dataclass
class Timeline:
    """The usable scans of a topic by one source of stamps, 8 bytes a scan."""

    gate: StampGate
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    skipped: Counter[str] = field(default_factory=Counter)
    cleaning: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(KINDS), dtype=np.int64))
    first: tuple[LaserSpec, str] | None = None

    def add(self, stamp_ns: int, spec: LaserSpec, frame_id: str, counts: NDArray[np.int64]) -> None:
        """Take in a sound scan."""
        if reason := self.gate.refusal(stamp_ns):
            self.skipped[reason] += 1
            return
        self.stamps_ns.append(stamp_ns)
        self.cleaning += counts
        if self.first is None:
            self.first = spec, frame_id


@dataclass
class TopicScans:
    """The scans of one topic, by both sources of stamps, because which one is right shows at the end only."""

    header: Timeline
    log: Timeline
    total: int = 0
    refused: Counter[str] = field(default_factory=Counter)

    def source(self) -> StampSource:
        """Choose the scans' own stamps, unless they keep less than half of the scans that the recorder's keep.

        So stamps that are all zero, constant, or led by one far in the future are not believed. A constant stamp
        above zero keeps one scan, which is half of two: two scans count as constant as well.
        """
        header, log = len(self.header.stamps_ns), len(self.log.stamps_ns)
        zero = header > 0 and self.header.stamps_ns[-1] == 0
        constant = header == 1 and log > 1
        return "log" if log and (zero or constant or 2 * header < log) else "header"

    def timeline(self) -> Timeline:
        """Return the one that is believed."""
        return self.header if self.source() == "header" else self.log


def period_and_gaps(stamps_ns: array[int]) -> tuple[float, tuple[Gap, ...]]:
    """Return the median period (s, 0 for a single scan) and the pauses longer than three of it."""
    if len(stamps_ns) < 2:
        return 0.0, ()
    stamps = np.array(stamps_ns, dtype=np.int64)
    steps = np.diff(stamps)
    period_ns = float(np.median(steps))
    return period_ns * NS, tuple(
        Gap(int(stamps[k]), float(steps[k]) * NS) for k in np.flatnonzero(steps > _GAP_PERIODS * period_ns)
    )
