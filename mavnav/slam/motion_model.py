"""Where the laser should be by now: odometry where the log has it, else constant velocity."""

from __future__ import annotations

from math import copysign
from typing import TYPE_CHECKING, NamedTuple

from mavnav.pose import Pose, wrap_angle
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavnav.pose import Rotation

    Odometry = Callable[[int], Pose | None]
    """Stamp (ns) -> odom_T_laser, None where odometry does not cover it."""

    Twist = tuple[float, float, float]
    """A velocity in the laser's own frame, m/s, m/s, rad/s."""

USUAL_PERIOD_S = 0.1  # from scan to scan, where stamps do not say it
LONGEST_S = 1.2  # a velocity is trusted no further
NEW_SHARE = 0.7  # of a new velocity in the running one


PROVEN_STEPS, FORGOTTEN = 10, 0.98
"""A yaw rate is used after so many steps; older ones count less by this factor a step."""

FIT_SHARE, FIT_RAD = 0.3, 0.3 * DEG
"""A yaw rate fits if it is wrong by less than this share of the turns, or by less than the noise of a match."""

ROTATION_GAP_NS = 200_000_000
"""A yaw rate is integrated over gaps up to this."""


class Proof(NamedTuple):
    """How well a measured yaw rate predicts turns: steps, and sums of squared errors and turns, rad2."""

    steps: float = 0.0
    by_rotation: float = 0.0
    by_velocity: float = 0.0
    turned: float = 0.0

    @property
    def fits(self) -> bool:
        """Whether it predicts better than constant velocity, or well."""
        well = max(self.by_velocity, FIT_SHARE**2 * self.turned, FIT_RAD**2 * self.steps)
        return self.steps >= PROVEN_STEPS and self.by_rotation <= well

    def after(self, turned_rad: float, by_rotation_rad: float, by_velocity_rad: float) -> Proof:
        """Return the proof after another step: how far the laser turned, and what either predicted."""
        errors = (wrap_angle(by_rotation_rad - turned_rad), wrap_angle(by_velocity_rad - turned_rad), turned_rad)
        squares = (old * FORGOTTEN + new * new for old, new in zip(self[1:], errors, strict=True))
        return Proof(self.steps * FORGOTTEN + 1.0, *squares)


class Motion(NamedTuple):
    """The last accepted pose and how the laser moved there.

    ``twist`` is the velocity in the laser's own frame, m/s, m/s, rad/s. ``period_s`` is the sensor's: steps of
    time are rounded to whole periods, because many drivers stamp a scan when it arrives, tens of ms early or late.
    With ``expects_rest`` the laser is expected where it was, unless odometry moves it. ``rotation`` is that of an
    inertial sensor, which takes the place of constant yaw rate as long as the ``proof`` holds that it fits.
    """

    period_s: float
    odometry: Odometry | None = None
    expects_rest: bool = False
    map_T_laser: Pose = Pose()
    stamp_ns: int = 0
    twist: Twist = (0.0, 0.0, 0.0)
    rotation: Rotation | None = None
    proof: Proof = Proof()

    def elapsed_s(self, stamp_ns: int) -> float:
        """Time to the last accepted pose, in whole periods, one at least."""
        return (round(abs(stamp_ns - self.stamp_ns) * NS / self.period_s) or 1) * self.period_s

    def predict(self, stamp_ns: int) -> Pose:
        """Return the pose to expect: odometry's, else constant velocity's or the last one."""
        ahead = self.by_odometry(stamp_ns)
        return ahead or (self.map_T_laser if self.expects_rest else self.by_velocity(stamp_ns))

    def by_velocity(self, stamp_ns: int) -> Pose:
        """Extrapolate the last pose with its twist, ``LONGEST_S`` at most; also back in time."""
        ahead_s = copysign(min(self.elapsed_s(stamp_ns), LONGEST_S), stamp_ns - self.stamp_ns)
        x, y, yaw = self.twist
        turn_rad = self._measured_turn(stamp_ns) if self.proof.fits else None
        return self.map_T_laser @ Pose(x * ahead_s, y * ahead_s, yaw * ahead_s if turn_rad is None else turn_rad)

    def _measured_turn(self, stamp_ns: int) -> float | None:
        return None if self.rotation is None else self.rotation.turned_rad(self.stamp_ns, stamp_ns, ROTATION_GAP_NS)

    def by_odometry(self, stamp_ns: int) -> Pose | None:
        """Move the last pose as odometry did; None where odometry does not cover both times."""
        if self.odometry is None:
            return None
        then, now = self.odometry(self.stamp_ns), self.odometry(stamp_ns)
        return None if then is None or now is None else self.map_T_laser @ then.between(now)

    def twist_at(self, stamp_ns: int) -> Twist:
        """Return the twist to de-skew a scan with: odometry's, else the running one."""
        ahead = self.by_odometry(stamp_ns)
        if ahead is None or self.stamp_ns == 0:
            turn_rad = self._measured_turn(stamp_ns) if self.proof.fits else None
            return self.twist if turn_rad is None else (*self.twist[:2], turn_rad / self.elapsed_s(stamp_ns))
        return _twist(self.map_T_laser, ahead, self.elapsed_s(stamp_ns))

    def moved_to(self, map_T_laser: Pose, stamp_ns: int) -> Motion:
        """Return the motion after a new accepted pose."""
        elapsed = self.elapsed_s(stamp_ns)
        twist = x, y, yaw = _twist(self.map_T_laser, map_T_laser, elapsed)
        if elapsed <= 0.5 + self.period_s:
            new, old, (last_x, last_y, last_yaw) = NEW_SHARE, 1.0 - NEW_SHARE, self.twist
            twist = new * x + old * last_x, new * y + old * last_y, new * yaw + old * last_yaw
        moved = self._at(map_T_laser, stamp_ns, twist)
        turn_rad = self._measured_turn(stamp_ns)
        if turn_rad is None:
            return moved
        turned_rad = wrap_angle(map_T_laser.yaw_rad - self.map_T_laser.yaw_rad)
        return moved._replace(proof=self.proof.after(turned_rad, turn_rad, self.twist[2] * elapsed))

    def started_at(self, map_T_laser: Pose, stamp_ns: int) -> Motion:
        """Return a motion at rest."""
        return self._at(map_T_laser, stamp_ns, (0.0, 0.0, 0.0))

    def coming_from(self, map_T_laser: Pose, stamp_ns: int) -> Motion:
        """Return the motion with the twist that led here from an earlier pose, unless that is too long ago."""
        elapsed = self.elapsed_s(stamp_ns)
        if elapsed > LONGEST_S:
            return self
        return self._at(self.map_T_laser, self.stamp_ns, _twist(map_T_laser, self.map_T_laser, elapsed))

    def _at(self, map_T_laser: Pose, stamp_ns: int, twist: Twist) -> Motion:
        before = self.period_s, self.odometry, self.expects_rest
        return Motion(*before, map_T_laser, stamp_ns, twist, self.rotation, self.proof)


def _twist(a: Pose, b: Pose, elapsed_s: float) -> Twist:
    """Return the velocity that leads from one pose to another of the same frame, seen from the first."""
    moved = a.between(b)
    return moved.x_m / elapsed_s, moved.y_m / elapsed_s, moved.yaw_rad / elapsed_s
