"""The height of the ceiling, where a tilted laser sees it: many returns at one height, and hardly any above."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from math import inf
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from mavnav.logs.attitude import RecordedAttitude
    from mavnav.scan import Scan

MOST_SCANS: Final = 3000
"""The ceiling is sought in the first so many scans."""

LEAST_TILT_RAD: Final = 2 * DEG
BIN_M, WIDE = 0.05, 4
"""Heights are counted in bins of the first size; a ceiling fills no more of them than the second."""

LEAST_RETURNS, TIMES_BELOW, SHARE_ABOVE = 100, 3.0, 0.05
"""A ceiling has so many returns, so many times those of as many bins below, and at most that share of them above."""


def with_ceiling(attitude: RecordedAttitude, scans: Iterable[Scan]) -> RecordedAttitude:
    """Add the height of the ceiling that scans show, which are not levelled."""
    return replace(attitude, ceiling_m=ceiling_height_m(scans, attitude)) if attitude.has_heights else attitude


def ceiling_height_m(scans: Iterable[Scan], attitude: RecordedAttitude) -> float:
    """Return the height of the ceiling above the floor, m, from scans that are not levelled; inf if none is seen."""
    if attitude.tilt_rad.max() < LEAST_TILT_RAD:
        return inf
    found = [_heights_above(scan, attitude) for scan in islice(scans, MOST_SCANS)]
    heights_m = np.concatenate(found) if found else np.zeros(0)
    counts = np.bincount((heights_m / BIN_M).astype(np.int64))
    sums = np.convolve(counts, np.ones(WIDE, np.int64))[: len(counts)]  # of the bins that end with each
    for last in range(len(counts) - 1, 2 * WIDE, -1):
        least = max(LEAST_RETURNS, TIMES_BELOW * sums[last - WIDE - 1])
        if sums[last] >= least and sums[last] == sums[last - 2 : last + 3].max():
            if counts[last + 1 :].sum() > SHARE_ABOVE * sums[last]:
                return inf
            bins = np.arange(last - WIDE + 1, last + 1)
            return float(BIN_M * ((bins + 0.5) @ counts[bins]) / sums[last])
    return inf


def _heights_above(scan: Scan, attitude: RecordedAttitude) -> NDArray[np.float64]:
    """Return the heights of the returns that lie above the laser, (n,), m."""
    roll, pitch, height = (v[0] for v in attitude.at(np.array([float(scan.stamp_ns - int(attitude.stamps_ns[0]))])))
    up = np.array([-np.sin(pitch), np.sin(roll) * np.cos(pitch)])
    rise_m = scan.points() @ up
    return np.asarray(height + rise_m[rise_m > 2 * BIN_M])
