"""The robot's own parts in the view of the laser: named and left out, and nothing else is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavnav.config.loading import load_config
from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.logs.false_returns import MOST_SCANS, ScanSample, own_beams, spread_over, without_beams
from mavnav.logs.health import sensor_health
from mavnav.logs.writing.recorder import Recording
from mavnav.logs.writing.recorder import record as write
from mavnav.pipelines.replay import ReplayRequest, replay_log
from mavnav.pose import Pose, Trajectory
from mavnav.slam.pipeline import run_slam
from support.synthetic import DEG, LDS_01, NOTHING, TOUR, Segments, along, box, furnished_rooms, record, room, scan_at

POSTS = np.vstack([box(0.25 * np.cos(a), 0.25 * np.sin(a), 0.08, 0.08) for a in (0.7, 2.2, -2.2, -0.7)])


def sample_of(walls: Segments, path: Trajectory, carried: Segments = POSTS) -> ScanSample:
    """Return the sample of the scans along a path."""
    sample = ScanSample()
    for scan in record(walls, path, LDS_01, noise=0.01, carried=carried).scans:
        sample.add(scan.ranges_m)
    return sample


def test_that_beams_on_posts_of_the_robot_are_its_own() -> None:
    sample = sample_of(furnished_rooms(), along(TOUR))
    own = own_beams(sample)
    on_posts = np.isfinite(scan_at(POSTS, Pose(), LDS_01).ranges_m)
    assert own is not None
    assert own[on_posts].all()
    assert own.sum() <= on_posts.sum() + 2 * 4 * round(0.01 * LDS_01.beams)  # edges on both sides of four posts


def test_that_a_robot_without_posts_has_no_own_beams() -> None:
    assert own_beams(sample_of(furnished_rooms(), along(TOUR), NOTHING)) is None


def test_that_things_near_a_laser_at_rest_are_not_its_own() -> None:
    at = along(TOUR)
    rest = Trajectory(at.stamps_ns, np.tile(at.xyyaw[:1], (len(at), 1)))
    assert own_beams(sample_of(furnished_rooms(), rest)) is None


def test_that_a_wall_beside_the_path_is_no_part_of_the_robot() -> None:
    hall = np.vstack((room(40.0, 20.0), box(10.0, 3.0, 1.0, 1.0), box(25.0, 2.5, 1.0, 1.0), box(33.0, 3.0, 2.0, 1.0)))
    assert own_beams(sample_of(hall, along([(2.0, 0.4), (38.0, 0.4)]), NOTHING)) is None


def test_that_a_sample_is_spread_over_all_scans_and_bounded() -> None:
    sample = ScanSample()
    for k in range(10_000):
        sample.add(np.array([float(k)]))
    taken = np.concatenate(sample.ranges_m)
    assert MOST_SCANS // 2 <= len(taken) <= MOST_SCANS
    assert np.unique(np.diff(taken)).tolist() == [sample.step]
    assert taken[-1] >= 10_000 - 2 * sample.step


def test_that_scans_of_other_numbers_of_beams_count_by_their_angles() -> None:
    sample = sample_of(furnished_rooms(), along(TOUR))
    own = own_beams(sample)
    sample.ranges_m[::3] = [spread_over(each, 355) for each in sample.ranges_m[::3]]
    other = own_beams(sample)
    assert own is not None
    assert other is not None
    assert np.mean(own == other) > 0.98
    assert np.isnan(without_beams(np.ones(355), own)).sum() == pytest.approx(own.sum() * 355 / 360, abs=4)


def test_that_a_long_rest_at_a_dock_makes_nothing_there_its_own() -> None:
    rest, drive = along(TOUR), Trajectory(along(TOUR).stamps_ns[:26], along(TOUR).xyyaw[:26])
    dock = np.vstack((furnished_rooms(), box(1.2, 0.7, 0.1, 0.5)))
    still = record(dock, Trajectory(rest.stamps_ns, np.tile(rest.xyyaw[:1], (len(rest), 1))), LDS_01).scans
    rng, sample, passing = np.random.default_rng(0), ScanSample(), np.arange(360) % 2 == 0
    passing[np.isfinite(scan_at(box(0.4, 0.0, 0.1, 0.5), Pose(), LDS_01).ranges_m)] = False
    for scan in still:
        sample.add(np.where(passing, scan.ranges_m * rng.uniform(0.4, 1.0, 360), scan.ranges_m))
    assert own_beams(sample) is not None
    for scan in record(dock, drive, LDS_01).scans:
        sample.add(scan.ranges_m)
    assert own_beams(sample) is None


def test_that_nothing_is_left_out_where_hardly_anything_else_is_seen() -> None:
    own = np.zeros(360, np.bool_)
    own[80:120] = True
    rng, sample = np.random.default_rng(0), ScanSample()
    for _ in range(40):
        sample.add(np.where(own, 0.5, np.where(np.arange(360) < 15, rng.uniform(1.0, 3.0, 360), np.nan)))
    assert own_beams(sample) is None
    for k, ranges_m in enumerate(sample.ranges_m):
        sample.ranges_m[k] = np.where(own, 0.5, np.where(np.arange(360) < 30, rng.uniform(1.0, 3.0, 360), ranges_m))
    assert own_beams(sample) is not None


def test_that_a_log_leaves_own_beams_out_and_is_tracked(tmp_path: Path) -> None:
    drive = record(furnished_rooms(), along(TOUR), LDS_01, noise=0.01, carried=POSTS)
    write(Recording(drive.scans, Trajectory.of([], []), Trajectory.of([], [])), tmp_path / "posts.mcap")
    log = open_log(tmp_path / "posts.mcap")
    assert log.own_beams is not None
    assert [text for text in log.warnings if f"{log.own_beams.sum()} of 360 beams" in text]
    assert sensor_health(log).dead_sectors_deg == []
    assert all(np.isnan(scan.ranges_m[log.own_beams]).all() for scan in log.scans())
    slam = run_slam(log.scans, Config(), log.period_s)
    truth = drive.map_T_laser
    off_m = np.hypot(*(slam.trajectory.xyyaw[:, :2] - truth.xyyaw[-len(slam.trajectory) :, :2]).T)
    assert len(slam.trajectory) == len(truth)
    assert off_m.max() < 0.1


def test_that_the_warning_names_the_sectors(tmp_path: Path) -> None:
    drive = record(furnished_rooms(), along(TOUR), LDS_01, noise=0.01, carried=POSTS[:4])
    write(Recording(drive.scans, Trajectory.of([], []), Trajectory.of([], [])), tmp_path / "post.mcap")
    (text,) = (text for text in open_log(tmp_path / "post.mcap").warnings if "own parts" in text)
    first, last = (float(word) for word in text.split("(at ")[1].split(" deg")[0].split(" to "))
    assert first < 0.7 / DEG < last
    assert last - first < 35.0


def test_that_a_robot_that_sees_nothing_in_most_scans_is_lost(tmp_path: Path) -> None:
    walls = np.vstack((furnished_rooms(), box(3.0, -0.6, 0.3, 0.3), box(1.0, -0.8, 0.4, 0.2)))
    path = along([(1.0, -1.5), (4.0, -1.2), (16.0, -9.0)])
    drive = record(walls, path, LDS_01, noise=0.01, carried=POSTS)
    write(Recording(drive.scans, Trajectory.of([], []), Trajectory.of([], [])), tmp_path / "away.mcap")
    config = load_config(None, ["robust.near_mm=400"])  # the posts are too near to be used
    _, document = replay_log(ReplayRequest(tmp_path / "away.mcap", tmp_path / "run", config), lambda *_: None, 0.0)
    assert document["verdict"]["word"] == "lost"
    assert document["exit_code"] == 5
