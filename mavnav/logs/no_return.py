"""The value that a driver writes where nothing is in range, if it is none of REP-117 and within the limits.

Taken for returns, it draws a ring around the laser wherever that goes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.logs.own_body import ScanSample

LEAST_SHARE, LEAST_BEAMS, MOST_SHARE = 0.01, 3, 0.99
"""Shares of all returns, and number a scan, between which that value lies. More are a round room, from its centre."""

LEAST_SCANS = 5
"""Number of scans from which a value may be a driver's habit."""

NEAR, NEAR_M, RARE = 0.05, 0.3, 0.1
"""Part of the value, at least so many meters, up to which others are near, and largest count of any of these, and of
all beyond, as a share of its own: the distances of a wall are spread, also those of a laser that rounds them."""


def no_return_m(sample: ScanSample) -> float | None:
    """Return the largest or least range, m, that stands for no return in a sample of scans; None if none does."""
    ranges_m = np.concatenate([np.zeros(0), *sample.ranges_m])
    values_m, counts = np.unique(ranges_m[np.isfinite(ranges_m)], return_counts=True)
    if not len(counts) or len(sample.ranges_m) < LEAST_SCANS:
        return None
    k, total = int(np.argmax(counts)), int(counts.sum())
    count = int(counts[k])
    near_m = max(NEAR * values_m[k], NEAR_M)
    first, last = np.searchsorted(values_m, (values_m[k] - near_m, values_m[k] + near_m))
    near, beyond = np.delete(counts[first:last], k - first), min(counts[:k].sum(), counts[k + 1 :].sum())
    least = max(LEAST_SHARE * total, LEAST_BEAMS * len(sample.ranges_m))
    stands_out = max(near.max(initial=0), beyond) <= RARE * count
    return float(values_m[k]) if least <= count <= MOST_SHARE * total and stands_out else None


def without_value(ranges_m: NDArray[np.float64], none_m: float) -> NDArray[np.float64]:
    """Return ranges (n,), m, with NaN in place of the one that stands for no return."""
    return np.where(ranges_m == none_m, np.nan, ranges_m)


def no_return_warning(none_m: float) -> str:
    """Say which value is taken for no return."""
    return f"many ranges are exactly {none_m:g} m, and hardly any are near that: this value is taken for no return"
