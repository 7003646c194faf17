"""What a log changes of the configuration that it is replayed with: how fast its vehicle may move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavnav.config.loading import load_config
from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.logs.writing.recorder import Recording, record
from mavnav.pipelines.maps import config_for_log
from mavnav.pipelines.replay import ReplayRequest, replay_log
from mavnav.pose import Trajectory
from mavnav.scan import LaserSpec
from support.synthetic import along, box, drifting_odometry, room
from support.synthetic import record as drive


def log_of(folder: Path, speed_m_s: float, walls: np.ndarray, unit: float = 1.0) -> Path:
    """Write a drive along a hall at a speed, with odometry that counts in a unit."""
    path = along([(3.0, 3.0), (36.0, 3.2), (36.0, 8.0)], 0.05, speed_m_s, 2.0)
    made = drive(walls, path, LONG_RANGE, noise=0.002)
    odometry = drifting_odometry(path, length_share=0.0, turn_share=0.0)
    odometry = Trajectory(odometry.stamps_ns, odometry.xyyaw * (unit, unit, 1.0))
    record(Recording(made.scans, odometry, Trajectory.of([], [])), folder / "fast.mcap")
    return folder / "fast.mcap"


LONG_RANGE = LaserSpec(-2.356, 4.712 / 540, 541, 0.1, 30.0)
"""270 deg, 30 m, all beams at once."""

HALL = np.vstack((room(40.0, 12.0), *(box(x, y, 0.5, 0.5) for x in (8.0, 15.0, 23.0, 31.0) for y in (5.0, 9.5))))


def test_that_a_fast_vehicle_is_tracked_and_its_limit_named(tmp_path: Path) -> None:
    path = log_of(tmp_path, 4.0, HALL)
    config, warnings = config_for_log(Config(), open_log(path))
    assert config.robust.max_speed_m_s == pytest.approx(6.0, abs=0.1)
    assert [text for text in warnings if "set robust.max_speed_m_s" in text]
    run, document = replay_log(
        ReplayRequest(path, tmp_path / "run", Config(), outputs=("trajectory",)), lambda *_: None, 0.0
    )
    assert run.slam.tracked_share > 0.98
    assert document["tracking"]["odometry"]["distance_scale"] == pytest.approx(1.0, abs=0.02)
    assert "max_speed_m_s" not in document["verdict"]["advice"]
    length_m = along([(3.0, 3.0), (36.0, 3.2), (36.0, 8.0)], 0.05, 4.0, 2.0).length_m
    assert document["tracking"]["path_length_m"] == pytest.approx(length_m, rel=0.02)


@pytest.mark.parametrize(("speed_m_s", "unit"), [(1.0, 1.0), (1.0, 100.0)], ids=["slow", "centimeters"])
def test_that_the_usual_limit_stays_for_others(speed_m_s: float, unit: float, tmp_path: Path) -> None:
    assert config_for_log(Config(), open_log(log_of(tmp_path, speed_m_s, HALL, unit))) == (Config(), ())


def test_that_a_limit_that_is_set_stays(tmp_path: Path) -> None:
    config = load_config(None, ["robust.max_speed_m_s=2"])
    assert config_for_log(config, open_log(log_of(tmp_path, 4.0, HALL))) == (config, ())
