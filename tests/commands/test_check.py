"""mavnav check: gates on runs that are there, and how it ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mavnav.batch import check as command
from mavnav.batch.document import BATCH_FILE
from mavnav.comparison.document import COMPARISON_FILE
from mavnav.errors import ExitCode

RUN = {"exit_code": 0, "scans": {"accepted": 100}, "tracking": {"intervals": []}}


def write(place: str, **more: Any) -> None:
    Path(place).mkdir(parents=True)
    (Path(place) / "run.json").write_text(json.dumps(RUN | more))


def cell(name: str, directory: str | None, exit_code: int = 0, **more: Any) -> dict[str, Any]:
    return {"name": name, "directory": directory, "exit_code": exit_code, "error": None, **more}


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def batch(home: Path) -> Path:
    """Return the directory of a batch: sound, damaged, without scans; and a run of a log that is no more."""
    write("b/cells/sound")
    write("b/cells/cut", exit_code=3)
    write("b/cells/stale", exit_code=5)
    cells = [cell("sound.bag", "cells/sound"), cell("cut.bag", "cells/cut", 3), cell("empty.bag", None, 4)]
    cells[2]["error"] = "empty.bag: no usable scans"
    Path("b/batch.json").write_text(json.dumps({"cells": cells}))
    return Path("b")


def accept(batch: Path, *codes: int) -> None:
    document = json.loads((batch / "batch.json").read_text())
    for row in document["cells"]:
        row["accepted"] = row["exit_code"] in codes
    (batch / "batch.json").write_text(json.dumps(document))


def test_a_run_that_could_not_be_made_counts(mavnav: Callable, batch: Path) -> None:
    """And one that the batch does not tell of does not."""
    code, out, err = mavnav("check", batch, "--gate", "scans.accepted>=1")
    assert code == ExitCode.NO_SCANS
    assert out.splitlines() == ["b/cells/sound: passed", "b/cells/cut: failed", "empty.bag: failed"]
    assert err.splitlines() == [
        "mavnav: error: b/cells/cut: it ended with exit code 3",
        "mavnav: error: empty.bag: empty.bag: no usable scans",
    ]
    assert mavnav("check", batch / "batch.json")[0] == ExitCode.NO_SCANS


def test_what_the_batch_accepts_is_accepted(mavnav: Callable, batch: Path) -> None:
    accept(batch, 3)
    assert mavnav("check", batch)[0] == ExitCode.NO_SCANS
    accept(batch, 3, 4)
    assert mavnav("check", batch) == (0, "b/cells/sound: passed\nb/cells/cut: passed\nempty.bag: passed\n", "")
    assert mavnav("check", batch, "--gate", "scans.accepted>=101")[0] == ExitCode.GATE_FAILED


def test_a_batch_that_was_never_finished_stands_for_what_is_there(mavnav: Callable, batch: Path) -> None:
    (batch / "batch.json").unlink()
    code, out, _ = mavnav("check", batch)
    assert code == ExitCode.TRACKING_LOST
    assert out.splitlines() == ["b/cells/cut: failed", "b/cells/sound: passed", "b/cells/stale: failed"]


def test_a_comparison(mavnav: Callable, comparison: Path) -> None:
    code, out, _ = mavnav("check", comparison, "--gate", "scans.processed>=1")
    assert (code, len(out.splitlines())) == (0, 2)


def test_relative_costs_of_a_comparison(mavnav: Callable, comparison: Path) -> None:
    prices = json.loads((comparison / "comparison.json").read_text())["price"]
    dearest = max(prices["evaluations"])
    assert mavnav("check", comparison, "--gate", f"price.evaluations<={dearest}")[0] == 0
    code, _, err = mavnav("check", comparison, "--gate", f"price.evaluations<{dearest}")
    assert (code, err.count("gate price.evaluations<")) == (1, 1)
    code, _, err = mavnav("check", comparison, "--gate", "price.foo<=3")
    assert (code, err) == (2, "mavnav: error: no number price.foo in run.json; price has evaluations, cpu, seconds\n")


def test_a_number_that_only_some_runs_have(mavnav: Callable, home: Path) -> None:
    write("one", tracking={"intervals": [{"scans": 2}]})
    write("two")
    gate = "tracking.intervals.0.scans<=3"
    code, _, err = mavnav("check", "one", "two", "--gate", gate)
    assert (code, err) == (1, f"mavnav: error: two: gate {gate} failed: this run has no such number\n")
    code, _, err = mavnav("check", "two", "--gate", gate)
    assert code == ExitCode.USAGE
    assert err.startswith("mavnav: error: no number tracking.intervals.0.scans in run.json")


def test_a_skip_reason_that_did_not_occur(mavnav: Callable, home: Path) -> None:
    write("one", scans={"skipped": {}})
    write("two", scans={"skipped": {"duplicate_stamp": 3}})
    gate = "scans.skipped.duplicate_stamp<=0"
    assert mavnav("check", "one", "--gate", gate) == (0, "one: passed\n", "")
    code, _, err = mavnav("check", "one", "two", "--gate", gate)
    assert (code, err) == (1, f"mavnav: error: two: gate {gate} failed: it is 3\n")


def test_the_end_of_a_run_is_told_beside_its_gates(mavnav: Callable, home: Path) -> None:
    write("lost", exit_code=5)
    code, out, err = mavnav("check", "lost", "--gate", "scans.accepted>=101", "--json")
    assert json.loads(out) == {
        "schema_version": 1,
        "runs": [
            {
                "run": "lost",
                "verdict": None,
                "gates": [{"gate": "scans.accepted>=101", "value": 100, "passed": False, "why": "it is 100"}],
                "error": "it ended with exit code 5",
                "exit_code": 5,
            }
        ],
        "exit_code": 5,
    }
    assert (code, len(err.splitlines())) == (5, 2)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("run.json", ""),
        ("run.json", "[]"),
        ("run.json", "{}"),
        ("run.json", '{"exit_code": 99}'),
        ("batch.json", '{"cells": [{"name": "a"'),
        ("batch.json", '{"cells": 1}'),
        ("batch.json", '{"cells": [[]]}'),
        ("batch.json", '{"cells": [{"name": "a", "directory": null, "exit_code": "4"}]}'),
        ("comparison.json", "{}"),
        ("comparison.json", '{"cells": [], "price": 3}'),
    ],
)
def test_what_is_not_ours(mavnav: Callable, home: Path, name: str, text: str) -> None:
    Path("odd").mkdir()
    (Path("odd") / name).write_text(text)
    wrong = "is not one of mavnav's" if text.endswith(("}", "[]")) else "is no JSON, or cut off"
    said = f"mavnav: error: odd/{name} {wrong}; name the directory of a finished run, or make it again\n"
    assert mavnav("check", "odd") == (ExitCode.USAGE, "", said)


def test_nothing_there(mavnav: Callable, home: Path) -> None:
    code, _, err = mavnav("check", "gone")
    assert (code, err[:33]) == (ExitCode.USAGE, "mavnav: error: gone: no run.json ")


def test_the_files_that_check_reads_are_those_that_are_written() -> None:
    assert set(command.WHOLE_FILES) == {BATCH_FILE, COMPARISON_FILE}


def judged(word: str, **more: Any) -> dict[str, Any]:
    return {"verdict": {"word": word, "reason": "the path jumps, at 3.0 s", "advice": "look at map.png"}, **more}


@pytest.fixture
def four(home: Path) -> list[str]:
    """Return the directories of runs of every verdict."""
    for word in ("good", "suspect", "wrong"):
        write(word, **judged(word))
    write("lost", **judged("lost", exit_code=5))
    return ["good", "suspect", "wrong", "lost"]


@pytest.mark.parametrize(
    ("accept", "failing"),
    [
        ((), {"wrong", "lost"}),
        (("good",), {"suspect", "wrong", "lost"}),
        (("suspect",), {"wrong", "lost"}),
        (("wrong",), {"lost"}),
        (("lost",), set()),
        ((5,), {"wrong"}),
        (("wrong", 5), set()),
    ],
)
def test_the_worst_verdict_that_passes(mavnav: Callable, four: list[str], accept: tuple, failing: set[str]) -> None:
    words = [word for each in accept for word in ("--accept", each)]
    code, out, err = mavnav("check", *four, *words)
    assert {line.partition(":")[0] for line in out.splitlines() if ": failed" in line} == failing
    assert code == (5 if "lost" in failing else 1 if failing else 0)
    assert err.splitlines() == [
        f"mavnav: error: {word}: {word}: the path jumps, at 3.0 s" for word in four if word in failing
    ]


def test_a_wrong_run_fails_with_1_and_its_verdict_is_in_the_document(mavnav: Callable, four: list[str]) -> None:
    code, out, _ = mavnav("check", "good", "wrong", "--json")
    assert code == 1
    assert [row["verdict"]["word"] for row in json.loads(out)["runs"]] == ["good", "wrong"]
    assert mavnav("check", "good", "--gate", "verdict==good")[0] == 0
    code, _, err = mavnav("check", "suspect", "--gate", "verdict==good")
    assert (code, err) == (1, "mavnav: error: suspect: suspect: the path jumps, at 3.0 s\n")


@pytest.mark.parametrize("accept", ["fine", "77", "-1"])
def test_what_is_neither_a_verdict_nor_an_exit_code(mavnav: Callable, four: list[str], accept: str) -> None:
    code, _, err = mavnav("check", "good", f"--accept={accept}")
    assert code == 2
    assert f"--accept {accept}: no exit code of mavnav" in err


def test_what_a_batch_accepts_of_verdicts_is_accepted(mavnav: Callable, home: Path) -> None:
    write("b/cells/wrong", **judged("wrong"))
    gate = {"gate": "verdict<=wrong", "value": "wrong", "passed": True, "why": ""}
    cells = [cell("wrong.bag", "cells/wrong", accepted=True, gates=[gate])]
    Path("b/batch.json").write_text(json.dumps({"cells": cells}))
    assert mavnav("check", "b")[0] == 0
    assert mavnav("check", "b", "--accept", "suspect")[0] == 1
    assert mavnav("check", "b", "--accept", "3")[0] == 0


def test_a_verdict_that_is_given_leaves_the_codes_that_the_batch_accepts(mavnav: Callable, batch: Path) -> None:
    accept(batch, 3, 4)
    assert mavnav("check", batch, "--accept", "good")[0] == 0
    lost = json.loads(Path("b/cells/cut/run.json").read_text()) | judged("lost", exit_code=5)
    Path("b/cells/cut/run.json").write_text(json.dumps(lost))
    document = json.loads(Path("b/batch.json").read_text())
    document["cells"][1]["exit_code"] = 5
    Path("b/batch.json").write_text(json.dumps(document))
    assert mavnav("check", batch)[0] == 0
    assert mavnav("check", batch, "--accept", "wrong")[0] == ExitCode.TRACKING_LOST


@pytest.mark.parametrize("verdict", [None, 3, [], {}, {"word": "fine", "reason": "", "advice": ""}, {"word": "good"}])
def test_a_verdict_that_is_none_is_no_verdict(mavnav: Callable, home: Path, verdict: object) -> None:
    write("run", verdict=verdict)
    assert mavnav("check", "run") == (0, "run: passed\n", "")
