"""A scenario: walls, a vehicle with its laser, where it starts and where it is to go. Strict, in the paper's units.

Lengths of the vehicle and its errors are in mm and degrees; positions in the world are in metres.
"""

from __future__ import annotations

from functools import cached_property
from math import floor, inf, pi
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from msgspec.structs import replace
from pydantic import Field, field_validator

from mavnav.config.models import Config
from mavnav.config.planner import PlannerConfig
from mavnav.config.strict import Strict
from mavnav.pose import Pose
from mavnav.simulation.world.flight import FlightConfig  # noqa: TC001  pydantic reads it
from mavnav.simulation.world.laser import LASERS, LaserModel
from mavnav.simulation.world.shapes import XY, Metre  # noqa: TC001  pydantic reads them
from mavnav.simulation.world.walls import Wall, world_of
from mavnav.units import DEG, MM, MS

if TYPE_CHECKING:
    from mavnav.scan import LaserSpec
    from mavnav.simulation.world.geometry import World

AERIAL = ("flight", "ceiling_m")
"""The keys that only a vehicle with a section ``flight`` has."""

LaserName = Literal["urg-04lx", "utm-30lx", "ust-10lx", "lds-01"]


class Start(Strict):
    """Where the vehicle's base begins, in the world frame."""

    x_m: Metre = Field(description="position, m")
    y_m: Metre = Field(description="position, m")
    yaw_deg: float = Field(0.0, description="heading, counter-clockwise from the x axis")


class LaserConfig(Strict):
    """A sensor by name, changes to its geometry, and its errors; the defaults are what the paper measured."""

    preset: LaserName = Field("urg-04lx", description="sensor preset; the paper's is urg-04lx")
    field_of_view_deg: float | None = Field(None, gt=0, le=360, description="angle from first to last beam, or null")
    step_deg: float | None = Field(None, ge=0.05, le=90, description="angle between two beams, or null")
    range_min_mm: float | None = Field(None, ge=0, le=1e6, description="nearest range, or null for the preset's")
    range_max_mm: float | None = Field(None, gt=0, le=1e6, description="farthest range, or null for the preset's")
    period_ms: float | None = Field(
        None, ge=1, le=10_000, description="time from scan to scan, or null for the preset's"
    )
    noise_percent: float = Field(1.5, ge=0, le=50, description="standard deviation of a range, of the distance")
    bias_percent: float = Field(0.0, ge=0, le=50, description="largest scale error of all ranges of a run")
    mixed_pixel_share: float = Field(
        0.3, ge=0, le=1, description="share of the beams at an edge that read between near and far"
    )
    min_reading_share: float = Field(0.002, ge=0, le=0.5, description="share of beams that read the minimum range")
    max_reading_share: float = Field(0.002, ge=0, le=0.5, description="share of beams that read the maximum range")
    incidence_max_deg: float | None = Field(
        60.0, gt=0, le=90, description="no return at larger angles to the wall's normal; null: always a return"
    )
    incidence_ramp_deg: float = Field(
        10.0, ge=0, le=90, description="returns become rarer over this many degrees before it"
    )
    moving: bool = Field(False, description="every beam is measured at its own time while the vehicle moves")

    @property
    def spec(self) -> LaserSpec:
        """Geometry of the sensor: the preset's with the changes."""
        spec = LASERS[self.preset]
        if self.field_of_view_deg is not None or self.step_deg is not None:
            step = spec.angle_step_rad if self.step_deg is None else self.step_deg * DEG
            span = spec.field_of_view_rad if self.field_of_view_deg is None else self.field_of_view_deg * DEG
            beams = floor(min(span, 2.0 * pi - step) / step + 1e-6) + 1
            pace = spec.time_increment_s / spec.angle_step_rad
            spec = replace(
                spec,
                angle_min_rad=-(beams - 1) / 2 * step,
                angle_step_rad=step,
                beams=beams,
                time_increment_s=pace * step,
            )
        if self.period_ms is not None:
            ratio = self.period_ms * MS / spec.scan_time_s
            spec = replace(spec, scan_time_s=self.period_ms * MS, time_increment_s=spec.time_increment_s * ratio)
        near = spec.range_min_m if self.range_min_mm is None else self.range_min_mm * MM
        far = spec.range_max_m if self.range_max_mm is None else self.range_max_mm * MM
        return replace(spec, range_min_m=near, range_max_m=far)


class VehicleConfig(Strict):
    """The vehicle: its size, the mounting of its laser, and the noise of its commands."""

    radius_mm: float = Field(150.0, gt=0, description="closer to a wall is a collision")
    noise_xy_mm: float = Field(20.0, ge=0, le=10_000, description="standard deviation of a step in x and in y")
    noise_yaw_deg: float = Field(5.0, ge=0, le=180, description="standard deviation of a step in azimuth")
    command_ms: float = Field(
        100.0,
        gt=0,
        le=10_000,
        description="time that a command takes, rounded to a whole number of scan periods, one at least",
    )
    laser_x_mm: float = Field(0.0, ge=-10_000, le=10_000, description="laser on the base, forward")
    laser_y_mm: float = Field(0.0, ge=-10_000, le=10_000, description="laser on the base, to the left")
    laser_yaw_deg: float = Field(0.0, description="laser on the base, counter-clockwise")


class RecoveryConfig(Strict):
    """What the vehicle does while its scans are not accepted (paper, "Corridor Mapping": it repositions itself)."""

    fly_on_steps: int = Field(6, ge=0, description="commands by dead reckoning after a rejected scan, then it hovers")
    hover_steps: int = Field(40, ge=1, description="scans that it hovers for before it gives up")
    hover_noise: bool = Field(False, description="hovering drifts like a command: by the vehicle's noise at each scan")


class Scenario(Strict):
    """Everything that decides a mission besides mavnav's version."""

    name: str = Field("", description="name of the mission; that of the file where it is not given")
    about: str = Field("", description="one line about the scenario")
    walls: tuple[Wall, ...] = Field(
        description="shapes: polyline, box, circle, arc, table or opening", json_schema_extra={"minItems": 1}
    )
    ceiling_m: float | None = Field(None, gt=0, le=1000, description="height of the ceiling above the floor, or null")
    measured: tuple[Wall, ...] = Field(
        (), description="walls as measured by hand, drawn on true_map.png besides the true ones"
    )
    start: Start = Field(description="pose of the vehicle's base at the start: x_m, y_m, yaw_deg")
    goal_m: XY = Field(description="position to reach with the laser, [x, y]")
    via_m: tuple[XY, ...] = Field((), description="positions to visit before the goal, in order, [[x, y], ...]")
    goal_radius_mm: float = Field(
        250.0,
        gt=0,
        description="the vehicle stops when its estimated position is within this distance of the goal; reached if the "
        "true one is within twice that, and the true path passed via_m within twice that",
    )
    max_steps: int = Field(500, ge=1, le=100_000, description="commands after which the mission is given up")
    seed: int = Field(0, ge=0, le=2**63, description="seed of all random numbers")
    laser: LaserConfig = Field(LaserConfig(), description="sensor: its name, or a section")
    vehicle: VehicleConfig = Field(VehicleConfig(), description="vehicle")
    flight: FlightConfig | None = Field(None, description="height and tilt of an aerial vehicle; null: it moves level")
    recovery: RecoveryConfig = Field(RecoveryConfig(), description="what happens after a rejected scan")
    planner: PlannerConfig = Field(PlannerConfig(), description="path planning")
    slam: Config = Field(Config(), description="method, grid, azimuth and what else configures a replay")

    @field_validator("name")
    @classmethod
    def _name_of_a_file(cls, name: str) -> str:
        if name in (".", "..") or any(c in "/\\" or c < " " for c in name):
            msg = "should be a name for files, without slashes and control characters"
            raise ValueError(msg)
        return name

    @field_validator("laser", mode="before")
    @classmethod
    def _laser_by_name(cls, value: object) -> object:
        return {"preset": value} if isinstance(value, str) else value

    @field_validator("walls")
    @classmethod
    def _some_walls(cls, walls: tuple[Wall, ...]) -> tuple[Wall, ...]:
        if not walls:
            msg = "needs one shape at least"
            raise ValueError(msg)
        return walls

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
        return max(1, round(self.vehicle.command_ms * MS / self.laser.spec.scan_time_s))

    @property
    def base_T_laser(self) -> Pose:
        """Where the laser sits."""
        v = self.vehicle
        return Pose(v.laser_x_mm * MM, v.laser_y_mm * MM, v.laser_yaw_deg * DEG)

    @property
    def goals_xy_m(self) -> tuple[XY, ...]:
        """Positions to visit in order, world frame; the last is the goal."""
        return (*self.via_m, self.goal_m)

    def document(self) -> dict[str, Any]:
        """Return the scenario as plain data, the search grid as text; it makes the same scenario again."""
        shapes = {
            name: [wall.model_dump(mode="json", exclude_none=True) for wall in walls]
            for name, walls in (("walls", self.walls), ("measured", self.measured))
        }
        left_out = () if self.flight else AERIAL
        return {**self.model_dump(mode="json", exclude={*left_out}), **shapes, "slam": self.slam.document()}


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
