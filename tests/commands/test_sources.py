"""Logs by address, by standard input, and in parts are the logs that a file would be."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavnav.cli import run
from mavnav.logs import open_log
from support.field_logs import drive_log
from support.log_files import drive, write_bag1, write_mcap


class Piped(io.TextIOWrapper):
    """Standard input of some bytes."""

    def __init__(self, content: bytes) -> None:
        super().__init__(io.BytesIO(content))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_mcap(tmp_path / "log.mcap", drive_log(2.0, beams=120))


def info_of(source: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert run(["info", source, "--json", "-q"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


def by_stdin(log: Path, patch: pytest.MonkeyPatch) -> str:
    patch.setattr(sys, "stdin", Piped(log.read_bytes()))
    return "-"


def by_address(log: Path, patch: pytest.MonkeyPatch) -> str:
    pytest.importorskip("fsspec", reason="the extra mavnav[cluster]")
    return f"file://{log}"


@pytest.mark.parametrize("given", [by_stdin, by_address])
def test_a_log_from_elsewhere_is_the_log(
    given: Callable[[Path, pytest.MonkeyPatch], str],
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    near = info_of(str(log), capsys)
    source = given(log, monkeypatch)
    far = info_of(source, capsys)
    assert far["input"]["path"] == source
    assert far | {"input": near["input"]} == near
    words = ["-q", "--outputs", "trajectory"]
    assert run(["replay", given(log, monkeypatch), "-o", str(tmp_path / "far"), *words]) == 0
    assert run(["replay", str(log), "-o", str(tmp_path / "near"), *words]) == 0
    assert (tmp_path / "far/trajectory.tum").read_bytes() == (tmp_path / "near/trajectory.tum").read_bytes()
    document = json.loads((tmp_path / "far/run.json").read_text())
    assert document["input"]["path"] == source
    capsys.readouterr()
    assert run(["convert", given(log, monkeypatch), str(tmp_path / "far.mcap"), "--json", "-q"]) == 0
    assert json.loads(capsys.readouterr().out)["input"]["path"] == source
    assert run(["convert", str(log), str(tmp_path / "near.mcap"), "-q"]) == 0
    assert (tmp_path / "far.mcap").read_bytes() == (tmp_path / "near.mcap").read_bytes()
    assert document["input"]["sha256"] == near["input"]["sha256"]


@pytest.mark.parametrize("command", ["info", "replay"])
def test_nothing_on_standard_input_is_no_log(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", Piped(b""))
    assert run([command, "-"]) == 4
    error = capsys.readouterr().err
    assert "-: no usable scans; the file is empty" in error
    assert "/mavnav-" not in error


def test_a_terminal_is_no_log_but_a_pipe_is(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal = Piped(b"")
    monkeypatch.setattr(terminal, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stdin", terminal)
    words = ["-o", str(tmp_path / "run"), "-q", "--outputs", "trajectory"]
    assert run(["replay", "-", *words]) == 2
    assert "write mavnav replay - < drive.mcap, or name a log" in capsys.readouterr().err
    os.mkfifo(tmp_path / "fifo")
    assert run(["replay", str(tmp_path / "fifo"), *words]) == 2
    assert "name a log, or pipe one into 'mavnav replay -'" in capsys.readouterr().err
    assert run(["replay", by_stdin(log, monkeypatch), *words]) == 0


def test_the_parts_of_a_bag_of_ros_1_are_one_log(tmp_path: Path) -> None:
    messages, folder = drive(30), tmp_path / "parts"
    folder.mkdir()
    parts = [messages[:20], messages[20:41], messages[41:]]
    for k, part in enumerate(parts):
        write_bag1(folder / f"drive_2020-01-31-12-0{k}-00_{k}.bag", part)
    whole, log = open_log(write_bag1(tmp_path / "drive.bag", messages)), open_log(folder)
    assert (log.format, len(log), log.damage, log.warnings) == ("rosbag1", 30, (), ())
    assert log.stamps_ns.tolist() == whole.stamps_ns.tolist()


def test_other_bags_in_a_folder_are_no_parts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a_0.bag", "b_1.bag"):
        write_bag1(tmp_path / name, drive(3))
    assert run(["info", str(tmp_path)]) == 2
    assert "no parts of one bag" in capsys.readouterr().err


def split_log(folder: Path, *names: str) -> list[Path]:
    """Write a drive of three seconds as parts of a second each."""
    messages = drive_log(3.0, beams=120)
    cuts = [messages[0].time_ns + k * 10**9 for k in range(3)] + [messages[-1].time_ns + 1]
    folder.mkdir()
    return [
        write_mcap(folder / name, [message for message in messages if begin <= message.time_ns < end])
        for name, begin, end in zip(names, cuts, cuts[1:], strict=False)
    ]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_parts_that_are_named_are_one_log(order: tuple[int, ...], tmp_path: Path) -> None:
    whole = open_log(write_mcap(tmp_path / "whole.mcap", drive_log(3.0, beams=120)))
    parts = split_log(tmp_path / "parts", "drive_2.mcap", "drive_9.mcap", "drive_10.mcap")
    first, *more = (parts[k] for k in order)
    log = open_log(first, more=tuple(more))
    assert (log.stamps_ns.tolist(), log.damage, log.warnings) == (whole.stamps_ns.tolist(), (), ())
    for a, b in zip(log.scans(), whole.scans(), strict=True):
        assert np.array_equal(a.ranges_m, b.ranges_m, equal_nan=True)


def test_a_replay_of_parts_is_repeated_and_is_that_of_the_whole_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parts = [str(part) for part in split_log(tmp_path / "parts", "d_0.mcap", "d_1.mcap", "d_2.mcap")]
    whole = write_mcap(tmp_path / "whole.mcap", drive_log(3.0, beams=120))
    words = ["-q", "--outputs", "trajectory"]
    for name, given in {
        "parts": parts,
        "whole": [str(whole)],
        "again": ["--again", str(tmp_path / "parts.run")],
        "moved": [*parts[::-1], "--again", str(tmp_path / "parts.run")],
    }.items():
        assert run(["replay", *given, "-o", str(tmp_path / f"{name}.run"), *words]) == 0
    tracks = {(tmp_path / f"{name}.run/trajectory.tum").read_bytes() for name in ("parts", "whole", "again", "moved")}
    assert len(tracks) == 1
    document = json.loads((tmp_path / "parts.run/run.json").read_text())
    assert [document["input"]["path"], *document["input"]["parts"]] == parts
    assert all(part in document["provenance"]["again"] for part in parts)
    capsys.readouterr()
    assert run(["info", *parts, "--json", "-q"]) == 0
    assert json.loads(capsys.readouterr().out)["input"]["sha256"] == document["input"]["sha256"]


@pytest.mark.parametrize("command", ["info", "replay"])
@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["a.mcap", "b.mcap"], "no parts of one bag by their names; run several logs with 'mavnav batch LOG ...'"),
        (["a_0.mcap", "b_1.mcap"], "no parts of one bag"),
        (["a_0.mcap", "."], "no parts of one bag"),
        (["a_0.mcap", "a_3.mcap"], "a_3.mcap: no such file"),
        (["a_0.mcap", "-"], "parts of a log are files"),
    ],
    ids=["logs", "bags", "folder", "missing", "stdin"],
)
def test_what_are_no_parts_of_one_bag_is_refused(
    command: str, names: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a.mcap", "b.mcap", "a_0.mcap", "b_1.mcap"):
        write_mcap(tmp_path / name, drive(2))
    assert run([command, *(name if name == "-" else str(tmp_path / name) for name in names)]) == 2
    assert message in capsys.readouterr().err
