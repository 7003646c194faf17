"""The height of the ceiling, where a tilted laser sees it: many returns at one height, and hardly any above."""

from __future__ import annotations

from itertools import islice
from math import inf
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from mavnav.logs.levelling import RecordedAttitude
    from mavnav.scan import Scan

MOST_SCANS: Final = 3000
"""The ceiling is sought in the first so many scans."""

LEAST_TILT_RAD: Final = 2 * DEG
HIGHEST_M: Final = 100.0
BIN_M: Final = 0.05
WIDTHS: Final = (1, 2, 4)
"""Heights are counted in bins of this size, of which a ceiling fills so many, by the noise of the attitude."""

LEAST_RETURNS, TIMES_BELOW, BELOW, SHARE_ABOVE = 100, 2.0, 6, 0.05
"""A ceiling has so many returns, so many times as dense as in the next bins below, and that share of them above."""

LEAST_SPREAD_RAD: Final = 1.5 * DEG
"""Standard deviation of the tilts that show it: at one tilt a wall is met at one height, too."""


def with_ceiling(attitude: RecordedAttitude, scans: Iterable[Scan]) -> RecordedAttitude:
    """Add the height of the ceiling that scans show, which are not levelled."""
    return replace(attitude, ceiling_m=ceiling_height_m(scans, attitude)) if attitude.has_heights else attitude


def ceiling_height_m(scans: Iterable[Scan], attitude: RecordedAttitude) -> float:
    """Return the height of the ceiling above the floor, m, from scans that are not levelled; inf if none is seen."""
    if attitude.tilt_rad.max() < LEAST_TILT_RAD or attitude.height_m.max() > HIGHEST_M:
        return inf
    above = [_above(scan, attitude) for scan in islice(scans, MOST_SCANS)]
    heights_m, tilts_rad = np.concatenate([np.zeros((0, 2)), *above]).T
    counts = np.bincount((heights_m / BIN_M).astype(np.int64))
    for width in WIDTHS:
        peak = _peak(counts, width)
        if peak:
            within = np.abs(heights_m / BIN_M - peak + 0.5 * width) <= 0.5 * width
            return float(heights_m[within].mean()) if tilts_rad[within].std() >= LEAST_SPREAD_RAD else inf
    return inf


def _peak(counts: NDArray[np.int64], width: int) -> int:
    """Return the end of the highest bins, of a width, that may be a ceiling; 0 if there are none."""
    for end in range(len(counts), BELOW + width - 1, -1):
        here, above = int(counts[end - width : end].sum()), int(counts[end:].sum())
        below = counts[end - width - BELOW : end - width].mean() * width
        if above > SHARE_ABOVE * max(here, LEAST_RETURNS):
            return 0
        if here >= LEAST_RETURNS and here >= TIMES_BELOW * below:
            return end
    return 0


def _above(scan: Scan, attitude: RecordedAttitude) -> NDArray[np.float64]:
    """Return height, m, and tilt, rad, of the returns that lie above the laser, (n, 2)."""
    roll, pitch, height = (v[0] for v in attitude.at(np.array([float(scan.stamp_ns - int(attitude.stamps_ns[0]))])))
    up = np.array([-np.sin(pitch), np.sin(roll) * np.cos(pitch)])
    rise_m = scan.points() @ up
    heights_m = height + rise_m[rise_m > 2 * BIN_M]
    return np.column_stack((heights_m, np.full(len(heights_m), np.hypot(*up))))
