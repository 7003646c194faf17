"""The model of run.json: runs of all kinds are read back by it, and its schema describes every number."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from msgspec import convert
from msgspec.structs import fields, replace

from mavnav.batch.baseline import TOLERANCES
from mavnav.batch.document import SECTIONS
from mavnav.batch.files import FIGURES
from mavnav.cli import run as command
from mavnav.errors import ExitCode
from mavnav.metrics.gates import OF_MAP
from mavnav.outputs.documents.quantities import PATH, QUANTITIES, TIME
from mavnav.outputs.documents.run_json import METRICS, RunDocument
from mavnav.outputs.documents.schema import number_schema, run_keys, run_schema
from mavnav.outputs.files.document import plain, run_document, to_json
from mavnav.slam.matching.steps import LostInterval, Steps

OPTIONAL = {"slices", "scenario", "localisation", "external", "alignment", "continued", "reference", "mission", "truth"}
TYPES = {
    "object": dict, "array": list, "string": str, "boolean": bool, "null": type(None), "integer": int,
    "number": (int, float),
}  # fmt: skip


def problems(value: Any, schema: dict[str, Any], name: str = "") -> list[str]:
    """Return where a value breaks a schema; keys that a record does not have are too many."""
    if "anyOf" in schema:
        return min((problems(value, option, name) for option in schema["anyOf"]), key=len)
    if "enum" in schema:
        return [] if value in schema["enum"] else [f"{name} is none of {schema['enum']}"]
    kind = TYPES[schema["type"]]
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        return [f"{name} is no {schema['type']}"]
    children: list[tuple[str, Any]] = []
    if isinstance(value, dict):
        children = list(value.items())
    elif isinstance(value, list):
        children = [("*", item) for item in value]
    any_key = None if "properties" in schema else True
    found = [f"{name}.{key} is missing" for key in schema.get("required", []) if key not in value]
    for key, child in children:
        inside = schema.get("properties", {}).get(key, schema.get("items", schema.get("additionalProperties", any_key)))
        if inside is None or inside is False:
            found.append(f"{name}.{key} is unknown")
        elif inside is not True:
            found += problems(child, inside, f"{name}.{key}")
    return found


def check(document: dict[str, Any], *optional: str) -> None:
    """Hold a run.json against the schema, and read it back into the model and write it again."""
    assert problems(document, run_schema()) == []
    assert OPTIONAL & set(document) == set(optional)
    assert json.loads(to_json(convert(document, RunDocument))) == document


def made(folder: Path, *args: object) -> dict[str, Any]:
    command([*map(str, args), "-o", str(folder), "-q"])
    return json.loads((folder / "run.json").read_text())


@pytest.mark.slow
def test_a_scored_run(tmp_path: Path, repo_root: Path) -> None:
    log, first = str(repo_root / "sample_logs" / "corridor.mcap"), tmp_path / "first"
    made(first, "replay", log, "--end", 2)
    command(["score", log, "--end", "2", "--trajectory", f"own={first}", "-o", str(tmp_path / "scores"), "-q"])
    check(json.loads((tmp_path / "scores" / "own" / "run.json").read_text()), "external")


@pytest.mark.slow
def test_a_replay_with_references_and_its_localisation(tmp_path: Path, repo_root: Path) -> None:
    log, first = repo_root / "sample_logs" / "corridor.mcap", tmp_path / "first"
    check(made(first, "replay", log, "--end", 2))
    relations = tmp_path / "relations.txt"
    stamps = [line.split()[0] for line in (first / "trajectory.tum").read_text().splitlines()]
    relations.write_text(f"{stamps[0]} {stamps[-1]} 0 0 0 0 0 0\n")
    known = ("--truth", first / "trajectory.tum", "--truth-map", "corridor", "--relations", relations)
    document = made(tmp_path / "second", "replay", log, "--end", 2, "--method", "paper", *known)
    check(document, "reference")
    assert set(document["reference"]) == {"ate", "rpe", "map_distance", "relations"}
    check(made(tmp_path / "third", "replay", log, "--end", 1, "--map", first, "--start-pose", "0,0,0"), "localisation")
    check(made(tmp_path / "fourth", "replay", log, "--start", 2, "--end", 3, "--continue", first), "continued")


@pytest.mark.slow
def test_simulated_runs(tmp_path: Path) -> None:
    quick = ("simulate", "corner", "--grid", "5x5", "--set", "slam.final_pass=false")
    document = made(tmp_path / "a", *quick, "--set", "max_steps=8")
    check(document, "scenario", "mission", "truth", "reference")
    assert "ate_rmse_m" in document["truth"]
    short = made(tmp_path / "b", *quick, "--set", "max_steps=1")
    check(short, "scenario", "mission", "truth", "reference")
    assert (set(short["truth"]), short["reference"]["ate"]) == ({"ate_poses"}, None)


def test_partial_and_lost_runs(run) -> None:
    document = plain(run_document(replace(run, stopped=ExitCode.INTERRUPTED), {"map.pgm": "abc"}))
    assert document["partial"]
    check(document)
    end = LostInterval(run.log.last_ns, run.log.last_ns, 1, recovered=False)
    steps = Steps(step._replace(tracked=k < 3) for k, step in enumerate(run.slam.steps))
    lost = plain(run_document(replace(run, slam=replace(run.slam, steps=steps, lost=(end,))), {}))
    assert lost["tracking"]["lost"]
    check(lost)


def test_a_run_that_draws_no_map_has_nothing_of_one(run) -> None:
    document = plain(run_document(replace(run, metrics=None), {}))
    check(document)
    assert set(OF_MAP).isdisjoint(document)
    with pytest.raises(ValueError, match="not measured"):
        _ = replace(run, metrics=None).measures


def test_what_breaks_the_schema_is_found(run) -> None:
    document = plain(run_document(run, {}))
    wrong = document | {"partial": 1, "scans": document["scans"] | {"total": "9"}, "extra": 1, "method": "other"}
    del wrong["search"]
    assert sorted(problems(wrong, run_schema())) == [
        ".extra is unknown",
        ".method is none of ['paper', 'robust']",
        ".partial is no boolean",
        ".scans.total is no integer",
        ".search is missing",
    ]


def test_every_number_has_a_title_a_description_and_a_unit() -> None:
    numbers = {
        name: node
        for name, node in run_keys().items()
        if {"number", "integer"} & {option.get("type") for option in node.get("anyOf", [node])}
    }
    assert len(numbers) > 150
    assert [
        name for name, node in numbers.items() if not all(node.get(k) for k in ("title", "description", "unit"))
    ] == []
    units = ("wall_thickness.2.p95_mm", "search.cost_m2.mean", "timing.stages.*", "scans.total", "map.size_m.*")
    assert [numbers[name]["unit"] for name in units] == ["mm", "m2", "s", "1", "m"]
    p95 = "95 % of the wall, by length, is not thicker (cells of at least 2 hits)"
    assert numbers["wall_thickness.2.p95_mm"]["description"] == p95


def test_keys_that_not_every_run_has() -> None:
    schema = run_schema()
    assert set(schema["properties"]) - set(schema["required"]) == OPTIONAL | {*OF_MAP}
    assert list(schema["properties"]) == [field.name for field in fields(RunDocument)]


def test_names_that_others_repeat_are_those_of_the_model() -> None:
    sections = {field.name for field in fields(RunDocument)}
    assert set(METRICS) | set(SECTIONS) <= sections
    repeated = [*FIGURES, *(tolerance.name for tolerance in TOLERANCES)]
    assert {*repeated, *(q.name for q in (*QUANTITIES, PATH, TIME))} <= set(run_keys())


def test_directions_come_from_the_model() -> None:
    assert [number_schema(t.name)["better"] == "higher" for t in TOLERANCES] == [t.high for t in TOLERANCES]
    assert {q.name for q in QUANTITIES if q.better > 0} == {"map.accepted_share"}
    assert (PATH.better, TIME.better) == (0, -1)


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("map.accepted_share", "accepted %"),
        ("wall_thickness.spread.p95_mm", "wall p95 mm"),
        ("map_quality.crispness.occupied_cells_per_m", "cells per m"),
        ("map_quality.crispness.entropy_bits", "entropy bit"),
        ("reference.ate.rmse_m", "ATE mm"),
        ("search.evaluations_per_scan.mean", "evaluations"),
        ("timing.cpu_s", "cpu s"),
    ],
)
def test_headings_of_columns(name: str, head: str) -> None:
    assert {q.name: q.head for q in QUANTITIES}[name] == head
