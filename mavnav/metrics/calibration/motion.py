"""How odometry predicts the motion of a laser: hand-eye calibration in the plane (Censi et al. 2013).

Seven parameters, in the order of `NAMES`: pose of the laser on the base (m, m, rad), time to add to the stamps of the
odometry (s), factors on its distances and on its turns, and how much a straight path turns (rad/m), as wheels of
unequal size make it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.units import NS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.pose import Trajectory

    Array = NDArray[np.float64]
    Complex = NDArray[np.complex128]

NAMES: Final = ("x_m", "y_m", "yaw_rad", "offset_s", "distance_scale", "turn_scale", "veer_rad_m")

YAW, OFFSET, DISTANCE, TURN = range(2, 6)
"""Their numbers, as far as they are used one by one."""

STEP_S: Final = 0.3
"""Steps take at least so long: shorter ones are as small as the noise of the odometry."""

LONGEST_STEP_S: Final = 1.5
"""A longer gap of the scans or of the odometry parts two chains of steps."""

LONGEST_OFFSET_S: Final = 1.2
"""Offsets are searched up to this, either way: beyond the longest that a replay corrects."""


class Wheels(NamedTuple):
    """What corrects odometry: factors on distances and turns, and the turn of a straight path, rad/m."""

    distance_scale: float = 1.0
    turn_scale: float = 1.0
    veer_rad_m: float = 0.0


GOOD_WHEELS: Final = Wheels()


class PlaneSteps(Struct, frozen=True):
    """Steps between poses: ``moved`` (n,) in the plane, complex, m, seen from the mean heading; ``turned`` (n,) rad."""

    moved: Complex
    turned: Array

    @classmethod
    def between(cls, where: Complex, heading_rad: Array) -> PlaneSteps:
        """Return the steps from each of the poses (n + 1,) to the next; headings are not wrapped."""
        mean_rad = 0.5 * (heading_rad[:-1] + heading_rad[1:])
        return cls(np.diff(where) * np.exp(-1j * mean_rad), np.diff(heading_rad))

    def path(self, wheels: Wheels) -> tuple[Complex, Array]:
        """Return positions (n + 1,), complex, m, and headings (n + 1,), rad, that corrected steps lead to from 0."""
        turned = wheels.turn_scale * self.turned + wheels.veer_rad_m * self.moved.real
        heading_rad = np.concatenate(((0.0,), np.cumsum(turned)))
        moved = wheels.distance_scale * self.moved * np.exp(1j * (heading_rad[:-1] + 0.5 * turned))
        return np.concatenate(((0.0,), np.cumsum(moved))), heading_rad


class Motions(Struct, frozen=True):
    """The tracked poses of a laser and the odometry of its base.

    ``laser_s`` (n,), ``where`` (n,) complex, m, and ``heading_rad`` (n,), not wrapped, are the track of the laser;
    ``linked`` (n - 1,) is false for its steps across a gap. ``odom_s`` (m,) and ``odom`` (m - 1 steps) are the
    odometry. Times begin with the odometry.
    """

    laser_s: Array
    where: Complex
    heading_rad: Array
    linked: NDArray[np.bool_]
    odom_s: Array
    odom: PlaneSteps

    def mirror(self) -> Motions:
        """Return the same as seen by a laser that is turned over about its x axis."""
        return replace(self, where=self.where.conj(), heading_rad=-self.heading_rad)

    def halves(self) -> tuple[Motions, Motions]:
        """Return the motions of the first and of the second half of the track; both have the pose between them."""
        middle = len(self.linked) // 2
        first, second = (
            replace(
                self,
                laser_s=self.laser_s[begin : end + 1],
                where=self.where[begin : end + 1],
                heading_rad=self.heading_rad[begin : end + 1],
                linked=self.linked[begin:end],
            )
            for begin, end in ((0, middle), (middle, len(self.linked)))
        )
        return first, second

    def laser_steps(self) -> PlaneSteps:
        """Return the steps of the laser (n - 1)."""
        return PlaneSteps.between(self.where, self.heading_rad)

    def predicted_steps(self, parameters: Array) -> PlaneSteps:
        """Return the same as the odometry predicts them by the parameters (7,)."""
        x_m, y_m, yaw_rad, offset_s, *wheels = parameters.tolist()
        where, heading_rad = self.base(offset_s, Wheels(*wheels))
        return PlaneSteps.between(where + complex(x_m, y_m) * np.exp(1j * heading_rad), heading_rad + yaw_rad)

    def base(self, offset_s: float, wheels: Wheels = GOOD_WHEELS) -> tuple[Complex, Array]:
        """Return positions (n,), complex, m, and headings (n,), rad, of the base at the scans, by the odometry."""
        where, heading_rad = self.odom.path(wheels)
        at_s = self.laser_s - offset_s
        x, y, yaw = (np.interp(at_s, self.odom_s, track) for track in (where.real, where.imag, heading_rad))
        return x + 1j * y, yaw


def motions_of(map_T_laser: Trajectory, odom_T_base: Trajectory, sweep_s: float) -> Motions:
    """Return the motions of a tracked log, in steps of `STEP_S` or more; a pose is that at the middle of its sweep.

    Scans at which no odometry is known, at any offset up to the longest, are left out.
    """
    odom_s = (odom_T_base.stamps_ns - odom_T_base.stamps_ns[0]) * NS
    laser_s = (map_T_laser.stamps_ns - odom_T_base.stamps_ns[0]) * NS + 0.5 * sweep_s
    inside = (laser_s > LONGEST_OFFSET_S) & (laser_s < odom_s[-1] - LONGEST_OFFSET_S)
    laser_s, poses = laser_s[inside], map_T_laser.xyyaw[inside]
    period_s = float(np.median(np.diff(laser_s))) if len(laser_s) > 1 else STEP_S
    every = max(1, int(np.ceil(STEP_S / period_s - 0.1)))
    laser_s, poses = laser_s[::every], poses[::every]
    where, heading_rad = _plane(poses)
    longest_s = max(LONGEST_STEP_S, 2.0 * every * period_s)
    gaps = np.concatenate(((0,), np.cumsum(np.diff(odom_s) > longest_s)))
    stretch = gaps[np.clip(np.searchsorted(odom_s, laser_s), 0, len(gaps) - 1)]  # of the odometry, between its gaps
    linked = (np.diff(laser_s) <= longest_s) & (np.diff(stretch) == 0)
    return Motions(laser_s, where, heading_rad, linked, odom_s, PlaneSteps.between(*_plane(odom_T_base.xyyaw)))


def _plane(xyyaw: Array) -> tuple[Complex, Array]:
    return xyyaw[:, 0] + 1j * xyyaw[:, 1], np.unwrap(xyyaw[:, 2])
