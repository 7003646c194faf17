"""Baselines: what is worse, better, the same, new and missing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from mavnav.batch.baseline import (
    EXAMPLE,
    Tolerance,
    changes,
    lacking,
    missing,
    parse_tolerance,
    read_baseline,
    tolerances,
    write_baseline,
)
from mavnav.errors import OutputError, UsageError
from mavnav.metrics.gates import check_names

WATCHED = tolerances([])


def row(name: str = "a.bag robust", code: int = 0, *, accepted: float = 0.9, p95_mm: float | None = 100.0) -> dict:
    run = {"map": {"accepted_share": accepted}, "wall_thickness": {"2": {"p95_mm": p95_mm}}}
    return {"name": name, "exit_code": code, "run": run}


@pytest.fixture
def baseline(tmp_path: Path) -> Path:
    path = tmp_path / "baseline.json"
    write_baseline([row()], path, WATCHED)
    return path


def change(baseline: Path, now: dict[str, Any], watched: tuple[Tolerance, ...] = WATCHED) -> tuple[str, list[str]]:
    found = changes(now, read_baseline(baseline), watched)
    return found["change"], [item["name"] for item in found["figures"]]


def test_within_the_tolerance_all_is_the_same(baseline: Path) -> None:
    assert change(baseline, row()) == ("same", [])
    assert change(baseline, row(accepted=0.881, p95_mm=104.9)) == ("same", [])


def test_worse_and_better_go_by_the_figure(baseline: Path) -> None:
    assert change(baseline, row(p95_mm=105.1)) == ("worse", ["wall_thickness.2.p95_mm"])
    assert change(baseline, row(p95_mm=94.9)) == ("better", ["wall_thickness.2.p95_mm"])
    assert change(baseline, row(accepted=0.87)) == ("worse", ["map.accepted_share"])
    assert change(baseline, row(accepted=0.93)) == ("better", ["map.accepted_share"])
    assert change(baseline, row(accepted=0.93, p95_mm=200))[0] == "worse"


def test_exit_codes_go_by_severity(baseline: Path) -> None:
    for code in (3, 5):  # 3 is next to 0
        assert change(baseline, row(code=code)) == ("worse", ["exit_code"])
    failed = {**row(code=4), "run": None}
    assert change(baseline, failed) == ("worse", ["exit_code"])
    write_baseline([failed], baseline, WATCHED)
    assert change(baseline, row(code=3)) == ("better", ["exit_code"])


def test_a_number_that_is_gone_is_worse_and_one_that_is_new_is_nothing(baseline: Path) -> None:
    assert change(baseline, row(p95_mm=None)) == ("worse", ["wall_thickness.2.p95_mm"])
    write_baseline([row(p95_mm=None)], baseline, WATCHED)
    assert change(baseline, row()) == ("same", [])


def test_a_map_that_has_lost_its_meaning_is_worse(baseline: Path) -> None:
    sound, empty = row(), row()
    sound["run"]["map_quality"] = {"meaningful": True}
    empty["run"]["map_quality"] = {"meaningful": False}
    write_baseline([sound], baseline, WATCHED)
    assert change(baseline, empty) == ("worse", ["map_quality.meaningful"])
    write_baseline([empty], baseline, WATCHED)
    assert change(baseline, sound) == ("better", ["map_quality.meaningful"])


def test_new_and_missing(baseline: Path) -> None:
    assert change(baseline, row("b.bag robust")) == ("new", [])
    assert missing([row("b.bag robust")], read_baseline(baseline)) == ["a.bag robust"]


def test_the_figures_of_a_whole_batch_do_as_well(tmp_path: Path) -> None:
    document = {"mavnav_version": "0.1.0", "cells": [row()]}
    (tmp_path / "batch.json").write_text(json.dumps(document))
    assert change(tmp_path, row(p95_mm=120))[0] == "worse"
    assert change(tmp_path / "batch.json", row()) == ("same", [])


def test_tolerances_of_ones_own(baseline: Path) -> None:
    mine = tolerances([parse_tolerance("wall_thickness.2.p95_mm", "30"), parse_tolerance("map.accepted_share", "0")])
    assert change(baseline, row(p95_mm=129), mine)[0] == "same"
    assert change(baseline, row(accepted=0.91), mine)[0] == "better"
    assert len(mine) == len(WATCHED)
    assert tolerances([parse_tolerance("timing.cpu_s", "50%")])[-1] == Tolerance("timing.cpu_s", relative=0.5)


@pytest.mark.parametrize(
    ("text", "absolute", "relative", "high"),
    [("5", 5.0, 0.0, False), (" 5 % ", 0.0, 0.05, False), ("1e-2,high", 0.01, 0.0, True), ("0", 0.0, 0.0, False)],
)
def test_tolerances_are_read(text: str, absolute: float, relative: float, high: bool) -> None:
    assert parse_tolerance("x", text) == Tolerance("x", absolute, relative, high)


@pytest.mark.parametrize("text", ["", "much", "5%%", "5,up", "e"])
def test_no_tolerance(text: str) -> None:
    with pytest.raises(UsageError, match="is no number"):
        parse_tolerance("x", text)


@pytest.mark.parametrize("text", ["-3", "-0.5%,high"])
def test_a_negative_tolerance_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="is negative; write 0 to allow no change"):
        parse_tolerance("x", text)


def test_metrics_that_the_file_lacks(baseline: Path, tmp_path: Path) -> None:
    def absent(path: Path, name: str, now: dict[str, Any]) -> list[str]:
        return lacking(now, read_baseline(path), tolerances([parse_tolerance(name, "0")]))

    now = row()
    now["run"]["timing"] = {"cpu_s": 2.0}
    assert absent(baseline, "timing.cpu_s", now) == ["timing.cpu_s"]
    assert absent(baseline, "timing.cpu_s", row()) == []  # the run does not have it either
    assert absent(baseline, "timing.cpu_s", {**now, "name": "new"}) == []
    assert absent(baseline, "wall_thickness.2.p95_mm", now) == []
    write_baseline([row()], baseline, tolerances([parse_tolerance("timing.cpu_s", "0")]))
    assert absent(baseline, "timing.cpu_s", now) == []  # its run did not have it
    (tmp_path / "batch.json").write_text(json.dumps({"mavnav_version": "0.1.0", "cells": [row()]}))
    assert absent(tmp_path, "timing.cpu_s", now) == []


def test_an_unknown_number_is_answered_with_the_option_of_tolerances() -> None:
    with pytest.raises(UsageError, match=r"no number foo in run\.json; .*, write for example --tolerance wall"):
        check_names(["foo"], ["a.b"], EXAMPLE)


def test_a_short_name_is_the_usual_one(baseline: Path) -> None:
    """As in a gate: a tolerance that takes the usual one's place under its full name does so under the short one."""
    mine = tolerances([parse_tolerance("wall_thickness.hits_2.p95_mm", "30")])
    assert len(mine) == len(WATCHED)
    assert change(baseline, row(p95_mm=129), mine)[0] == "same"
    kept = json.loads(baseline.read_text())
    kept["cells"][0]["figures"] = {"wall_thickness.hits_2.p95_mm": 80.0}
    baseline.write_text(json.dumps(kept))
    assert change(baseline, row(p95_mm=129), mine) == ("worse", ["wall_thickness.2.p95_mm"])


@pytest.mark.parametrize("figures", [None, [], {"map.accepted_share": "0.9"}, {"map.accepted_share": float("nan")}])
def test_figures_that_are_none_are_no_baseline(baseline: Path, figures: object) -> None:
    kept = json.loads(baseline.read_text())
    kept["cells"][0]["figures"] = figures
    baseline.write_text(json.dumps(kept))
    with pytest.raises(UsageError, match="is no baseline"):
        read_baseline(baseline)


def test_nan_is_never_better(baseline: Path) -> None:
    assert change(baseline, row(p95_mm=float("nan"))) == ("worse", ["wall_thickness.2.p95_mm"])


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"cells": [{}], "mavnav_version": ""}', '{"cells": [{"name": 1}]}'])
def test_no_baseline(tmp_path: Path, text: str) -> None:
    path = tmp_path / "b.json"
    path.write_text(text)
    with pytest.raises(UsageError, match="is no baseline"):
        read_baseline(path)
    with pytest.raises(UsageError, match="--update-baseline"):
        read_baseline(tmp_path / "gone.json")


def test_a_baseline_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        write_baseline([row()], tmp_path / "file" / "b.json", WATCHED)
