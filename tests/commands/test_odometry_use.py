"""How the odometry of a log was used stands in run.json and on the screen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from mavnav.cli import run
from support.field_logs import drive_log
from support.log_files import ODOM, write_mcap
from support.marks import slow

LOG = Path(__file__).parents[2] / "sample_logs" / "complex.bag"


def replayed(directory: Path, *more: str) -> dict[str, Any]:
    assert run(["replay", str(LOG), "-o", str(directory), "--end", "6", "-q", "--outputs", "trajectory", *more]) == 0
    return json.loads((directory / "run.json").read_text())["tracking"]


def test_odometry_that_fits_is_used_as_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    used = replayed(tmp_path / "a")["odometry"]
    assert used["used"]
    assert (used["offset_s"], used["distance_scale"], used["turn_scale"], used["left_out"]) == (0.0, 1.0, 1.0, [])
    assert 0.0 < used["noise"]["m_per_m"] < 0.2
    assert "odometry /odom as recorded, off the track by" in capsys.readouterr().out


@pytest.mark.slow
def test_what_corrects_odometry_is_stated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = replayed(tmp_path / "a", "--set", "odometry.distance_scale=100")["odometry"]
    assert wrong["used"]
    assert wrong["distance_scale"] == pytest.approx(1.0, rel=0.05)  # of what was recorded
    given = replayed(tmp_path / "b", "--set", "odometry.distance_scale=1.05")["odometry"]
    assert given["distance_scale"] == pytest.approx(1.05, rel=0.05)
    assert "odometry" in capsys.readouterr().out


def test_without_odometry_there_is_nothing_to_state(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "odometry" not in replayed(tmp_path / "a", "--odom", "off")
    assert "odometry switched off" in capsys.readouterr().out


@pytest.mark.slow
def test_the_odometry_of_a_mission_is_its_commands(tmp_path: Path) -> None:
    assert run(["simulate", "corner", "-o", str(tmp_path / "a"), "-q"]) == 0
    used = json.loads((tmp_path / "a" / "run.json").read_text())["tracking"]["odometry"]
    assert used["used"]
    assert used["noise"] == {"m_per_m": None, "rad_per_rad": None}


@pytest.mark.parametrize("off_s", [-40.0, slow(20.0)])
def test_odometry_of_another_clock_is_used_and_its_offset_stated(off_s: float, tmp_path: Path) -> None:
    off_ns = round(off_s * 1e9)
    messages = [
        replace(m, stamp_ns=m.stamp_ns + off_ns, log_ns=m.stamp_ns) if m.type == ODOM else m
        for m in drive_log(8.0, beams=120, odometry=True)
    ]
    log = write_mcap(tmp_path / "log.mcap", sorted(messages, key=lambda m: m.time_ns))
    words = ["replay", str(log), "-q", "--outputs", "trajectory"]
    assert run([*words, "-o", str(tmp_path / "a")]) == 0
    assert run([*words, "-o", str(tmp_path / "b"), "--set", f"odometry.offset_s={-off_s}"]) == 0
    for name in "ab":
        used = json.loads((tmp_path / name / "run.json").read_text())["tracking"]["odometry"]
        assert used["used"]
        assert used["offset_s"] == pytest.approx(-off_s, abs=0.06)
