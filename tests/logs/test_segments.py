"""Segments of a turn are joined to the sweeps that they are parts of; what is none is not touched."""

from __future__ import annotations

from math import tau
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.cli import run
from mavnav.logs import Log, open_log
from support.field_logs import drive_log, segments, with_fields
from support.log_files import LASER, Message, laser, write_mcap


@pytest.fixture(scope="module")
def sweeps() -> list[Message]:
    return drive_log(3.0, beams=120)


def ranges_of(log: Log) -> np.ndarray:
    return np.array([scan.ranges_m for scan in log.scans()])


@pytest.mark.parametrize("parts", [2, 3, 5, 12, 40])
@pytest.mark.parametrize("clockwise", [False, True])
def test_segments_become_the_sweeps_that_they_are_of(
    parts: int, clockwise: bool, sweeps: list[Message], tmp_path: Path
) -> None:
    whole = [m for m in sweeps if m.type == LASER]
    if clockwise:
        whole = with_fields(whole, angle_min=np.pi, angle_increment=-tau / 120)
    log = open_log(write_mcap(tmp_path / "a", segments(whole, parts)))
    original = open_log(write_mcap(tmp_path / "b", whole))
    assert (len(log), log.counts.total, log.sensor.beams) == (len(whole), len(whole), 120)
    assert np.array_equal(ranges_of(log), ranges_of(original), equal_nan=True)
    assert np.array_equal(log.stamps_ns, original.stamps_ns)
    assert log.sensor.sweep_s == pytest.approx(0.1, rel=1e-3)
    assert any("which are joined to sweeps" in text for text in log.warnings)
    again = np.array([ranges_m for _, ranges_m in log._reread()])
    assert np.array_equal(again, ranges_of(log), equal_nan=True)


@pytest.mark.parametrize(("parts", "overlap"), [(12, 1), (12, 5), (6, 8), (3, 20)])
@pytest.mark.parametrize("stated", [True, False], ids=["increment", "none"])
def test_segments_that_repeat_beams_of_the_one_before_are_joined(
    parts: int, overlap: int, stated: bool, sweeps: list[Message], tmp_path: Path
) -> None:
    cut = segments(sweeps, parts, overlap)
    log = open_log(write_mcap(tmp_path / "a", cut if stated else with_fields(cut, time_increment=0.0)))
    original = open_log(write_mcap(tmp_path / "b", sweeps))
    assert np.array_equal(ranges_of(log), ranges_of(original), equal_nan=True)
    assert log.sensor.sweep_s == pytest.approx(0.1, rel=1e-3)
    assert not any("missing" in text for text in log.warnings)


def test_lost_segments_are_beams_without_a_return(sweeps: list[Message], tmp_path: Path) -> None:
    cut = segments(sweeps, 12)
    lost = {30, 31, 64, 100, 101, 102}
    log = open_log(write_mcap(tmp_path / "a", [m for k, m in enumerate(cut) if k not in lost]))
    original = open_log(write_mcap(tmp_path / "b", sweeps))
    expected = ranges_of(original)
    for k in lost:
        expected[k // 12, k % 12 * 10 : k % 12 * 10 + 10] = np.nan
    assert np.array_equal(ranges_of(log), expected, equal_nan=True)
    assert sum(f"segments are missing in 3 of {len(sweeps)} sweeps" in text for text in log.warnings) == 1
    assert not any("missing" in text for text in original.warnings)


def test_segments_of_less_than_a_turn_begin_behind_the_sector_that_is_not_covered(
    sweeps: list[Message], tmp_path: Path
) -> None:
    cut = [m for k, m in enumerate(segments(sweeps, 12)) if k % 12 < 9][4:]
    log = open_log(write_mcap(tmp_path / "a", cut))
    assert len(log) == len(sweeps)
    assert log.sensor.angle_min_rad == pytest.approx(-np.pi)
    assert not any("missing" in text for text in log.warnings)
    assert np.isfinite(ranges_of(log)[1:, :90]).all()
    assert np.isnan(ranges_of(log)[:, 90:]).all()


def test_segments_with_the_stamp_of_their_sweep_are_joined(sweeps: list[Message], tmp_path: Path) -> None:
    cut = [replace(m, stamp_ns=sweeps[k // 6].stamp_ns) for k, m in enumerate(segments(sweeps, 6))]
    log = open_log(write_mcap(tmp_path / "a", cut))
    assert np.array_equal(log.stamps_ns, [m.stamp_ns for m in sweeps])
    assert log.sensor.sweep_s == pytest.approx(0.1, rel=1e-3)


def test_segments_without_a_time_increment_are_timed_by_their_stamps(sweeps: list[Message], tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", with_fields(segments(sweeps, 6), time_increment=0.0)))
    assert log.sensor.sweep_s == pytest.approx(0.1, rel=1e-3)


def test_segments_that_do_not_follow_each_other_are_reported(sweeps: list[Message], tmp_path: Path) -> None:
    cut = [m for k, m in enumerate(segments(sweeps, 12)) if k % 5 == 0]
    log = open_log(write_mcap(tmp_path / "a", cut))
    assert any("segments that do not follow each other" in text for text in log.warnings)


@pytest.mark.parametrize(
    "damage",
    [
        {"angle_min": float("nan")},
        {"angle_min": 1e30},
        {"angle_increment": 0.0, "angle_max": 0.0},
        {"angle_increment": 1e-30, "angle_max": 0.0},
        {"time_increment": float("nan")},
        {"ranges": []},
    ],
    ids=lambda fields: "-".join(f"{name}={value}" for name, value in fields.items()),
)
@pytest.mark.parametrize("place", [0, 3, 40])
def test_a_damaged_segment_costs_itself_alone(
    damage: dict[str, object], place: int, sweeps: list[Message], tmp_path: Path
) -> None:
    cut = segments(sweeps, 12)
    cut[place] = replace(cut[place], fields=cut[place].fields | damage)
    log = open_log(write_mcap(tmp_path / "a", cut))
    whole = [scan for scan in log.scans() if scan.spec.beams == 120]
    assert len(sweeps) - 1 <= len(whole) <= len(sweeps) + 1
    returns = sum(int(np.isfinite(scan.ranges_m).sum()) for scan in whole)
    assert returns >= sum(len(m.fields["ranges"]) for m in segments(sweeps, 12)) - 10


@pytest.mark.parametrize(
    "scans",
    [
        [laser(k) for k in range(30)],
        [laser(k, angle_min=-np.pi / 2, angle_increment=np.pi / 180, beams=180) for k in range(30)],
        [laser(k, angle_min=0.0, angle_increment=tau / 64, beams=64) for k in range(30)],
        [laser(k, angle_min=0.0, angle_increment=tau / 64, beams=64) for k in range(3)],
        [laser(k, angle_min=float("nan")) if k == 3 else laser(k) for k in range(30)],
        [laser(k, angle_min=-1.0 + 1e-4 * k) for k in range(30)],
    ],
    ids=["narrow", "half a turn", "a turn", "few", "damaged", "wandering"],
)
def test_other_scans_stay_as_they_are(scans: list[Message], tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", scans))
    assert log.counts.total == len(scans)
    assert log.sensor.beams == len(scans[0].fields["ranges"])
    assert not any("joined" in text for text in log.warnings)


def test_a_log_of_segments_is_tracked(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", segments(drive_log(6.0, beams=120), 12))
    assert run(["replay", str(path), "-o", str(tmp_path / "run"), "-q", "--outputs", "trajectory"]) == 0
