"""The floor ahead of a laser that is pitched down, which moves along with the vehicle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

import mavnav as api
from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.logs.writing.recorder import Recording as Recorded
from mavnav.logs.writing.recorder import record as write
from mavnav.pipelines.replay import ReplayRequest, replay_log
from mavnav.pose import Pose, Trajectory
from mavnav.scan import LaserSpec
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.retries.levelling import as_recorded
from mavnav.slam.track import Track
from support.synthetic import DEG, NOTHING, SHORT, Recording, Segments, along, box, polyline, record

CORRIDOR = np.vstack(
    (
        polyline((0.0, -1.2), (30.0, -1.2), (30.0, 1.2), (0.0, 1.2), closed=True),
        *(box(x_m, side * 1.2, 0.9, 0.24) for x_m, side in ((5.0, -1), (7.7, 1), (13.0, -1), (17.5, 1), (22.0, -1))),
    )
)
OUT_AND_BACK = [(4.0, 0.0), (22.0, 0.1), (4.0, 0.0)]
FLOOR = polyline((4.0, -9.0), (4.0, 9.0))
"""Where a laser 0.25 m high that is 3.6 deg down meets the floor, laser frame: it sees nothing past that line."""


def with_right_wheels(recording: Recording) -> SlamResult:
    """Return the run beside odometry without error."""
    return run_slam(lambda: recording.scans, Config(), 0.1, recording.map_T_laser)


@pytest.mark.parametrize("floor", [FLOOR, polyline((7.0, -6.0), (1.0, 6.0))], ids=["pitched", "rolled, too"])
def test_floor_ahead_does_not_hold_the_track(floor: Segments) -> None:
    """The track stood still with it for most of the way, and was hardly doubted."""
    recording = record(CORRIDOR, along(OUT_AND_BACK, speed_m_s=0.8), SHORT, 0.003, carried=floor)
    result = with_right_wheels(recording)
    off_m = np.hypot(*(result.trajectory.xyyaw - recording.map_T_laser.xyyaw)[:, :2].T)
    assert off_m.max() < 0.2
    assert "moves along with the vehicle, as the floor does" in result.warnings[0]


@pytest.mark.parametrize("periods_s", [1.7, 12.0], ids=["soft suspension", "slow"])
def test_floor_at_a_distance_that_varies_does_not_hold_the_track(periods_s: float) -> None:
    """The pitch varies by 0.7 deg, and the distance by more than the vehicle drives in a second."""
    path, scans = along(OUT_AND_BACK, speed_m_s=0.8), []
    for k in range(len(path)):
        x_m = 4.0 + 0.8 * np.sin(2.0 * np.pi * 0.1 * k / periods_s)
        floor, here = polyline((x_m, -9.0), (x_m, 9.0)), Trajectory(path.stamps_ns[[k]], path.xyyaw[[k]])
        scans += record(CORRIDOR, here, SHORT, 0.003, seed=k, carried=floor).scans
    recording = Recording(scans, path)
    result = with_right_wheels(recording)
    off_m = np.hypot(*(result.trajectory.xyyaw - recording.map_T_laser.xyyaw)[:, :2].T)
    assert off_m.max() < 0.2
    assert "moves along with the vehicle, as the floor does" in result.warnings[0]


def test_floor_is_no_wall_that_the_map_lacks(tmp_path: Path) -> None:
    """It counted among the walls that the laser saw: 25 % of them could be measured, and the right map was suspect."""
    drive = record(CORRIDOR, along(OUT_AND_BACK[:2], speed_m_s=0.8), SHORT, 0.003, carried=FLOOR)
    write(Recorded(drive.scans, drive.map_T_laser, Trajectory.of([], [])), tmp_path / "pitched.mcap")
    request = ReplayRequest(tmp_path / "pitched.mcap", tmp_path / "run", Config())
    _, document = replay_log(request, lambda *_: None, 0.0)
    assert document["verdict"]["word"] == "good"
    kept = list(open_log(tmp_path / "run" / "result.mcap").scans())
    assert len(kept) == len(drive.scans)
    assert all((scan.points()[:, 0] < 3.7).all() for scan in kept)


def test_calibration_leaves_the_floor_out(tmp_path: Path) -> None:
    """Its track has no odometry: it stood still, and nothing was determined."""
    drive = record(CORRIDOR, along(OUT_AND_BACK, speed_m_s=0.8), SHORT, 0.003, carried=FLOOR)
    write(Recorded(drive.scans, drive.map_T_laser, Trajectory.of([], [])), tmp_path / "pitched.mcap")
    document = api.calibrate(tmp_path / "pitched.mcap")
    scale = next(row for row in document["quantities"] if row["name"] == "distance_scale")
    assert scale["agrees"], scale
    assert [line for line in document["warnings"] if "as the floor does" in line]


@pytest.mark.parametrize("carried", [NOTHING, box(0.5, 0.0, 0.1, 0.2)], ids=["nothing", "a post"])
def test_walls_and_posts_are_no_floor(carried: Segments) -> None:
    """Beams that see past what stays ahead do not meet the floor there."""
    recording = record(CORRIDOR, along(OUT_AND_BACK[:2], speed_m_s=0.8), SHORT, 0.003, carried=carried)
    assert not any("as the floor" in line for line in with_right_wheels(recording).warnings)


HALL = np.vstack((polyline((0, 0), (20, 0), (20, 12), (0, 12), closed=True), box(5, 1, 1, 1), box(9, 11, 1, 1)))
FAR = replace(SHORT, range_max_m=25.0)


def test_odometry_that_counts_too_far_shows_no_floor() -> None:
    """The wall ahead comes nearer by less than half of what it counts."""
    recording = record(HALL, along([(2.0, 5.0), (7.0, 5.2)], speed_m_s=0.2), FAR, 0.01)
    too_far = Trajectory(recording.map_T_laser.stamps_ns, recording.map_T_laser.xyyaw * (2.2, 2.2, 1.0))
    result = run_slam(lambda: recording.scans, Config(), 0.1, too_far)
    assert result.odometry is not None
    assert not any("as the floor" in line for line in result.warnings)


def test_walls_of_a_laser_that_looks_back_unknown_to_the_odometry_are_no_floor() -> None:
    """Walls behind recede as those ahead should come nearer."""
    path = along([(3.0, 5.0), (16.0, 5.2)], speed_m_s=0.8)
    turned = path.compose(Pose(0.0, 0.0, np.pi))
    result = run_slam(lambda: record(HALL, turned, FAR, 0.01).scans, Config(), 0.1, path)
    assert not any("as the floor" in line for line in result.warnings)


def test_wall_ahead_of_sideways_motion_is_no_floor() -> None:
    """A vehicle that drives faster to and from it than along it moves ahead on the whole."""
    x_m = np.concatenate((np.zeros(120), 0.1 * np.arange(40), 0.1 * np.arange(40, 0, -1)))
    y_m = np.append(0.03 * np.arange(120), np.full(80, 3.6))
    there = np.column_stack((12.0 + x_m, 3.0 + y_m, np.zeros(200)))
    xyyaw = np.vstack((there, there * (1, -1, 1) + (0, 9.6, 0)))
    stamps_ns = 1_700_000_000_000_000_000 + 100_000_000 * np.arange(len(xyyaw))
    recording = record(HALL, Trajectory(stamps_ns, xyyaw), FAR, 0.005)
    assert not any("as the floor" in line for line in with_right_wheels(recording).warnings)


def test_few_beams_that_meet_both_walls_of_an_aisle_see_no_floor() -> None:
    """Of beams 4 deg apart, those beside the one straight ahead see as far at any place."""
    aisle = np.vstack((polyline((0, -0.75), (60, -0.75), (60, 0.75), (0, 0.75), closed=True), box(9, 0.75, 0.9, 0.2)))
    sparse = LaserSpec(-180 * DEG, 4 * DEG, 90, 0.05, 12.0, 0.0, 0.1)
    recording = record(aisle, along([(3.0, 0.0), (30.0, 0.0)], speed_m_s=0.8), sparse, 0.005)
    assert not any("as the floor" in line for line in with_right_wheels(recording).warnings)


@pytest.mark.parametrize("speed_m_s", [0.8, 0.25], ids=["fast", "slow"])
def test_round_wall_is_no_floor(speed_m_s: float) -> None:
    """Along a circle the wall of a round room stays at its distance ahead; a slow vehicle hardly turns in a second."""
    angles_rad = np.arange(0, 361, 3) * DEG
    wall, path = (list(zip(r * np.cos(angles_rad), r * np.sin(angles_rad), strict=True)) for r in (5.0, 3.4))
    room = np.vstack((polyline(*wall), box(0.0, 0.0, 0.6, 0.6), box(1.0, 4.8, 0.5, 0.4)))
    recording = record(room, along(path[:80], speed_m_s=speed_m_s), SHORT, 0.003)
    assert not any("as the floor" in line for line in with_right_wheels(recording).warnings)


def test_odometry_of_a_laser_at_rest_shows_no_floor() -> None:
    """Wheels on a stand drive on, and the wall ahead stays: it was left out, though that odometry is not used."""
    path = along([(4.0, 0.0), (12.0, 0.05)], speed_m_s=0.8)
    at_rest = Trajectory(path.stamps_ns, np.repeat(path.xyyaw[:1], len(path), axis=0))
    recording = record(CORRIDOR, at_rest, SHORT, 0.003, carried=polyline((6.0, -9.0), (6.0, 9.0)))
    result = run_slam(lambda: recording.scans, Config(), 0.1, path)
    assert result.odometry is None
    assert not any("as the floor" in line for line in result.warnings)


def test_floor_is_left_out_of_scans_as_recorded_too() -> None:
    recording = record(CORRIDOR, along(OUT_AND_BACK[:2], speed_m_s=0.8), SHORT, 0.003, carried=FLOOR)
    begin = Track(list, Config(), Motion(0.1), make_method(Config())).with_findings(floor_m=(3.0, 0.0))
    track = as_recorded(lambda: recording.scans).change(begin)
    assert track is not None
    assert all((scan.points()[:, 0] < 3.0).all() for scan in track.log_scans())
