"""Motion model: prediction of the next pose from odometry if the log has it, else from constant velocity."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import copysign, inf, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavnav.pose import Pose, Rotation, Trajectory, wrap_angle
from mavnav.slam.matching.steps import Step, jumps
from mavnav.units import DEG, NS

Odometry = Callable[[int], Pose | None]
"""Stamp (ns) -> odom_T_laser, None where odometry does not cover it."""

Twist = tuple[float, float, float]
"""A velocity in the laser's own frame, m/s, m/s, rad/s."""


USUAL_PERIOD_S = 0.1  # scan period where the stamps do not show it
GAP_S, LONGEST_S = 0.5, 1.2
"""Time without a pose or a measured motion that is a gap, and longest extrapolation of a velocity, s."""

MOST_ERROR = 0.3
"""Largest error of a measured motion that is used, as a share of the motion."""

NEW_SHARE = 0.7  # weight of a new velocity in the running average

LEAST_FIT_STEPS, FIT_DECAY = 10, 0.98
"""Minimum number of steps before a measured yaw rate is used, and the factor by which their weight decays at a step."""

FIT_RAD = 0.3 * DEG
"""RMS error of a yaw rate that fits, however little the laser turns: the noise of a match, rad."""


class YawRateFit(NamedTuple):
    """Running fit of a measured yaw rate: decayed number of steps, and decayed sums of squares, rad2.

    The sums are those of the errors of the measured yaw rate, of the errors of constant velocity, and of the turns.
    """

    steps: float = 0.0
    by_rotation: float = 0.0
    by_velocity: float = 0.0
    turned: float = 0.0

    @property
    def fits(self) -> bool:
        """Whether the measured yaw rate predicts better than constant velocity, or well enough by itself."""
        well = max(self.by_velocity, MOST_ERROR**2 * self.turned, FIT_RAD**2 * self.steps)
        return self.steps >= LEAST_FIT_STEPS and self.by_rotation <= well

    def after(self, turned_rad: float, by_rotation_rad: float, by_velocity_rad: float) -> YawRateFit:
        """Return the fit after another step: how far the laser turned, and the two predictions of it, rad."""
        errors = (wrap_angle(by_rotation_rad - turned_rad), wrap_angle(by_velocity_rad - turned_rad), turned_rad)
        squares = (old * FIT_DECAY + new * new for old, new in zip(self[1:], errors, strict=True))
        return YawRateFit(self.steps * FIT_DECAY + 1.0, *squares)


class Motion(NamedTuple):
    """The last accepted pose and the velocity there.

    ``twist`` is the velocity in the laser frame, m/s, m/s, rad/s. ``period_s`` is the sensor's scan period: time steps
    are rounded to whole periods, because many drivers stamp a scan at its arrival, tens of ms early or late. With
    ``expects_rest`` and without odometry the last pose is the prediction. ``rotation`` holds the yaw rates of an
    inertial sensor, which replace the constant yaw rate while ``yaw_rate_fit`` shows that they fit. Odometry that moves
    faster than ``fastest``, m/s and rad/s, predicts nothing. ``commanded``: odometry is that of commands, which err
    independently of each other.
    """

    period_s: float
    odometry: Odometry | None = None
    expects_rest: bool = False
    map_T_laser: Pose = Pose()
    stamp_ns: int = 0
    twist: Twist = (0.0, 0.0, 0.0)
    rotation: Rotation | None = None
    yaw_rate_fit: YawRateFit = YawRateFit()
    fastest: tuple[float, float] = (inf, inf)
    commanded: bool = False

    def elapsed_s(self, stamp_ns: int) -> float:
        """Return the time from or to the last accepted pose, s, in whole periods, at least one."""
        return (round(abs(stamp_ns - self.stamp_ns) * NS / self.period_s) or 1) * self.period_s

    def predict(self, stamp_ns: int) -> Pose:
        """Return the predicted pose: by odometry, else by constant velocity, or the last pose."""
        ahead = self.by_odometry(stamp_ns)
        return ahead or (self.map_T_laser if self.expects_rest else self.by_velocity(stamp_ns))

    def expected_poses(self, predicted: Pose, stamp_ns: int) -> tuple[Pose, ...]:
        """Return the expected poses of a scan: as predicted, by constant velocity, and at rest."""
        return tuple(dict.fromkeys((predicted, self.by_velocity(stamp_ns), self.map_T_laser)))

    def by_velocity(self, stamp_ns: int) -> Pose:
        """Extrapolate the last pose with its twist, ``LONGEST_S`` at most; also back in time."""
        ahead_s = copysign(min(self.elapsed_s(stamp_ns), LONGEST_S), stamp_ns - self.stamp_ns)
        x, y, yaw = self.twist
        turn_rad = self._measured_turn(stamp_ns) if self.yaw_rate_fit.fits else None
        return self.map_T_laser @ Pose(x * ahead_s, y * ahead_s, yaw * ahead_s if turn_rad is None else turn_rad)

    def _measured_turn(self, stamp_ns: int) -> float | None:
        return None if self.rotation is None else self.rotation.turned_rad(self.stamp_ns, stamp_ns, round(GAP_S / NS))

    def by_odometry(self, stamp_ns: int) -> Pose | None:
        """Return the last pose moved by the odometry; None where it does not cover both times, or is too fast."""
        moved = self.odometry and motion_by(self.odometry, self.stamp_ns, stamp_ns)
        if moved is None:
            return None
        (most_m_s, most_rad_s), elapsed_s = self.fastest, self.elapsed_s(stamp_ns)
        possible = moved.distance_m <= most_m_s * elapsed_s and abs(moved.yaw_rad) <= most_rad_s * elapsed_s
        return self.map_T_laser @ moved if possible else None

    def odometry_at(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return at which stamps (n,) the odometry is known."""
        pose_at = self.odometry or (lambda _: None)
        return np.array([pose_at(stamp_ns) is not None for stamp_ns in stamps_ns.tolist()], np.bool_)

    def twist_at(self, stamp_ns: int) -> Twist:
        """Return the twist for de-skewing a scan, also an earlier one: from odometry, else the running average."""
        ahead, ahead_s = self.by_odometry(stamp_ns), copysign(self.elapsed_s(stamp_ns), stamp_ns - self.stamp_ns)
        if ahead is None or self.stamp_ns == 0:
            turn_rad = self._measured_turn(stamp_ns) if self.yaw_rate_fit.fits else None
            return self.twist if turn_rad is None else (*self.twist[:2], turn_rad / ahead_s)
        return _twist(self.map_T_laser, ahead, ahead_s)

    def moved_to(self, map_T_laser: Pose, stamp_ns: int) -> Motion:
        """Return the motion after a new accepted pose."""
        elapsed = self.elapsed_s(stamp_ns)
        twist = x, y, yaw = _twist(self.map_T_laser, map_T_laser, elapsed)
        if elapsed <= GAP_S + self.period_s:
            new, old, (last_x, last_y, last_yaw) = NEW_SHARE, 1.0 - NEW_SHARE, self.twist
            twist = new * x + old * last_x, new * y + old * last_y, new * yaw + old * last_yaw
        moved = self._replace(map_T_laser=map_T_laser, stamp_ns=stamp_ns, twist=twist)
        turn_rad = self._measured_turn(stamp_ns)
        if turn_rad is None:
            return moved
        turned_rad = wrap_angle(map_T_laser.yaw_rad - self.map_T_laser.yaw_rad)
        return moved._replace(yaw_rate_fit=self.yaw_rate_fit.after(turned_rad, turn_rad, self.twist[2] * elapsed))

    def started_at(self, map_T_laser: Pose, stamp_ns: int) -> Motion:
        """Return the motion at rest at a pose."""
        return self._replace(map_T_laser=map_T_laser, stamp_ns=stamp_ns, twist=(0.0, 0.0, 0.0))

    def coming_from(self, map_T_laser: Pose, stamp_ns: int) -> Motion:
        """Return the motion with the velocity from an earlier pose to this one; unchanged after a long gap."""
        elapsed = self.elapsed_s(stamp_ns)
        return self if elapsed > LONGEST_S else self._replace(twist=_twist(map_T_laser, self.map_T_laser, elapsed))


def motion_by(odometry: Odometry, start_ns: int, end_ns: int) -> Pose | None:
    """Return the motion by odometry between two stamps, in its frame at the first; None where it covers not both."""
    then, now = odometry(start_ns), odometry(end_ns)
    return None if then is None or now is None else then.between(now)


def motion_at(motion: Motion, step: Step, before: Step) -> Motion:
    """Return the motion at a step, with the velocity from another one to it; at rest after a long gap."""
    here = motion.started_at(step.match.map_T_laser, step.stamp_ns)
    return here.coming_from(before.match.map_T_laser, before.stamp_ns)


def _twist(a: Pose, b: Pose, elapsed_s: float) -> Twist:
    """Return the velocity from pose ``a`` to pose ``b``, frame of ``a``, m/s, m/s, rad/s."""
    moved = a.between(b)
    return moved.x_m / elapsed_s, moved.y_m / elapsed_s, moved.yaw_rad / elapsed_s


def motions_along(map_T_laser: Trajectory, motion: Motion) -> Iterator[Motion]:
    """Yield the motion at every pose, with the velocity of the path before and after it."""
    for row, (x, y, yaw) in enumerate(twists(map_T_laser, motion.period_s).tolist()):
        stamp_ns = int(map_T_laser.stamps_ns[row])
        yield motion._replace(odometry=None, map_T_laser=map_T_laser[row], stamp_ns=stamp_ns, twist=(x, y, yaw))


def twists(map_T_laser: Trajectory, period_s: float) -> NDArray[np.float64]:
    """Return the velocity at every pose (n, 3), laser frame, m/s, m/s, rad/s; 0 between two gaps."""
    moved = np.diff(map_T_laser.xyyaw, axis=0)
    moved[:, 2] = (moved[:, 2] + pi) % (2.0 * pi) - pi
    elapsed_s = np.maximum(np.round(np.diff(map_T_laser.stamps_ns) * NS / period_s), 1.0) * period_s
    joined = (elapsed_s <= LONGEST_S) & ~jumps(map_T_laser)[1]
    weights = np.pad(np.where(joined, elapsed_s, 0.0), 1)
    sums = np.pad(np.where(joined[:, None], moved, 0.0), ((1, 1), (0, 0)))
    x, y, yaw = ((sums[:-1] + sums[1:]) / np.maximum(weights[:-1] + weights[1:], period_s)[:, None]).T
    cos, sin = np.cos(map_T_laser.xyyaw[:, 2]), np.sin(map_T_laser.xyyaw[:, 2])
    return np.column_stack((cos * x + sin * y, cos * y - sin * x, yaw))
