"""Advice is tried: what a verdict or a warning of a track advises is done, and the track is better for it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from shlex import split
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.cli import run
from mavnav.scan import Attitude
from support.field_logs import START_S, drive_log, tour, wheels
from support.log_files import IMU, LASER, ODOM, TF, Message, write_mcap
from support.synthetic import along, corridor_with_rooms, room
from support.tilted import quaternion

pytestmark = pytest.mark.slow


def replayed(log: Path, directory: Path, *more: str) -> tuple[int, dict[str, Any]]:
    """Return the exit code of a replay and its run.json."""
    code = run(["replay", str(log), "-o", str(directory), "-q", "--outputs", "trajectory,metrics", *more])
    return code, json.loads((directory / "run.json").read_text())


def options_in(text: str) -> list[str]:
    """Return the options of a line of advice."""
    return [word for option in re.findall(r"--[a-z]+ [^;,() ]+", text) for word in split(option)]


def blinded(messages: list[Message], first_s: float, last_s: float) -> list[Message]:
    """Return messages whose scans see random ranges in a window, as of a laser that is carried."""
    rng, start_ns = np.random.default_rng(1), messages[0].stamp_ns
    return [
        replace(m, fields=m.fields | {"ranges": rng.uniform(0.3, 5.0, len(m.fields["ranges"]))})
        if m.type == LASER and first_s <= (m.stamp_ns - start_ns) * 1e-9 < last_s
        else m
        for m in messages
    ]


def test_a_clock_that_was_set_back_is_explained_by_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    messages = sorted(drive_log(6.0, beams=180, odometry=True), key=lambda m: m.time_ns)
    half = len(messages) // 2
    back = [replace(m, stamp_ns=m.stamp_ns - 2 * 10**9) for m in messages[half:]]
    log = write_mcap(tmp_path / "log.mcap", messages[:half] + back)
    _, document = replayed(log, tmp_path / "a")
    assert document["verdict"]["word"] == "suspect"
    assert document["verdict"]["advice"].startswith("see whether its stamps ascend with mavnav info")
    capsys.readouterr()
    assert run(["info", str(log)]) == 0
    assert "check the clock of the driver: it jumps" in capsys.readouterr().out


def test_what_has_poses_of_a_lost_log_is_mapped_alone(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", blinded(drive_log(8.0, beams=120), 4.0, 99.0))
    code, document = replayed(log, tmp_path / "a")
    assert (code, document["verdict"]["word"]) == (5, "lost")
    assert document["verdict"]["advice"].startswith("map what has poses alone, with --start")
    code, document = replayed(log, tmp_path / "b", *options_in(document["verdict"]["advice"]))
    assert (code, document["verdict"]["word"]) == (0, "good")


def test_a_blind_log_is_explained_and_drawn_as_the_error_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_mcap(tmp_path / "log.mcap", blinded(drive_log(2.0, beams=120), 0.0, 99.0))
    code, document = replayed(log, tmp_path / "a")
    assert code == 5
    assert "look at the sensor with mavnav info; record odometry" in document["verdict"]["advice"]
    assert "map.png of a run with --outputs pictures" in capsys.readouterr().err
    assert run(["info", str(log)]) == 0
    assert run(["replay", str(log), "-o", str(tmp_path / "b"), "-q", "--outputs", "pictures"]) == 5
    assert (tmp_path / "b/map.png").exists()


def carried(first_s: float, then_s: float) -> list[Message]:
    """Return a drive after which the laser is carried into another building, where it drives on."""
    here = drive_log(first_s, beams=120)
    start_ns = here[-1].stamp_ns + 10**9
    path = along([(1.0, 1.0), (1.0 + 0.8 * then_s, 1.0)], 0.02, 0.8, 1.0, start_ns)
    return [*here, *drive_log(path=path, walls=corridor_with_rooms(), beams=120)]


def test_parts_that_are_left_out_are_replayed_alone(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", carried(8.0, 6.2))
    code, document = replayed(log, tmp_path / "a")
    (warning,) = document["warnings"]
    assert (code, "are left out; replay them alone with --start" in warning) == (5, True)
    advice = "replay the parts that are left out alone with --start and --end"
    assert document["verdict"]["advice"].startswith(advice)
    code, document = replayed(log, tmp_path / "b", *options_in(warning))
    assert (code, document["verdict"]["word"]) == (0, "good")


def test_the_parts_of_a_run_with_a_start_are_those_of_the_log(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", carried(8.0, 6.2))
    _, document = replayed(log, tmp_path / "a", "--start", "0.95")
    part = next(part for part in document["tracking"]["parts"] if not part["joined"])
    first_s = document["input"]["first_stamp_s"]
    assert document["input"]["start_s"] == pytest.approx(first_s - START_S)
    advice = options_in(document["warnings"][0])
    _, alone = replayed(log, tmp_path / "b", *advice)
    assert alone["scans"]["processed"] == part["scans"]
    assert alone["input"]["first_stamp_s"] == pytest.approx(first_s + part["from_s"])


def test_odometry_that_was_left_out_is_used_as_advised(tmp_path: Path) -> None:
    """Along bare walls, whose ends are out of range, nothing else tells the way."""
    walls = np.array([(0.0, 0.0, 60.0, 0.0), (0.0, 2.0, 60.0, 2.0)])
    path = along([(20.0, 1.0), (30.0, 1.0)], 0.02, 0.8, 1.0, START_S * 10**9)
    log = write_mcap(tmp_path / "log.mcap", drive_log(path=path, walls=walls, beams=720, odometry=True))
    _, document = replayed(log, tmp_path / "a", "--odom", "off")
    assert document["verdict"]["advice"].startswith("use --odom auto if the log has odometry")
    _, document = replayed(log, tmp_path / "b", "--odom", "auto")
    assert document["verdict"]["word"] == "good"
    assert document["tracking"]["path_length_m"] == pytest.approx(9.8, abs=0.1)


def test_the_stretch_that_odometry_covers_is_replayed_alone(tmp_path: Path) -> None:
    path = tour(8.0)
    messages = [
        m
        for m in drive_log(path=path, beams=120, odometry=True)
        if m.type == LASER or m.stamp_ns < (START_S + 4) * 10**9
    ]
    log = write_mcap(tmp_path / "log.mcap", messages)
    _, document = replayed(log, tmp_path / "a")
    assert [text for text in document["warnings"] if "or cut the log with --start and --end" in text]
    _, document = replayed(log, tmp_path / "b", "--end", "3.9")
    assert (document["tracking"]["odometry"]["used"], document["warnings"]) == (True, [])


def test_odometry_that_jumps_is_used_between_its_jumps(tmp_path: Path) -> None:
    """For 0.9 s of every 3 it is 30 m away, as of a receiver between high walls. Without it, its use is advised."""
    messages = [
        replace(m, fields=m.fields | {"x": m.fields["x"] + 30.0})
        if m.type == ODOM and (m.stamp_ns - START_S * 10**9) % (3 * 10**9) > 2.1e9
        else m
        for m in drive_log(8.0, beams=120, odometry=True)
    ]
    log = write_mcap(tmp_path / "log.mcap", messages)
    _, document = replayed(log, tmp_path / "a")
    (advice,) = [text for text in document["warnings"] if text.startswith("odometry is used for ")]
    assert advice.endswith("the others are matched without it: see what publishes it")
    assert not [text for text in document["warnings"] if "record" in text or "--odom" in text]


def test_odometry_of_something_else_is_compared_by_calibrate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = drive_log(18.0, beams=90)
    other = wheels(
        along(
            [(0.0, 0.0), (4.0, 0.0), (4.0, -3.0), (0.0, -3.0), (0.0, 0.0), (4.0, 0.0)], 0.02, 0.6, 0.7, START_S * 10**9
        )
    )
    log = write_mcap(tmp_path / "log.mcap", sorted([*messages, *other], key=lambda m: m.time_ns))
    _, document = replayed(log, tmp_path / "a")
    assert [text for text in document["warnings"] if "'mavnav calibrate' compares them" in text]
    capsys.readouterr()
    assert run(["calibrate", str(log), "-q"]) == 1
    assert "odometry and laser turn differently" in capsys.readouterr().err


def test_spoilt_scans_are_explained_by_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every third scan is cut to a few beams."""
    messages = drive_log(6.0, beams=120)
    rng = np.random.default_rng(2)
    spoilt = [
        replace(m, fields=m.fields | {"ranges": np.where(rng.random(120) < 0.1, m.fields["ranges"], np.inf)})
        if k % 3 == 1
        else m
        for k, m in enumerate(messages)
    ]
    log = write_mcap(tmp_path / "log.mcap", spoilt)
    _, document = replayed(log, tmp_path / "a")
    assert [text for text in document["warnings"] if "See them with 'mavnav info'" in text]
    assert run(["info", str(log)]) == 0
    assert "less than half of the valid beams of their neighbors in 20 scans" in capsys.readouterr().out


def test_too_few_beams_are_told_by_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    messages = drive_log(3.0, beams=120)
    rng = np.random.default_rng(2)
    blind = [
        replace(m, fields=m.fields | {"ranges": np.where(rng.random(120) < 0.03, m.fields["ranges"], np.inf)})
        for m in messages
    ]
    log = write_mcap(tmp_path / "log.mcap", blind)
    _, document = replayed(log, tmp_path / "a")
    assert "look at the ranges with mavnav info, and at near_mm and far_mm" in document["verdict"]["advice"]
    assert run(["info", str(log)]) == 0
    assert "3 % of the beams are valid, 3 a scan in the median: clean the window" in capsys.readouterr().out


def test_a_map_too_large_fits_in_larger_cells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = along([(20.0, 10.0), (21.0, 10.0)], 0.02, 0.8, 1.0, START_S * 10**9)
    walls = room(40.0, 20.0)
    log = write_mcap(tmp_path / "log.mcap", drive_log(path=path, walls=walls, beams=360, range_max_m=30.0))
    directory = str(tmp_path / "run")
    assert run(["replay", str(log), "-o", directory, "-q", "--set", "robust.cell_mm=1"]) == 2
    assert (
        "or the cells are too small; see the ranges with 'mavnav info', or --set ...cell_mm" in capsys.readouterr().err
    )
    assert replayed(log, tmp_path / "run", "--set", "robust.cell_mm=40")[0] == 0


def test_a_tilt_that_is_not_used_is_used_by_name(tmp_path: Path) -> None:
    """A sensor takes its acceleration for a tilt of a level laser."""
    scans = drive_log(6.0, beams=120)
    place = {"parent": "laser", "child": "imu", "x": 0.0, "y": 0.0, "yaw": 0.0}
    turns = [quaternion(Attitude(0.35 * np.sin(0.05 * k), 0.0, 0.0)) for k in range(10 * len(scans))]
    tilts = [
        Message(
            "/imu", IMU, scans[0].stamp_ns + k * 10**7, {"rates": (0.0, 0.0, 0.0), "xyzw": tuple(q[n] for n in "xyzw")}
        )
        for k, q in enumerate(turns)
    ]
    messages = [Message("/tf_static", TF, scans[0].stamp_ns, place), *sorted([*scans, *tilts], key=lambda m: m.time_ns)]
    log = write_mcap(tmp_path / "log.mcap", messages)
    advice = "--attitude TOPIC uses a topic whatever the walls say"
    warned = [
        any(advice in text for text in replayed(log, tmp_path / name, *more)[1]["warnings"])
        for name, more in (("a", []), ("b", ["--attitude", "/imu"]))
    ]
    assert warned == [True, False]
    assert json.loads((tmp_path / "b/run.json").read_text())["input"]["attitude"]["topic"] == "/imu"
