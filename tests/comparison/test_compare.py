"""Comparisons: files, runs that are reused, and runs that fail alone."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec.structs import replace

from mavnav.api.results import Comparison
from mavnav.batch.request import BatchRequest
from mavnav.batch.runner import BatchPlan, plan_batch
from mavnav.comparison.document import problems
from mavnav.comparison.pipeline import (
    comparison_request,
    comparison_settings,
    is_report_current,
    plan_comparison,
    run_comparison,
    short_names,
)
from mavnav.errors import ExitCode, OutputError, UsageError
from mavnav.jobs.run_cache import run_key
from mavnav.jobs.worker import Event, Started
from mavnav.metrics.gates import parse_gate
from mavnav.profiling import silent

SAMPLE = Path(__file__).parents[2] / "sample_logs" / "corridor.mcap"
GRIDS = ("5x5", "12x12")


def request(directory: Path, *logs: Path, grids: tuple[str, ...] = GRIDS, **more: object) -> BatchRequest:
    settings = comparison_settings(None, ["azimuth=6"], (), grids, (), {"final_pass": False})
    reading = {"end_s": 0.5} | more.pop("reading", {})  # type: ignore[operator]
    return comparison_request(logs or (SAMPLE,), settings, directory, reading, **more)  # type: ignore[arg-type]


def plan(wanted: BatchRequest) -> BatchPlan:
    return plan_comparison(wanted, silent)


def keys_of(wanted: BatchRequest) -> list[str]:
    return [case.run.key for case in plan(wanted).cases if case.run]


def run(wanted: BatchRequest, on_event: Callable[[Event], None] = lambda event: None) -> dict:
    return run_comparison(plan(wanted), on_event)


@pytest.fixture
def finished(comparison: Path) -> tuple[Path, dict]:
    return comparison, json.loads((comparison / "comparison.json").read_text())


@pytest.fixture
def copied(comparison: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(comparison, tmp_path / "copy"))


def test_every_combination_is_a_run(finished: tuple[Path, dict]) -> None:
    directory, document = finished
    assert document["exit_code"] == 0
    assert [(c["grid"], c["azimuth"], c["status"]) for c in document["cells"]] == [(g, 6, "done") for g in GRIDS]
    for cell in document["cells"]:
        assert cell["directory"] == f"cells/corridor-robust-{cell['azimuth']}-{cell['grid']}-{cell['key'][:8]}"
        ran = json.loads((directory / cell["directory"] / "run.json").read_text())
        assert ran["grid"] == cell["grid"]
        assert all(ran[name] == section for name, section in cell["run"].items())
        assert {"scans", "tracking", "search", "timing", "wall_thickness"} <= set(cell["run"])


def test_the_files_say_the_same(finished: tuple[Path, dict]) -> None:
    directory, document = finished
    files = {"cells", "comparison.json", "comparison.csv", "comparison.md", "report.html"}
    assert files == {path.name for path in directory.iterdir() if path.suffix != ".png"}
    assert json.loads((directory / "comparison.json").read_text()) == document
    rows = list(csv.DictReader((directory / "comparison.csv").read_text().splitlines()))
    assert [row["grid"] for row in rows] == list(GRIDS)
    assert float(rows[1]["timing.cpu_s"]) == document["cells"][1]["run"]["timing"]["cpu_s"]
    assert float(rows[1]["price.evaluations"]) == document["price"]["evaluations"][1] > 1
    markdown = (directory / "comparison.md").read_text().splitlines()
    assert markdown[2] == document["headline"]
    assert {line.count(" | ") for line in markdown[4:]} == {markdown[4].count(" | ")}
    assert len(markdown) == 4 + 2 + len(GRIDS)
    assert [row["verdict"] for row in rows] == [cell["run"]["verdict"]["word"] for cell in document["cells"]]
    assert {row["finding"] for row in rows} == {document["headline"]}


def test_what_was_run_is_not_run_again(copied: Path, finished: tuple[Path, dict]) -> None:
    again = plan(request(copied))
    assert again.missing == []
    document = run_comparison(again, lambda event: pytest.fail("nothing is to be run"))
    assert [cell["status"] for cell in document["cells"]] == ["cached", "cached"]
    assert document["winners"] == finished[1]["winners"]
    assert document["price"] == finished[1]["price"]


def test_a_report_of_the_same_results_is_not_drawn_again(copied: Path) -> None:
    assert is_report_current(plan(request(copied)))
    assert not is_report_current(plan(request(copied, force=True)))
    assert not is_report_current(plan(request(copied, grids=("5x5",))))
    (copied / "comparison.json").write_text("[]")
    assert not is_report_current(plan(request(copied)))


def test_a_report_that_was_removed_is_drawn_again(copied: Path) -> None:
    (copied / "report.html").unlink()
    assert not is_report_current(plan(request(copied)))


def test_a_batch_in_the_same_directory_reuses_the_runs(copied: Path) -> None:
    assert plan_batch(replace(request(copied), patterns=True), silent).missing == []


def test_force_runs_again(copied: Path) -> None:
    assert len(plan(request(copied, force=True)).missing) == 2


def test_only_what_is_missing_is_run(copied: Path) -> None:
    wanted = plan(request(copied, grids=("5x5", "6x6")))
    assert [str(case.run.request.config.grid) for case in wanted.missing if case.run] == ["6x6"]


def test_a_torn_run_is_run_again(copied: Path, finished: tuple[Path, dict]) -> None:
    first, second = (copied / cell["directory"] / "run.json" for cell in finished[1]["cells"])
    first.write_text("{")
    second.unlink()
    assert len(plan(request(copied)).missing) == 2


def test_the_key_holds_all_that_decides_the_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = Path(shutil.copy(SAMPLE, tmp_path / "a.mcap"))

    def keys(**more: object) -> list[str]:
        return keys_of(request(tmp_path / "out", log, **more))  # type: ignore[arg-type]

    first = keys()
    assert keys() == first
    moved = Path(shutil.copy(log, tmp_path / "b.mcap"))
    assert keys_of(request(tmp_path / "out", moved)) == first
    assert not set(keys(grids=("4x5", "5x4"))) & set(first)
    planned = plan(request(tmp_path / "out", log)).cases[0].run
    assert planned is not None
    assert run_key(planned.request, "other log", "") not in first
    monkeypatch.setattr("mavnav.jobs.run_cache.__version__", "99.0.0")
    assert not set(keys()) & set(first)
    monkeypatch.undo()
    monkeypatch.setattr("mavnav.jobs.run_cache.source_sha256", lambda: "other code")
    assert not set(keys()) & set(first)


def test_references_are_read_before_the_work_and_are_part_of_the_key(tmp_path: Path) -> None:
    truth = tmp_path / "truth.tum"

    def key(**references: Path) -> str:
        return keys_of(request(tmp_path / "out", reading=references))[0]

    def with_truth(*ys: float) -> str:
        truth.write_text("".join(f"{k / 10:.1f} {k} {y} 0 0 0 0 1\n" for k, y in enumerate(ys)))
        return key(truth=truth)

    keys = [key(), with_truth(0, 0, 0), with_truth(0, 0, 1), key(truth_map=Path("corridor"))]
    assert len(set(keys)) == 4
    assert with_truth(0, 0, 0) == keys[1]
    truth.write_text("no truth\n")
    with pytest.raises(UsageError, match=r"truth\.tum"):
        key(truth=truth)
    with pytest.raises(UsageError, match="one log at a time"):
        request(tmp_path / "out", SAMPLE, truth, reading={"truth_map": Path("corridor")})


def test_a_truth_in_the_log_is_part_of_the_key(tmp_path: Path) -> None:
    def keys(**reading: str) -> list[str]:
        return keys_of(request(tmp_path / "out", reading=reading))

    named = keys(truth="topic:/ground_truth")
    assert len({*keys(), *keys(truth="auto"), *named}) == 3 * len(GRIDS)
    both = request(tmp_path / "out", SAMPLE, SAMPLE.with_name("other.mcap"), reading={"truth": "auto"})
    assert len(both.entries) == 2
    case = plan(request(tmp_path / "out", reading={"truth": "auto"})).cases[0]
    assert case.has_references
    assert case.run is not None
    assert case.run.request.options["truth"] == "auto"


def test_the_same_log_twice_is_compared_once(tmp_path: Path) -> None:
    copy = Path(shutil.copy(SAMPLE, tmp_path / "copy.mcap"))
    assert len(plan(request(tmp_path / "out", SAMPLE, copy, SAMPLE)).cases) == 2


@pytest.mark.slow
def test_a_killed_worker_costs_its_run_alone(tmp_path: Path) -> None:
    directory = tmp_path / "out"

    def kill_the_first(event: Event) -> None:
        if isinstance(event, Started) and event.index == 0:
            os.kill(event.pid, signal.SIGKILL)

    document = run(request(directory), kill_the_first)
    first, second = document["cells"]
    assert (first["status"], second["status"]) == ("failed", "done")
    assert first["error"].startswith("its process was killed by SIGKILL")
    assert first["error"].endswith("given up after 3 tries")
    assert first["run"] is first["directory"] is None
    assert (first["exit_code"], document["exit_code"]) == (ExitCode.BUG, ExitCode.BUG)
    assert "corridor.mcap robust 6/5x5: its process was killed" in (directory / "comparison.md").read_text()
    assert [path.name for path in (directory / "cells").iterdir()] == [second["directory"].removeprefix("cells/")]

    ran: list[int] = []
    document = run(request(directory), lambda event: ran.append(event.index))
    assert set(ran) == {0}
    assert [cell["status"] for cell in document["cells"]] == ["done", "cached"]
    assert document["exit_code"] == 0


def test_a_log_without_scans_fails_alone(tmp_path: Path, copied: Path) -> None:
    empty = tmp_path / "empty.mcap"
    empty.write_bytes(b"no log")
    document = run(request(copied, empty, SAMPLE))
    assert [cell["status"] for cell in document["cells"]] == ["failed", "failed", "cached", "cached"]
    assert document["exit_code"] == ExitCode.NO_SCANS
    assert document["cells"][0]["error"].startswith(str(empty))
    assert [log["cells"] for log in document["logs"]] == [[0, 1], [2, 3]]
    assert set(map(tuple, document["logs"][0]["best"].values())) == {()}
    assert document["logs"][1]["best"]["search.evaluations_per_scan.mean"] == [2]
    assert set(document["winners"].values()) == {None}
    assert document["price"]["coarsest"] == [None, None, 2, 2]


def test_gates_hold_for_every_run(copied: Path) -> None:
    gates = (parse_gate("scans.processed>=3"), parse_gate("price.evaluations<=1"))
    document = run(request(copied, gates=gates))
    assert [(g["cell"], g["passed"]) for g in document["gates"]] == [(0, True), (0, True), (1, True), (1, False)]
    assert document["gates"][3]["why"].startswith("it is ")
    assert document["exit_code"] == ExitCode.GATE_FAILED


def test_unknown_gates_stop_before_the_work(copied: Path) -> None:
    with pytest.raises(UsageError, match=r"did you mean scans.processed\?"):
        plan(request(copied, gates=(parse_gate("scans.procesed>=3"),)))
    with pytest.raises(UsageError, match=r"no number price.foo in run.json; price has evaluations, cpu, seconds$"):
        plan(request(copied, gates=(parse_gate("price.foo<=3"),)))


def test_a_number_that_a_run_lacks_fails_there(copied: Path) -> None:
    """All the others are done by then: there is a comparison."""
    document = run(request(copied, gates=(parse_gate("tracking.intervals.7.scans<=3"),)))
    assert [gate["why"] for gate in document["gates"]] == ["this run has no such number"] * 2
    assert document["exit_code"] == ExitCode.GATE_FAILED


def test_a_directory_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(OutputError, match="holds other files"):
        plan(request(tmp_path))
    with pytest.raises(OutputError, match="is a file; choose another"):
        plan(request(tmp_path / "thesis.tex"))


@pytest.mark.slow
def test_logs_of_one_file_name_have_names_of_their_own(tmp_path: Path) -> None:
    content = SAMPLE.read_bytes()
    for folder, length in (("p1", len(content)), ("p2", len(content) // 2)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.mcap").write_bytes(content[:length])
    logs = [tmp_path / "p1" / "a.mcap", tmp_path / "p2" / "a.mcap"]
    document = run(request(tmp_path / "out", *logs, gates=(parse_gate("scans.processed<1"),)))
    names = [f"{folder}/a.mcap robust 6/{grid}" for folder in ("p1", "p2") for grid in GRIDS]
    assert [cell["name"] for cell in document["cells"]] == names
    assert list(Comparison(tmp_path / "out", document).runs) == names
    assert [line.partition(":")[0] for line in problems(document)] == names


def test_as_little_of_a_path_as_distinguishes_it() -> None:
    names = {"a.bag": "a.bag", "x/a.bag": "x/a.bag", "y/p/b.bag": "y/p/b.bag", "z/p/b.bag": "z/p/b.bag", "/q/c": "c"}
    assert short_names([Path(path) for path in names]) == {Path(path): name for path, name in names.items()}
