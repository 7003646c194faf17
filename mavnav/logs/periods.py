"""How often scans come, and where they pause."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavnav.logs.records import Gap
from mavnav.units import NS

_GAP_PERIODS: Final = 3.0

_SHORTEST_NS, _BURST_SHARE, _LEAST_BURST_SCANS = 5_000_000, 0.3, 10
"""Time between two scans that is too short for a laser, and share and number of such scans of a log with bursts."""
_MANY_SCANS, _BURST_QUANTILE = 64, 0.95
"""Number of scans over which their mean period is taken, and quantile of the steps that is one between bursts."""


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
