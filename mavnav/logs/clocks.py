"""Clocks in a log: the times of recording show where one was set, and by how much two of them differ."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavnav.units import NS, pluralize

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


def shift_s(clock: Clock | None, scans: Clock | None) -> float:
    """Return what to add to stamps of a clock to have those of the scans', s; 0 where no recording shows it."""
    if clock is None or scans is None:
        return 0.0
    shift = scans.ahead_s - clock.ahead_s
    return shift if abs(shift) > max(APART_S, SPREAD * (clock.spread_s + scans.spread_s)) else 0.0


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
