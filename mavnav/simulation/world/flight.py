"""What an aerial vehicle does besides moving in the plane: its height, its tilt, and the sensor of both."""

from __future__ import annotations

from typing import Annotated, Final

import numpy as np
from msgspec import Meta

from mavnav.config.models import Strict, in_si, setting
from mavnav.scan import Attitude
from mavnav.units import DEG, MM, MS

Tilt = Annotated[float, Meta(ge=0.0, le=20.0)]

GRAVITY_M_S2: Final = 9.81


class FlightConfig(Strict, frozen=True):
    """Flight of an aerial vehicle; without this section it moves level, in the plane of its laser."""

    height_m: Annotated[float, setting("commanded height of the laser above the floor", gt=0, le=1000)] = 1.2
    slice_mm: Annotated[float, setting("slice around it in which walls are obstacles", gt=0, le=5000)] = 400.0
    tilt_noise_deg: Annotated[Tilt, setting("standard deviation of roll and of pitch in steady flight")] = 2.0
    height_noise_mm: Annotated[float, setting("standard deviation of the height", ge=0, le=500)] = 20.0
    correlation_ms: Annotated[float, setting("time in which both fall to 1/e", gt=0, le=60_000)] = 300.0
    max_tilt_deg: Annotated[Tilt, setting("largest tilt to accelerate; 0: none")] = 5.0
    response_ms: Annotated[float, setting("time constant of the tilt after a command", gt=0, le=60_000)] = 200.0
    sensor_tilt_deg: Annotated[Tilt, setting("standard deviation of measured roll and pitch")] = 0.5
    sensor_height_mm: Annotated[float, setting("standard deviation of the measured height", ge=0, le=500)] = 10.0

    tilt_noise_rad, max_tilt_rad, sensor_tilt_rad = in_si(DEG, "tilt_noise_deg", "max_tilt_deg", "sensor_tilt_deg")
    height_noise_m, sensor_height_m = in_si(MM, "height_noise_mm", "sensor_height_mm")
    correlation_s, response_s = in_si(MS, "correlation_ms", "response_ms")

    @property
    def slice_m(self) -> tuple[float, float]:
        """Lower and upper end of the slice in which walls are obstacles."""
        return self.height_m - 0.5 * self.slice_mm * MM, self.height_m + 0.5 * self.slice_mm * MM


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
