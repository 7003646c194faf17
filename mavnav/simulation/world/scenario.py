"""A scenario: walls, a vehicle with its laser, where it starts and where it is to go. Strict, in the paper's units.

Lengths of the vehicle and its errors are in mm and degrees; positions in the world are in metres.
"""

from __future__ import annotations

from functools import cached_property
from math import floor, inf, pi
from typing import Annotated, Any, Final, Literal

import numpy as np
from msgspec import Meta, to_builtins
from msgspec.structs import asdict, replace

from mavnav.config.models import Config, InSI, PlannerConfig, Strict, in_si, setting
from mavnav.pose import Pose
from mavnav.scan import LaserSpec
from mavnav.simulation.world.geometry import World
from mavnav.simulation.world.laser import LASERS, LaserModel
from mavnav.simulation.world.shapes import XY, Degrees, Metre, WallEntry, world_of
from mavnav.units import DEG, MM, MS

AERIAL = ("flight", "ceiling_m")
"""The keys that only a vehicle with a section ``flight`` has."""

Tilt = Annotated[float, Meta(ge=0.0, le=20.0)]

LaserName = Literal["urg-04lx", "utm-30lx", "ust-10lx", "lds-01"]


_GOAL_RADIUS: Final = (
    "the vehicle stops when its estimated position is within this distance of the goal; reached if the true one is "
    "within twice that, and the true path passed via_m within twice that"
)


class StartConfig(Strict, frozen=True):
    """Where the vehicle's base begins, in the world frame."""

    x_m: Annotated[Metre, setting("position, m")]
    y_m: Annotated[Metre, setting("position, m")]
    yaw_deg: Annotated[Degrees, setting("heading, counter-clockwise from the x axis")] = 0.0


class LaserConfig(Strict, frozen=True):
    """A sensor by name, changes to its geometry, and its errors; the defaults are what the paper measured."""

    preset: Annotated[LaserName, setting("sensor preset; the paper's is urg-04lx")] = "urg-04lx"
    field_of_view_deg: Annotated[float, setting("angle from first to last beam, or null", gt=0, le=360)] | None = None
    step_deg: Annotated[float, setting("angle between two beams, or null", ge=0.05, le=90)] | None = None
    range_min_mm: Annotated[float, setting("nearest range, or null: the preset's", ge=0, le=1e6)] | None = None
    range_max_mm: Annotated[float, setting("farthest range, or null: the preset's", gt=0, le=1e6)] | None = None
    period_ms: Annotated[float, setting("time from scan to scan, or null: the preset's", ge=1, le=10_000)] | None = None
    noise_percent: Annotated[float, setting("standard deviation of a range, of the distance", ge=0, le=50)] = 1.5
    bias_percent: Annotated[float, setting("largest scale error of all ranges of a run", ge=0, le=50)] = 0.0
    mixed_pixel_share: Annotated[float, setting("share of beams at an edge that read in between", ge=0, le=1)] = 0.3
    min_reading_share: Annotated[float, setting("share of beams that read the minimum range", ge=0, le=0.5)] = 0.002
    max_reading_share: Annotated[float, setting("share of beams that read the maximum range", ge=0, le=0.5)] = 0.002
    incidence_max_deg: Annotated[float, setting("largest angle to a wall's normal; null: any", gt=0, le=90)] | None = (
        60.0
    )
    incidence_ramp_deg: Annotated[float, setting("within this before it, returns become rarer", ge=0, le=90)] = 10.0
    moving: Annotated[bool, setting("every beam is measured at its own time while the vehicle moves")] = False

    @property
    def spec(self) -> LaserSpec:
        """Geometry of the sensor: the preset's with the changes."""
        spec = LASERS[self.preset]
        if self.field_of_view_deg is not None or self.step_deg is not None:
            step = spec.angle_step_rad if self.step_deg is None else self.step_deg * DEG
            span = spec.field_of_view_rad if self.field_of_view_deg is None else self.field_of_view_deg * DEG
            beams = floor(min(span, 2.0 * pi - step) / step + 1e-6) + 1
            pace_s = spec.time_increment_s / spec.angle_step_rad * step
            first = -(beams - 1) / 2 * step
            spec = replace(spec, angle_min_rad=first, angle_step_rad=step, beams=beams, time_increment_s=pace_s)
        if self.period_ms is not None:
            ratio = self.period_ms * MS / spec.scan_time_s
            spec = replace(spec, scan_time_s=self.period_ms * MS, time_increment_s=spec.time_increment_s * ratio)
        near = spec.range_min_m if self.range_min_mm is None else self.range_min_mm * MM
        far = spec.range_max_m if self.range_max_mm is None else self.range_max_mm * MM
        return replace(spec, range_min_m=near, range_max_m=far)


class VehicleConfig(Strict, frozen=True):
    """The vehicle: its size, the mounting of its laser, and the noise of its commands."""

    radius_mm: Annotated[float, setting("closer to a wall is a collision", gt=0, le=1_000_000)] = 150.0
    noise_xy_mm: Annotated[float, setting("standard deviation of a step in x and in y", ge=0, le=10_000)] = 20.0
    noise_yaw_deg: Annotated[float, setting("standard deviation of a step in azimuth", ge=0, le=180)] = 5.0
    command_ms: Annotated[float, setting("time of a command: whole scan periods, one at least", gt=0, le=10_000)] = (
        100.0
    )
    laser_x_mm: Annotated[float, setting("laser on the base, forward", ge=-10_000, le=10_000)] = 0.0
    laser_y_mm: Annotated[float, setting("laser on the base, to the left", ge=-10_000, le=10_000)] = 0.0
    laser_yaw_deg: Annotated[Degrees, setting("laser on the base, counter-clockwise")] = 0.0

    radius_m, laser_x_m, laser_y_m = in_si(MM, "radius_mm", "laser_x_mm", "laser_y_mm")
    laser_yaw_rad, command_s = InSI("laser_yaw_deg", DEG), InSI("command_ms", MS)


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


class RecoveryConfig(Strict, frozen=True):
    """What the vehicle does while its scans are not accepted (paper, "Corridor Mapping": it repositions itself)."""

    fly_on_steps: Annotated[int, setting("commands by dead reckoning after a rejected scan, then it hovers", ge=0)] = 6
    hover_steps: Annotated[int, setting("scans that it hovers for before it gives up", ge=1)] = 40
    hover_noise: Annotated[bool, setting("hovering drifts like a command: by the vehicle's noise at each scan")] = False


class Scenario(Strict, frozen=True, kw_only=True, dict=True):
    """Everything that decides a mission besides mavnav's version."""

    name: Annotated[str, setting("name of the mission; that of the file where it is not given")] = ""
    about: Annotated[str, setting("one line about the scenario")] = ""
    walls: Annotated[tuple[WallEntry, ...], setting("polyline, box, circle, arc, table or opening", min_length=1)]
    ceiling_m: Annotated[float, setting("height of the ceiling above the floor, or null", gt=0, le=1000)] | None = None
    measured: Annotated[tuple[WallEntry, ...], setting("walls as measured by hand, for true_map.png")] = ()
    start: Annotated[StartConfig, setting("pose of the vehicle's base at the start: x_m, y_m, yaw_deg")]
    goal_m: Annotated[XY, setting("position to reach with the laser, [x, y]")]
    via_m: Annotated[tuple[XY, ...], setting("positions to visit before the goal, in order, [[x, y], ...]")] = ()
    goal_radius_mm: Annotated[float, setting(_GOAL_RADIUS, gt=0, le=1_000_000)] = 250.0
    max_steps: Annotated[int, setting("commands after which the mission is given up", ge=1, le=100_000)] = 500
    seed: Annotated[int, setting("seed of all random numbers", ge=0, le=2**63 - 1)] = 0
    laser: Annotated[LaserConfig, setting("sensor: its name, or a section")] = LaserConfig()
    vehicle: Annotated[VehicleConfig, setting("vehicle")] = VehicleConfig()
    flight: Annotated[FlightConfig | None, setting("height and tilt of an aerial vehicle; null: it moves level")] = None
    recovery: Annotated[RecoveryConfig, setting("what happens after a rejected scan")] = RecoveryConfig()
    planner: Annotated[PlannerConfig, setting("path planning")] = PlannerConfig()
    slam: Annotated[Config, setting("method, grid, azimuth and what else configures a replay")] = Config()

    goal_radius_m = InSI("goal_radius_mm", MM)

    def __post_init__(self) -> None:
        """Raise ValueError if no file can have the scenario's name."""
        if self.name in (".", "..") or any(c in "/\\" or c < " " for c in self.name):
            raise ValueError("name: should be a name for files, without slashes and control characters")

    @cached_property
    def world(self) -> World:
        """The walls as geometry."""
        return world_of(self.walls, spatial=self.flight is not None, ceiling_m=self.ceiling_m)

    @cached_property
    def obstacles(self) -> World:
        """The walls that the vehicle can meet: those in the slice at flight height."""
        return self.world.slice(*self.flight.slice_m) if self.flight else self.world

    @property
    def levels_scans(self) -> bool:
        """Whether the measured attitude is used."""
        return self.flight is not None and self.slam.attitude != "off"

    @property
    def uses_odometry(self) -> bool:
        """Whether commands predict the poses of scans; those of the paper's method always (its Figure 1)."""
        return self.slam.method == "paper" or self.slam.odom != "off"

    @cached_property
    def measured_walls(self) -> World | None:
        """The walls as measured by hand, None where that is not given."""
        return world_of(self.measured) if self.measured else None

    @property
    def world_T_base(self) -> Pose:
        """Where the vehicle's base begins."""
        return Pose(self.start.x_m, self.start.y_m, self.start.yaw_deg * DEG)

    @property
    def scans_a_command(self) -> int:
        """Scans that the laser takes while the vehicle executes a command, 1 at least."""
        return max(1, round(self.vehicle.command_s / self.laser.spec.scan_time_s))

    @property
    def base_T_laser(self) -> Pose:
        """Where the laser sits."""
        v = self.vehicle
        return Pose(v.laser_x_m, v.laser_y_m, v.laser_yaw_rad)

    @property
    def goals_xy_m(self) -> tuple[XY, ...]:
        """Positions to visit in order, world frame; the last is the goal."""
        return (*self.via_m, self.goal_m)

    def document(self) -> dict[str, Any]:
        """Return the scenario as plain data, the search grid as text; it makes the same scenario again."""
        plain = {name: to_builtins(value) for name, value in asdict(self).items() if self.flight or name not in AERIAL}
        shapes = {name: [_without_nulls(entry) for entry in plain[name]] for name in ("walls", "measured")}
        return {**plain, **shapes, "slam": self.slam.document()}


def _without_nulls(entry: dict[str, Any]) -> dict[str, Any]:
    """Leave the shapes that an entry of ``walls`` is not, and what its shape does not have, out of it."""
    shapes = {name: shape for name, shape in entry.items() if shape}
    return {name: {key: value for key, value in shape.items() if value is not None} for name, shape in shapes.items()}


def laser_model(scenario: Scenario) -> LaserModel:
    """Build the sensor of a scenario; its bias is drawn from the scenario's seed, evenly within the bound."""
    c = scenario.laser
    bias = np.random.default_rng([scenario.seed, 2]).uniform(-1.0, 1.0) * c.bias_percent / 100.0
    faint = c.incidence_max_deg is not None
    most = (c.incidence_max_deg or 0.0) * DEG
    return LaserModel(
        c.spec,
        noise=c.noise_percent / 100.0,
        bias=float(bias),
        mixed_pixels=c.mixed_pixel_share,
        min_readings=c.min_reading_share,
        max_readings=c.max_reading_share,
        incidence_sure_rad=most - c.incidence_ramp_deg * DEG if faint else pi,
        incidence_max_rad=most if faint else inf,
    )
