"""Laser scans: what a sensor is, what it saw, and where that lies in the laser's own frame."""

from __future__ import annotations

from functools import cached_property, lru_cache
from math import inf, tau
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Line = tuple[float, float]
"""The nearest point of a line, x and y, m, laser frame."""

SAME_RAD: Final = 1e-5
"""Bearings no farther apart are one: angles are stored with 24 bits."""

JUMP_M, JUMP_SHARE = 0.1, 0.05
"""Neighboring returns farther apart, in m and as a share of the range, are of two surfaces."""

NEAR_M, NEAR_SHARE = 0.1, 0.02
"""Returns of tilted beams no farther from floor or ceiling, in m and as a share of the range, are taken as its own."""


LONGEST_SWEEP: Final = 1.4
"""Largest number of scan periods of a sweep; if it takes more, the recorded time between the beams is wrong.

As far from 1, of stamps that jitter, as from 2, of times that are twice too long.
"""


PLAUSIBLE_SWEEP: Final = (0.7, 1.5)
"""Ratios of the stated time of a turn to the usual one that are not doubted."""

FEWEST_KEPT: Final = 0.4
"""Share of the scans of a laser that a log keeps at least where its stated time between two scans is used."""


class Attitude(NamedTuple):
    """Tilt and height of the laser (REP-103 axes: x forward, y left, z up), rad and m above the floor.

    A direction of the laser is ``Ry(pitch) Rx(roll)`` times itself in the level frame of the same heading; the yaw
    belongs to the pose. ``height_m`` is NaN where it is not known.
    """

    roll_rad: float
    pitch_rad: float
    height_m: float


class LaserSpec(Struct, frozen=True, dict=True):
    """Geometry and limits of a planar laser (sensor_msgs/LaserScan).

    Beam ``i`` points to ``angle_min_rad + i * angle_step_rad``, counter-clockwise from the laser's x axis;
    the step may be negative. ``range_max_m`` is inf where the sensor gives no limit.
    ``time_increment_s`` lies between two beams, ``scan_time_s`` between two scans (0: not known).
    """

    angle_min_rad: float
    angle_step_rad: float
    beams: int
    range_min_m: float
    range_max_m: float
    time_increment_s: float = 0.0
    scan_time_s: float = 0.0

    @property
    def angles_rad(self) -> NDArray[np.float64]:
        """Bearings of the beams, shape (beams,)."""
        return self.angle_min_rad + self.angle_step_rad * np.arange(self.beams, dtype=np.float64)

    @cached_property
    def directions(self) -> NDArray[np.float64]:
        """Cosines and sines of the bearings, shape (beams, 2); computed once for equal geometries, read-only."""
        return _directions(self)

    @property
    def field_of_view_rad(self) -> float:
        """Angle between the first beam and the last."""
        return abs(self.angle_step_rad) * max(self.beams - 1, 0)

    @property
    def sweep_s(self) -> float:
        """Time that the beams of a steady sweep take."""
        return abs(self.time_increment_s) * self.beams

    @property
    def stated_turn_s(self) -> float:
        """Time that the beams of a whole turn take, as the time between two of them states it; 0 if none is stated."""
        return abs(self.time_increment_s) * tau / abs(self.angle_step_rad)

    def usual_turn_s(self, period_s: float) -> float:
        """Return how long a turn of the laser takes: the stated time between two scans, or the period if that is not.

        The stated time is shorter where scans were dropped.
        """
        return self.scan_time_s if FEWEST_KEPT * period_s <= self.scan_time_s <= LONGEST_SWEEP * period_s else period_s

    def has_plausible_sweep(self, period_s: float) -> bool:
        """Return whether the stated time of a turn is about the usual one for the period between two scans, s."""
        low, high = PLAUSIBLE_SWEEP
        return low <= self.stated_turn_s / max(self.usual_turn_s(period_s), 1e-9) <= high

    @lru_cache(maxsize=8)  # noqa: B019  equal sensors are one
    def turning_in(self, turn_s: float) -> LaserSpec:
        """Return the sensor with a time between two beams of so long a turn; in reverse order if it is negative."""
        return replace(self, time_increment_s=turn_s * abs(self.angle_step_rad) / tau)

    @lru_cache(maxsize=8)  # noqa: B019  as above
    def turned_over(self) -> LaserSpec:
        """Return the sensor as seen from above where it is mounted upside down: turned about its x axis."""
        return replace(self, angle_min_rad=-self.angle_min_rad, angle_step_rad=-self.angle_step_rad)


def runs_of(marks: NDArray[np.bool_], least: int = 1) -> list[range]:
    """Return the ranges of ``least`` or more successive beams, or rows, that are marked; ``marks`` (n,)."""
    edges = np.diff(np.concatenate(([False], marks, [False])).astype(np.int8))
    pairs = zip(np.flatnonzero(edges > 0).tolist(), np.flatnonzero(edges < 0).tolist(), strict=True)
    return [range(start, end) for start, end in pairs if end - start >= least]


@lru_cache(maxsize=8)
def _directions(spec: LaserSpec) -> NDArray[np.float64]:
    angles = spec.angles_rad
    directions = np.column_stack((np.cos(angles), np.sin(angles)))
    directions.flags.writeable = False
    return directions


class Scan(Struct, frozen=True):
    """One sweep of the laser.

    ``ranges_m`` is (beams,) float64, read-only; NaN means no valid return, and nothing else is ever odd:
    every convention of a sensor or driver ends where logs are read. ``stamp_ns`` is the time of the first beam.
    ``times_s`` (beams,) are the times of the beams since then if several lasers were merged, else None: a steady sweep.
    ``heights_m`` (beams,) are the heights of the returns above the floor if the scan was levelled, NaN where the range
    is, else None.
    """

    stamp_ns: int
    ranges_m: NDArray[np.float64]
    spec: LaserSpec
    times_s: NDArray[np.float64] | None = None
    heights_m: NDArray[np.float64] | None = None

    def __repr__(self) -> str:
        """Return stamp and sensor, in a line."""
        return f"Scan(stamp_ns={self.stamp_ns}, ranges_m=float64[{len(self.ranges_m)}], spec={self.spec})"

    def __post_init__(self) -> None:
        """Freeze ranges and heights; raises TypeError for ranges that are no array."""
        if not isinstance(self.ranges_m, np.ndarray):
            raise TypeError(f"ranges_m is a {type(self.ranges_m).__name__}; give a numpy array, one range a beam")
        self.ranges_m.flags.writeable = False
        if self.heights_m is not None:
            self.heights_m.flags.writeable = False

    @property
    def sweep_s(self) -> float:
        """Time that the beams take."""
        return self.spec.sweep_s if self.times_s is None else float(np.ptp(self.times_s))

    @property
    def late_s(self) -> NDArray[np.float64]:
        """Times of the beams (beams,) after mid-sweep."""
        n = self.spec.beams
        times_s = self.spec.time_increment_s * np.arange(n) if self.times_s is None else self.times_s
        return np.asarray(times_s - 0.5 * (times_s.min() + times_s.max()))

    def seen_at_mid_sweep(self, twist: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ranges (beams,) and directions (beams, 2) as from the pose at mid-sweep, of merged lasers.

        ``twist`` (3,) is the motion of the laser in its own frame, m/s, m/s, rad/s.
        """
        late_s = self.late_s
        c, s = np.cos(twist[2] * late_s), np.sin(twist[2] * late_s)
        x, y = self.ranges_m * self.spec.directions.T
        xy = np.column_stack((c * x - s * y + twist[0] * late_s, s * x + c * y + twist[1] * late_s))
        ranges_m = np.hypot(*xy.T)
        return ranges_m, xy / np.maximum(ranges_m, 1e-9)[:, None]

    def points(self) -> NDArray[np.float64]:
        """Return the end points of the valid beams in the laser's frame, (n, 2) in metres."""
        good = np.isfinite(self.ranges_m)
        return self.ranges_m[good, None] * self.spec.directions[good]


def scan_before(scan: Scan, line_m: Line) -> Scan:
    """Return a scan without the returns at a line and past it; ``line_m`` is its nearest point, m, laser frame."""
    past = scan.ranges_m * (scan.spec.directions @ line_m) >= float(np.dot(line_m, line_m))
    heights_m = None if scan.heights_m is None else np.where(past, np.nan, scan.heights_m)
    return replace(scan, ranges_m=np.where(past, np.nan, scan.ranges_m), heights_m=heights_m)


def level_scan(
    scan: Scan, roll_rad: Floats | float, pitch_rad: Floats | float, height_m: Floats | float, ceiling_m: float = inf
) -> Scan:
    """Return a scan of a tilted laser projected to the horizontal plane, on the same even bearings.

    ``roll_rad``, ``pitch_rad`` and ``height_m`` are those of `Attitude`; (beams,) if the laser moves during the sweep.
    Each return is taken for that of a vertical wall. It falls on the nearest bearing, of several the nearest counts,
    and its range is that of its surface at this bearing. Without any tilt the ranges stay to the last bit. Returns of
    tilted beams on the floor, or on the ceiling at ``ceiling_m``, are no walls: their ranges become NaN. ``heights_m``
    stays None where the height of the laser is not known.
    """
    known = bool(np.isfinite(height_m).all())
    if not (np.any(roll_rad) or np.any(pitch_rad)):
        heights_m = np.where(np.isfinite(scan.ranges_m), height_m, np.nan)
        return replace(scan, heights_m=heights_m if known else None)
    x, y = (scan.ranges_m[:, None] * scan.spec.directions).T
    sin_roll, cos_roll, sin_pitch, cos_pitch = np.sin(roll_rad), np.cos(roll_rad), np.sin(pitch_rad), np.cos(pitch_rad)
    above_m = height_m + y * sin_roll * cos_pitch - x * sin_pitch
    off_m = NEAR_M + NEAR_SHARE * scan.ranges_m
    floor = above_m < np.minimum(off_m, 0.5 * height_m)
    ceiling = above_m > np.maximum(ceiling_m - off_m, 0.5 * (height_m + ceiling_m))
    x, y = x * cos_pitch + y * sin_roll * sin_pitch, y * cos_roll
    x[floor | ceiling] = np.nan
    beam, range_m, kept = on_bearings(x, y, scan.spec, scan.spec.angle_step_rad)
    source = nearest_returns(beam, range_m, kept)
    beam = beam[source]
    ranges_m, heights_m = np.full(scan.spec.beams, np.nan), np.full(scan.spec.beams, np.nan)
    ranges_m[beam], heights_m[beam] = range_m[source], above_m[source]
    times_s = None
    if scan.times_s is not None:
        times_s = scan.times_s.copy()
        times_s[beam] = scan.times_s[source]
    return replace(scan, ranges_m=ranges_m, times_s=times_s, heights_m=heights_m if known else None)


def on_bearings(
    x: Floats, y: Floats, spec: LaserSpec, step_rad: float
) -> tuple[NDArray[np.intp], Floats, NDArray[np.bool_]]:
    """Return for each point (n,), m, the beam of ``spec`` that is nearest, its range there, m, and whether it is one.

    The range is that of its surface at the bearing of the beam. The points are in the order of their bearings, which
    descend where ``step_rad`` is negative; they are NaN where there is no return.
    """
    bearing_rad, range_m = np.arctan2(y, x), np.hypot(x, y)
    off = (bearing_rad - spec.angle_min_rad) / spec.angle_step_rad
    off = (off + 0.5) % (tau / abs(spec.angle_step_rad)) - 0.5
    beam = np.round(off)
    aside_rad = (beam - off) * spec.angle_step_rad
    moved_m = _at_bearing(x, y, range_m, bearing_rad + aside_rad, aside_rad * step_rad > 0.0)
    range_m = np.where(np.abs(aside_rad) > SAME_RAD, moved_m, range_m)
    kept = np.isfinite(range_m) & (beam < spec.beams)
    return np.where(kept, beam, 0).astype(np.intp), range_m, kept


def nearest_returns(beam: NDArray[np.intp], range_m: Floats, kept: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return which of the kept points, (n,) each, is the nearest of its beam: numbers (m,), one for each such beam."""
    numbers = np.flatnonzero(kept)
    nearest_last = numbers[np.argsort(-range_m[numbers], kind="stable")][::-1]
    _, first = np.unique(beam[nearest_last], return_index=True)
    return nearest_last[first]


def _at_bearing(x: Floats, y: Floats, range_m: Floats, bearing_rad: Floats, ahead: NDArray[np.bool_]) -> Floats:
    """Return where the line through each return and its neighbor on the same surface has these bearings, m.

    ``ahead`` is the side on which the bearing lies: the neighbor there goes before the other. Without any the range
    stays.
    """
    crossing_m, c, s = range_m, np.cos(bearing_rad), np.sin(bearing_rad)
    apart_m = np.maximum(JUMP_M, JUMP_SHARE * range_m)
    for side in (~ahead, ahead):  # at the end of a full turn the neighbor is at its begin
        other = (np.arange(len(x)) + np.where(side, 1, -1)) % max(len(x), 1)
        along_x, along_y = x[other] - x, y[other] - y
        with np.errstate(invalid="ignore", divide="ignore"):
            moved_m = (x * along_y - y * along_x) / (c * along_y - s * along_x)
        same = (np.hypot(along_x, along_y) <= apart_m) & (np.abs(moved_m - range_m) <= apart_m)
        crossing_m = np.where(same, moved_m, crossing_m)
    return crossing_m
