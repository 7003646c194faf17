"""Where the laser should be by now: odometry where the log has it, else constant velocity."""

from __future__ import annotations

from math import copysign
from typing import TYPE_CHECKING, NamedTuple

from mavnav.pose import Pose
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Callable

    Odometry = Callable[[int], Pose | None]
    """Stamp (ns) -> odom_T_laser, None where odometry does not cover it."""

    Twist = tuple[float, float, float]
    """A velocity in the laser's own frame, m/s, m/s, rad/s."""

LONGEST_S = 1.2  # a velocity is trusted no further
NEW_SHARE = 0.7  # of a new velocity in the running one


class Motion(NamedTuple):
    """The last accepted pose and how the laser moved there.

    ``twist`` is the velocity in the laser's own frame, m/s, m/s, rad/s. ``period_s`` is the sensor's: steps of
    time are rounded to whole periods, because many drivers stamp a scan when it arrives, tens of ms early or late.
    With ``expects_rest`` the laser is expected where it was, unless odometry moves it.
    """

    period_s: float
    odometry: Odometry | None = None
    expects_rest: bool = False
    map_T_laser: Pose = Pose()
    stamp_ns: int = 0
    twist: Twist = (0.0, 0.0, 0.0)

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
        return self.map_T_laser @ Pose(x * ahead_s, y * ahead_s, yaw * ahead_s)

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
            return self.twist
        return _twist(self.map_T_laser, ahead, self.elapsed_s(stamp_ns))

    def moved_to(self, map_T_laser: Pose, stamp_ns: int) -> Motion:
        """Return the motion after a new accepted pose."""
        elapsed = self.elapsed_s(stamp_ns)
        twist = x, y, yaw = _twist(self.map_T_laser, map_T_laser, elapsed)
        if elapsed <= 0.5 + self.period_s:
            new, old, (last_x, last_y, last_yaw) = NEW_SHARE, 1.0 - NEW_SHARE, self.twist
            twist = new * x + old * last_x, new * y + old * last_y, new * yaw + old * last_yaw
        return self._at(map_T_laser, stamp_ns, twist)

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
        return Motion(self.period_s, self.odometry, self.expects_rest, map_T_laser, stamp_ns, twist)


def _twist(a: Pose, b: Pose, elapsed_s: float) -> Twist:
    """Return the velocity that leads from one pose to another of the same frame, seen from the first."""
    moved = a.between(b)
    return moved.x_m / elapsed_s, moved.y_m / elapsed_s, moved.yaw_rad / elapsed_s
