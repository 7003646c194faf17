"""The Python interface: what its page and its notebook show is run here."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mavnav

ROOT = Path(__file__).parent.parent
EXAMPLES = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs/python.md").read_text(), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def log() -> Path:
    return ROOT / "sample_logs" / "complex.bag"


@pytest.fixture(scope="module")
def run(log: Path) -> mavnav.Run:
    return mavnav.replay(log, end_s=2)


@pytest.fixture
def folder(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty folder to work in, with a log as the examples call it."""
    shutil.copy(log, tmp_path / "drive.bag")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("number", range(3))
def test_the_examples_run(number: int, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert len(EXAMPLES) == 3
    exec(compile(EXAMPLES[number], f"example {number}", "exec"), {})
    assert capsys.readouterr().out
    assert (folder / "runs/first/run.json").is_file() == (number == 0)


def test_the_notebook_runs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    shown = []
    monkeypatch.setattr(pyplot, "show", lambda: (shown.append(pyplot.gcf()), pyplot.close()))
    cells = json.loads((ROOT / "docs/first_map.ipynb").read_text())["cells"]
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
    assert len(shown) == 2


def test_a_run_has_what_its_files_say(run: mavnav.Run, tmp_path: Path) -> None:
    assert run.trajectory.xyyaw.shape == (len(run.trajectory.stamps_ns), 3)
    assert run.metrics["scans"]["tracked"] == len(run.trajectory)
    assert int((run.map.hits > 0).sum()) == run.metrics["map"]["cells"]
    assert not run.lost
    assert 0.0 <= (run.doubt or 0.0) <= 1.0
    kept = run.save(tmp_path / "kept")
    again = mavnav.load_run(tmp_path / "kept")
    np.testing.assert_array_equal(again.trajectory.xyyaw, run.trajectory.xyyaw)
    with pytest.raises(mavnav.MavnavError, match="exists"):
        run.save(kept.directory)
    assert run.save(kept.directory, force=True).metrics == run.metrics


def test_a_run_without_a_directory_goes_with_its_object(log: Path) -> None:
    run = mavnav.replay(log, end_s=0.5, online=True)
    where = run.directory
    assert (where / "run.json").is_file()
    del run
    assert not where.exists()


def test_the_same_as_the_command(log: Path, run: mavnav.Run, tmp_path: Path) -> None:
    from mavnav.cli import run as command

    assert command(["replay", str(log), "--end", "2", "-q", "-o", str(tmp_path / "run")]) == 0
    for name in ("trajectory.tum", "hits.npz", "map.pgm", "map.png"):
        assert (tmp_path / "run" / name).read_bytes() == (run.directory / name).read_bytes()


def test_steps_of_scans_are_those_of_the_command_on_line(log: Path) -> None:
    opened = mavnav.open_log(log, end_s=2)
    found = [step.match.map_T_laser for step in mavnav.track(opened, period_s=opened.period_s) if step.tracked]
    run = mavnav.replay(log, end_s=2, online=True, odom="off")
    np.testing.assert_allclose(found, run.trajectory.xyyaw, atol=1e-6)


def test_a_mission(tmp_path: Path) -> None:
    run = mavnav.simulate("corner", seed=3, settings={"max_steps": 4}, record=tmp_path / "flight.mcap")
    assert run.metrics["mission"]["steps"] == 4
    assert len(mavnav.open_log(tmp_path / "flight.mcap")) > 0


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: mavnav.replay("nothing.mcap"), "no such file"),
        (lambda: mavnav.replay("nothing.mcap", settings={"robust.cel_mm": 3}), "did you mean robust.cell_mm"),
        (lambda: mavnav.load_run("."), "holds no run"),
        (lambda: mavnav.compare([]), "no log to compare"),
        (lambda: mavnav.simulate("nowhere"), "nowhere"),
        (lambda: mavnav.open_log("nothing.mcap"), "no such file"),
    ],
)
def test_errors_are_one_line(call, said: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(mavnav.MavnavError, match=said) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_every_name_is_there_and_described() -> None:
    for name in mavnav.__all__:
        assert getattr(mavnav, name).__doc__
    assert dir(mavnav) == sorted(mavnav.__all__)
    with pytest.raises(AttributeError):
        _ = mavnav.nothing


def test_importing_is_light() -> None:
    code = "import sys, mavnav\nprint(sorted({'numpy', 'numba', 'pydantic', 'mcap', 'typer'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ast.literal_eval(done.stdout) == []
