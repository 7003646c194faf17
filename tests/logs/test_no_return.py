"""A value within the limits that a driver writes where nothing is in range: named and left out, and no wall is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.logs import log as logs_log
from mavnav.logs import open_log, topic_scans
from mavnav.logs.false_returns import LEAST_NONE_SCANS, ScanSample, no_return_m
from mavnav.logs.writing.recorder import Recording
from mavnav.logs.writing.recorder import record as write
from mavnav.pose import Trajectory
from support.synthetic import LDS_01, TOUR, along, furnished_rooms, record, room

PATH = along(TOUR)
AT_REST = Trajectory(PATH.stamps_ns, np.tile(PATH.xyyaw[:1], (len(PATH), 1)))


def seen(path: Trajectory = PATH, noise: float = 0.01, none_m: float = np.nan) -> list[NDArray[np.float64]]:
    """Return the ranges of scans of furnished rooms, with a value where nothing is in range."""
    scans = record(furnished_rooms(), path, LDS_01, noise=noise).scans
    return [np.where(np.isnan(scan.ranges_m), none_m, scan.ranges_m) for scan in scans]


def sample_of(ranges_m: list[NDArray[np.float64]]) -> ScanSample:
    sample = ScanSample()
    for each in ranges_m:
        sample.add(each)
    return sample


@pytest.mark.parametrize("none_m", [3.45, 0.13, 25.0])
@pytest.mark.parametrize("step_m", [1e-9, 0.01, 0.025])
def test_that_a_value_for_no_return_is_distinguished_from_walls(none_m: float, step_m: float) -> None:
    rounded = [np.round(each / step_m) * step_m for each in seen()]
    assert no_return_m(sample_of(rounded)) is None
    ranges_m = [np.where(np.isnan(each), none_m, each) for each in rounded]
    assert no_return_m(sample_of(ranges_m)) == none_m
    spurious = [np.where(np.random.default_rng(k).random(360) < 1e-3, 30.0, each) for k, each in enumerate(ranges_m)]
    assert no_return_m(sample_of(spurious)) == none_m


@pytest.mark.parametrize("noise", [0.0, 0.003])
@pytest.mark.parametrize("path", [PATH, AT_REST])
def test_that_walls_are_returns_also_in_centimeters_and_at_rest(path: Trajectory, noise: float) -> None:
    assert no_return_m(sample_of([np.round(each, 2) for each in seen(path, noise)])) is None
    hall = record(room(6.8, 6.8), AT_REST, LDS_01, noise=noise).scans
    assert no_return_m(sample_of([np.round(scan.ranges_m, 2) for scan in hall])) is None


@pytest.mark.parametrize("step_m", [0.05, 0.1])
def test_that_a_wall_beside_the_robot_is_one_also_where_ranges_are_rounded_coarsely(step_m: float) -> None:
    """At 1 m the next value of such a laser is 5 or 10 % off."""
    wall_m = 1.0 / np.cos(np.linspace(-1.4, 1.4, 361))
    noisy_m = [wall_m + 0.01 * np.random.default_rng(k).standard_normal(361) for k in range(30)]
    assert no_return_m(sample_of([np.round(ranges_m / step_m) * step_m for ranges_m in noisy_m])) is None


def test_that_a_round_room_is_a_wall_from_its_centre() -> None:
    assert no_return_m(sample_of([np.full(360, 3.0)] * 30)) is None
    assert no_return_m(sample_of([np.full(360, np.nan)])) is None
    assert no_return_m(ScanSample()) is None


@pytest.mark.parametrize("kept_bytes", [topic_scans.KEPT_BYTES, 0])
def test_that_a_log_leaves_the_value_out(kept_bytes: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topic_scans, "KEPT_BYTES", kept_bytes)
    monkeypatch.setattr(logs_log, "KEPT_BYTES", kept_bytes)
    scans = list(record(furnished_rooms(), PATH, LDS_01, noise=0.01).scans)
    ringed = [replace(scan, ranges_m=np.where(np.isnan(scan.ranges_m), 3.45, scan.ranges_m)) for scan in scans]
    write(Recording(ringed, Trajectory.of([], []), Trajectory.of([], [])), tmp_path / "ring.mcap")
    log = open_log(tmp_path / "ring.mcap")
    assert log.warnings == (
        "/scan: many ranges are exactly 3.45 m, and hardly any are near that: this value is taken for no return",
    )
    for read, scan in zip(log.scans(), scans, strict=True):
        np.testing.assert_array_equal(np.isnan(read.ranges_m), np.isnan(scan.ranges_m))


def test_that_a_few_scans_show_no_habit_of_a_driver() -> None:
    """One scan of 1, 2, 2 and 2 m lost three of its beams."""
    scan_m = np.array([1.0, 2.0, 2.0, 2.0])
    assert no_return_m(sample_of([scan_m] * (LEAST_NONE_SCANS - 1))) is None
    assert no_return_m(sample_of([scan_m] * LEAST_NONE_SCANS)) == 2.0
