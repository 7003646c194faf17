"""Stamps in a log: the order in which its messages are used, their clocks, and how often scans come.

The times of recording show where a clock was set, and by how much two of them differ.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Callable
from typing import Final, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.logs.records import Gap, Warn
from mavnav.units import NS, pluralize

StampSource = Literal["header", "log"]

_LATEST_NS: Final = 1 << 62
_CALENDAR_NS: Final = 1_000_000_000_000_000_000
"""September 2001: stamps of a clock with a date are later, those that count from a start before."""

APART_S: Final = 1.0
"""Clocks that are closer, s, are compared by the motion that they date; recording may be late by as much."""

SPREAD: Final = 2.0
"""Difference between two clocks in spreads of both, from which it is one."""

SET_FORWARD_S: Final = 10.0
"""A step of the stamps beyond that of the times of recording, s, that is no pause of the recorder."""

SAME_RATE: Final = (0.9, 1.1)
"""Ratios of the stamps' time to that of recording where both are of real time."""

FASTEST_HZ, SLOWEST_HZ = 1000.0, 0.1
"""No planar laser scans faster, and none that moves as slowly."""

OTHER_UNIT: Final = 0.01
"""Ratio of the time of such scans by their stamps and by recording from which they are in another unit, as ms are."""

LEAST_SCANS: Final = 10
"""Fewer show no rate."""

_GAP_PERIODS: Final = 3.0

_SHORTEST_NS, _BURST_SHARE, _LEAST_BURST_SCANS = 5_000_000, 0.3, 10
"""Time between two scans that is too short for a laser, and share and number of such scans of a log with bursts."""
_MANY_SCANS, _BURST_QUANTILE = 64, 0.95
"""Number of scans over which their mean period is taken, and quantile of the steps that is one between bursts."""


def storable(stamp_ns: int) -> int:
    """Return a stamp within the range of 64 bits; an impossible one stays impossible."""
    return min(max(stamp_ns, -1), _LATEST_NS)


class Stamps(Struct):
    """Both stamps of the messages of a topic as they came, 16 bytes each: of their headers, and of their recording."""

    header_ns: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.header_ns)

    def add(self, header_ns: int, log_ns: int) -> None:
        """Take in the stamps of one message."""
        self.header_ns.append(header_ns if 0 <= header_ns < _LATEST_NS else storable(header_ns))
        self.log_ns.append(log_ns if 0 <= log_ns < _LATEST_NS else storable(log_ns))

    def extend(self, header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> None:
        """Take in the stamps of several messages, (n,) each."""
        for column, values in ((self.header_ns, header_ns), (self.log_ns, log_ns)):
            column.frombytes(values.clip(-1, _LATEST_NS).tobytes())

    def by(self, source: StampSource) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the stamps of a source, and those of recording, (n,) each."""
        header_ns, log_ns = np.array(self.header_ns, np.int64), np.array(self.log_ns, np.int64)
        return (header_ns if source == "header" else log_ns), log_ns


class MessageTrack(Struct):
    """The messages of a topic as they came: the frame of a sensor or body, stamps, and numbers of single precision."""

    topic: str
    frame: str = ""
    stamps: Stamps = field(default_factory=Stamps)
    numbers: array[float] = field(default_factory=lambda: array("f"))

    def extend(self, stamps_ns: NDArray[np.int64], log_ns: NDArray[np.int64], numbers: NDArray[np.float64]) -> None:
        """Take in several messages: stamps (n,) of both kinds, and numbers (n, k)."""
        self.stamps.extend(stamps_ns, log_ns)
        with np.errstate(over="ignore"):
            self.numbers.frombytes(numbers.astype(self.numbers.typecode).tobytes())

    def rows(self, width: int) -> NDArray[np.float64]:
        """Return the numbers of all messages, (n, width)."""
        return np.array(self.numbers, np.float64).reshape(-1, width)


def ascending(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Choose the most elements that ascend strictly.

    Where passing over what is not later than all before keeps as many, that is the choice: so of two equal stamps the
    first counts, and a step back costs the scans after it, not those before.

    Parameters
    ----------
    stamps_ns
        (n,), in the order of use.

    Returns
    -------
    indices
        (m,), ascending, with ``m <= n``.
    """
    later = stamps_ns[1:] > np.maximum.accumulate(stamps_ns)[:-1]
    greedy = np.flatnonzero(np.concatenate((np.ones(min(len(stamps_ns), 1), np.bool_), later)))
    if (np.diff(stamps_ns) >= 0).all():
        return greedy
    longest = _longest_ascending(stamps_ns.tolist())
    return greedy if len(greedy) >= len(longest) else np.array(longest)


def in_order(stamps_ns: NDArray[np.int64], recorded_ns: NDArray[np.int64], topic: str, warn: Warn) -> NDArray[np.int64]:
    """Choose the most messages of ascending stamps, in the order of the file, or of recording where that keeps more.

    Returns their indices in the order of use, and warns of those left out; of equal stamps one is enough.
    """
    possible = np.flatnonzero(~impossible_stamps(stamps_ns))
    chosen = better_order(possible, recorded_ns, lambda numbers: numbers[ascending(stamps_ns[numbers])])
    if len(chosen) < len(stamps_ns) and (left_out := ~np.isin(stamps_ns, stamps_ns[chosen])).any():
        warn(f"{topic}: {left_out.sum()} of {len(stamps_ns)} messages are left out, their stamps do not ascend")
    return chosen


def better_order(
    numbers: NDArray[np.int64], recorded_ns: NDArray[np.int64], choose: Callable[[NDArray[np.int64]], NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Choose from the numbers (n,) in the order of the file, or of recording where that keeps more."""
    chosen = choose(numbers)
    if len(chosen) == len(numbers):
        return chosen
    other = choose(numbers[np.argsort(recorded_ns[numbers], kind="stable")])
    return other if len(other) > len(chosen) else chosen


def _longest_ascending(values: list[int]) -> list[int]:
    """Return the indices of the longest strictly ascending subsequence (patience sorting)."""
    tops: list[int] = []
    indices: list[int] = []
    previous: list[int] = []
    for index, value in enumerate(values):
        pile = bisect_left(tops, value)
        previous.append(indices[pile - 1] if pile else -1)
        tops[pile : pile + 1] = [value]
        indices[pile : pile + 1] = [index]
    chain, index = [], indices[-1] if indices else -1
    while index >= 0:
        chain.append(index)
        index = previous[index]
    return chain[::-1]


def impossible_stamps(stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which stamps are no times; zero is one, unless the clock has a date."""
    given = stamps_ns[stamps_ns != 0]
    least = 1 if len(given) and np.median(given) > _CALENDAR_NS else 0
    return (stamps_ns < least) | (stamps_ns >= _LATEST_NS)


class Clock(NamedTuple):
    """How far the stamps of a topic are ahead of the times of recording, s: the median, and the range of most."""

    ahead_s: float
    spread_s: float


def clock_of(stamps_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> Clock | None:
    """Return the clock of messages by their stamps and their times of recording, (n,) each; None without any."""
    if not len(stamps_ns):
        return None
    low, middle, high = np.quantile((stamps_ns - log_ns) * NS, (0.05, 0.5, 0.95)).tolist()
    return Clock(middle, high - low)


def shift_s(clock: Clock | None, scans: Clock | None, sweep_s: float) -> float:
    """Return what to add to stamps of a clock to have those of the scans', s; 0 where no recording shows it.

    A scan may be recorded at the end of its sweep.
    """
    if clock is None or scans is None:
        return 0.0
    shift = scans.ahead_s - clock.ahead_s
    return shift if abs(shift) > max(APART_S + sweep_s, SPREAD * (clock.spread_s + scans.spread_s)) else 0.0


def set_back_text(stamps_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> str:
    """Say why stamps (n,) do not ascend, of messages in the order of recording at ``log_ns``."""
    backward = np.flatnonzero(np.diff(stamps_ns) < -APART_S / NS)
    if not len(backward):
        return "several share one stamp, or they do not ascend"
    since_s = (log_ns[backward[0] + 1] - log_ns[0]) * NS
    times = "once" if len(backward) == 1 else f"{len(backward)} times, first"
    return f"the clock was set back {times} {since_s:.1f} s after the first scan"


def set_forward_text(stamps_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> str:
    """Say that ascending stamps (n,) were set forward, if their times of recording show it; else nothing."""
    steps_s, recorded_s = np.diff(stamps_ns) * NS, np.diff(log_ns) * NS
    forward = steps_s - recorded_s > SET_FORWARD_S
    rate = steps_s[~forward].sum() / max(recorded_s[~forward].sum(), NS)
    if not forward.any() or not SAME_RATE[0] < rate < SAME_RATE[1]:
        return ""
    first = int(np.argmax(forward))
    times = pluralize(int(forward.sum()), "time")
    return f"the clock was set forward {times}, by {steps_s[first]:.0f} s at {recorded_s[:first].sum():.1f} s"


def other_unit_text(stamps_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> str:
    """Say that ascending stamps (n,) of scans are in another unit, by the times of recording; else nothing."""
    span_s, recorded_s = (float(np.ptp(each)) * NS for each in (stamps_ns, log_ns))
    scans = len(stamps_ns)
    if scans < LEAST_SCANS:
        return ""
    short = span_s * FASTEST_HZ < scans and span_s < OTHER_UNIT * recorded_s
    slow = float(np.median(np.diff(stamps_ns))) * NS * SLOWEST_HZ > 1.0  # whatever pauses there are
    long = slow and recorded_s < OTHER_UNIT * span_s and recorded_s * FASTEST_HZ > scans
    if not (short or long):
        return ""
    return f"they say that {scans} scans took {span_s:.6g} s, recording {recorded_s:.4g} s: they are in another unit"


def period_and_gaps(stamps_ns: NDArray[np.int64]) -> tuple[float, tuple[Gap, ...]]:
    """Return the median period (s, 0 for a single scan) and the pauses longer than three of it.

    Where scans come in bursts, the period is the median over many scans, and a pause is longer than three bursts.
    """
    if len(stamps_ns) < 2:
        return 0.0, ()
    steps = np.diff(stamps_ns)
    period_ns = burst_ns = float(np.median(steps))
    if comes_in_bursts(stamps_ns):
        period_ns, burst_ns = _mean_step_ns(stamps_ns), float(np.quantile(steps, _BURST_QUANTILE))
    return period_ns * NS, tuple(
        Gap(int(stamps_ns[k]), float(steps[k]) * NS) for k in np.flatnonzero(steps > _GAP_PERIODS * burst_ns)
    )


def comes_in_bursts(stamps_ns: NDArray[np.int64]) -> bool:
    """Return whether many scans follow the one before faster than any laser turns: a buffer delivered them at once."""
    if len(stamps_ns) < _LEAST_BURST_SCANS or _mean_step_ns(stamps_ns) < 2 * _SHORTEST_NS:
        return False
    return bool(np.mean(np.diff(stamps_ns) < _SHORTEST_NS) > _BURST_SHARE)


def _mean_step_ns(stamps_ns: NDArray[np.int64]) -> float:
    """Return the median of the mean steps over many scans, which pauses do not change."""
    n = min(_MANY_SCANS, len(stamps_ns) - 1)
    return float(np.median(stamps_ns[n:] - stamps_ns[:-n])) / n
