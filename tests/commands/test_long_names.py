"""Names over 255 bytes are refused in one line; shorter ones that more is added to are cut."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mavnav.atomic_files import beside, short_name
from mavnav.errors import ExitCode
from support.sessions import cut, tour, written

if TYPE_CHECKING:
    from collections.abc import Callable

TOO_LONG = "y" * 300
FEW = ("--end", "0.5", "--online", "-q", "--grid", "5x5", "--outputs", "trajectory")


@pytest.mark.parametrize(
    "line",
    [
        "info LONG",
        "replay LONG",
        "replay LOG -o LONG",
        "replay LOG --config LONG",
        "replay LOG --map LONG",
        "replay LOG --continue LONG",
        "compare LONG",
        "compare LOG -o LONG",
        "batch LONG.yaml",
        "batch LOG -o LONG",
        "batch LOG --junit LONG",
        "batch LOG --summary LONG",
        "batch LOG --baseline LONG",
        "metrics LONG",
        "diff LONG LONG",
        "diff LOG LOG -o LONG.png",
        "merge LONG LOG",
        "merge LOG LOG -o LONG",
        "calibrate LOG -o LONG.json",
        "simulate LONG",
        "simulate corner -o LONG",
        "simulate corner --record LONG.mcap",
        "simulate corner --animate LONG.gif",
        "convert LONG a.mcap",
        "convert LOG LONG.mcap",
    ],
)
def test_a_name_that_no_file_can_have_is_refused_in_one_line(
    mavnav: Callable, sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    words = (str(sample) if word == "LOG" else word.replace("LONG", TOO_LONG) for word in line.split())
    code, out, err = mavnav(*words, "-q")
    of_output = re.search(r" (-o|--junit|--summary|--record|--animate|convert LOG) LONG", f" {line}")
    end, what = (ExitCode.OUTPUT, "written") if of_output else (ExitCode.USAGE, "reached")
    assert (code, out, err.count("\n")) == (end, "", 1), err
    assert f" cannot be {what}: File name too long; choose a shorter name" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("letter", ["y", "é"])
def test_a_log_of_the_longest_name_is_replayed_merged_and_compared(
    mavnav: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, letter: str
) -> None:
    monkeypatch.chdir(tmp_path)
    log = written(cut(tour("hall"), 3)[0], Path(letter * (250 // len(letter.encode())) + ".mcap"))
    assert mavnav("replay", log, *FEW)[0] == 0
    (run,) = (path for path in Path("runs").iterdir() if not path.is_symlink())
    assert (run / "run.json").is_file()
    assert mavnav("batch", log, *FEW[:-2], "-o", "b", "--summary", "s" * 250)[0] == 0
    assert json.loads(Path("b/batch.json").read_text())["cells"][0]["status"] == "done"
    assert mavnav("merge", log, log, "-o", "m", "-q")[0] in {ExitCode.DONE, ExitCode.GATE_FAILED}
    assert list(Path("m").glob("session_*.tum"))


def test_a_file_of_the_longest_name_is_replaced(tmp_path: Path) -> None:
    target = tmp_path / ("n" * 255)
    for text in ("old", "new"):
        with beside(target) as partial:
            partial.write_text(text)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["new"]


def test_long_names_are_cut_between_letters() -> None:
    assert short_name("drive") == "drive"
    assert short_name("é" * 100) == "é" * 75
    assert short_name("a" + "é" * 100) == "a" + "é" * 74
