"""Degenerate geometry: motion in one direction is not observable without odometry, and only a warning shows it."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.mapping.line_map import LineMap
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.scan import LaserSpec
from mavnav.slam.matching.observability import LEAST_OBSERVABILITY, degeneracy_warning, symmetric
from mavnav.slam.matching.scan_matching import first_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.pipeline import run_slam
from support import naive
from support.synthetic import URG_04LX, Recording, along, drifting_odometry, furnished_rooms, polyline, record, room

CIRCLE = polyline(*((2.5 * np.cos(a), 2.5 * np.sin(a)) for a in np.arange(0.0, 2 * pi, pi / 60)), closed=True)
CORRIDOR = polyline((-20, -1), (20, -1)), polyline((-20, 1), (20, 1))
LASER = Pose(0.3, -0.2, 0.7)
SHORT_SIGHTED = LaserSpec(URG_04LX.angle_min_rad, URG_04LX.angle_step_rad, 681, 0.02, 4.0, 0.0, 0.1)


def driven(walls: np.ndarray, *way_m: tuple[float, float]) -> Recording:
    return record(walls, along(list(way_m)), SHORT_SIGHTED, noise=0.005)


@pytest.mark.parametrize(
    ("walls", "way"),
    [
        (np.vstack(CORRIDOR), [(0.0, 0.0), (3.0, 0.2)]),
        (CORRIDOR[1], [(0.0, -1.0), (3.0, -1.0)]),
        (CIRCLE, [(-0.5, 0.0), (0.5, 0.3)]),
    ],
    ids=["corridor", "one wall", "round room"],
)
def test_degenerate_geometry_is_reported(walls: np.ndarray, way: list[tuple[float, float]]) -> None:
    drive = driven(walls, *way)
    found = run_slam(lambda: drive.scans, Config(), 0.1)
    (warning,) = found.warnings
    assert "motion in one direction is not observable" in warning
    assert found.doubt is not None
    assert found.doubt.high
    assert "weakly constrained pose" in {reason.name for reason in found.doubt.reasons}


@pytest.mark.parametrize("walls", [furnished_rooms(), room(4.0, 3.5)], ids=["furnished", "empty room"])
def test_a_room_holds_the_laser(walls: np.ndarray) -> None:
    drive = driven(walls, (0.8, 0.7), (2.8, 0.7), (2.9, 1.5))
    found = run_slam(lambda: drive.scans, Config(), 0.1)
    assert found.warnings == ()
    assert found.doubt is not None
    assert not found.doubt.high
    assert found.doubt.reasons == ()


def test_odometry_holds_it_too() -> None:
    drive = driven(np.vstack(CORRIDOR), (0.0, 0.0), (2.0, 0.1))
    odometry = drifting_odometry(drive.world_T_laser)
    found = run_slam(lambda: drive.scans, Config(), 0.1, odometry)
    (warning,) = found.warnings
    assert "motion in one direction is that of the odometry alone" in warning
    assert found.doubt is not None
    assert not found.doubt.high


def test_a_room_needs_no_odometry() -> None:
    drive = driven(furnished_rooms(), (0.8, 0.7), (2.8, 0.7), (2.9, 1.5))
    assert run_slam(lambda: drive.scans, Config(), 0.1, drifting_odometry(drive.world_T_laser)).warnings == ()


@pytest.mark.parametrize("poses", [2, 6])
def test_odometry_of_a_moment_does_not_hold_it(poses: int) -> None:
    drive = driven(np.vstack(CORRIDOR), (0.0, 0.0), (3.0, 0.2))
    odometry = drifting_odometry(drive.world_T_laser)
    short = Trajectory(odometry.stamps_ns[:poses], odometry.xyyaw[:poses])
    found = run_slam(lambda: drive.scans, Config(), 0.1, short)
    covered, degenerate = found.warnings
    assert covered.startswith(f"odometry covers {poses} of {len(drive.scans)} scans")
    assert "motion in one direction is not observable" in degenerate
    assert found.doubt is not None
    assert found.doubt.high
    assert "weakly constrained pose" in {reason.name for reason in found.doubt.reasons}


def test_no_place_along_a_wall_is_preferred_to_that_of_the_odometry() -> None:
    drive = record(CORRIDOR[1], along([(0.0, -1.0), (3.0, -1.0)]), SHORT_SIGHTED, seed=5)
    found = run_slam(lambda: drive.scans, Config(), 0.1, drifting_odometry(drive.world_T_laser, seed=5))
    assert np.abs(found.trajectory.xyyaw - drive.map_T_laser.xyyaw)[:, 0].max() < 0.2
    assert found.doubt is not None
    assert not found.doubt.high


def nothing(_: np.ndarray) -> str:
    return ""


@pytest.mark.parametrize(("loose", "told"), [(4, ""), (5, "from 0.3 to 0.7 s): ")])
def test_a_few_scans_are_no_slide(loose: int, told: str) -> None:
    steps = Steps(Step(k, k * 100_000_000, first_match(100), tracked=True) for k in range(20))
    holds = np.ones(20)
    holds[3 : 3 + loose] = 0.5 * LEAST_OBSERVABILITY
    assert told in degeneracy_warning(steps, holds, nothing)
    assert bool(degeneracy_warning(steps, holds, nothing)) == bool(told)


def test_the_meaning_is_that_of_the_degenerate_scans() -> None:
    steps = Steps(Step(k, k * 100_000_000, first_match(100), tracked=True) for k in range(20))
    holds, seen = np.ones(20), list[int]()
    holds[5:10] = 0.0

    def meaning(stamps_ns: np.ndarray) -> str:
        seen.extend(stamps_ns.tolist())
        return "so it is"

    assert degeneracy_warning(steps, holds, meaning).endswith("(from 0.5 to 0.9 s): so it is")
    assert seen == [k * 100_000_000 for k in range(5, 10)]


def test_a_run_that_was_stopped_tells_of_the_scans_that_came() -> None:
    steps = Steps(Step(k, k * 100_000_000, first_match(100), tracked=True) for k in range(20))
    assert "25 % of the scans" in degeneracy_warning(steps, np.zeros(5), nothing)


def random_map(seed: int) -> tuple[LineMap, np.ndarray]:
    """Return the map of random walls, and points on them, and off them, seen from ``LASER``."""
    rng = np.random.default_rng(seed)
    line_map = LineMap(0.02, 0.06, 0.01, known_points=4.0)
    ends = np.repeat(rng.uniform(-2, 2, (8, 2, 2)), 50, axis=0)
    walls = ends[:, 0] + rng.random((400, 1)) * (ends[:, 1] - ends[:, 0]) + rng.normal(0, 0.01, (400, 2))
    line_map.insert(walls)
    return line_map, transform_points(LASER.inverse(), np.vstack((walls[::3] + 0.02, rng.uniform(-5, 5, (20, 2)))))


@pytest.mark.parametrize("seed", range(5))
def test_the_kernel_is_its_twin(seed: int) -> None:
    line_map, points = random_map(seed)
    fast, sums = line_map.observability(points, LASER)
    slow, information, _ = naive.observability(points, LASER, line_map)
    assert slow > 0.01
    assert fast == pytest.approx(slow, abs=1e-9)
    np.testing.assert_allclose(symmetric(sums), information, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_the_pulls_are_those_of_the_twin(seed: int) -> None:
    line_map, points = random_map(seed)
    sums, table = line_map.pulls(points, LASER, 0.05)
    _, all_information, _ = naive.observability(points, LASER, line_map)
    _, information, pulls = naive.observability(points, LASER, line_map, 0.05, 4.0)
    assert 20.0 < information[0, 0] + information[1, 1] < 0.9 * (all_information[0, 0] + all_information[1, 1])
    np.testing.assert_allclose(symmetric(sums), information, atol=1e-6)
    fast = {tuple(column[3:5].tolist()): column[:3] for column in table.T if column[5]}
    assert fast.keys() == pulls.keys()
    for square, pull in pulls.items():
        np.testing.assert_allclose(fast[square], pull, atol=1e-6)


def test_no_point_holds_nothing() -> None:
    line_map, nothing = LineMap(0.02, 0.06, 0.01), np.zeros((0, 2))
    assert line_map.observability(nothing, Pose())[0] == 0.0
    assert not line_map.pulls(nothing, Pose(), 1.0)[1].any()
