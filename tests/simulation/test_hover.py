"""Missions of a vehicle that tilts: what it goes round, and what the attitude is worth to it."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mavnav.pipelines.simulate import recording_of, truth_errors
from mavnav.pose import Pose
from mavnav.scan import Attitude
from mavnav.simulation.mission import Flight, fly
from mavnav.simulation.planner.potential_field import MotionCommand
from mavnav.simulation.vehicle import vehicle_of
from mavnav.simulation.world.scenario_file import load_scenario
from mavnav.units import DEG

if TYPE_CHECKING:
    from pathlib import Path

TILTED = ("flight.tilt_noise_deg=10",)
CORRIDOR = """\
walls:
  - polyline: {{closed: true, points_m: [[0, 0], [4, 0], [4, 2], [0, 2]]}}
  - polyline: {{points_m: [[2, 0], [2, 2]], height_m: {}}}
start: {{x_m: 0.7, y_m: 1}}
goal_m: [3.3, 1]
flight: {{height_m: 1.1, tilt_noise_deg: 10}}
max_steps: 100
"""
"""A corridor with a wall right across."""


@cache
def flown(*settings: str) -> Flight:
    return fly(load_scenario("hover", settings))


@pytest.mark.slow
def test_the_attitude_makes_a_mission_as_exact_as_a_level_one() -> None:
    used, ignored = flown(*TILTED), flown(*TILTED, "slam.attitude=off")
    assert used.mission.reached
    assert truth_errors(used).ate_rmse_m < 0.012
    assert truth_errors(ignored).ate_rmse_m > 2 * truth_errors(used).ate_rmse_m
    assert used.mission.min_clearance_m > 0.3


@pytest.mark.slow
def test_a_flight_has_an_attitude_for_every_scan() -> None:
    flight = flown(*TILTED)
    true, measured = np.array(flight.tilts), np.array(flight.attitudes)
    assert true.shape == measured.shape == (len(flight.scans), 3)
    assert true[:, :2].std() / DEG == pytest.approx(10, abs=3)
    assert (measured - true).std(axis=0) == pytest.approx([0.5 * DEG, 0.5 * DEG, 0.01], rel=0.3)
    record = recording_of(flight)
    assert [stamp for stamp, _ in record.attitudes] == [scan.stamp_ns for scan in flight.scans]
    assert isinstance(record.attitudes[0][1], Attitude)
    again = fly(load_scenario("hover", TILTED))
    assert again.attitudes == flight.attitudes
    assert all(a.ranges_m.tobytes() == b.ranges_m.tobytes() for a, b in zip(again.scans, flight.scans, strict=True))


@pytest.mark.parametrize(("period_ms", "command_s"), [(25, 0.1), (30, 0.09), (100, 0.1), (200, 0.2)])
def test_tilt_is_of_the_time_that_a_command_lasts(period_ms: float, command_s: float) -> None:
    """A command lasts whole scan periods, the one of 100 ms three of 30 ms or one of 200 ms."""
    level = ("flight.tilt_noise_deg=0", "flight.max_tilt_deg=20", "flight.response_ms=0.001")
    scenario = load_scenario("hover", [*level, f"laser.period_ms={period_ms}"])
    vehicle = vehicle_of(scenario, scenario.laser.spec.scan_time_s)
    assert len(list(vehicle.execute(MotionCommand(0.01, 0.0, 0.0), Pose()))) * period_ms == pytest.approx(
        1e3 * command_s
    )
    assert vehicle.body.true[-1].pitch_rad == pytest.approx(np.arctan(0.01 / command_s**2 / 9.81))


def through(folder: Path, height_m: str, *settings: str) -> Flight:
    """Fly through the corridor with a wall of these heights."""
    path = folder / "corridor.yaml"
    path.write_text(CORRIDOR.format(height_m))
    return fly(load_scenario(path, settings))


@pytest.mark.parametrize(("height_m", "reached"), [("[0, 0.7]", True), ("[0.2, 1.2]", False), ("[1.5, 2]", True)])
def test_a_wall_stops_the_vehicle_at_its_own_height_alone(height_m: str, *, reached: bool, tmp_path: Path) -> None:
    """The tilted laser sees the wall now and then wherever it is."""
    mission = through(tmp_path, height_m).mission
    assert mission.reached == reached
    assert mission.min_clearance_m > 0.15


def test_a_moving_laser_tilts_during_the_sweep(tmp_path: Path) -> None:
    flight = through(tmp_path, "[0, 0.7]", "laser.moving=true")
    assert flight.mission.reached
    assert truth_errors(flight).ate_rmse_m < 0.03
    assert recording_of(flight).attitudes[0][0] > flight.scans[0].stamp_ns
