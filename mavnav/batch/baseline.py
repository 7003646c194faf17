"""Baselines: the metrics of an earlier batch, and the tolerances for the metrics of a new one."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from math import isfinite
from pathlib import Path
from typing import Any, Final

from msgspec import Struct

from mavnav.atomic_files import beside, writing
from mavnav.config.named_files import read_json
from mavnav.errors import SEVERITY, ExitCode, UsageError
from mavnav.metrics.gates import full_name
from mavnav.outputs.documents.quantities import number
from mavnav.outputs.files.document import to_json
from mavnav.version import DOCUMENT_HEAD


class Tolerance(Struct, frozen=True):
    """Tolerance of a number of run.json: the larger of ``absolute`` and ``relative`` times the baseline value.

    With ``high``, larger values are better.
    """

    name: str
    absolute: float = 0.0
    relative: float = 0.0
    high: bool = False


TOLERANCES: Final = (
    Tolerance("map_quality.meaningful", high=True),
    Tolerance("map.accepted_share", absolute=0.02, high=True),
    Tolerance("tracking.tracked_share", absolute=0.01, high=True),
    Tolerance("wall_thickness.spread.median_mm", absolute=2.0, relative=0.05),
    Tolerance("wall_thickness.spread.p95_mm", absolute=2.0, relative=0.05),
    Tolerance("wall_thickness.2.p95_mm", absolute=2.0, relative=0.05),
    Tolerance("map_quality.ghost_walls.length_m", absolute=0.25, relative=0.05),
    Tolerance("map_quality.revisits.nn_l_mm", absolute=0.5, relative=0.05),
    Tolerance("map_quality.crispness.occupied_cells_per_m", relative=0.05),
    Tolerance("search.evaluations_per_scan.mean", relative=0.1),
)
"""Tolerances of the metrics compared by default. CPU time is not compared, because it depends on the machine."""

EXAMPLE: Final = "write for example --tolerance wall_thickness.p95_mm=5%"

_NUMBER: Final = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_TOLERANCE: Final = re.compile(rf"\s*({_NUMBER})\s*(%?)\s*(?:,\s*(low|high)\s*)?")


def parse_tolerance(name: str, text: str) -> Tolerance:
    """Parse a tolerance such as ``5``, ``5%`` or ``5%,high``.

    By default the better direction is that of the metric in `TOLERANCES`, else low. The name may be abbreviated as in a
    gate. Raises UsageError.
    """
    name = full_name(name)
    match = _TOLERANCE.fullmatch(text)
    if match is None:
        raise UsageError(f"the tolerance {text!r} of {name} is no number, with % or not; {EXAMPLE}")
    if (size := float(match[1])) < 0:
        raise UsageError(f"the tolerance {text!r} of {name} is negative; write 0 to allow no change")
    default = any(known.name == name and known.high for known in TOLERANCES)
    high = match[3] == "high" if match[3] else default
    return Tolerance(name, high=high, **({"relative": size / 100} if match[2] else {"absolute": size}))


def tolerances(given: Iterable[Tolerance]) -> tuple[Tolerance, ...]:
    """Return the default tolerances, replaced or extended by the given ones."""
    return tuple(({known.name: known for known in TOLERANCES} | {mine.name: mine for mine in given}).values())


class ChangeKind(StrEnum):
    """Change of a number or of a run since the baseline."""

    SAME = "same"
    BETTER = "better"
    WORSE = "worse"
    NEW = "new"


class Baseline(Struct, frozen=True):
    """The runs of an earlier batch by name, each with its exit code, and its metrics or sections of run.json.

    ``figures`` of a run are the metrics in a baseline file; None if ``path`` is a whole batch.
    """

    path: Path
    version: str
    runs: Mapping[str, Mapping[str, Any]]


def read_baseline(path: Path) -> Baseline:
    """Read ``batch.json`` of a directory, or a file written by `write_baseline`; raises UsageError for other input."""
    file = path / "batch.json" if path.is_dir() else path
    try:
        document = read_json(file)
        cells = [{"run": None, **cell, "figures": _figures(cell)} for cell in document["cells"]]
        runs = {cell["name"]: cell for cell in cells}
        for run in cells:
            ExitCode(run["exit_code"])
        return Baseline(path, str(document["mavnav_version"]), runs)
    except OSError as error:
        reason = f"{file}: the baseline cannot be read ({error.strerror})"
        raise UsageError(f"{reason}; name an earlier batch, or make one with --update-baseline") from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        advice = "name the directory of a batch, its batch.json, or a baseline file"
        raise UsageError(f"{file} is no baseline; {advice}") from error


def _figures(cell: Mapping[str, Any]) -> dict[str, float | None] | None:
    """Return the metrics that a baseline file has of a run, by their full names; None for a run of a whole batch.

    Raises ValueError for a value that is no finite number.
    """
    if "figures" not in cell:
        return None
    stored = cell["figures"]
    for value in stored.values():
        if value is not None and not (isinstance(value, int | float) and isfinite(value)):
            raise ValueError
    return {full_name(name): value for name, value in stored.items()}


def is_any_unwritten(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether a run could not be written, as on a full disk: what it reaches is not known."""
    return any(row["exit_code"] == ExitCode.OUTPUT for row in rows)


def write_baseline(rows: Sequence[Mapping[str, Any]], path: Path, watched: Sequence[Tolerance]) -> None:
    """Write only the metrics that are compared, so that the file can be committed with the code."""
    document = {**DOCUMENT_HEAD, "cells": [_baseline_row(row, watched) for row in rows]}
    with writing(path, "name another file"), beside(path) as partial:
        partial.write_text(to_json(document), encoding="utf-8")


def _baseline_row(row: Mapping[str, Any], watched: Sequence[Tolerance]) -> dict[str, Any]:
    figures = {tolerance.name: number(row["run"], tolerance.name) for tolerance in watched}
    return {"name": row["name"], "exit_code": row["exit_code"], "figures": figures}


def changes(row: Mapping[str, Any], baseline: Baseline, watched: Sequence[Tolerance]) -> dict[str, Any]:
    """Compare a run with the run of the same name in the baseline.

    Returns the overall ``change``; ``figures``: the old value, the new value and the change of each metric outside of
    its tolerance, and of a changed exit code; and ``before``, the old values by their names. A number that is missing
    now counts as worse, and so does a map that is no longer meaningful. One without a baseline value is not compared.
    """
    before = baseline.runs.get(row["name"])
    if before is None:
        return {"change": ChangeKind.NEW, "figures": [], "before": {}}
    old = {tolerance.name: _before(before, tolerance.name) for tolerance in watched}
    items = [_code_change(before["exit_code"], row["exit_code"])]
    if row["run"]:
        items += [_figure_change(t, old[t.name], number(row["run"], t.name)) for t in watched]
    moved = [item for item in items if item["change"] != ChangeKind.SAME]
    kinds = {item["change"] for item in moved}
    whole = next((kind for kind in (ChangeKind.WORSE, ChangeKind.BETTER) if kind in kinds), ChangeKind.SAME)
    return {"change": whole, "figures": moved, "before": old}


def _before(run: Mapping[str, Any], name: str) -> float | None:
    stored: float | None = (run["figures"] or {}).get(name)
    return number(run["run"], name) if stored is None else stored


def lacking(row: Mapping[str, Any], baseline: Baseline, watched: Sequence[Tolerance]) -> list[str]:
    """Return the metrics of a run for which a tolerance was given, and which the baseline file does not have."""
    stored = baseline.runs.get(row["name"], {"figures": None})["figures"]
    given = [tolerance.name for tolerance in watched if tolerance not in TOLERANCES]
    absent = [name for name in given if stored is not None and name not in stored]
    return [name for name in absent if number(row["run"], name) is not None]


def lacking_text(path: object, name: str) -> str:
    """Return what is missing in a baseline file, and how to add it."""
    return f"{path} has no {name}; add it with --update-baseline and this --tolerance"


def _code_change(before: int, now: int) -> dict[str, Any]:
    change = _compare(SEVERITY.index(ExitCode(now)), SEVERITY.index(ExitCode(before)), 0.0)
    return {"name": "exit_code", "before": before, "now": now, "change": change}


def _figure_change(tolerance: Tolerance, before: float | None, now: float | None) -> dict[str, Any]:
    if before is None:
        change = ChangeKind.SAME
    elif now is None:
        change = ChangeKind.WORSE
    else:
        sign = -1.0 if tolerance.high else 1.0
        change = _compare(sign * now, sign * before, max(tolerance.absolute, tolerance.relative * abs(before)))
    return {"name": tolerance.name, "before": before, "now": now, "change": change}


def _compare(now: float, before: float, allowed: float) -> ChangeKind:
    """Compare two numbers of which the smaller one is better."""
    if abs(now - before) <= allowed:
        return ChangeKind.SAME
    return ChangeKind.WORSE if now > before else ChangeKind.BETTER


def missing(rows: Sequence[Mapping[str, Any]], baseline: Baseline) -> list[str]:
    """Return the names of the baseline's runs that are missing in a batch."""
    names = {row["name"] for row in rows}
    return [name for name in baseline.runs if name not in names]
