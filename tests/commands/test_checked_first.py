"""Mistakes on the command line are found before kernels are compiled or loaded."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import mavnav.pipelines.evaluate
import mavnav.slam.methods.registry
from mavnav.errors import ExitCode
from mavnav.kernels.machine.jit import Kernel

if TYPE_CHECKING:
    from collections.abc import Callable

USAGE, NO_SCANS, OUTPUT = ExitCode.USAGE, ExitCode.NO_SCANS, ExitCode.OUTPUT

MISTAKES = [
    (USAGE, "replay none.mcap"),
    (USAGE, "replay LOG --start 5 --end 2"),
    (USAGE, "replay LOG --gate tracking.lots==false"),
    (USAGE, "replay LOG --gate reference.ate.rmse_m<=1"),
    (USAGE, "replay LOG --gate tracking.lost"),
    (USAGE, "replay LOG --topic /none"),
    (USAGE, "replay LOG --odom /none"),
    (NO_SCANS, "replay LOG --start 1000"),
    (OUTPUT, "replay LOG -o kept"),
    (USAGE, "replay LOG --map . --method paper"),
    (USAGE, "replay LOG --map none.yaml"),
    (USAGE, "replay LOG --start-pose 1,2,3"),
    (USAGE, "replay LOG --truth none.tum"),
    (USAGE, "replay LOG --truth-map none.yaml"),
    (USAGE, "replay LOG --relations none.relations"),
    (USAGE, "replay LOG --grid 0x5"),
    (USAGE, "replay LOG --set robust.cel_mm=3"),
    (USAGE, "replay LOG --config none.yaml"),
    (USAGE, "compare none.mcap"),
    (USAGE, "compare LOG --grid 0x5"),
    (USAGE, "compare LOG --gate tracking.lots==false"),
    (USAGE, "compare LOG --start 5 --end 2"),
    (OUTPUT, "compare LOG -o kept"),
    (USAGE, "batch LOG --gate tracking.lots==false"),
    (USAGE, "batch LOG --start 5 --end 2"),
    (USAGE, "batch LOG --baseline none"),
    (USAGE, "batch LOG --tolerance tracking.lots=1"),
    (USAGE, "batch none.yaml"),
    (OUTPUT, "batch LOG -o kept"),
    (USAGE, "simulate none"),
    (USAGE, "simulate corner --gate mission.reachd==true"),
    (USAGE, "simulate corner --planner none"),
    (OUTPUT, "simulate corner -o kept"),
    (USAGE, "simulate corner --record a.txt"),
    (USAGE, "metrics none"),
    (USAGE, "metrics kept"),
    (USAGE, "metrics kept --truth none.tum"),
    (USAGE, "check none"),
    (USAGE, "check kept --gate tracking.lost"),
]


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a working directory with a directory of other files, in which no kernel may be asked for."""

    def asked(*_: object) -> None:
        pytest.fail("kernels are asked for")

    monkeypatch.setattr(mavnav.slam.methods.registry, "prepare", asked)
    monkeypatch.setattr(mavnav.pipelines.evaluate, "prepare", asked)
    monkeypatch.setattr(Kernel, "load", asked)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "notes.txt").touch()
    return tmp_path


@pytest.mark.parametrize(("code", "line"), MISTAKES, ids=[line for _, line in MISTAKES])
def test_mistakes_are_found_before_kernels_are_needed(
    mavnav: Callable, sample: Path, kept: Path, code: ExitCode, line: str
) -> None:
    found, _, err = mavnav(*(str(sample) if word == "LOG" else word for word in line.split()))
    assert (found, err.count("\n")) == (code, 1), err
    assert err.startswith("mavnav: error: ")
    assert [path.name for path in kept.iterdir() if path.name not in {"kept", "runs"}] == []


def test_a_mistake_compiles_nothing(sample: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mavnav", "replay", str(sample), "-q", "--gate", "tracking.lots==false"]
    environment = os.environ | {"MAVNAV_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, "did you mean tracking.lost" in done.stderr) == (ExitCode.USAGE, True)
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("metrics {file}", "the YAML file of a map, or a run directory"),
        ("replay LOG --map {file}", "the YAML file of a map, or a run directory"),
        ("replay LOG --map .", "the YAML file of a map, or a run directory"),
        ("replay LOG --truth-map {file}", "the YAML file of a map, or a scenario"),
        ("simulate {file}", "the YAML file of a scenario, or a shipped one: complex, "),
        ("batch {file}.yaml", "the YAML file of a manifest"),
        ("replay LOG --config {file}", "a YAML file or a preset"),
    ],
)
@pytest.mark.parametrize("content", [b"P5\n2 2\n255\n\x80\xff\xff\x00", b"P2\n2 2\n255\n0 0 0 0\n"], ids=["P5", "P2"])
def test_a_file_of_another_kind_is_told_what_to_name(
    mavnav: Callable,
    sample: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    line: str,
    named: str,
    content: bytes,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("map.pgm", "map.pgm.yaml"):
        Path(name).write_bytes(content)
    words = line.format(file="map.pgm").split()
    code, out, err = mavnav(*(sample if word == "LOG" else word for word in words), "-q")
    assert (code, out) == (USAGE, "")
    assert f"name {named}" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "corner", "-o", "run", "--record"),
        ("simulate", "corner", "-o", "run", "--animate"),
        ("calibrate", "SAMPLE", "-o"),
        ("batch", "SAMPLE", "-o", "runs", "--junit"),
        ("batch", "SAMPLE", "-o", "runs", "--summary"),
    ],
    ids=" ".join,
)
def test_a_file_that_cannot_be_made_is_refused_first(
    words: tuple[str, ...], mavnav: Callable, sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").touch()
    suffix = {"--record": ".mcap", "--animate": ".gif", "--junit": ".xml", "--summary": ".md"}.get(words[-1], ".json")
    named = [str(sample) if word == "SAMPLE" else word for word in words]
    code, out, err = mavnav(*named, f"taken/file{suffix}", "-q")
    assert (code, out) == (6, "")
    assert err.splitlines()[-1].endswith(f"{tmp_path / 'taken'} is no directory; choose another place")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
