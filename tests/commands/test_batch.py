"""mavnav batch: what it prints, and how it ends."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from mavnav.batch import runner
from mavnav.commands import signals
from mavnav.errors import ExitCode
from mavnav.slam.methods import registry


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Be in a folder with an empty one."""
    (tmp_path / "logs").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_table_on_stdout_and_a_line_a_run_on_stderr(mavnav: Callable, empty: Path) -> None:
    code, out, err = mavnav("batch", "logs", "gone.bag")
    assert code == ExitCode.USAGE
    lines = out.splitlines()
    assert [line.split()[0] for line in lines[:3]] == ["run", "gone.bag", "logs"]
    assert lines[-1] == "0 of 2 runs passed, 2 could not be made; runs/batch/batch.html"
    assert "mavnav: 1 of 2: logs robust 20/10x10: logs: no logs in this folder" in err
    assert "mavnav: 2 of 2: gone.bag robust 20/10x10: gone.bag: no such file" in err


def test_a_line_of_json_a_run_and_a_last_one(mavnav: Callable, empty: Path) -> None:
    code, out, _ = mavnav("batch", "logs", "gone.bag", "--json", "-q")
    events = [json.loads(line) for line in out.splitlines()]
    assert [event["event"] for event in events] == ["run", "run", "batch"]
    assert [event["exit_code"] for event in events] == [4, 2, code]
    assert "cells" not in events[-1]


@pytest.mark.parametrize(("source", "code"), [("sample_lgos", 2), ("logs", 4), ("*.mcapp", 2)])
def test_an_earlier_batch_is_kept_where_no_log_can_be_read(
    mavnav: Callable, empty: Path, source: str, code: int
) -> None:
    earlier = Path("runs/batch/batch.json")
    earlier.parent.mkdir(parents=True)
    earlier.write_text("kept")
    assert mavnav("batch", source)[0] == code
    assert [(path.name, path.read_text()) for path in earlier.parent.iterdir()] == [("batch.json", "kept")]


@pytest.mark.parametrize(("workers", "text"), [(1, "1 worker;"), (2, "2 workers;")])
def test_a_cluster_is_reported_with_its_workers(
    mavnav: Callable, empty: Path, monkeypatch: pytest.MonkeyPatch, workers: int, text: str
) -> None:
    found = SimpleNamespace(workers=workers, dashboard="http://127.0.0.1:8787/status")
    monkeypatch.setattr("mavnav.jobs.dask.connect", lambda *_: nullcontext(found))
    assert f"mavnav: {text} dashboard at {found.dashboard}\n" in mavnav("batch", "gone.bag", "--scheduler", "local")[2]


def test_nothing_at_all_leaves_nothing(mavnav: Callable, empty: Path) -> None:
    code, out, err = mavnav("batch", "-q")
    assert (code, out) == (ExitCode.USAGE, "")
    assert err == "mavnav: error: no logs; list them in a manifest, or name logs, patterns or folders\n"
    assert not Path("runs").exists()


@pytest.mark.parametrize("option", ["--junit", "--summary"])
def test_a_folder_is_no_file_and_stays(mavnav: Callable, empty: Path, option: str) -> None:
    Path("logs/notes.txt").write_text("mine")
    code, out, err = mavnav("batch", "gone.bag", option, "logs", "-q")
    assert (code, out, err) == (ExitCode.OUTPUT, "", "mavnav: error: logs is a directory; name a file\n")
    assert Path("logs/notes.txt").read_text() == "mine"
    assert not Path("runs").exists()


def test_the_verdict_is_told_though_a_file_cannot_be_written(
    mavnav: Callable, empty: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavnav.outputs.directory.check_parent", lambda _: None)  # as if it had become a file meanwhile
    Path("file").write_text("")
    code, out, err = mavnav("batch", "gone.bag", "--junit", "file/batch.xml", "-q")
    assert code == ExitCode.OUTPUT
    assert out.splitlines()[-1] == "0 of 1 runs passed, 1 could not be made; runs/batch/batch.html"
    assert err.startswith("mavnav: error: file/batch.xml cannot be written")


def test_a_part_leads_to_no_page(mavnav: Callable, empty: Path) -> None:
    out = mavnav("batch", "gone.bag", "--part", "1/2", "-q")[1]
    assert out.splitlines()[-1] == "0 of 1 runs passed, 1 could not be made; runs/batch"
    assert not Path("runs/batch/batch.html").exists()


def test_an_interrupted_batch_says_what_stays(mavnav: Callable, empty: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise signals.Interrupted

    monkeypatch.setattr(runner, "run_batch", interrupted)
    code, out, err = mavnav("batch", "logs", "-q")
    assert (code, out) == (ExitCode.INTERRUPTED, "")
    assert err.splitlines() == [
        "mavnav: runs that are finished stay in runs/batch; the same call makes the others",
        "mavnav: interrupted",
    ]


def test_kernels_are_there_before_the_workers(mavnav: Callable, empty: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or all of them would compile at once, and what that takes would count against the time of a run."""
    loaded: list[str] = []
    monkeypatch.setattr(registry, "load_kernels", lambda config, _: loaded.append(config.method))
    monkeypatch.setattr(runner, "run_batch", lambda *_: pytest.fail("too early") if not loaded else _stop())
    Path("logs/a.mcap").write_bytes(b"")
    mavnav("batch", "logs", "gone.bag", "--method", "robust", "--method", "paper", "-q")
    assert loaded == ["robust", "paper"]


def _stop() -> None:
    raise signals.Interrupted


def test_the_schema_of_manifests(mavnav: Callable) -> None:
    code, out, _ = mavnav("batch", "--schema")
    assert code == 0
    assert {"logs", "runs", "gates", "baseline"} <= set(json.loads(out)["properties"])


def test_help_names_the_extra(mavnav: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert "mavnav[cluster]" in mavnav("batch", "--help")[1]


INPUT, OWN = "which is an input; name another file", "is a file of the batch itself; name another file"


@pytest.mark.parametrize("option", ["--junit", "--summary"])
@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("logs/a.mcap", INPUT),
        ("logs/../link.mcap", INPUT),
        ("rosbag/metadata.yaml", INPUT),
        ("rosbag/a.db3", INPUT),
        ("m.yaml", INPUT),
        ("c.yaml", INPUT),
        ("run.yaml", INPUT),
        ("truth.tum", INPUT),
        ("plan.pgm", INPUT),
        ("before/batch.json", INPUT),
        ("runs/b/batch.json", OWN),
        ("runs/b/batch.csv", OWN),
        ("runs/b/batch.html", OWN),
        ("runs/b/cells/a/run.json", OWN),
        ("runs/b", "runs/b is a directory of the batch; name another file"),
        ("runs", "runs is a directory of the batch; name another file"),
    ],
)
def test_a_file_that_is_read_or_written_otherwise_is_refused(
    mavnav: Callable, empty: Path, option: str, file: str, words: str
) -> None:
    Path("rosbag").mkdir()
    Path("before").mkdir()
    Path("before/batch.json").write_text('{"cells": [], "mavnav_version": "1"}')
    for name in ("logs/a.mcap", "rosbag/metadata.yaml", "rosbag/a.db3", "truth.tum", "plan.pgm"):
        Path(name).write_text("mine")
    Path("link.mcap").symlink_to("logs/a.mcap")
    Path("c.yaml").write_text("azimuth: 20\n")
    Path("run.yaml").write_text("azimuth: 10\n")
    Path("plan.yaml").write_text("image: plan.pgm\nresolution: 0.05\n")
    entry = "{log: rosbag, truth: truth.tum, truth_map: plan.yaml}"
    Path("m.yaml").write_text(f"logs: [{entry}]\nruns: [{{config: run.yaml}}]\nbaseline: before\n")
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    config = ("--config", "c.yaml") if file == "c.yaml" else ()
    code, out, err = mavnav("batch", "m.yaml", "logs", *config, option, file, "-o", "runs/b", "-q")
    assert (code, out, err.count("\n")) == (ExitCode.USAGE, "", 1)
    assert err.startswith(f"mavnav: error: {option}: {file} ")
    assert words in err
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before


def test_two_files_need_two_names(mavnav: Callable, empty: Path) -> None:
    code, _, err = mavnav("batch", "logs", "--junit", "a", "--summary", "logs/../a", "-q")
    assert (code, err) == (2, "mavnav: error: --junit and --summary are both logs/../a; name two files\n")
    Path("loop").symlink_to("loop")
    assert mavnav("batch", "logs", "--junit", "loop", "--summary", "loop", "-q")[0] == ExitCode.USAGE
    new = ("--baseline", "a", "--update-baseline")
    assert "--junit and --baseline are both a" in mavnav("batch", "logs", "--junit", "a", *new, "-q")[2]


def test_files_beside_those_of_the_batch_are_written(mavnav: Callable, empty: Path) -> None:
    files = ("--junit", "runs/batch/batch.xml", "--summary", "logs/batch.md")
    for _ in range(2):
        assert mavnav("batch", "logs", *files, "-q")[0] == ExitCode.NO_SCANS
    assert Path("runs/batch/batch.xml").is_file()
    assert Path("logs/batch.md").is_file()


def test_a_new_baseline_is_named_with_what_failed(mavnav: Callable, empty: Path) -> None:
    asked = ("batch", "gone.bag", "lost.bag", "--baseline", "base.json", "--update-baseline")
    said = "mavnav: wrote the baseline base.json; 2 of 2 runs in it failed\n"
    assert said in mavnav(*asked)[2]
    assert "baseline" not in mavnav(*asked, "-q")[2]


def test_a_baseline_that_stays_for_a_full_disk_is_named(mavnav: Callable, empty: Path, sample: Path) -> None:
    Path("runs/batch/batch.json").parent.mkdir(parents=True)
    Path("runs/batch/batch.json").write_text("{}")
    Path("runs/batch/cells").write_bytes(b"")
    asked = ("--baseline", "base.json", "--update-baseline", "--online", "-q")
    code, _, err = mavnav("batch", sample, *asked)
    assert (code, Path("base.json").exists()) == (ExitCode.OUTPUT, False)
    assert "mavnav: warning: no baseline base.json is written: runs could not be; make room" in err
