"""``mavnav replay --outputs trajectory``: the poses of any other run, and no map that nothing asks for."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mavnav.cli import run
from mavnav.config.loading import load_config
from mavnav.errors import ExitCode
from mavnav.metrics.gates import NO_MAP, OF_MAP
from mavnav.pipelines.replay import ReplayRequest, replay_log
from support.error_lines import expect_error

Mavnav = Callable[..., "tuple[int, str, str]"]

ALONE = ("--outputs", "trajectory", "-q")
DRAWING = {"draw map", "measuring"}
"""The passes of a replay that only a map needs."""


def document(directory: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((directory / "run.json").read_text())
    return loaded


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory, sample: Path) -> Path:
    """Return the directory of a run of a trajectory alone."""
    directory = tmp_path_factory.mktemp("alone") / "alone"
    assert run(["replay", str(sample), *ALONE, "-o", str(directory)]) == 0
    return directory


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, sample: Path) -> Path:
    """Return the directory of a run of the same log with its map."""
    directory = tmp_path_factory.mktemp("whole") / "whole"
    assert run(["replay", str(sample), "--outputs", "trajectory,map", "-q", "-o", str(directory)]) == 0
    return directory


def test_the_trajectory_is_that_of_a_run_with_a_map(alone: Path, whole: Path) -> None:
    bare, drawn = document(alone), document(whole)
    names = {"trajectory.tum", "trajectory.csv", "trajectory_base.tum"}
    assert bare["outputs"].keys() == names
    assert all(bare["outputs"][name] == drawn["outputs"][name] for name in names)
    assert drawn.keys() - bare.keys() == {*OF_MAP}
    same = bare.keys() - {"timing", "provenance", "outputs", "verdict"}
    assert all(bare[name] == drawn[name] for name in same)


def test_the_verdict_does_not_speak_of_a_map(alone: Path, whole: Path) -> None:
    reasons = [document(run)["verdict"]["reason"] for run in (alone, whole)]
    assert reasons == ["no sign of an error in the path", "no sign of an error in path or map"]


@pytest.mark.parametrize(
    ("settings", "asked", "drawn"),
    [
        ([], {"outputs": ("trajectory",)}, set()),
        ([], {"outputs": ("trajectory", "graph")}, set()),
        (["final_pass=false"], {"outputs": ("trajectory",)}, set()),
        ([], {"outputs": ("trajectory",), "gated": True}, DRAWING),
        ([], {"outputs": ("trajectory", "metrics")}, DRAWING),
        ([], {"outputs": ("mcap",)}, DRAWING),
    ],
)
def test_a_map_is_drawn_and_measured_only_if_something_needs_it(
    settings: list[str], asked: dict[str, Any], drawn: set[str], sample: Path, tmp_path: Path
) -> None:
    passes: set[str] = set()
    request = ReplayRequest(sample, tmp_path / "r", load_config(None, settings), options={"end_s": 1.0}, **asked)
    replay_log(request, lambda phase, *_: passes.add(phase), 0.0)
    assert passes & DRAWING == drawn


def test_a_true_map_is_compared_with_one(sample: Path, whole: Path, tmp_path: Path, mavnav: Mavnav) -> None:
    code, _, err = mavnav("replay", sample, *ALONE, "--truth-map", whole / "map.yaml", "-o", tmp_path / "r")
    assert (code, err) == (0, "")
    assert document(tmp_path / "r")["reference"]["map_distance"]["mean_mm"] < 20.0


@pytest.mark.parametrize(("bound_mm", "code"), [(300, ExitCode.DONE), (1, ExitCode.GATE_FAILED)])
def test_a_gate_on_walls_decides(bound_mm: int, code: int, sample: Path, tmp_path: Path, mavnav: Mavnav) -> None:
    gate = f"wall_thickness.p95_mm<={bound_mm}"
    assert mavnav("replay", sample, *ALONE, "-o", tmp_path / "r", "--gate", gate)[0] == code
    assert document(tmp_path / "r").keys() >= {*OF_MAP}


def test_the_screen_has_no_line_on_the_map(sample: Path, tmp_path: Path, mavnav: Mavnav) -> None:
    code, out, err = mavnav("replay", sample, *ALONE, "--online", "-v", "--end", 1, "-o", tmp_path / "r")
    rows = {line.split("  ")[0] for line in out.splitlines()}
    assert (code, err) == (0, "")
    assert rows >= {"path", "open", "next"}
    assert rows.isdisjoint({"map", "walls", "ghost walls", "wall thickness", "corners"})


def test_what_needs_a_map_says_that_there_is_none(alone: Path, whole: Path, tmp_path: Path, mavnav: Mavnav) -> None:
    assert mavnav("check", alone)[0] == 0
    expect_error(mavnav("check", alone, "--gate", "wall_thickness.p95_mm<=150"), ExitCode.USAGE, NO_MAP)
    code, out, _ = mavnav("compare", alone, whole, "-q", "-o", tmp_path / "c")
    assert code == 0
    assert "Only robust 20/10x10 whole gives a map worth looking at" in out
    assert "no map" in out
    other = Path(shutil.copytree(alone, tmp_path / "other"))
    code, out, _ = mavnav("compare", alone, other, "-q", "-o", tmp_path / "d")
    assert (code, NO_MAP in out) == (0, True)
