"""A laser in a world: geometry of known sensors, and the errors that the paper measured ("Laser Scan")."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, pi
from typing import Final

import numpy as np
from msgspec import Struct

from mavnav.pose import Pose
from mavnav.scan import LaserSpec, Scan
from mavnav.simulation.world.geometry import Array, World
from mavnav.units import DEG

LASERS: Final[dict[str, LaserSpec]] = {
    "urg-04lx": LaserSpec(-340 * 360 / 1024 * DEG, 360 / 1024 * DEG, 681, 0.02, 5.0, 0.1 / 1024, 0.1),
    "utm-30lx": LaserSpec(-135 * DEG, 0.25 * DEG, 1081, 0.1, 30.0, 0.025 / 1440, 0.025),
    "ust-10lx": LaserSpec(-135 * DEG, 0.25 * DEG, 1081, 0.06, 10.0, 0.025 / 1440, 0.025),
    "lds-01": LaserSpec(0.0, DEG, 360, 0.12, 3.5, 0.2 / 360, 0.2),
}
"""Sensors by name. ``urg-04lx`` is the paper's: 240 degrees in 681 beams, 5 m, ten scans a second."""

EDGE_M: Final = 0.1
"""Where the true ranges of two neighbouring beams differ by more, there is an edge between them."""


class LaserModel(Struct, frozen=True):
    """A sensor with its errors; with the defaults it has none.

    ``bias`` and ``noise`` are shares of the distance: a factor that stays, and a standard deviation. The shares of
    ``mixed_pixels`` count beams at an edge, those of ``min_readings`` and ``max_readings`` all beams. Up to
    ``incidence_sure_rad`` from a wall's normal every beam returns, from ``incidence_max_rad`` on none, between them
    ever fewer.
    """

    spec: LaserSpec
    noise: float = 0.0
    bias: float = 0.0
    mixed_pixels: float = 0.0
    min_readings: float = 0.0
    max_readings: float = 0.0
    incidence_sure_rad: float = pi
    incidence_max_rad: float = inf

    def read(self, ranges_m: Array, incidence_rad: Array, rng: np.random.Generator) -> Array:
        """Return what the sensor makes of true ranges and incidences, (n,) each; NaN where it has no valid return.

        Every scan draws the same number of random numbers, whatever it sees.
        """
        gauss, edge, mix, odd, faint = rng.standard_normal(len(ranges_m)), *rng.random((4, len(ranges_m)))
        read = np.where(edge < self.mixed_pixels, _mix_edges(ranges_m, mix), ranges_m)
        read *= (1.0 + self.bias) * (1.0 + self.noise * gauss)
        read[odd < self.min_readings] = self.spec.range_min_m
        read[odd > 1.0 - self.max_readings] = self.spec.range_max_m
        valid = (read > self.spec.range_min_m) & (read < self.spec.range_max_m) & (faint >= self._loss(incidence_rad))
        return np.where(valid, read, np.nan)

    def _loss(self, incidence_rad: Array) -> Array:
        """Probability that a wall throws nothing back, (n,)."""
        ramp = max(self.incidence_max_rad - self.incidence_sure_rad, 1e-12)
        return np.clip((np.nan_to_num(incidence_rad) - self.incidence_sure_rad) / ramp, 0.0, 1.0)


def _mix_edges(ranges_m: Array, share: Array) -> Array:
    """Return ranges between a beam's own and its neighbour's across the nearest edge, its own where there is none."""
    padded = np.concatenate((ranges_m[:1], ranges_m, ranges_m[-1:]))
    with np.errstate(invalid="ignore"):  # inf - inf: two beams that meet nothing
        before, after = padded[:-2] - ranges_m, padded[2:] - ranges_m
    before, after = (np.where(np.isfinite(jump), jump, 0.0) for jump in (before, after))
    jump = np.where(np.abs(before) > np.abs(after), before, after)
    return ranges_m + np.where(np.abs(jump) > EDGE_M, share * jump, 0.0)


def take_scan(
    world: World,
    motion: Pose | Callable[[float], Pose],
    laser: LaserModel,
    rng: np.random.Generator,
    stamp_ns: int,
    tilts: Array | None = None,
) -> Scan:
    """Take one scan.

    Parameters
    ----------
    motion
        world_T_laser: where the laser rests, or its pose as a function of the seconds since the first beam.
    stamp_ns
        Time of the first beam.
    tilts
        Roll (rad), pitch (rad) and height (m) of the laser at each beam, (3, beams); None for a level laser that meets
        all walls, whatever their heights.
    """
    xy_m, yaw_rad = _where(motion, laser.spec)
    if tilts is None:
        ranges_m, incidence_rad = world.cast(xy_m, laser.spec.angles_rad + yaw_rad)
    else:
        roll_rad, pitch_rad, height_m = tilts
        directions = tilted_directions(laser.spec.angles_rad, roll_rad, pitch_rad, yaw_rad)
        ranges_m, incidence_rad = world.cast_tilted(xy_m, height_m, directions)
    return Scan(stamp_ns, laser.read(ranges_m, incidence_rad, rng), laser.spec)


def _where(motion: Pose | Callable[[float], Pose], spec: LaserSpec) -> tuple[Array, Array]:
    """Position (2,) or (n, 2) and heading () or (n,) of the laser at each of its beams."""
    if isinstance(motion, Pose):
        return np.array((motion.x_m, motion.y_m)), np.array(motion.yaw_rad)
    poses = np.array([motion(k * spec.time_increment_s).as_array() for k in range(spec.beams)])
    return poses[:, :2], poses[:, 2]


def tilted_directions(bearings_rad: Array, roll_rad: Array, pitch_rad: Array, yaw_rad: Array) -> Array:
    """Return unit vectors ``Rz(yaw) Ry(pitch) Rx(roll)`` times those at bearings (n,) of the laser's plane, (n, 3)."""
    along, aside = np.cos(bearings_rad), np.sin(bearings_rad)
    x = along * np.cos(pitch_rad) + aside * np.sin(roll_rad) * np.sin(pitch_rad)
    y = aside * np.cos(roll_rad)
    z = aside * np.sin(roll_rad) * np.cos(pitch_rad) - along * np.sin(pitch_rad)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.column_stack((c * x - s * y, s * x + c * y, z))
