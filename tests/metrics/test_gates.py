"""Gates: how they are read, what they say of a run, and the names that they know."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from mavnav.errors import ExitCode, UsageError, worst
from mavnav.metrics.gates import (
    HEADLINES,
    SKIP_REASONS,
    VERDICTS,
    Gate,
    check_known,
    check_names,
    clear_name,
    find,
    full_name,
    judge,
    judge_some,
    names,
    number,
    parse_gate,
    renaming,
)
from mavnav.outputs.documents.schema import number_names

RUN: dict[str, Any] = {
    "grid": "10x10",
    "scans": {"accepted": 137},
    "tracking": {"lost": False, "intervals": [{"scans": 4}]},
    "wall_thickness": {
        "spread": {"p95_mm": 135.0, "median_mm": 60.0, "p95_cells": 6.75},
        "1": {"p95_cells": 9.5},
        "2": {"p95_mm": 158.0, "p95_cells": 7.0, "max_mm": None},
    },
    "map_quality": {"meaningful": True, "why": [], "revisits": None},
}
EMPTY = RUN | {"map_quality": {"meaningful": False, "why": ["0.3 m of wall", "9 % of the scans mapped"]}}


def verdict(text: str, document: dict[str, Any] = RUN) -> tuple[bool, str]:
    (found,) = judge([parse_gate(text)], document)
    return found["passed"], found["why"]


def test_parse() -> None:
    assert parse_gate("wall_thickness.p95_cells<=7") == Gate(
        "wall_thickness.p95_cells<=7", "wall_thickness.p95_cells", "<=", 7.0
    )
    assert parse_gate("  tracking.lost == False ").bound is False
    assert parse_gate("a != -1e-3").bound == -0.001
    assert parse_gate("a<inf").bound == float("inf")


@pytest.mark.parametrize("text", ["", "a", "a<=", "<=7", "a=7", "a<=x", "a<=nan", "a<=7 8", "a<<7", "a b<7"])
def test_what_is_no_gate_is_a_usage_error(text: str) -> None:
    with pytest.raises(UsageError, match="write for example --gate"):
        parse_gate(text)


@pytest.mark.parametrize(
    ("text", "passed"),
    [
        ("scans.accepted<=137", True),
        ("scans.accepted<137", False),
        ("scans.accepted>=137", True),
        ("scans.accepted>137", False),
        ("scans.accepted==137", True),
        ("scans.accepted!=137", False),
        ("tracking.lost==false", True),
        ("tracking.lost!=false", False),
        ("tracking.intervals.0.scans<5", True),
        ("wall_thickness.1.p95_cells<=7", False),
        ("wall_thickness.2.p95_cells<=7", True),
        ("wall_thickness.hits_2.p95_cells<7", False),
        ("wall_thickness.p95_cells<7", True),
        ("wall_thickness.p95_mm<=140", True),
        ("wall_thickness.median_mm==60", True),
        ("wall_thickness.spread.p95_mm==135", True),
        ("wall_thickness.hits_2.p95_mm==158", True),
        ("map_quality.meaningful==true", True),
    ],
)
def test_operators(text: str, passed: bool) -> None:
    assert verdict(text)[0] is passed


def test_a_skip_reason_that_did_not_occur_counts_as_0() -> None:
    run = {"scans": {"skipped": {"empty": 2}}}
    assert verdict("scans.skipped.duplicate_stamp<=0", run)[0]
    assert verdict("scans.skipped.duplicate_stamp>0", run) == (False, "it is 0")
    assert verdict("scans.skipped.empty<=0", run) == (False, "it is 2")
    for name, document in (("scans.skipped.empti", run), ("scans.skipped.empty", RUN)):
        with pytest.raises(UsageError, match=f"no number {name}"):
            find(document, name)
    check_names(["scans.skipped.duplicate_stamp"], number_names())
    with pytest.raises(UsageError, match=r"did you mean scans.skipped.duplicate_stamp\?"):
        check_names(["scans.skipped.duplicat_stamp"], number_names())


def test_all_skip_reasons_are_known(repo_root: Path) -> None:
    section = (repo_root / "docs" / "formats.md").read_text().split("## Skipped scans")[1].split("\n* ")[0]
    rows = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    assert sorted(re.findall(r"`(\w+)`", " ".join(rows))) == sorted(SKIP_REASONS)


def test_null_fails_whatever_the_bound() -> None:
    for text in ("wall_thickness.max_mm<=inf", "wall_thickness.max_mm!=3", "map_quality.revisits.nn_l_mm>=0"):
        assert verdict(text) == (False, "it is not known for this run")


def test_nan_fails_whatever_the_bound() -> None:
    """No run.json of ours has one, one that was written by hand may."""
    nan = {"wall_thickness": {"spread": {"p95_mm": float("nan")}}}
    assert verdict("wall_thickness.p95_mm!=3", nan) == (False, "it is not known for this run")


def judged(word: str, reason: str = "the walls leave a direction open") -> dict[str, Any]:
    return RUN | {"verdict": {"word": word, "reason": reason, "advice": ""}}


@pytest.mark.parametrize(
    ("text", "passing"),
    [
        ("verdict", {"good", "suspect"}),
        ("verdict<=suspect", {"good", "suspect"}),
        ("verdict==good", {"good"}),
        ("verdict!=lost", {"good", "suspect", "wrong"}),
        ("verdict<lost", {"good", "suspect", "wrong"}),
    ],
)
def test_the_gate_on_the_verdict(text: str, passing: set[str]) -> None:
    """Verdicts are ordered from good to bad; the word alone holds for what may be used after a look."""
    assert {word for word in VERDICTS if verdict(text, judged(word))[0]} == passing
    check_names([parse_gate(text).name], number_names())


def test_a_failed_gate_on_the_verdict_says_why() -> None:
    assert verdict("verdict", judged("wrong")) == (False, "wrong: the walls leave a direction open")
    assert judge([parse_gate("verdict")], judged("good"))[0]["value"] == "good"
    with pytest.raises(UsageError, match="fine is no verdict; they are good, suspect, wrong, lost"):
        parse_gate("verdict==fine")
    assert judge_some([parse_gate("verdict")], RUN)[0]["why"] == "this run has no such number"


@pytest.mark.parametrize(
    ("name", "clear"),
    [
        ("wall_thickness.2.p95_mm", "wall_thickness.hits_2.p95_mm"),
        ("wall_thickness.5.max_cells", "wall_thickness.hits_5.max_cells"),
        ("wall_thickness.max_mm", "wall_thickness.hits_2.max_mm"),
    ],
)
def test_old_names_of_wall_thickness_are_read_with_a_note(name: str, clear: str) -> None:
    assert renaming(name) == f"{name} is an old name of {clear}"
    assert full_name(name) == full_name(clear)


def test_names_of_today_need_no_note() -> None:
    names_of_today = [
        "p95_mm",
        "median_mm",
        "spread.p95_mm",
        "hits_2.p95_mm",
        "paper_cells.max",
        "published_map.p95_mm",
    ]
    assert [renaming(f"wall_thickness.{name}") for name in names_of_today] == [""] * len(names_of_today)
    assert renaming("scans.accepted") == ""
    assert [clear_name(name) for name in HEADLINES] == list(HEADLINES)


def test_a_name_that_only_some_have() -> None:
    gates, other = [parse_gate("tracking.intervals.0.scans<5")], {"tracking": {"intervals": []}}
    check_known(gates, [other, RUN])
    assert [found["why"] for found in judge_some(gates, other)] == ["this run has no such number"]
    assert judge_some(gates, RUN) == judge(gates, RUN)
    with pytest.raises(UsageError, match="no number tracking"):
        check_known(gates, [other, other])
    check_known(gates, [])


def test_a_map_that_is_not_meaningful_fails_its_gates() -> None:
    passed, why = verdict("wall_thickness.p95_cells<=7", EMPTY)
    assert not passed
    assert why == "it is 6.75, but the map is not meaningful: 0.3 m of wall; 9 % of the scans mapped"
    assert verdict("map_quality.meaningful==false", EMPTY)[0]
    assert verdict("map_quality.meaningful==true", EMPTY) == (False, "it is false")
    assert verdict("scans.accepted>100", EMPTY)[0]


@pytest.mark.parametrize("name", ["reference.map_distance.p95_mm", "slices.0.wall_thickness.paper_cells.max"])
def test_a_map_that_is_not_meaningful_fails_gates_on_true_walls_and_slices(name: str) -> None:
    reference = {"map_distance": {"p95_mm": 20.0}, "ate": {"rmse_m": 0.1}}
    more = {"reference": reference, "slices": [{"wall_thickness": {"paper_cells": {"max": 3.0}}}]}
    assert verdict(f"{name}<=50", RUN | more)[0]
    passed, why = verdict(f"{name}<=50", EMPTY | more)
    assert not passed
    assert "the map is not meaningful: 0.3 m of wall" in why
    assert verdict("reference.ate.rmse_m<=0.2", EMPTY | more)[0]


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("wall_thickness.p59_cells", "wall_thickness.p95_cells"),
        ("wall_thicknes.2.p95_cells", "wall_thickness.p95_cells"),
        ("wall_thicknes.p95_cells", "wall_thickness.p95_cells"),
        ("wall_thickness.p95", "wall_thickness.p95_mm"),
        ("p95_mm", "wall_thickness.p95_mm"),
        ("accepted", "scans.accepted"),
        ("scans", "scans.accepted"),
        ("grid", ""),
        ("tracking.intervals.1.scans", "tracking.intervals.0.scans"),
        ("tracking.intervals.-1.scans", "tracking.intervals.0.scans"),
        ("reference.ate.rmse_m", ""),
    ],
)
def test_unknown_names_are_usage_errors(name: str, nearest: str) -> None:
    with pytest.raises(UsageError) as caught:
        find(RUN, name)
    assert number(RUN, name) is None
    assert name in str(caught.value)
    assert f"did you mean {nearest}?" in str(caught.value) if nearest else "did you mean" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_reference_that_was_not_given_is_said() -> None:
    with pytest.raises(UsageError, match="it needs --truth"):
        find(RUN, "reference.ate.rmse_m")


def test_names_are_known_before_there_is_a_run() -> None:
    known = number_names()
    check_names(["wall_thickness.p95_cells", "tracking.intervals.3.scans", "map_quality.revisits.nn_l_mm"], known)
    for name in ("wall_thickness.p59_cells", "tracking.intervals", "tracking.lots", "grid", "reference.ate.rmse_m"):
        with pytest.raises(UsageError, match=f"no number {name} in run.json"):
            check_names([name], known)


@pytest.mark.parametrize(
    ("name", "ending"),
    [
        ("scans.acepted", "did you mean scans.accepted?"),
        ("wall_thickness.p59_mm", "did you mean wall_thickness.p95_mm?"),
        ("wall_thickness.3.p95_mm", "did you mean wall_thickness.p95_mm?"),
        ("wall_thickness", "did you mean wall_thickness.p95_mm?"),
        ("map_quality.revisits", "did you mean map_quality.revisits.nn_l_mm?"),
        ("config.robust.cel_mm", "did you mean config.robust.cell_mm?"),
        ("accepted", "did you mean scans.accepted?"),
        ("reference.ate.rmse_m", "it needs --truth, --truth-map or --relations"),
        ("ate.rmse_m", "it needs --truth, --truth-map or --relations"),
        ("wall", "did you mean wall_thickness.p95_mm?"),
        ("log", "write for example --gate 'wall_thickness.p95_mm<=150'"),
        ("mission.steps", "write for example --gate 'wall_thickness.p95_mm<=150'"),
        ("config.grid", "; config has azimuth, slice_mm, upside_down, final_pass"),
    ],
)
def test_a_name_that_no_run_has_is_answered_before_the_work(name: str, ending: str) -> None:
    with pytest.raises(UsageError) as caught:
        check_names([name], number_names())
    assert str(caught.value).startswith(f"no number {name} in run.json; ")
    assert str(caught.value).endswith(ending)


def test_names_of_references_are_known_where_there_are_some() -> None:
    known = number_names(reference=True)
    check_names(["reference.ate.rmse_m", "reference.relations.all.share", "scans.accepted"], known)
    with pytest.raises(UsageError, match=r"did you mean reference.ate.rmse_m\?"):
        check_names(["reference.ate.rsme_m"], known)


def test_names_are_those_that_can_be_found() -> None:
    assert "wall_thickness.2.max_mm" in names(RUN)
    assert "grid" not in names(RUN)
    for name in names(RUN):
        assert number(RUN, name) == find(RUN, name)


def test_the_worst_exit_code() -> None:
    assert worst([]) == ExitCode.DONE
    assert worst([3, 0]) == ExitCode.DAMAGED_INPUT
    assert worst([3, 1]) == ExitCode.GATE_FAILED
    assert worst([1, 5, 4]) == ExitCode.NO_SCANS
    assert worst([5, 70, 1]) == ExitCode.BUG
