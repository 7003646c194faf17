"""The time of a sweep that is missing, or that no laser has: found where the laser turns, kept where it is right."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.scan import LaserSpec
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from support.field_logs import START_S, drive_log, with_fields
from support.log_files import write_mcap
from support.marks import slow
from support.synthetic import URG_04LX, along

TURNING = along([(3.4, 0.8), (4.9, 0.8), (4.6, 2.9), (4.6, 1.2)], 0.02, 0.6, 2.0, START_S * 10**9)


def replayed(path: Path, config: Config | None = None) -> SlamResult:
    log = open_log(path)
    return run_slam(log.scans, config or Config(), log.period_s)


@pytest.mark.parametrize(
    ("factor", "scan_time"),
    [(0.0, 0.0), (1 / 3, 0.1), slow(1e-3, 1e-4), slow(2.0, 0.1)],
    ids=["none", "third", "1000th", "double"],
)
def test_a_wrong_time_of_the_sweep_is_corrected(factor: float, scan_time: float, tmp_path: Path) -> None:
    messages = drive_log(path=TURNING, beams=120)
    beam_s = messages[0].fields["time_increment"]
    path = write_mcap(tmp_path / "a", with_fields(messages, time_increment=factor * beam_s, scan_time=scan_time))
    found = replayed(path)
    assert [text for text in found.warnings if f"fit better with {beam_s:.3g} s (a turn in 0.100 s)" in text]
    assert [(attempt.name, attempt.kept) for attempt in found.attempts] == [("timed sweeps", True)]


@pytest.mark.parametrize("sweep_s", [0.0, 0.1], ids=["at once", "in a period"])
def test_a_right_time_of_the_sweep_is_kept(sweep_s: float, tmp_path: Path) -> None:
    found = replayed(write_mcap(tmp_path / "a", drive_log(path=TURNING, beams=120, sweep_s=sweep_s)))
    assert not found.attempts
    assert not [text for text in found.warnings if "time_increment" in text]


def test_that_a_sweep_seen_at_once_is_not_tracked_in_other_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavnav.slam.retries.sweep_time.cost_ratios", lambda *_: pytest.fail("it was tracked again"))
    replayed(write_mcap(tmp_path / "a", drive_log(path=TURNING, beams=120, sweep_s=0.0)))


@pytest.mark.parametrize(
    ("time_increment_s", "scan_time_s", "period_s", "plausible"),
    [
        (0.1 / 1024, 0.1, 0.1, True),
        (0.1 / 1024, 0.1, 0.2, True),  # every second scan was dropped
        (0.1 / 1024, 0.0, 0.2, False),
        (0.0, 0.1, 0.1, False),
        (-0.1 / 1024, 0.1, 0.1, True),
        (0.1 / 3072, 0.1, 0.1, False),
        (0.1 / 3072, 0.1 / 3, 0.1, False),
        (0.2 / 1024, 0.2, 0.1, False),
    ],
)
def test_the_turn_of_a_laser_takes_the_time_between_two_scans(
    time_increment_s: float, scan_time_s: float, period_s: float, plausible: bool
) -> None:
    spec = replace(URG_04LX, time_increment_s=time_increment_s, scan_time_s=scan_time_s)
    assert spec.has_plausible_sweep(period_s) == plausible


def test_a_sweep_is_timed_by_the_angle_between_its_beams() -> None:
    spec = LaserSpec(0.0, -0.1, 20, 0.1, 10.0)
    assert spec.turning_in(-0.2).time_increment_s == pytest.approx(-0.2 * 0.1 / 6.283185307)
    assert spec.turning_in(0.2).stated_turn_s == pytest.approx(0.2)
