"""Laser scans: what a sensor is, what it saw, and where that lies in the laser's own frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class LaserSpec:
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

    def turned_over(self) -> LaserSpec:
        """Return the sensor as seen from above where it is mounted upside down: turned about its x axis."""
        return _turned_over(self)


@lru_cache(maxsize=8)
def _turned_over(spec: LaserSpec) -> LaserSpec:
    return replace(spec, angle_min_rad=-spec.angle_min_rad, angle_step_rad=-spec.angle_step_rad)


@lru_cache(maxsize=8)
def _directions(spec: LaserSpec) -> NDArray[np.float64]:
    angles = spec.angles_rad
    directions = np.column_stack((np.cos(angles), np.sin(angles)))
    directions.flags.writeable = False
    return directions


@dataclass(frozen=True, slots=True)
class Scan:
    """One sweep of the laser.

    ``ranges_m`` is (beams,) float64, read-only; NaN means no valid return, and nothing else is ever odd:
    every convention of a sensor or driver ends where logs are read. ``stamp_ns`` is the time of the first beam.
    ``times_s`` (beams,) are the times of the beams since then if several lasers were merged, else None: a steady sweep.
    """

    stamp_ns: int
    ranges_m: NDArray[np.float64]
    spec: LaserSpec
    times_s: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        """Freeze the ranges."""
        self.ranges_m.flags.writeable = False

    @property
    def sweep_s(self) -> float:
        """Time from the first beam to the last."""
        if self.times_s is not None:
            return float(np.ptp(self.times_s))
        return abs(self.spec.time_increment_s) * self.spec.beams

    def seen_at_mid_sweep(self, twist: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ranges (beams,) and directions (beams, 2) as from the pose at mid-sweep, of merged lasers.

        ``twist`` (3,) is the motion of the laser in its own frame, m/s, m/s, rad/s.
        """
        times_s = np.zeros(self.spec.beams) if self.times_s is None else self.times_s
        late_s = times_s - 0.5 * (times_s.min() + times_s.max())
        c, s = np.cos(twist[2] * late_s), np.sin(twist[2] * late_s)
        x, y = self.ranges_m * self.spec.directions.T
        xy = np.column_stack((c * x - s * y + twist[0] * late_s, s * x + c * y + twist[1] * late_s))
        ranges_m = np.hypot(*xy.T)
        return ranges_m, xy / np.maximum(ranges_m, 1e-9)[:, None]

    def points(self) -> NDArray[np.float64]:
        """Return the end points of the valid beams in the laser's frame, (n, 2) in metres."""
        good = np.isfinite(self.ranges_m)
        return self.ranges_m[good, None] * self.spec.directions[good]
