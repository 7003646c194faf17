"""What is made of a mission: errors against the truth, the recording, the walls in the map frame."""

from __future__ import annotations

from functools import cache
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.errors import NoScansError, OutputError, UsageError
from mavnav.logs import open_log
from mavnav.logs.writing.recorder import record
from mavnav.mapping.occupancy_grid import Grid, GridBuilder
from mavnav.outputs.documents.run_json import TruthErrors
from mavnav.pipelines.simulate import (
    SimulationRequest,
    check_outputs,
    recording_of,
    simulate_mission,
    truth_errors,
    wall_distances_m,
)
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.simulation.mission import Flight, fly
from mavnav.simulation.world.geometry import World
from mavnav.simulation.world.scenario_file import load_scenario
from mavnav.units import DEG


@cache
def flown(**settings: Any) -> Flight:
    """Fly some steps of the corner, the laser off the middle of the vehicle."""
    mounted = {"vehicle.laser_x_mm": 120, "vehicle.laser_y_mm": -60, "vehicle.laser_yaw_deg": 35}
    return fly(load_scenario("corner", (), {"max_steps": 14, **mounted, **settings}))


def estimated(flight: Flight, poses: Trajectory, **more: Any) -> Flight:
    """Return the flight with other estimates."""
    return replace(flight, slam=replace(flight.slam, trajectory=poses, **more))


# ---- errors against the truth ----------------------------------------------------------------------------------------


def test_a_perfect_estimate_has_no_error() -> None:
    errors = truth_errors(estimated(flown(), flown().map_T_laser))
    for name in ("ate_rmse_m", "unaligned_max_m", "final_error_m", "final_yaw_error_rad", "map_yaw_error_rad"):
        assert getattr(errors, name) == pytest.approx(0.0, abs=1e-9)
    assert errors.ate_poses == 15


def test_a_planted_error_gives_the_planted_numbers() -> None:
    """The whole estimate turned by 3 degrees and moved, and the last pose 40 mm and 2 degrees off besides."""
    flight = flown()
    turn = Pose(0.03, -0.04, 3 * DEG)
    poses = [turn @ flight.map_T_laser[k] for k in range(15)]
    errors = truth_errors(estimated(flight, Trajectory.of(flight.map_T_laser.stamps_ns.tolist(), poses)))
    assert errors.ate_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert errors.map_yaw_error_rad == pytest.approx(3 * DEG)
    assert errors.final_yaw_error_rad == pytest.approx(3 * DEG)
    assert errors.final_aligned_error_m == pytest.approx(0.0, abs=1e-9)
    true = flight.map_T_laser[14]
    assert errors.final_error_m == pytest.approx(hypot(poses[-1].x_m - true.x_m, poses[-1].y_m - true.y_m))
    poses[-1] = poses[-1] @ Pose(0.04, 0.0, 2 * DEG)
    errors = truth_errors(estimated(flight, Trajectory.of(flight.map_T_laser.stamps_ns.tolist(), poses)))
    assert errors.final_yaw_error_rad == pytest.approx(5 * DEG)
    assert 0.025 < errors.ate_max_m < 0.04  # the alignment takes its share
    assert errors.ate_rmse_m < errors.ate_max_m < errors.unaligned_max_m


def test_only_tracked_poses_are_compared() -> None:
    """Stamps decide which truth belongs to an estimate."""
    flight = flown()
    some = Trajectory(flight.map_T_laser.stamps_ns[[0, 4, 9]].copy(), flight.map_T_laser.xyyaw[[0, 4, 9]].copy())
    errors = truth_errors(estimated(flight, some))
    assert errors.ate_poses == 3
    assert errors.unaligned_max_m == 0.0


# ---- distance to the nearest wall ------------------------------------------------------------------------------------


def painted(flight: Flight, stretch: float = 1.0) -> Grid:
    """Return a map of the true walls all round, seen from the last pose, ``stretch`` times as far as they are."""
    grid, here = GridBuilder(0.01), flight.map_T_laser[14]
    there = flight.world_T_map @ here
    bearings = np.linspace(-np.pi, np.pi, 8000)
    ranges, _ = flight.scenario.world.cast((there.x_m, there.y_m), bearings + there.yaw_rad)
    points = stretch * ranges[:, None] * np.column_stack((np.cos(bearings), np.sin(bearings)))
    grid.insert(here, transform_points(here, points))
    return grid.by_rows()


@pytest.mark.parametrize("stretch", [1.0, 1.05])
def test_the_wall_distance_is_read_off_the_map(stretch: float) -> None:
    flight = flown()
    flight = estimated(flight, flight.map_T_laser, grid=painted(flight, stretch))
    wall_m, true_m = wall_distances_m(flight, flight.map_T_laser[14], flight.map_T_laser[14])
    there = flight.world_T_map @ flight.map_T_laser[14]
    assert true_m >= flight.scenario.world.clearance_m(np.array([(there.x_m, there.y_m)]))[0] - 1e-9
    assert wall_m == pytest.approx(stretch * true_m, abs=0.012)
    share = truth_errors(flight).wall_distance_error_share
    assert share == pytest.approx(abs(wall_m - true_m) / true_m)


def test_a_map_without_walls_has_no_distance() -> None:
    flight = estimated(flown(), flown().map_T_laser, grid=Grid(0.02))
    wall_m, true_m = wall_distances_m(flight, Pose(), Pose())
    assert np.isnan(wall_m)
    assert 0.3 < true_m < 5.0


# ---- frames ----------------------------------------------------------------------------------------------------------


def test_walls_move_as_the_rays_do() -> None:
    world = load_scenario("curved").world
    a_T_world = Pose(1.0, -2.0, 0.8)
    other = world.seen_from(a_T_world.inverse())
    bearings = np.linspace(-3, 3, 500)
    here = a_T_world @ Pose(0.8, 2.4)
    there, _ = other.cast((here.x_m, here.y_m), bearings + 0.8)
    np.testing.assert_allclose(there, world.cast((0.8, 2.4), bearings)[0], rtol=0.0, atol=1e-9)
    assert isinstance(other, World)


def test_the_recording_tells_the_base(tmp_path: Path) -> None:
    flight = flown()
    recording = recording_of(flight)
    start = recording.world_T_base[0]
    np.testing.assert_allclose(start.as_array(), flight.scenario.world_T_base.as_array(), atol=1e-9)
    record(recording, tmp_path / "flight.mcap")
    log = open_log(tmp_path / "flight.mcap")
    assert log.base_T_laser is not None
    np.testing.assert_allclose(log.base_T_laser.as_array(), flight.scenario.base_T_laser.as_array(), atol=1e-9)
    assert log.odometry is not None
    odom_T_laser = flight.odom_T_base.compose(flight.scenario.base_T_laser)
    np.testing.assert_allclose(log.odometry.odom_T_laser.xyyaw, odom_T_laser.xyyaw, atol=1e-9)
    again = list(log.scans())
    assert [scan.stamp_ns for scan in again] == [scan.stamp_ns for scan in flight.scans]
    for scan, original in zip(again, flight.scans, strict=True):
        np.testing.assert_allclose(scan.ranges_m, original.ranges_m, rtol=1e-6)


# ---- the pipeline ----------------------------------------------------------------------------------------------------


def request(folder: Path, **more: Any) -> SimulationRequest:
    settings = more.pop("settings", {"max_steps": 3})
    return SimulationRequest(load_scenario("corner", (), settings), Path("corner.yaml"), folder / "run", **more)


def test_outputs_are_asked_for_before_the_flight(tmp_path: Path) -> None:
    (tmp_path / "there.mcap").touch()
    (tmp_path / "there.gif").touch()
    (tmp_path / "run").mkdir()
    for more in ({}, {"force": True, "recording": tmp_path / "there.txt"}, {"animation": tmp_path / "there.gif"}):
        with pytest.raises((OutputError, UsageError)):
            check_outputs(request(tmp_path, **more))
    check_outputs(request(tmp_path, force=True, recording=tmp_path / "there.mcap", animation=tmp_path / "there.gif"))


@pytest.mark.parametrize("other", [{"recording": "run"}, {"animation": "b/../run"}])
def test_two_outputs_need_two_names(tmp_path: Path, other: dict[str, str]) -> None:
    with pytest.raises(UsageError, match="run is to be two things"):
        check_outputs(request(tmp_path, **{key: tmp_path / name for key, name in other.items()}))


@pytest.mark.parametrize(("name", "where"), [("run/result.mcap", "a/run"), ("a", "a/run"), ("a", "a/b/run")])
@pytest.mark.parametrize("force", [False, True])
def test_a_recording_does_not_overwrite_the_run(tmp_path: Path, name: str, where: str, *, force: bool) -> None:
    recording = tmp_path / "a" / name if "/" in name else tmp_path / name
    asked = replace(request(tmp_path, recording=recording, force=force), directory=tmp_path / where)
    with pytest.raises(UsageError, match="is a part of the run, or contains it; name recording and animation"):
        check_outputs(asked)


def test_a_recording_in_the_run_directory_is_written(tmp_path: Path) -> None:
    asked = request(tmp_path, recording=tmp_path / "run" / "drive.mcap", animation=tmp_path / "run" / "drive.gif")
    for force in (False, True):
        given = replace(asked, force=force, content=("0" * 64, 1), outputs=("trajectory",))
        simulate_mission(given, lambda *_: None, 0.0)
        assert {"drive.mcap", "drive.gif", "run.json"} <= {path.name for path in (tmp_path / "run").iterdir()}


def test_a_circle_of_links_is_no_bug(tmp_path: Path) -> None:
    (tmp_path / "run").symlink_to("run")
    with pytest.raises(OutputError, match="run is a link that leads nowhere"):
        check_outputs(request(tmp_path))


def test_a_laser_that_sees_nothing_is_said_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(NoScansError, match=r"^corner.yaml: in 40 scans the laser saw too little"):
        simulate_mission(request(tmp_path, settings={"laser.range_max_mm": 100}), lambda *_: None, 0.0)
    assert list(tmp_path.iterdir()) == []


def test_two_poses_measure_nothing() -> None:
    flight = flown()
    few = Trajectory(flight.map_T_laser.stamps_ns[:2].copy(), flight.map_T_laser.xyyaw[:2].copy())
    assert truth_errors(estimated(flight, few)) == TruthErrors(2)


def test_the_document_names_the_odometry_that_was_used(tmp_path: Path, repo_root: Path) -> None:
    def used(name: str, **slam: Any) -> tuple[str, Any]:
        settings = {"max_steps": 4} | {f"slam.{key}": value for key, value in slam.items()}
        asked = request(tmp_path / name, settings=settings, outputs=("trajectory",))
        asked = replace(asked, path=repo_root / "configs" / "corner.yaml")
        _, document = simulate_mission(asked, lambda *_: None, 0.0)
        return document["config"]["odom"], document["input"]["odometry"]

    odometry = {"topic": "/odom", "source": "odom"}
    assert used("with") == ("auto", odometry)
    assert used("without", odom="off") == ("off", None)
    assert used("paper", method="paper") == ("off", odometry)
