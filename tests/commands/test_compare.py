"""mavnav compare: its table, its streams, its exit codes, and what is left when it is stopped."""

from __future__ import annotations

import json
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from conftest import SHORT_COMPARISON
from mavnav.commands.comparison_table import bar, print_comparison
from mavnav.commands.progress import watching
from mavnav.commands.shared import gated_code, gates_of
from mavnav.errors import ExitCode, UsageError
from mavnav.jobs.worker import Ended, Outcome, Retried, Started, Status


@pytest.fixture
def directory(comparison: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(comparison, tmp_path / "copy"))


@pytest.fixture
def again(mavnav: Callable, repo_root: Path, directory: Path) -> Callable[..., tuple[int, str, str]]:
    """Return the same comparison as a command: it only reads its runs again."""
    log = repo_root / "sample_logs" / "corridor.mcap"
    return lambda *args: mavnav("compare", log, "-o", directory, *SHORT_COMPARISON, *args)


def test_a_line_for_every_run(again: Callable, directory: Path) -> None:
    code, out, err = again()
    headline, _, table = out.partition("\n\n")
    assert " ".join(headline.split()) == json.loads((directory / "comparison.json").read_text())["headline"]
    assert headline.startswith(("A finer grid pays on this log: ", "A finer grid does not pay on this log: "))
    lines = table.splitlines()
    assert (code, err) == (0, "")
    assert lines[0].split()[:4] == ["method", "grid", "verdict", "accepted"]
    assert [line.split()[:4] for line in lines[1:3]] == [
        ["robust", "6/5x5", "✓", "good"],
        ["robust", "6/12x12", "✓", "good"],
    ]
    assert all(line.rstrip().endswith("reused") for line in lines[1:3])
    assert lines[-1] == f"report  {directory / 'report.html'}"
    assert max(map(len, lines)) <= 200


def test_runs_of_another_log_in_the_same_directory_are_named(
    mavnav: Callable, directory: Path, tmp_path: Path, sample: Path
) -> None:
    other = shutil.copy(sample, tmp_path / "other.mcap")
    code, _, err = mavnav("compare", other, "-o", directory, *SHORT_COMPARISON)
    assert code == 0 and err.startswith("mavnav: warning: 2 runs of other logs, listed here before, stayed in cells")
    assert len(list((directory / "cells").iterdir())) == 4


@pytest.mark.slow
def test_the_report_is_drawn_once(again: Callable, directory: Path) -> None:
    report = directory / "report.html"
    before = report.stat().st_mtime_ns
    again()
    assert report.stat().st_mtime_ns == before
    report.unlink()
    again()
    assert report.is_file()


def test_a_narrow_terminal_gets_fewer_figures(
    comparison: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    document = json.loads((comparison / "comparison.json").read_text())
    monkeypatch.setattr("mavnav.commands.terminal.UNFOLDED", 80)
    print_comparison(document)
    headline, _, table = capsys.readouterr().out.partition("\n\n")
    assert " ".join(headline.split()) == document["headline"]
    head, *lines = table.splitlines()
    assert len(lines) == len(document["cells"])
    assert max(map(len, [head, *lines])) <= 80
    assert "wall p95 mm" in head
    assert "entropy" not in head


@pytest.mark.parametrize("width", [40, 60, 80, 120])
@pytest.mark.parametrize("several", [False, True])
def test_no_head_and_no_cell_is_cut(
    comparison: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, width: int, several: bool
) -> None:
    """With every metric known, the methods, grids and remarks remain, whatever the width."""
    document = json.loads((comparison / "comparison.json").read_text())
    for cell in document["cells"]:
        cell["azimuth"], cell["grid"], cell["status"] = 40, "40x40", "cached"
        cell["run"]["reference"] = {"ate": {"rmse_m": 0.0123}, "map_distance": {"mean_mm": 12.3}}
        cell["run"]["map_quality"]["meaningful"] = False
    document["logs"] *= 2 if several else 1
    monkeypatch.setattr("mavnav.commands.terminal.UNFOLDED", width)
    print_comparison(document)
    headline, _, table = capsys.readouterr().out.partition("\n\n")
    assert " ".join(headline.split()) == document["headline"]
    head, *lines = table.splitlines()
    assert max(map(len, [head, *lines])) <= width
    assert head.split()[several : several + 2] == ["method", "grid"]
    assert ("wall p95 mm" in head) == (width >= 60)
    assert ("map error mm" in head) == (width >= (80 if several else 60))
    assert sum("robust  40/40x40" in line for line in lines) == len(document["cells"])
    assert " ".join(lines).count("meaningful") == len(document["cells"])


def test_json_is_comparison_json_and_nothing_else(again: Callable, directory: Path) -> None:
    code, out, err = again("--json")
    assert (code, err) == (0, "")
    assert json.loads(out) == json.loads((directory / "comparison.json").read_text())


def test_a_gate_that_does_not_hold(again: Callable) -> None:
    code, out, err = again("--gate", "search.evaluations_per_scan.mean<1", "--gate", "scans.processed>=1")
    assert code == ExitCode.GATE_FAILED
    assert "robust" in out
    lines = err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith(
        "mavnav: error: corridor.mcap robust 6/5x5: gate search.evaluations_per_scan.mean<1 failed:"
    )


def test_previews(again: Callable) -> None:
    _, out, _ = again("--preview")
    assert out.count("corridor.mcap robust") == 2
    assert any(0x2800 < ord(c) < 0x2900 for c in out)
    _, out, err = again("--preview", "--json")
    json.loads(out)
    assert any(0x2800 < ord(c) < 0x2900 for c in err)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["nowhere.mcap"], "no such file"),
        (["--grid", "5"], "write for example --grid 10x10"),
        (
            ["--grid", "5x5", "--grid", "6x6", "--azimuth", "5", "--azimuth", "6", "--azimuth", "7"],
            "3 values of --azimuth",
        ),
        (["--method", "best"], "--method"),
        (["--gate", "thickness"], "write for example --gate"),
        (["-j", "0"], "--jobs"),
        (["--extrinsic", "1"], "--extrinsic"),
        (["--config", "nowhere.yaml"], "nowhere.yaml"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_one_line_for_what_cannot_be_done(mavnav: Callable, tmp_path: Path, args: list[str], words: str) -> None:
    code, out, err = mavnav("compare", "-o", tmp_path / "out", *args)
    assert (code, out) == (ExitCode.USAGE, "")
    assert words in err.splitlines()[-1]
    assert not (tmp_path / "out" / "cells").exists()


def test_a_log_without_scans(mavnav: Callable, tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"no log")
    code, out, err = mavnav("compare", tmp_path / "empty.mcap", "--grid", "10x10", "-o", tmp_path / "out")
    assert code == ExitCode.NO_SCANS
    assert "failed" in out
    assert err.splitlines()[-1].startswith("mavnav: error: empty.mcap robust 20/10x10: ")


@pytest.mark.slow
def test_a_damaged_log_is_named(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(sample.read_bytes()[:50_000])
    code, _, err = mavnav("compare", path, "-o", tmp_path / "out", "--grid", "5x5", "-q")
    assert code == ExitCode.DAMAGED_INPUT
    assert err.splitlines() == [
        f"mavnav: warning: cut.mcap robust {grid}: the log is damaged; what is intact was used"
        for grid in ("10/5x5", "20/10x10")
    ]


def lines_of(process) -> Iterator[str]:
    yield from iter(process.stderr.readline, "")


@pytest.mark.slow
def test_ctrl_c_keeps_the_finished_runs(spawn: Callable, sample: Path, tmp_path: Path) -> None:
    """The signal reaches the parent alone here; on a terminal the workers, which get it too, do not hear it."""
    few = ("-o", tmp_path / "out", "-j", 1, "--end", 0.5, "--online", "--grid", "5x5", "--grid", "60x60")
    process = spawn("compare", sample, *few)
    for line in lines_of(process):
        if "1 of 2" in line:
            break
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (ExitCode.INTERRUPTED, "", "mavnav: interrupted\n")
    (kept,) = (tmp_path / "out" / "cells").iterdir()
    assert kept.name.startswith("corridor-robust-10-5x5-")


def test_a_plain_line_for_every_run_that_ends(capsys: pytest.CaptureFixture[str]) -> None:
    with watching(["a.bag robust 6/5x5", "b\x1b.bag"], quiet=False) as listen:
        listen(Started(1, 7))
        listen(Ended(1, Outcome(Status.DIED, 7, 1.0, error="its process was killed by SIGKILL")))
        listen(Ended(0, Outcome(Status.DONE, 8, 2.04, value={})))
    assert capsys.readouterr().err.splitlines() == [
        "mavnav: 1 of 2: b\\x1b.bag failed: its process was killed by SIGKILL",
        "mavnav: 2 of 2: a.bag robust 6/5x5 done in 2.0 s",
    ]


def test_bars() -> None:
    assert bar(1, 1) == "██████"
    assert bar(0.5, 1) == "███   "
    assert bar(0, 1) == bar(0, 0) == "      "
    assert bar(1, 48) == "▏     "


def test_a_run_that_is_tried_again_has_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Where its end has none, because somebody else tells of it."""
    with watching(["a.bag", "b.bag"], quiet=False, lines=False) as listen:
        listen(Started(1, 4711))
        listen(Retried(1, "its process was killed by SIGKILL"))
        listen(Ended(1, Outcome(Status.DONE, 4712, 1.0)))
    said = "mavnav: b.bag: its process was killed by SIGKILL; it is tried again at the end\n"
    assert capsys.readouterr().err == said


def test_gates_of_a_single_run(mavnav: Callable, sample: Path, tmp_path: Path) -> None:
    few = ("--end", 0.5, "--online", "-q", "--json")
    code, out, err = mavnav("replay", sample, "-o", tmp_path / "r", *few, "--gate", "scans.tracked>100", "--preview")
    assert code == ExitCode.GATE_FAILED
    assert json.loads(out)["exit_code"] == 0
    assert "mavnav: error: gate scans.tracked>100 failed: it is " in err
    assert any(0x2800 < ord(c) < 0x2900 for c in err)
    code, _, err = mavnav("replay", sample, "-o", tmp_path / "t", *few, "--gate", "scans.tracked")
    assert (code, (tmp_path / "t").exists()) == (ExitCode.USAGE, False)


def test_the_exit_code_of_a_run_and_its_gates(capsys: pytest.CaptureFixture[str]) -> None:
    lost = {"exit_code": 5, "scans": {"tracked": 3}}
    assert gated_code(lost, gates_of(["scans.tracked>=4"])) == ExitCode.TRACKING_LOST
    assert gated_code(lost | {"exit_code": 3}, gates_of(["scans.tracked>=4"])) == ExitCode.GATE_FAILED
    assert gated_code(lost | {"exit_code": 3}, gates_of(["scans.tracked>=3"])) == ExitCode.DAMAGED_INPUT
    assert len(capsys.readouterr().err.splitlines()) == 2
    with pytest.raises(UsageError, match=r"did you mean scans.tracked\?"):
        gated_code(lost, gates_of(["scans.traked>100"]))
