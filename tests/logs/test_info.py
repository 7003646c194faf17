"""``mavnav info``: the table, the one JSON object, and the exit codes."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

import pytest

from mavnav.cli import run
from mavnav.logs import survey
from support.log_files import IMU, PERIOD_NS, START_NS, Message, drive, foxglove_json, laser, write_mcap

if TYPE_CHECKING:
    from pathlib import Path

Capture = pytest.CaptureFixture[str]


def told(capsys: Capture, *args: object) -> tuple[int, dict[str, Any], str]:
    code = run(["info", *map(str, args), "--json"])
    out, err = capsys.readouterr()
    return code, json.loads(out), err


def test_json_holds_the_fixed_fields(tmp_path: Path, capsys: Capture) -> None:
    path = write_mcap(tmp_path / "a", drive())
    code, document, err = told(capsys, path)
    assert (code, document["exit_code"], err) == (0, 0, "")
    assert document["schema_version"] == 1
    assert document["input"].keys() == {"path", "sha256", "format", "size_bytes"}
    assert document["input"]["size_bytes"] == path.stat().st_size
    assert [t["name"] for t in document["topics"]] == ["/odom", "/scan", "/tf_static"]
    assert document["topics"][1] == {
        "name": "/scan",
        "type": "sensor_msgs/msg/LaserScan",
        "encoding": "cdr",
        "count": 25,
    }
    assert document["scans"] == {"total": 25, "usable": 25, "skipped": {}, "suspect": 0}
    assert document["sensor"]["beams"] == 16
    assert document["time"]["rate_hz"] == pytest.approx(10.0)
    assert document["odometry"]["length_m"] == pytest.approx(2.4)
    assert document["mounting"] == {
        "source": "tf_static",
        "base_frame": "base_link",
        "x_m": 0.2,
        "y_m": 0.1,
        "yaw_rad": pytest.approx(0.5),
    }
    assert (document["damage"], document["warnings"]) == ([], [])


def test_an_inertial_sensor_has_its_rate(tmp_path: Path, capsys: Capture) -> None:
    turning = [Message("/imu", IMU, START_NS + k * PERIOD_NS // 2, {"rates": (0.0, 0.0, 0.5)}) for k in range(20)]
    path = write_mcap(tmp_path / "a", [*(laser(k) for k in range(10)), *turning])
    assert told(capsys, path)[1]["imu"] == {"topic": "/imu", "messages": 20, "rate_hz": pytest.approx(20.0)}
    run(["info", str(path)])
    assert "/imu, 20 messages, 20 Hz" in capsys.readouterr().out


def test_sha256_is_that_of_the_file(tmp_path: Path, capsys: Capture) -> None:
    path = write_mcap(tmp_path / "a", [laser(0)])
    assert told(capsys, path)[1]["input"]["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_damaged_log_exits_with_3_and_lists_the_damage(tmp_path: Path, capsys: Capture) -> None:
    path = write_mcap(tmp_path / "a", drive())
    path.write_bytes(path.read_bytes()[:-4])
    code, document, _ = told(capsys, path)
    assert (code, document["exit_code"]) == (3, 3)
    assert document["damage"][0].keys() == {"what", "where"}


def test_no_log_exits_with_4_and_still_prints_the_object(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "notes.mcap"
    path.write_text("hello")
    code, document, err = told(capsys, path)
    assert (code, document["exit_code"]) == (4, 4)
    assert document["input"]["format"] == "unknown"
    assert document["scans"] == {"total": 0, "usable": 0, "skipped": {}, "suspect": 0}
    assert err.count("\n") == 1
    assert "not an MCAP file" in err


def test_the_cause_of_a_refusal_is_printed_once(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "a.mcap").touch()
    assert run(["info", str(tmp_path / "a.mcap")]) == 4
    assert capsys.readouterr().err.count("the file is empty") == 1


def test_unusable_scans_exit_with_4_and_say_why(tmp_path: Path, capsys: Capture) -> None:
    code, document, _ = told(capsys, write_mcap(tmp_path / "a", [laser(k, ranges=[0.0, 0.0]) for k in range(3)]))
    assert code == 4
    assert document["scans"] == {"total": 3, "usable": 0, "skipped": {"no_valid_beam": 3}, "suspect": 0}


def test_the_report_is_not_folded_off_a_terminal(tmp_path: Path, capsys: Capture) -> None:
    topic = "/robot" + 20 * "/front"
    run(["info", str(write_mcap(tmp_path / "a", [laser(0, topic=topic)]))])
    lines = capsys.readouterr().out.splitlines()
    assert f"topics      {topic}  sensor_msgs/msg/LaserScan  cdr  1" in lines
    assert [line for line in lines if line != line.rstrip()] == []


def test_several_scan_topics_are_each_examined(tmp_path: Path, capsys: Capture) -> None:
    front = [laser(k, topic="/front") for k in range(3)]
    path = write_mcap(tmp_path / "a", [*front, laser(1, topic="/rear", ranges=[]), laser(2, topic="/rear")])
    code, document, _ = told(capsys, path)
    assert (code, document["exit_code"], document["topic"]) == (0, 0, None)
    assert document["scans"] == {"total": 5, "usable": 4, "skipped": {"empty": 1}, "suspect": 0}
    assert [(t["topic"], t["scans"]["usable"]) for t in document["scan_topics"]] == [("/front", 3), ("/rear", 1)]
    assert any("a replay needs --topic" in w for w in document["warnings"])
    rear = told(capsys, path, "--topic", "/rear")[1]
    assert (rear["topic"], rear["scans"]["total"]) == ("/rear", 2)
    assert rear["scan_topics"][0]["sensor"] == rear["sensor"]


def test_missing_file_exits_with_2_and_one_line(tmp_path: Path, capsys: Capture) -> None:
    assert run(["info", str(tmp_path / "absent"), "--json"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)


def test_json_is_strict_where_a_limit_is_infinite(tmp_path: Path, capsys: Capture) -> None:
    scan = {"timestamp": {"sec": 1, "nsec": 0}, "start_angle": 0.0, "end_angle": 1.0, "ranges": [1.0, 2.0]}
    _, document, _ = told(capsys, foxglove_json(tmp_path / "a", [scan]))
    assert document["sensor"]["range_max_m"] is None


def test_table_shows_names_as_they_are_and_warns_on_stderr(tmp_path: Path, capsys: Capture) -> None:
    path = write_mcap(tmp_path / "a", [laser(k, topic="/[red]scan\x1b[2J") for k in (0, 1, 1)])
    assert run(["info", str(path)]) == 0
    out, err = capsys.readouterr()
    assert "/[red]scan\\x1b[2J" in out
    assert "\x1b" not in out + err
    assert "2 usable of 3, 1 duplicate stamp" in out
    assert "1 of 3 scans skipped" in err


def test_lines_are_not_folded_where_a_program_reads_them(tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / ("long-" * 20)
    folder.mkdir()
    path = write_mcap(folder / "a", drive())
    assert run(["info", str(path)]) == 0
    assert f"log         {path}\n" in capsys.readouterr().out


def test_a_single_scan_has_no_time_for_a_turn(tmp_path: Path, capsys: Capture) -> None:
    assert run(["info", str(write_mcap(tmp_path / "a", [laser(0)]))]) == 0
    assert "sweep       no time_increment: right if all beams are taken at once\n" in capsys.readouterr().out


def test_sha256_counts_the_zeros_of_holes(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        for text in (b"one", b"two"):
            file.write(text)
            file.seek(5_000_000, 1)
        file.truncate()
    assert survey(path).sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
