"""Other programs in a batch: each a row of its own, whether it gave poses or failed."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from mavnav.batch.options import BatchOptions, request_of
from mavnav.cli import run
from mavnav.errors import ConfigError, ExitCode
from support.small_batch import NAME, batch

COPY = "import shutil, sys\nshutil.copy(*sys.argv[1:])\n"


def programs(*names: str) -> dict[str, object]:
    """Return what adds programs to a batch of one log: ``copies`` has the poses of mavnav, others fail."""
    (poses,) = Path("runs/batch/cells").glob("good-robust*/trajectory.tum")
    Path("copy.py").write_text(COPY)
    commands = {"copies": f"{sys.executable} copy.py {poses} {{out}}", "fails": "false {out}"}
    return {"sources": ("logs/good.mcap",), "programs": [f"{name}={commands[name]}" for name in names]}


def test_programs_are_rows_and_those_that_fail_stop_nothing(home: Path) -> None:
    document, ran = batch(**programs("copies", "fails"), repeat=2, gates=("identical", "map.accepted_share>=0.9"))
    suffix = NAME.removeprefix("6/5x5 final_pass=false ")
    own, copies, fails = (
        f"logs/good.mcap robust {NAME}",
        f"logs/good.mcap copies {suffix}",
        f"logs/good.mcap fails {suffix}",
    )
    rows = {row["name"]: row for row in document["cells"]}
    assert list(rows) == [own, f"{own} #2", copies, f"{copies} #2", fails, f"{fails} #2"]
    assert set(ran) == rows.keys() - {own}
    assert [rows[name]["code"] for name in (own, copies, f"{copies} #2", fails)] == [0, 0, 0, ExitCode.GATE_FAILED]
    assert rows[fails]["error"].startswith("it ended with code 1; see ")
    assert (rows[copies]["trajectory"], rows[copies]["method"], rows[copies]["grid"]) == ("copies", "external", None)
    assert 0.0 < rows[copies]["run"]["timing"]["cpu_s"] < 20.0
    assert "search" not in rows[copies]["run"]
    written = json.loads((home / "runs/batch" / rows[copies]["directory"] / "run.json").read_text())
    assert written["external"]["source"].endswith("'{out}'")
    assert document["exit_code"] == ExitCode.GATE_FAILED


@pytest.mark.slow
def test_a_program_runs_again_when_its_file_has_changed(home: Path) -> None:
    given = programs("copies")
    _, ran = batch(**given)
    assert len(ran) == 1
    assert batch(**given)[1] == []
    Path("copy.py").write_text(f"{COPY}# changed\n")
    assert batch(**given)[1] == ran


def test_two_programs_need_two_names() -> None:
    with pytest.raises(ConfigError, match="two runs are named 'a'"):
        request_of(BatchOptions(sources=("logs",), programs=("a=x {out}", "a=y {out}")))


def test_the_command_takes_programs_and_their_limit(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slow = f'slow={sys.executable} -c "import time; time.sleep(60)" {{out}}'
    words = ("--external", slow, "--time-limit", "0.5", "--end", "0.5", "--online", "-o", "limited", "-j", "1")
    assert run(["batch", "logs/good.mcap", *words, "--grid", "5x5"]) == ExitCode.GATE_FAILED
    assert "slow end_s=0.5: it took over 0.5 s" in capsys.readouterr().out
