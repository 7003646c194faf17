"""The vehicle of a mission: its true state, attitude and path, and where its laser is over a sweep."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.scan import Attitude, LaserSpec
from mavnav.simulation.planner.potential_field import MotionCommand
from mavnav.simulation.world.scenario import FlightConfig, Scenario
from mavnav.units import DEG, MM, NS

GRAVITY_M_S2: Final = 9.81

START_NS = 1_700_000_000_000_000_000
"""Stamp of the first scan, the same for every mission."""


class Body:
    """The true attitude of the laser and what the sensor measures of it, scan by scan; read-only lists from outside.

    Roll and pitch are the tilt of the commanded accelerations and a correlated noise; the height is the commanded one
    and such a noise.
    """

    def __init__(self, config: FlightConfig, period_s: float, command_s: float, seed: int) -> None:
        """Begin in level flight with a first attitude: ``seed`` decides all."""
        self._config, self._command_s = config, command_s
        self._noise, self._sensor = (np.random.default_rng([seed, stream]) for stream in (3, 4))
        self._kept = float(np.exp(-period_s / (config.correlation_s)))
        self._follow = 1.0 - float(np.exp(-period_s / (config.response_s)))
        self._sigmas = np.array([*[config.tilt_noise_rad] * 2, config.height_noise_m])
        self._off = self._sigmas * self._noise.standard_normal(3)
        self._velocity_m_s, self._wanted, self._tilt = np.zeros(2), np.zeros(2), np.zeros(2)
        self.true: list[Attitude] = []
        self.measured: list[Attitude] = []
        self._note()

    def command(self, dx_m: float, dy_m: float) -> None:
        """Take a command of the laser's frame: the vehicle tilts towards where it accelerates to."""
        velocity_m_s = np.array((dx_m, dy_m)) / self._command_s
        x, y = (velocity_m_s - self._velocity_m_s) / self._command_s
        most = self._config.max_tilt_rad
        self._wanted = np.clip(np.arctan2([-y, x], GRAVITY_M_S2), -most, most)
        self._velocity_m_s = velocity_m_s

    def step(self) -> None:
        """Go on to the next scan."""
        fresh = self._noise.standard_normal(3) * np.sqrt(1.0 - self._kept**2)
        self._off = self._kept * self._off + self._sigmas * fresh
        self._tilt = self._tilt + self._follow * (self._wanted - self._tilt)
        self._note()

    def _note(self) -> None:
        c = self._config
        true = np.array([*self._tilt, c.height_m]) + self._off
        noise = np.array([*[c.sensor_tilt_rad] * 2, c.sensor_height_m])
        self.true.append(Attitude(*true.tolist()))
        self.measured.append(Attitude(*(true + noise * self._sensor.standard_normal(3)).tolist()))


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
    step = (vehicle.world_T_base[-2:][0] @ vehicle.base_T_laser).between(here)

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
