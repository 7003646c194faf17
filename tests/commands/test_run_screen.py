"""The screen of a run: short, in its order, with the map on a terminal; warnings once, the worst first."""

from __future__ import annotations

import io
import json
import os
import pty
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mavnav.commands import run_screen, terminal
from mavnav.commands.run_screen import log_rows, map_rows, note_run, note_warnings, reference_rows, refusal_rows
from mavnav.commands.terminal import verdict_rows
from support.marks import slow

LOG = Path(__file__).parents[2] / "sample_logs" / "complex.bag"


def on_terminal(*words: object, columns: int = 80, **env: str) -> tuple[int, str]:
    """Run a command line on a terminal of so many columns; return its code and what it shows, escapes included."""
    here, there = pty.openpty()
    line = [sys.executable, "-m", "mavnav", *map(str, words)]
    given = os.environ | {"COLUMNS": str(columns), "TERM": "xterm-256color", **env}
    with subprocess.Popen(line, stdin=there, stdout=there, stderr=there, env=given) as process:
        os.close(there)
        shown = b""
        while part := _read(here):
            shown += part
    os.close(here)
    return process.returncode, shown.decode().replace("\r\n", "\n")


def _read(file: int) -> bytes:
    try:
        return os.read(file, 65536)
    except OSError:  # the other end is closed
        return b""


def plain(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)


def braille(text: str) -> int:
    return sum(any(0x2800 < ord(c) < 0x2900 for c in line) for line in text.splitlines())


@pytest.mark.parametrize("columns", [80, slow(120)])
def test_the_screen_on_a_terminal_has_the_map_and_fits(tmp_path: Path, columns: int) -> None:
    code, shown = on_terminal("replay", LOG, "--end", 1.5, "-q", "-o", tmp_path / "r", columns=columns)
    lines = plain(shown).rstrip().splitlines()
    assert code == 0
    assert lines[0].startswith("✓ good")
    assert "\x1b[1;32m✓ good" in shown
    assert sum(1 + (len(line) - 1) // columns for line in lines) <= 40
    assert max(len(line) for line in lines if not line.startswith("mavnav: ")) <= columns
    assert 5 <= braille(shown) <= 15


def test_a_terminal_need_not_have_the_map(tmp_path: Path) -> None:
    words = ("replay", LOG, "--end", 0.5, "-q", "-o", tmp_path / "r", "--outputs", "trajectory", "--no-preview")
    code, shown = on_terminal(*words)
    assert (code, braille(shown)) == (0, 0)


@pytest.mark.slow
def test_verbose_shows_the_metrics(mavnav: Callable, tmp_path: Path) -> None:
    words = ("replay", LOG, "--end", 2, "-q", "-o", tmp_path / "r")
    short, long = mavnav(*words)[1], mavnav(*words, "--force", "-v")[1]
    assert braille(short) == 0
    assert "cells across walls" not in short
    for word in ("cells across walls", "walls in map.pgm", "crispness", "scans/s"):
        assert word in long
    assert long.split()[:2] == short.split()[:2]


@pytest.mark.slow
def test_the_map_is_printed_elsewhere_if_that_is_asked(mavnav: Callable, tmp_path: Path) -> None:
    words = ("replay", LOG, "--end", 1, "-q", "--preview")
    assert braille(mavnav(*words, "-o", tmp_path / "a")[1]) > 3
    _, out, err = mavnav(*words, "--json", "-o", tmp_path / "b")
    json.loads(out)
    assert braille(err) > 3


def test_one_length_and_share_of_the_straight_walls_is_on_a_screen() -> None:
    spread = {"median_mm": 41.0, "p95_mm": 61.0, "length_m": 12.6, "measured_share": 1.0}
    quality = {"ghost_walls": {"count": 0}, "support": {"wall_m": 23.8}}
    document = {"map": {"size_m": [3.7, 8.7], "cell_mm": 20.0}, "wall_thickness": {"spread": spread}}
    document |= {"map_quality": quality, "tracking": {"path_length_m": 6.04}}
    rows = dict(map_rows(document))
    assert rows["walls"] == "median 41 mm, p95 61 mm (12.6 m, 100 % of the straight walls in the scans)"
    assert not any("23.8" in text for text in rows.values())


def tracked(*intervals: tuple[float, float, int], odom: str = "auto", method: str = "robust", **tracking: Any) -> str:
    """Return the row on what was used of a log with stretches without a pose."""
    keys = ("start_s", "end_s", "scans")
    listed = [dict(zip(keys, each, strict=True)) for each in intervals]
    document = {
        "input": {"path": "logs/drive.bag", "duration_s": 93.84, "odometry": {"topic": "/odom"}},
        "scans": {"total": 940, "processed": 936, "accepted": 900},
        "tracking": {"intervals": listed, **tracking},
        "loop_closure": {"closures": [{}] * 3},
        "config": {"odom": odom, "method": method},
    }
    rows = dict(log_rows(document))
    assert rows["log"] == "drive.bag, 93.8 s, 940 scans, 936 of them used"
    return rows["used"]


def test_a_jump_is_no_stretch_without_a_pose() -> None:
    """A screen said "lost 0 scans in 1 stretch"."""
    assert tracked((21.4, 21.6, 0)) == "96.2 % of the scans have a pose; no odometry; 3 loops closed"
    assert "; odometry switched off; " in tracked(odom="off")
    assert "; the method uses no odometry; " in tracked(odom="off", method="paper")
    assert ", none from 3.0 to 4.5 s; " in tracked((3.0, 4.5, 15), (21.4, 21.6, 0))
    many = tracked((3.0, 4.5, 15), (5.0, 6.0, 10), (7.0, 8.0, 10))
    assert ", none from 3.0 to 4.5 s, 5.0 to 6.0 s and 1 other stretch; " in many


def test_odometry_is_shown_with_what_corrects_it() -> None:
    used = {"used": True, "offset_s": 0.28, "distance_scale": 1.004, "turn_scale": 0.9, "noise": {"m_per_m": 0.04}}
    corrected = "odometry /odom corrected by +0.28 s, turns x 0.9, off the track by 4 % of the distance"
    assert corrected in tracked(odometry=used)
    assert "odometry /odom not used, it contradicts the scans" in tracked(odometry=used | {"used": False})


def test_a_verdict_has_a_row_for_its_advice_if_it_has_one() -> None:
    good = {"word": "good", "reason": "no sign", "advice": ""}
    assert [text for _, text in verdict_rows(good)] == ["no sign"]
    assert [text for _, text in verdict_rows(good | {"advice": "look"})] == ["no sign", "look"]


def test_warnings_are_printed_once_and_those_of_one_kind_together(capsys: pytest.CaptureFixture[str]) -> None:
    parts = [f"{n} scans from {n}.0 to {n}.5 s do not match" for n in (5, 6, 7)]
    note_warnings([parts[0], "few beams", *parts, "few beams", "a", "b", "c"])
    assert capsys.readouterr().err.splitlines() == [
        "mavnav: warning: 5 scans from 5.0 to 5.5 s do not match (2 more of this kind)",
        "mavnav: warning: few beams",
        "mavnav: warning: a",
        "mavnav: warning: b",
        "mavnav: 1 more warning in run.json; -v prints them",
    ]
    note_warnings(["a", "b", "c", "d", "e"], all_=True)
    assert len(capsys.readouterr().err.splitlines()) == 5


def test_the_worst_comes_first(capsys: pytest.CaptureFixture[str]) -> None:
    document = {
        "verdict": {"word": "lost", "reason": "tracking was lost", "advice": "look at map.png"},
        "exit_code": 5,
        "damage": [{"what": "the chunk is cut", "where": "byte 7"}],
        "warnings": ["few beams"],
        "partial": False,
    }
    note_run(document, verdict=True)
    assert [line.partition(": ")[2][:20] for line in capsys.readouterr().err.splitlines()] == [
        "error: lost: trackin",
        "warning: the input i",
        "warning: few beams",
    ]
    note_run(document, verdict=False)
    assert "lost" not in capsys.readouterr().err


class Terminal(io.StringIO):
    encoding = "utf-8"  # type: ignore[assignment]

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("no_color", "coloured"), [("", True), ("1", False)])
def test_messages_are_coloured_on_a_terminal(monkeypatch: pytest.MonkeyPatch, no_color: str, coloured: bool) -> None:
    monkeypatch.setenv("NO_COLOR", no_color)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", shown := Terminal())
    terminal.note("mavnav: warning: few beams")
    terminal.note("mavnav: stopped")
    first, second = shown.getvalue().splitlines()
    assert first == ("\x1b[33mmavnav: warning:\x1b[0m few beams" if coloured else "mavnav: warning: few beams")
    assert second == "mavnav: stopped"


def test_a_stream_without_the_signs_gets_others() -> None:
    ascii_only = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    assert [terminal.verdict_mark(word, ascii_only)[0] for word in ("good", "suspect", "wrong", "lost")] == [
        "+ good",
        "? suspect",
        "x wrong",
        "x lost",
    ]
    assert terminal.verdict_mark("", ascii_only) == ("", "")


def test_lines_of_the_map_leave_room_for_the_rest() -> None:
    assert run_screen.MAP_LINES + run_screen.MOST_WARNINGS + 2 * 10 <= 40


def test_the_screen_says_which_rule_refused_how_many_scans() -> None:
    refused = [
        {"rule": "cost", "scans": 3, "median": 1.24, "worst": 2.5},
        {"rule": "share", "scans": 12, "median": 0.5, "worst": 0.31},
        {"rule": "beams", "scans": 1, "median": 20.0, "worst": 20.0},
    ]
    ((name, text),) = refusal_rows({"scans": {"refused": refused}})
    assert name == "refused"
    assert text == (
        "3 scans by cost (1.2 times the threshold, 2.5 at worst); 12 scans by share (50 % of the beams agree, 31 % at "
        "worst); 1 scan by beams (20 valid, 20 at worst)"
    )
    assert not list(refusal_rows({"scans": {"refused": []}}))
    assert not list(refusal_rows({"scans": {}}))


def test_errors_of_few_poses_or_none_are_named_so() -> None:
    ate = {"rmse_m": 0.0186, "max_m": 0.0354, "share": 0.06}
    rpe = {"delta_m": 1.0, "distance_rmse_m": None}
    assert list(reference_rows({"ate": ate, "rpe": rpe})) == [
        ("ATE, aligned", "18.6 mm rmse, 35.4 mm max, of 6 % of the poses")
    ]
    assert list(reference_rows({"ate": ate | {"share": 1.0}, "rpe": rpe})) == [
        ("ATE, aligned", "18.6 mm rmse, 35.4 mm max")
    ]
    ((_, text),) = reference_rows({"ate": None, "rpe": None})
    assert text.startswith("unknown: too few poses")
    assert list(reference_rows({"relations": {"all": {"scored": 0, "relations": 7}}})) == [("relations", "0 of 7")]
    assert list(reference_rows(None)) == []


def test_a_log_that_is_the_current_folder_has_a_name(
    mavnav: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(LOG.parent / "corner")
    code, out, _ = mavnav("replay", ".", "--end", 0.5, "-q", "-o", tmp_path / "run", "--outputs", "trajectory")
    assert code == 0
    assert re.search(r"^log +[.], \d", out, re.MULTILINE)
