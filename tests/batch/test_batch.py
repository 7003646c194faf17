"""Batches: what fails fails alone, what is there stays, what dies is tried again."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
from pathlib import Path

import pytest

from mavnav.batch.document import missing_lines, remark, why
from mavnav.batch.options import BatchOptions, request_of
from mavnav.batch.request import BatchPart
from mavnav.batch.runner import plan_batch, run_batch
from mavnav.errors import ConfigError, ExitCode, OutputError, UsageError
from mavnav.jobs.worker import Ended, Event, Started
from mavnav.metrics.gates import check_names, names
from mavnav.outputs.documents.schema import number_names
from support.small_batch import NAME, OPTIONS, batch


def rows(document: dict) -> dict[str, dict]:
    return {row["log"]: row for row in document["cells"]}


def test_what_fails_fails_alone(home: Path) -> None:
    document = json.loads(Path("runs/batch/batch.json").read_text())
    found = rows(document)
    assert list(found) == ["logs/cut.mcap", "logs/empty.mcap", "logs/good.mcap", "gone.bag"]
    assert {log: row["exit_code"] for log, row in found.items()} == {
        "logs/cut.mcap": ExitCode.DAMAGED_INPUT,
        "logs/empty.mcap": ExitCode.NO_SCANS,
        "logs/good.mcap": ExitCode.DONE,
        "gone.bag": ExitCode.USAGE,
    }
    assert found["logs/empty.mcap"]["error"].startswith("logs/empty.mcap")
    assert found["gone.bag"]["error"].startswith("gone.bag: no such file")
    assert found["logs/good.mcap"]["name"] == f"logs/good.mcap robust {NAME}"
    assert document["exit_code"] == ExitCode.USAGE
    assert document["counts"] == {
        "runs": 4,
        "done": 2,
        "cached": 0,
        "failed": 2,
        "verdicts": {"good": 2},
        "codes": {"0": 1, "3": 1, "4": 1, "2": 1},
    }


def test_what_is_there_is_not_run_again(home: Path) -> None:
    document, ran = batch()
    assert ran == [f"logs/empty.mcap robust {NAME}"]
    assert [row["status"] for row in document["cells"]] == ["cached", "failed", "cached", "failed"]
    assert document["exit_code"] == ExitCode.USAGE


def test_runs_of_other_logs_in_the_same_directory_are_kept_and_named(home: Path) -> None:
    batch(sources=("logs/good.mcap",))
    other = shutil.copy("logs/good.mcap", "other.mcap")
    document, _ = batch(sources=(other,), grids=("7x7",))
    ((kind, line),) = missing_lines(document)
    assert (kind, line.startswith("1 run of other logs, listed here before, stayed in cells")) == ("warning", True)
    document, ran = batch(sources=("logs/good.mcap", other))
    assert (missing_lines(document), len(ran)) == ([], 1)


def test_a_page_that_is_asked_for_later_is_drawn(home: Path) -> None:
    asked = {"sources": ("logs/good.mcap",), "report": True}
    document, ran = batch(**asked)
    assert len(ran) == 1
    assert Path("runs/batch", document["cells"][0]["directory"], "report.html").is_file()
    assert batch(**asked)[1] == []


FOUR_KEYS = '{"exit_code": 0, "tracking": {"lost": false}, "map_quality": {"meaningful": true}, "outputs": {}}'


@pytest.mark.parametrize("broken", ["", "[]", "{}", '{"exit_code": "0"}', '{"exit_code": 0}', FOUR_KEYS])
def test_a_run_that_was_spoilt_is_made_again(home: Path, broken: str) -> None:
    path = next(Path("runs/batch/cells").glob("good-*/run.json"))
    path.write_text(broken)
    assert f"logs/good.mcap robust {NAME}" in missing_runs()


def missing_runs() -> list[str]:
    planned = plan_batch(request_of(BatchOptions(**OPTIONS)), lambda *args: None)
    return [case.name for case in planned.missing]


@pytest.mark.parametrize("change", [{"input": 5}, {"exit_code": 99}, {"exit_code": None}, {"tracking": {}}])
def test_a_run_with_a_wrong_section_is_made_again(home: Path, change: dict) -> None:
    path = next(Path("runs/batch/cells").glob("good-*/run.json"))
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    document, ran = batch(sources=("logs/good.mcap",))
    assert (len(ran), document["exit_code"]) == (1, 0)
    assert batch(sources=("logs/good.mcap",))[1] == []


@pytest.mark.parametrize("name", ["hits.npz", "map.pgm", "map.png", "trajectory.tum"])
def test_a_run_without_one_of_its_files_is_made_again(home: Path, name: str) -> None:
    path = next(Path("runs/batch/cells").glob(f"good-*/{name}"))
    content = path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert f"logs/good.mcap robust {NAME}" in missing_runs()
    path.unlink()
    assert f"logs/good.mcap robust {NAME}" in missing_runs()
    path.write_bytes(content)
    assert f"logs/good.mcap robust {NAME}" not in missing_runs()


def test_a_run_that_is_spoilt_meanwhile_does_not_pass(home: Path) -> None:
    planned = plan_batch(request_of(BatchOptions(**OPTIONS | {"sources": ("logs/good.mcap",)})), lambda *args: None)
    next(Path("runs/batch/cells").glob("good-*/run.json")).write_text('{"exit_code": 0}')
    document = run_batch(planned, lambda event: None, lambda row: None)
    (row,) = document["cells"]
    assert row["error"].endswith("run.json was removed or damaged meanwhile; repeat this call")
    assert (row["status"], document["exit_code"]) == ("failed", ExitCode.OUTPUT)


def test_force_runs_again(home: Path) -> None:
    asked = BatchOptions(sources=("logs/good.mcap",), grids=("5x5",), azimuths=(6,), options={"end_s": 0.5}, force=True)
    assert len(plan_batch(request_of(asked), lambda *args: None).missing) == 1


def test_the_table_is_read_by_a_parser(home: Path) -> None:
    with Path("runs/batch/batch.csv").open() as file:
        table = {row["log"]: row for row in csv.DictReader(file)}
    assert table["logs/good.mcap"]["code"] == "0"
    assert table["logs/good.mcap"]["verdict"] == "good"
    assert table["logs/good.mcap"]["reason"] == "no sign of an error in path or map"
    assert table["gone.bag"]["verdict"] == ""
    assert int(table["logs/good.mcap"]["scans.processed"]) >= 5
    assert table["gone.bag"]["scans.processed"] == ""
    assert table["gone.bag"]["error"].startswith("gone.bag: no such file")


def test_codes_that_are_accepted(home: Path) -> None:
    document, _ = batch(sources=("logs/*t.mcap", "logs/good.mcap"), accept=(3,))
    assert [(row["exit_code"], row["code"]) for row in document["cells"]] == [(3, 0), (0, 0)]
    assert document["exit_code"] == 0


def test_gates_pass_and_fail(home: Path) -> None:
    document, _ = batch(sources=("logs/good.mcap",), gates=("scans.processed>=3", "scans.accepted>=1000"))
    row = document["cells"][0]
    assert [gate["passed"] for gate in row["gates"]] == [True, True, False]
    assert row["gates"][2]["why"].startswith("it is ")
    assert (row["exit_code"], row["code"], document["exit_code"]) == (0, 1, 1)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"gates": ("scans.procesed>=3",)}, r"did you mean scans.processed\?"),
        ({"tolerances": ("wall_thickness.p59_mm=5%",)}, r"did you mean wall_thickness.p95_mm\?"),
        ({"gates": ("reference.ate.rmse_m<=0.1",)}, "it needs --truth"),
    ],
)
def test_numbers_that_no_run_has_stop_before_the_work(home: Path, asked: dict, said: str) -> None:
    """Nothing is there that could tell the names."""
    with pytest.raises(UsageError, match=said):
        batch(**asked, directory=Path("new"), listen=lambda event: pytest.fail("nothing is to be run"))


NULL = (
    *(f"input.{name}" for name in ("base_frame", "base_T_laser", "mounting_source", "odometry")),
    "provenance.command",
    *(f"provenance.options.{name}" for name in ("topic", "extrinsic", "map", "start_pose", "config")),
    *(f"provenance.options.{name}" for name in ("truth", "truth_map", "relations")),
)
"""Names that `names` takes for numbers, because they are null in these runs."""


def test_the_numbers_of_every_run_are_known_before(home: Path) -> None:
    runs = sorted(Path("runs/batch/cells").glob("*/run.json"))
    assert len(runs) == 2
    for run in runs:
        check_names(names(json.loads(run.read_text())), [*number_names(), *NULL])


def test_a_number_that_one_run_lacks_fails_that_run_alone(home: Path) -> None:
    document, _ = batch(gates=("tracking.intervals.7.scans<=3",))
    found = rows(document)["logs/good.mcap"]
    assert found["gates"][1]["why"] == "this run has no such number"
    assert found["code"] == ExitCode.GATE_FAILED


def test_a_gate_on_a_map_that_means_nothing(home: Path) -> None:
    path = next(Path("runs/batch/cells").glob("good-*/run.json"))
    run = json.loads(path.read_text())
    run["map_quality"].update(meaningful=False, why=["two scans are no map"])
    path.write_text(json.dumps(run))
    document, _ = batch(sources=("logs/good.mcap",), gates=("wall_thickness.p95_mm<=100000",))
    gate = document["cells"][0]["gates"][1]
    assert not gate["passed"]
    assert gate["why"].endswith("the map is not meaningful: two scans are no map")


def give_verdict(log: str, word: str) -> None:
    """Change the verdict in the run.json of a finished run."""
    path = next(Path("runs/batch/cells").glob(f"{log}-*/run.json"))
    run = json.loads(path.read_text())
    run["verdict"].update(word=word, reason="the path jumps, at 0.3 s")
    path.write_text(json.dumps(run))


@pytest.mark.parametrize(
    ("word", "accept", "code"),
    [
        ("suspect", (), 0),
        ("suspect", ("good",), 1),
        ("wrong", (), 1),
        ("wrong", ("wrong",), 0),
        ("wrong", ("suspect", "lost"), 0),
        ("lost", (), 1),
        ("lost", (5,), 0),
        ("wrong", (5,), 1),
    ],
)
def test_a_batch_fails_for_its_verdicts(home: Path, word: str, accept: tuple[int | str, ...], code: int) -> None:
    give_verdict("good", word)
    document, _ = batch(sources=("logs/good.mcap",), accept=accept)
    (row,) = document["cells"]
    assert (row["exit_code"], row["code"], document["exit_code"]) == (0, code, code)
    assert document["counts"]["verdicts"] == {word: 1}
    assert why(row) == ([f"{word}: the path jumps, at 0.3 s"] if code else [])
    assert remark(row) == f"{word}: the path jumps, at 0.3 s"


def test_what_a_manifest_accepts_of_a_log(home: Path) -> None:
    give_verdict("good", "wrong")
    give_verdict("cut", "suspect")
    Path("night.yaml").write_text(
        "logs:\n"
        "  - {log: logs/good.mcap, end_s: 0.5, accept: wrong}\n"
        "  - {log: logs/cut.mcap, end_s: 0.5, accept: [3, good]}\n"
        "runs: [{grid: 5x5, azimuth: 6, final_pass: false}]\n"
    )
    document, _ = batch(sources=("night.yaml",), grids=(), azimuths=(), options={}, directory=Path("runs/batch"))
    assert [(row["exit_code"], row["code"]) for row in document["cells"]] == [(0, 0), (3, 1)]


def test_a_manifest_with_gates_for_some(home: Path) -> None:
    Path("ci").mkdir()
    Path("ci/night.yaml").write_text("""
logs:
  - log: ../logs/good.mcap
    end_s: 0.5
    gates: scans.processed>=1000
  - {log: ../logs/cut.mcap, end_s: 0.5, accept: 3}
runs:
  - {name: quick, grid: 5x5, azimuth: 6, final_pass: false}
gates: scans.processed>=1
output: ../runs/batch
""")
    document, ran = batch(sources=("ci/night.yaml",), grids=(), azimuths=(), options={})
    assert ran == []
    assert [row["name"] for row in document["cells"]] == [
        "../logs/good.mcap quick end_s=0.5",
        "../logs/cut.mcap quick end_s=0.5",
    ]
    assert [row["code"] for row in document["cells"]] == [1, 0]
    assert document["exit_code"] == ExitCode.GATE_FAILED


def test_a_killed_worker_is_tried_again(home: Path) -> None:
    killed = []

    def kill_once(event: Event) -> None:
        if isinstance(event, Started) and not killed:
            killed.append(event.pid)
            os.kill(event.pid, signal.SIGKILL)

    document, ran = batch(sources=("logs/good.mcap",), grids=("6x6",), listen=kill_once)
    assert len(ran) == len(killed) == 1
    assert (document["cells"][0]["status"], document["exit_code"]) == ("done", 0)
    assert not [path for path in Path("runs/batch/cells").iterdir() if path.name.startswith(".")]


def test_a_log_that_always_kills_its_worker_is_given_up_and_named(home: Path) -> None:
    def kill(event: Event) -> None:
        if isinstance(event, Started):
            os.kill(event.pid, signal.SIGKILL)

    document, _ = batch(sources=("logs/good.mcap",), grids=("6x6",), listen=kill, tries=2)
    row = document["cells"][0]
    assert row["error"].endswith("given up after 2 tries")
    assert (row["status"], row["exit_code"]) == ("failed", ExitCode.BUG)


def test_a_log_that_changes_before_its_run_leaves_no_run(home: Path) -> None:
    """Or the result of what it was in between would stay as that of what it is."""
    content = Path("logs/good.mcap").read_bytes()

    def cut(event: Event) -> None:
        if isinstance(event, Started):
            Path("logs/good.mcap").write_bytes(content[: len(content) // 2])

    asked = {"sources": ("logs/good.mcap",), "grids": ("6x6",)}
    document, _ = batch(**asked, listen=cut)
    assert document["cells"][0]["error"].startswith("logs/good.mcap: changed since it was first read")
    assert document["exit_code"] == ExitCode.USAGE
    Path("logs/good.mcap").write_bytes(content)
    document, ran = batch(**asked)
    assert (len(ran), document["exit_code"]) == (1, 0)


def test_the_same_results_whoever_makes_them(home: Path) -> None:
    one = json.loads(next(Path("runs/batch/cells").glob("good-*/run.json")).read_text())
    document, _ = batch(sources=("logs/good.mcap",), directory=Path("other"))
    two = json.loads(Path("other", document["cells"][0]["directory"], "run.json").read_text())
    assert one["outputs"] == two["outputs"]


def test_runs_that_share_a_directory_are_made_once(home: Path) -> None:
    Path("copies").mkdir()
    shutil.copy("logs/good.mcap", "copies/good.mcap")
    asked = BatchOptions(sources=("logs/good.mcap", "copies/good.mcap"), directory=Path("new"))
    planned = plan_batch(request_of(asked), lambda *args: None)
    assert (len(planned.cases), len(planned.missing)) == (2, 1)


def test_a_log_that_cannot_be_run_is_named_in_its_own_row(home: Path) -> None:
    """Two logs of one name and content share a run."""
    Path("logs/sub").mkdir()
    shutil.copy("logs/empty.mcap", "logs/sub/empty.mcap")
    for sources in (("logs/empty.mcap", "logs/sub"), ("logs/sub", "logs/empty.mcap")):
        document, ran = batch(sources=sources, directory=Path("new"))
        assert len(ran) == 1
        assert all(row["error"].startswith(f"{row['log']}: ") for row in document["cells"])


def test_parts_are_the_whole(home: Path) -> None:
    def names(part: str | None) -> list[str]:
        asked = BatchOptions(sources=("logs", "gone.bag"), grids=("5x5", "6x6"), part=part)
        return [case.name for case in plan_batch(request_of(asked), lambda *args: None).cases]

    parts = [names(f"{k}/3") for k in (1, 2, 3)]
    assert sorted(name for part in parts for name in part) == sorted(names(None))
    assert {len(part) for part in parts} == {2, 3}
    Path("runs/batch/batch.json").unlink()
    document, _ = batch(part="3/4")
    assert [row["log"] for row in document["cells"]] == ["logs/good.mcap"]
    assert not Path("runs/batch/batch.json").exists()


def test_baselines(home: Path) -> None:
    good = {"sources": ("logs/good.mcap",), "baseline": Path("base.json")}
    document, _ = batch(**good, update_baseline=True)
    assert (document["baseline"], document["exit_code"]) == (None, 0)
    document, _ = batch(**good, gates=("baseline",))
    assert document["baseline"]["same"] == 1
    assert document["cells"][0]["gates"][1:] == [{"gate": "baseline", "value": 0, "passed": True, "why": ""}]

    kept = json.loads(Path("base.json").read_text())
    kept["cells"][0]["figures"]["search.evaluations_per_scan.mean"] /= 2
    kept["cells"].append({"name": "old.bag robust", "exit_code": 0, "figures": {}})
    Path("base.json").write_text(json.dumps(kept))
    document, _ = batch(**good)
    assert document["exit_code"] == 0
    assert (document["baseline"]["worse"], document["baseline"]["missing"]) == (1, ["old.bag robust"])
    document, _ = batch(**good, gates=("baseline",))
    assert document["exit_code"] == ExitCode.GATE_FAILED
    assert "search.evaluations_per_scan.mean went from" in document["cells"][0]["gates"][1]["why"]
    document, _ = batch(**good, tolerances=("search.evaluations_per_scan.mean=200%",))
    assert document["baseline"]["worse"] == 0


def test_a_tolerance_for_a_metric_that_the_baseline_lacks_fails_its_gate(home: Path) -> None:
    good = {"sources": ("logs/good.mcap",), "baseline": Path("base.json")}
    batch(**good, update_baseline=True)
    said = "base.json has no timing.cpu_s; add it with --update-baseline and this --tolerance"
    mine = good | {"tolerances": ("timing.cpu_s=1000%",)}
    document, _ = batch(**mine, gates=("baseline",))
    assert document["cells"][0]["gates"][1:] == [{"gate": "baseline", "value": 1, "passed": False, "why": said}]
    assert (document["exit_code"], missing_lines(document)) == (ExitCode.GATE_FAILED, [])
    document, _ = batch(**mine)
    assert (document["exit_code"], missing_lines(document)) == (0, [("warning", f"{said}; it is not compared")])
    document, _ = batch(**mine, update_baseline=True)
    assert missing_lines(document) == []
    document, _ = batch(**mine, gates=("baseline",))
    assert (document["exit_code"], document["baseline"]["lacking"]) == (0, [])


def test_a_whole_batch_as_the_baseline(home: Path) -> None:
    document, _ = batch(baseline=Path("runs/batch"))
    assert (document["baseline"]["same"], document["baseline"]["missing"]) == (4, [])


@pytest.mark.parametrize(
    ("more", "error", "said"),
    [
        ({"sources": ()}, UsageError, "no logs"),
        ({"sources": ("a.yaml", "b.yml")}, UsageError, "2 manifests"),
        ({"sources": ("gone.yaml",)}, ConfigError, "gone.yaml"),
        ({"gates": ("baseline",)}, UsageError, "no baseline; name one"),
        ({"update_baseline": True}, UsageError, "no baseline; name one"),
        ({"update_baseline": True, "baseline": Path("logs")}, UsageError, "logs is a directory"),
        ({"update_baseline": True, "baseline": Path("runs/batch/batch.json")}, UsageError, "batch.json would be lost"),
        ({"update_baseline": True, "baseline": Path("logs/good.mcap/b")}, OutputError, "good.mcap is no directory"),
        ({"baseline": Path("gone.json")}, UsageError, "the baseline cannot be read"),
        ({"accept": (9,)}, UsageError, "--accept 9"),
        ({"tolerances": ("x",)}, UsageError, "--tolerance 'x'"),
        ({"part": "1"}, UsageError, "--part '1'"),
        ({"part": "3/2"}, UsageError, "part 3/2 is none"),
        ({"directory": Path("logs")}, OutputError, "holds other files"),
    ],
)
def test_what_cannot_be_done_is_said_before_the_work(home: Path, more: dict, error: type, said: str) -> None:
    with pytest.raises(error, match=said):
        batch(**more, listen=lambda event: pytest.fail("nothing is to be run"))


def test_a_part_may_be_empty(home: Path) -> None:
    assert BatchPart(2, 2).number == 2
    document, ran = batch(sources=("logs/good.mcap",), part="2/2")
    assert (document["cells"], ran, document["exit_code"]) == ([], [], 0)


def test_a_run_that_takes_too_long(home: Path) -> None:
    ended: list[Event] = []
    document, _ = batch(sources=("logs/good.mcap",), grids=("7x7",), timeout_s=0.01, listen=ended.append)
    assert document["cells"][0]["error"] == "took longer than 0.01 s"
    assert len([event for event in ended if isinstance(event, Ended)]) == 1


MANIFEST = """
logs:
  - logs/*.mcap
  - {log: logs/good.mcap, gates: scans.processed>=1000}
  - {log: logs/cut.mcap, accept: 3}
  - {log: logs/empty.mcap, accept: 4, gates: baseline}
baseline: base.json
"""


def test_what_several_entries_say_of_a_log_holds_together(home: Path) -> None:
    """A pattern for all, and then what is known of some."""
    Path("night.yaml").write_text(MANIFEST)
    kept = {"name": f"logs/good.mcap robust {NAME}", "exit_code": 0, "figures": {"map.accepted_share": 2.0}}
    Path("base.json").write_text(json.dumps({"mavnav_version": "0", "cells": [kept]}))
    document, ran = batch(sources=("night.yaml",), directory=Path("runs/batch"))
    assert ran == [f"logs/empty.mcap robust {NAME}"]
    assert {row["log"]: (row["exit_code"], row["code"]) for row in document["cells"]} == {
        "logs/cut.mcap": (3, 0),
        "logs/empty.mcap": (4, 0),
        "logs/good.mcap": (0, 1),
    }
    assert {row["log"]: [gate["gate"] for gate in row["gates"]] for row in document["cells"]} == {
        "logs/cut.mcap": ["verdict<=suspect"],
        "logs/empty.mcap": ["baseline"],
        "logs/good.mcap": ["verdict<=suspect", "scans.processed>=1000"],
    }


def test_references_of_a_log_that_a_pattern_names_as_well(home: Path) -> None:
    Path("a.tum").write_text("0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")
    Path("b.tum").write_text("0 0 0 0 0 0 0 1\n1 2 0 0 0 0 0 1\n")
    logs = "logs: [logs/*.mcap, {log: logs/good.mcap, truth: a.tum, gates: reference.ate.rmse_m<=1}"

    def truths(text: str) -> dict[str, Path | None]:
        Path("night.yaml").write_text(text)
        cases = plan_batch(request_of(BatchOptions(sources=("night.yaml",))), lambda *args: None).cases
        return {case.log: case.run.request.options.get("truth") for case in cases if case.run}

    assert truths(f"{logs}, logs/good.mcap]") == dict.fromkeys(("logs/cut.mcap", "logs/empty.mcap")) | {
        "logs/good.mcap": Path("a.tum")
    }
    with pytest.raises(UsageError, match="two entries compare it with different references"):
        truths(f"{logs}, {{log: logs/good.mcap, truth: b.tum}}]")


def test_a_part_misses_nothing_and_makes_no_baseline(home: Path) -> None:
    mine = {"sources": ("logs/good.mcap", "logs/cut.mcap"), "baseline": Path("base.json"), "accept": (3,)}
    batch(**mine, update_baseline=True)
    document, _ = batch(**mine, gates=("baseline",), part="1/2")
    assert (document["baseline"]["missing"], document["exit_code"]) == ([], 0)
    document, _ = batch(**mine | {"sources": ("logs/good.mcap",)}, gates=("baseline",))
    assert (len(document["baseline"]["missing"]), document["exit_code"]) == (1, ExitCode.GATE_FAILED)
    with pytest.raises(UsageError, match="--part and --only for some"):
        batch(**mine, update_baseline=True, part="1/2")


def test_some_logs_of_a_manifest_make_no_baseline(home: Path) -> None:
    Path("night.yaml").write_text("logs: [logs/good.mcap, {log: logs/cut.mcap, name: cut}]")
    some = {"sources": ("night.yaml",), "baseline": Path("base.json"), "update_baseline": True}
    with pytest.raises(UsageError, match="--part and --only for some"):
        batch(**some, only=("cut",))


def test_a_log_without_a_name_is_chosen_by_its_path(home: Path) -> None:
    Path("night.yaml").write_text("logs: [logs/good.mcap, {log: logs/cut.mcap, name: cut}]")
    document, _ = batch(sources=("night.yaml",), only=("logs/good.mcap",))
    assert [row["log"] for row in document["cells"]] == ["logs/good.mcap"]
    with pytest.raises(UsageError, match=r"known are logs/good\.mcap, cut"):
        batch(sources=("night.yaml",), only=("logs/cut.mcap",))


def test_two_logs_of_one_name_are_refused(home: Path) -> None:
    Path("night.yaml").write_text("logs: [{log: logs/good.mcap, name: a}, {log: logs/cut.mcap, name: a}]")
    with pytest.raises(UsageError, match=r"two logs are named 'a', logs/good\.mcap and logs/cut\.mcap; give each"):
        batch(sources=("night.yaml",))


def test_a_run_that_cannot_be_written_leaves_the_baseline_as_it_was(home: Path) -> None:
    good = {"sources": ("logs/good.mcap",), "baseline": Path("base.json"), "update_baseline": True}
    batch(**good)
    before = Path("base.json").read_bytes()
    shutil.rmtree("runs/batch/cells")
    Path("runs/batch/cells").write_bytes(b"")
    document, _ = batch(**good)
    assert document["exit_code"] == ExitCode.OUTPUT
    assert Path("base.json").read_bytes() == before


@pytest.mark.parametrize("wrong", ["accept: 9", "gates: scans.processed<=7m", "gates: baseline"])
def test_what_an_entry_asks_is_read_before_the_logs(home: Path, wrong: str) -> None:
    Path("night.yaml").write_text(f"logs: [{{log: logs/good.mcap, {wrong}}}]")
    with pytest.raises(UsageError, match=r"accept: 9|m' is not NAME|no baseline"):
        request_of(BatchOptions(sources=("night.yaml",)))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("gates: [scans.total>=1,\n  tracking.lots==false]", "5: no number tracking.lots in run.json; did you mean"),
        ("gates: foo<=1", "4: no number foo in run.json; .*, write for example wall_thickness.p95_mm<=150, or base"),
        ("gates:\n  - basline", "5: gate 'basline' is not NAME, .* write for example .*, or baseline"),
        ("accept: [3, 99]", "4: accept: 99: no exit code of mavnav"),
        ("tolerances: {wall_thickness.p95_mm: 5,\n  timing.cpu_s: much}", "5: the tolerance 'much' of timing.cpu_s"),
        ("tolerances: {timing.cpu_s: -5}", "4: the tolerance '-5.0' of timing.cpu_s is negative"),
        (
            "tolerances:\n  wall_thickness.p59_mm: 5",
            "5: no number wall_thickness.p59_mm in run.json; did you mean wall_thickness.p95_mm",
        ),
    ],
)
@pytest.mark.parametrize("of_log", [False, True])
def test_errors_in_a_manifest_have_its_line(home: Path, of_log: bool, wrong: str, said: str) -> None:
    indent = "    " if of_log and not wrong.startswith("tolerances") else ""
    lines = ["logs:", "  - log: logs/good.mcap", "    end_s: 0.5", *(indent + line for line in wrong.split("\n"))]
    Path("night.yaml").write_text("\n".join(lines))
    with pytest.raises(ConfigError, match=f"^night.yaml:{said}"):
        plan_batch(request_of(BatchOptions(sources=("night.yaml",))), lambda *args: None)


def test_a_gate_of_the_command_line_has_no_line(home: Path) -> None:
    Path("night.yaml").write_text("logs: [logs/good.mcap]\ngates: scans.total>=1\n")
    for gate, said in (("basline", "^--gate 'basline' is not"), ("foo<=1", "^no number foo .*example --gate")):
        with pytest.raises(UsageError, match=said):
            plan_batch(request_of(BatchOptions(sources=("night.yaml",), gates=(gate,))), lambda *args: None)
