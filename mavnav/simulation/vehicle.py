"""The vehicle of a mission: its true state, how it executes commands, and where its laser is over a sweep."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.scan import Attitude, LaserSpec
from mavnav.simulation.planner.potential_field import MotionCommand
from mavnav.simulation.world import Body, Scenario
from mavnav.units import DEG, MM, NS

START_NS = 1_700_000_000_000_000_000
"""Stamp of the first scan, the same for every mission."""


class Vehicle(Struct):
    """The true state, which only the world sees: poses of the base, and what the commands should have made of them.

    ``world_T_base`` and ``odom_T_base`` hold a pose for every scan, at ``stamps_ns``. A command takes
    ``scans_a_command`` scans, at constant velocity. ``body`` is the attitude of an aerial vehicle, None of another.
    """

    base_T_laser: Pose
    period_ns: int
    scans_a_command: int
    world_T_base: list[Pose]
    odom_T_base: list[Pose] = field(default_factory=lambda: [Pose()])
    body: Body | None = None

    @property
    def stamps_ns(self) -> list[int]:
        """Stamps of the scans so far."""
        return [START_NS + k * self.period_ns for k in range(len(self.world_T_base))]

    def odometry(self, stamp_ns: int) -> Pose | None:
        """Return odom_T_laser at the stamp of a scan: the commands so far, as if they had been executed exactly."""
        k = (stamp_ns - START_NS) // self.period_ns
        return self.odom_T_base[k] @ self.base_T_laser if 0 <= k < len(self.odom_T_base) else None

    def execute(self, command: MotionCommand, noise: Pose) -> Iterator[None]:
        """Move by a command of the laser's frame, and by its error (paper, "Maneuver Performance"), scan by scan."""
        wanted = Pose(command.dx_m, command.dy_m, command.dyaw_rad)
        done = Pose(wanted.x_m + noise.x_m, wanted.y_m + noise.y_m, wanted.yaw_rad + noise.yaw_rad)
        world_T_base, odom_T_base = self.world_T_base[-1], self.odom_T_base[-1]
        if self.body:
            self.body.command(command.dx_m, command.dy_m)
        for scan in range(1, self.scans_a_command + 1):
            share = scan / self.scans_a_command
            self.odom_T_base.append(odom_T_base @ self._base_motion(wanted, share))
            self.world_T_base.append(world_T_base @ self._base_motion(done, share))
            if self.body:
                self.body.step()
            yield

    def _base_motion(self, motion: Pose, share: float) -> Pose:
        """Return the base's part of a motion of the laser."""
        part = Pose(share * motion.x_m, share * motion.y_m, share * motion.yaw_rad)
        return self.base_T_laser @ part @ self.base_T_laser.inverse()


def vehicle_of(scenario: Scenario, period_s: float) -> Vehicle:
    """Return the vehicle where it begins."""
    flight, command_s = scenario.flight, scenario.scans_a_command * period_s
    body = Body(flight, period_s, command_s, scenario.seed) if flight else None
    start, period_ns = scenario.world_T_base, round(period_s / NS)
    return Vehicle(scenario.base_T_laser, period_ns, scenario.scans_a_command, [start], body=body)


def disturbance(scenario: Scenario, rng: np.random.Generator, command: MotionCommand) -> Pose:
    """Draw the error of a command; one to hover has none unless ``hover_noise`` is set."""
    vehicle = scenario.vehicle
    x, y, yaw = rng.standard_normal(3)
    if command == MotionCommand() and not scenario.recovery.hover_noise:
        return Pose()
    return Pose(x * vehicle.noise_xy_mm * MM, y * vehicle.noise_xy_mm * MM, yaw * vehicle.noise_yaw_deg * DEG)


def sweeping(vehicle: Vehicle, here: Pose, spec: LaserSpec) -> Callable[[float], Pose]:
    """Return the laser's pose over a sweep, as the last step goes on: ``here`` is the pose at mid-sweep."""
    period_s, mid_s = vehicle.period_ns * NS, mid_sweep_s(spec)
    before = vehicle.world_T_base[-2:][0] @ vehicle.base_T_laser
    step = before.between(here)

    def at(seconds: float) -> Pose:
        share = (seconds - mid_s) / period_s
        return here @ Pose(share * step.x_m, share * step.y_m, share * step.yaw_rad)

    return at


def tilts_over(attitudes: list[Attitude], spec: LaserSpec, period_s: float) -> NDArray[np.float64]:
    """Return roll, pitch and height at each beam, (3, beams), as the last step goes on: the present is mid-sweep."""
    late_s = spec.time_increment_s * np.arange(spec.beams) - mid_sweep_s(spec)
    before, here = np.array(attitudes[-2:])[[0, -1], :, None]
    return np.asarray(here + late_s / period_s * (here - before))


def mid_sweep_s(spec: LaserSpec) -> float:
    """Return the time from the first beam to the middle of the sweep."""
    return 0.5 * (spec.beams - 1) * spec.time_increment_s
