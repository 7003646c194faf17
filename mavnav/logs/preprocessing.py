"""The scan filter: where every odd convention of sensors and drivers ends.

A range is classified in the order of REP-117: within the limits it is valid, else -inf is too close, +inf is nothing
in range, NaN is erroneous. Drivers older than the REP put 0, negative values and values beyond the limits. Whatever is
not valid becomes NaN, and is counted by kind. LaserScan is in meters, but some drivers write centimeters or
millimeters.
"""

from __future__ import annotations

from math import inf, isfinite, isnan, nextafter, tau
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavnav.logs.messages.definitions import LaserMessage
from mavnav.logs.records import Warn
from mavnav.scan import LaserSpec

KINDS: Final = ("valid", "zero", "below_min", "above_max", "nan", "plus_inf", "minus_inf", "negative")

_LEAST_M: Final = -1.7976931348623157e308
_SMALLEST_M: Final = 5e-324
MOST_BEAMS: Final = 1 << 15
"""More than any planar laser has; what has more is thinned, so that no scan costs seconds."""

_AT_MAX_SHARE, _AT_MAX_LEAST = 0.02, 10
"""More readings of exactly the maximum are no wall: simulators and some drivers write it where nothing is in range."""

LONGEST_SWEEP_S: Final = 60.0
"""A scan whose time increment makes it longer has no usable increment."""

_MOST_TURNS: Final = 1.1
"""A scan may overlap itself a little; one of several turns has a wrong increment."""


def clean(
    ranges_m: NDArray[np.floating], range_min_m: float, range_max_m: float
) -> tuple[NDArray[np.float64], tuple[int, ...]]:
    """Turn every range that is no return into NaN.

    Parameters
    ----------
    ranges_m
        Shape (beams,), as the driver wrote them.
    range_min_m, range_max_m
        Limits, both inclusive. 0 and infinity are never valid, whatever the limits.

    Returns
    -------
    cleaned, counts
        (beams,) float64 with NaN for no return, and the number of beams of each of ``KINDS``.
    """
    with np.errstate(invalid="ignore"):  # a signalling NaN, as damage may leave it
        cleaned = ranges_m.astype(np.float64)
    lowest, highest = max(range_min_m, _SMALLEST_M), min(range_max_m, FARTHEST_M)
    (odd,) = (~((cleaned >= lowest) & (cleaned <= highest))).nonzero()
    counts = _count(cleaned[odd], lowest, len(cleaned))
    cleaned[odd] = np.nan
    return cleaned, counts


def _count(odd_m: NDArray[np.float64], lowest_m: float, beams: int) -> tuple[int, ...]:
    """Count the kinds of ranges that are not valid: sorted, NaN last, they lie between these edges."""
    odd_m.sort()
    minus, zero, small, low, plus, nan = odd_m.searchsorted(
        np.array((_LEAST_M, 0.0, _SMALLEST_M, lowest_m, np.inf, np.nan))
    ).tolist()
    valid, n = beams - len(odd_m), len(odd_m)
    return valid, small - zero, low - small, plus - low, n - nan, nan - plus, minus, zero - minus


class ScanFilter:
    """The cleaning of one topic's scans; remembers the last geometry, so that equal scans share one LaserSpec.

    ``warn`` takes a line about something odd that was put right. ``doubt`` says, in the end, why the topic as a whole
    cannot be what it claims: its ranges or angles are of another unit.
    """

    def __init__(self, topic: str, warn: Warn) -> None:
        self._topic = topic
        self._warn = warn
        self._key: tuple[float | None, ...] = ()
        self._spec: LaserSpec | None = None
        self._units = RangeUnits()
        self._turns = ""
        self._max_is_none = False
        self._invalid = np.zeros(len(KINDS), np.int64)

    @property
    def doubt(self) -> str:
        """The reason to refuse the whole topic, empty where there is none."""
        return self._units.doubt or (self._turns if self._spec is None else "")

    @property
    def invalid(self) -> str:
        """What the ranges of scans without a valid one are, and what to check; empty where there is no such scan."""
        total = int(self._invalid.sum())
        if not total or self._spec is None:
            return ""
        kinds = sorted(zip(self._invalid.tolist(), KINDS, strict=True), reverse=True)
        shares = ", ".join(f"{100 * n / total:.0f} % {kind.replace('_', ' ')}" for n, kind in kinds if n)
        limits = f"range_min and range_max are {self._spec.range_min_m:g} and {self._spec.range_max_m:g} m"
        return f"their ranges are {shares}, and {limits}: check the laser, and whether all these are in meters"

    def admit(self, message: LaserMessage) -> tuple[LaserSpec, NDArray[np.float64], tuple[int, ...]] | str:
        """Return geometry, cleaned ranges and counts; or, in a word, the reason why the scan is unusable."""
        self._units.look_at(message)
        message = self._with_step(message)
        if reason := _refusal(message):
            beams, step_rad = len(message.ranges_m), message.angle_step_rad
            if reason == "impossible_geometry" and 20.0 < abs(step_rad) * (beams - 1) <= 400.0:
                what = f"{beams} beams of angle_increment {step_rad:g} are more than a turn"
                self._turns = f"{what}: the angles look like degrees, and LaserScan is in radians"
            return reason
        message = self._thin(message)
        spec = self._spec_of(message)
        cleaned, counts = clean(message.ranges_m, spec.range_min_m, self._farthest_m(message.ranges_m, spec))
        if not counts[0]:
            self._invalid += counts
            return "no_valid_beam"
        return spec, cleaned, counts

    def _farthest_m(self, ranges_m: NDArray[np.floating], spec: LaserSpec) -> float:
        """Return the greatest valid range: below the sensor's maximum, from where that stands for no return."""
        if not self._max_is_none and isfinite(spec.range_max_m):
            most = max(_AT_MAX_SHARE * len(ranges_m), _AT_MAX_LEAST)
            self._max_is_none = bool(np.count_nonzero(ranges_m == spec.range_max_m) > most)
            if self._max_is_none:
                reason = f"many ranges are range_max itself ({spec.range_max_m:g} m)"
                self._warn(f"{self._topic}: {reason}; from there on they are taken for no return")
        return nextafter(spec.range_max_m, 0.0) if self._max_is_none else spec.range_max_m

    def _with_step(self, message: LaserMessage) -> LaserMessage:
        """Return the message with the increment that first and last angle make where it has none, or cannot be."""
        beams, last_rad = len(message.ranges_m), message.last_angle_rad
        if beams < 2 or last_rad is None or _refusal(message) not in {"zero_angle_increment", "impossible_geometry"}:
            return message
        mended = message._replace(angle_step_rad=(last_rad - message.angle_min_rad) / (beams - 1))
        if _refusal(mended) or abs(last_rad) > tau:
            return message
        text = f"angle_increment is {message.angle_step_rad:g}; by angle_min, angle_max and {beams} beams it is"
        self._warn(f"{self._topic}: {text} {mended.angle_step_rad:.6g} rad, which is used: set it in the driver")
        return mended

    def _thin(self, message: LaserMessage) -> LaserMessage:
        """Take one of every so many beams where a scan has far too many."""
        every = -(-len(message.ranges_m) // MOST_BEAMS)
        if every == 1:
            return message
        self._warn(f"{self._topic}: a scan has more than {MOST_BEAMS} beams; one of {every} is used")
        return message._replace(
            angle_step_rad=message.angle_step_rad * every,
            time_increment_s=message.time_increment_s * every,
            ranges_m=message.ranges_m[::every],
        )

    def _spec_of(self, message: LaserMessage) -> LaserSpec:
        # angle_min .. scan_time and the number of beams; frame and stamp are not geometry
        key = (*message[2:9], len(message.ranges_m))
        if self._spec is None or key != self._key:
            spec = self._make_spec(message)
            if self._spec is not None and _geometry(spec) != _geometry(self._spec):
                self._warn(f"{self._topic}: the geometry of the scans changes on the way; each scan keeps its own")
            self._key, self._spec = key, spec
        return self._spec

    def _make_spec(self, message: LaserMessage) -> LaserSpec:
        self._check(message)
        geometry = (message.angle_min_rad, message.angle_step_rad, len(message.ranges_m))
        times = (self._time_increment_s(message), _finite_or_zero(message.scan_time_s))
        return LaserSpec(*geometry, *_limits(message), *times)

    def _time_increment_s(self, message: LaserMessage) -> float:
        """Return the time between two beams; 0 if the message gives none, or an impossible one."""
        increment_s = _finite_or_zero(message.time_increment_s)
        if abs(increment_s) * len(message.ranges_m) <= LONGEST_SWEEP_S:
            return increment_s
        self._warn(f"{self._topic}: the time between two beams, {increment_s:g} s, is impossible; it is not used")
        return 0.0

    def _check(self, message: LaserMessage) -> None:
        """Warn about fields that contradict the rest and are not used."""
        if message.has_limits and _limits(message) == (0.0, np.inf):
            text = f"{message.range_min_m:g} to {message.range_max_m:g} m"
            self._warn(f"{self._topic}: the range limits ({text}) are unusable; every positive range is used")
        elif message.has_limits and (text := decimeters(*_limits(message))):
            self._warn(f"{self._topic}: {text}")
        if message.has_pose:
            self._warn(f"{self._topic}: the scans carry a pose of their own, which is not used")
        last = message.angle_min_rad + message.angle_step_rad * (len(message.ranges_m) - 1)
        told_last = message.last_angle_rad
        # Many drivers are one beam out here; that is no news.
        if told_last is not None and not abs(told_last - last) <= 1.5 * abs(message.angle_step_rad):
            text = f"angle_max is {told_last:.4f} rad, but {len(message.ranges_m)} beams end at {last:.4f}"
            self._warn(f"{self._topic}: {text}; number of beams and increment are used")


def _refusal(message: LaserMessage) -> str | None:
    beams = len(message.ranges_m)
    if not beams:
        return "empty"
    if not (isfinite(message.angle_min_rad) and isfinite(message.angle_step_rad)):
        return "non_finite_angle"
    if message.angle_step_rad == 0.0:
        return "zero_angle_increment"
    too_wide = abs(message.angle_step_rad) * max(beams - 1, 1) > _MOST_TURNS * tau
    return "impossible_geometry" if too_wide or abs(message.angle_min_rad) > 2 * tau else None


def _limits(message: LaserMessage) -> tuple[float, float]:
    """Return the range limits, (0, inf) where they are unusable. A maximum of +inf is a sensor without one."""
    low, high = message.range_min_m, message.range_max_m
    if not isfinite(low) or isnan(high) or high <= low:
        return 0.0, np.inf
    return max(low, 0.0), high


def _geometry(spec: LaserSpec) -> tuple[float, float, int]:
    return spec.angle_min_rad, spec.angle_step_rad, spec.beams


def _finite_or_zero(seconds: float) -> float:
    return seconds if isfinite(seconds) else 0.0


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
        limits_text = f"range_min and range_max are {low:g} and {high:g}"
        what = "more than half of the ranges lie beyond 250 m" if far else limits_text
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
