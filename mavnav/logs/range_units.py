"""The unit of ranges: LaserScan is in meters, but some drivers write centimeters or millimeters."""

from __future__ import annotations

from math import inf
from typing import Final

import numpy as np

from mavnav.logs.messages.records import LaserMessage

FARTHEST_M: Final = 250.0
"""No planar laser sees farther; a reading beyond is no return, whatever the limits say."""

LOOKED_AT: Final = 20
"""So many scans decide on the unit of the ranges."""

UNITS: Final = {"centimeters": 100, "millimeters": 1000}
"""Units that are not meters, and how many of each are a meter."""

REACHES_M: Final = (2.5, 130.0)
BLIND_M: Final = 0.6
"""Maximum ranges that planar lasers have, and largest minimum range, m."""

FARTHEST_BLIND_M: Final = 1.0
"""Lasers with a minimum range of so much, m, are as good as unknown; those of 0.1 m in decimeters are not."""

FAR_SHARE: Final = 0.5
"""Share of the ranges beyond ``FARTHEST_M`` above which they are in no meters."""

FARTHEST_QUANTILE: Final = 0.9
"""Quantile of the ranges that the limits include if both are in one unit."""


class RangeUnits:
    """What the first scans of a topic show of the unit of their ranges and limits."""

    def __init__(self) -> None:
        self._scans, self._far, self._positive = 0, 0, 0
        self._limits = (0.0, inf)
        self._reaches: list[float] = []

    def look_at(self, message: LaserMessage) -> None:
        """Count what is too far; the farthest value of a scan may be a driver's word for no return."""
        if self._scans == LOOKED_AT:
            return
        self._scans += 1
        ranges = message.ranges_m
        finite = ranges[np.isfinite(ranges) & (ranges > 0)]
        far = finite[finite > FARTHEST_M]
        self._positive += len(finite)
        self._far += int(np.count_nonzero(far < far.max())) if len(far) else 0
        self._limits = message.range_min_m, message.range_max_m
        if len(finite):
            self._reaches.append(float(np.quantile(finite, FARTHEST_QUANTILE)))

    @property
    def doubt(self) -> str:
        """Why the ranges are in no meters, and what to do; empty where they may be."""
        low, high = self._limits
        far = self._far > FAR_SHARE * self._positive
        reach = float(np.median(self._reaches)) if self._reaches else 0.0
        odd_limits = BLIND_M < low < 0.5 * reach and 2 * FARTHEST_M < high < inf
        if not (far or odd_limits):
            return ""
        units = self._units(reach)
        what = (
            "more than half of the ranges lie beyond 250 m"
            if far
            else f"range_min and range_max are {low:g} and {high:g}"
        )
        divisors = " or ".join(str(UNITS[unit]) for unit in units)
        limits = ", not the limits" if _is_a_laser(low, high) else ", range_min and range_max too"
        return f"{what}: they look like {' or '.join(units)}, not meters; divide them by {divisors}{limits}"

    def _units(self, reach: float) -> list[str]:
        """Return the units that limits and ranges may be in; all if they contradict each other."""
        low, high = self._limits
        fit = [unit for unit, count in UNITS.items() if _is_a_laser(low / count, high / count)]
        if _is_a_laser(low, high):  # the limits are in meters: the ranges alone are not
            fit = [unit for unit, count in UNITS.items() if reach / count <= high][:1]
        return fit or [*UNITS]


def decimeters(low: float, high: float) -> str:
    """Return what limits say that may be in decimeters, where hardly a laser is blind so far; else empty."""
    if not (low >= FARTHEST_BLIND_M and _is_a_laser(low / 10, high / 10)):
        return ""
    return (
        f"range_min and range_max are {low:g} and {high:g}, and hardly a laser is blind so far: if the walls come out "
        "ten times too far, these and the ranges are in decimeters; divide them by 10"
    )


def _is_a_laser(low_m: float, high_m: float) -> bool:
    """Return whether a laser may have these limits."""
    return REACHES_M[0] <= high_m <= REACHES_M[1] and low_m <= BLIND_M
