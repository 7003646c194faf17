"""batch.json: a row for every run, with its gates, its change since the baseline, and how its repetitions differ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from os.path import relpath
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavnav.batch.baseline import Baseline, ChangeKind, changes, lacking, lacking_text
from mavnav.batch.cases import CaseResult
from mavnav.batch.request import BatchRequest, Rules
from mavnav.config.named_files import read_json
from mavnav.errors import SEVERITY, ExitCode, worst
from mavnav.jobs.run_cache import RUNS_FOLDER
from mavnav.metrics.gates import VERDICTS, accepts_code, failure_text, judge_some, judge_verdict
from mavnav.outputs.directory import digests_of
from mavnav.outputs.documents.quantities import NAMED, TIME, verdict_texts, without_search
from mavnav.outputs.documents.verdict import EXTERNAL
from mavnav.units import pluralize
from mavnav.version import DOCUMENT_HEAD

BATCH_FILE: Final = "batch.json"
IDENTICAL_GATE: Final = "identical"

_MEASURED: Final = ("verdict", "scans", "tracking", "search", "map", "wall_thickness", "map_quality", "reference")
SECTIONS: Final = (*_MEASURED, "timing", "exit_code")
"""Sections of run.json that the document of a comparison or a batch repeats for every run."""

KEY_FIGURES: Final = (
    NAMED["map.accepted_share"],
    NAMED["wall_thickness.spread.p95_mm"],
    NAMED["map_quality.ghost_walls.length_m"],
    TIME,
)
"""Metrics of a run in the table of a batch."""


def judged_row(result: CaseResult, request: BatchRequest) -> dict[str, Any]:
    """Return the row of a run in batch.json, with the results of its gates.

    This is the row of comparison.json with ``setting``, ``seconds``, ``gates``, ``baseline`` (None without one),
    ``accepted`` and ``code``. The code is the worst exit code of the gates and of the run; the run's own code is
    ignored if it is accepted. The verdict is a gate, too. A gate on a number that the run does not have fails.
    """
    case, rules, outcome = result.case, request.rules, result.outcome
    own = {"log": case.log, "setting": case.setting.name, "seconds": outcome.seconds if outcome else None}
    row = run_row(result, request.directory) | own | {"licence": case.licence, "peers": case.peers}
    row["repeat"] = {"of": case.repeat_of, "differs": []} if case.repeat_of else None
    accept = rules.accept | case.accept
    bounds, run = (*rules.gates, *case.gates), result.document
    gates = [] if run is None else [*judge_verdict(accept, run), *judge_some(bounds, run)]
    change = None
    if rules.baseline:
        absent = [] if request.new_baseline else lacking(row, rules.baseline, rules.watched)
        change = changes(row | {"name": case.repeat_of or case.name}, rules.baseline, rules.watched)
        change |= {"lacking": absent}
        if rules.baseline_gate or (case.baseline_gate and request.new_baseline is None):
            gates.append(_baseline_verdict(change, rules.baseline.path))
    accepted = accepts_code(accept, row["exit_code"])
    codes = [] if accepted else [row["exit_code"]]
    codes += [ExitCode.GATE_FAILED for gate in gates if not gate["passed"]]
    return row | {"gates": gates, "baseline": change, "accepted": accepted, "code": int(worst(codes))}


def run_row(result: CaseResult, directory: Path) -> dict[str, Any]:
    """Return the row of a run: its display name, its settings, its status, and the sections of its run.json.

    Its directory is relative to ``directory``. A log that cannot be read has no run, and the error of its case.
    """
    case, outcome, run, planned = result.case, result.outcome, result.document, result.case.run
    config = case.setting.config
    given = {"trajectory": case.external, "method": EXTERNAL, "grid": None, "azimuth": None} if case.external else {}
    return {
        "name": case.name,
        "log": str(planned.request.log) if planned else case.log,
        "method": config.method,
        "grid": str(config.grid),
        "azimuth": config.azimuth,
        "differs": case.setting.differs,
        "key": planned.key if planned else None,
        "status": "failed" if run is None else "done" if outcome else "cached",
        "exit_code": int(run["exit_code"] if run else outcome.exit_code if outcome else case.exit_code),
        "error": (outcome.error if outcome else case.error) or None,
        "directory": Path(relpath(planned.directory, directory)).as_posix() if planned and run else None,
        "run": {name: run[name] for name in SECTIONS if name in run} if run else None,
    } | given


def of_program(document: dict[str, Any]) -> dict[str, Any]:
    """Return run.json of a run at the poses of a program without what is mavnav's own: its time is the program's."""
    spent = {name: document["external"].get(name) for name in ("wall_s", "cpu_s", "peak_memory_mb")}
    return without_search(document) | {"timing": spent}


def _baseline_verdict(change: Mapping[str, Any], path: Path) -> dict[str, Any]:
    worse = [item for item in change["figures"] if item["change"] == ChangeKind.WORSE]
    reasons = [f"{item['name']} went from {_text(item['before'])} to {_text(item['now'])}" for item in worse]
    reasons += [lacking_text(path, name) for name in change["lacking"]]
    return {"gate": "baseline", "value": len(reasons), "passed": not reasons, "why": "; ".join(reasons)}


def _text(number: float | None) -> str:
    return "nothing" if number is None else f"{number:.6g}"


def batch_document(
    rows: Sequence[dict[str, Any]], wall_s: float, rules: Rules, missing_runs: Sequence[str]
) -> dict[str, Any]:
    """Return batch.json of these rows; runs that only the baseline has, ``missing_runs``, fail the baseline gate."""
    runs = [row["run"] for row in rows]
    baseline, gated = rules.baseline, rules.baseline_gate
    codes = [*(row["code"] for row in rows), *(ExitCode.GATE_FAILED for _ in missing_runs if gated)]
    return {
        **DOCUMENT_HEAD,
        "profile": next((run["map_quality"]["profile"] for run in runs if run and run.get("map_quality")), None),
        "counts": _counts(rows),
        "wall_s": wall_s,
        "cells": list(rows),
        "baseline": None if baseline is None else {**_since(rows, baseline, missing_runs), "gate": gated},
        "exit_code": int(worst(codes)),
    }


def _counts(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    status, codes = Counter(row["status"] for row in rows), Counter(row["code"] for row in rows)
    words = Counter(verdict_texts(row["run"])[0] for row in rows)
    return {
        "runs": len(rows),
        **{name: status[name] for name in ("done", "cached", "failed")},
        "verdicts": {word: words[word] for word in VERDICTS if words[word]},
        "codes": {str(int(code)): codes[code] for code in SEVERITY if codes[code]},
    }


def _since(rows: Sequence[Mapping[str, Any]], baseline: Baseline, missing_runs: Sequence[str]) -> dict[str, Any]:
    kinds = Counter(row["baseline"]["change"] for row in rows)
    counts = {str(change): kinds[change] for change in ChangeKind}
    absent = list(dict.fromkeys(name for row in rows for name in row["baseline"]["lacking"]))
    about = {"path": str(baseline.path), "mavnav_version": baseline.version}
    return {**about, **counts, "missing": list(missing_runs), "lacking": absent}


def compare_repeats(rows: Sequence[dict[str, Any]], directory: Path, *, gate: bool) -> None:
    """Add to ``repeat`` of the row of each repetition how its files differ from those of the run that it repeats.

    With ``gate``, a repetition with other bytes, or that ended otherwise, fails.
    """
    named = {row["name"]: row for row in rows}
    for row in (row for row in rows if row["repeat"] and row["repeat"]["of"] in named):
        differs = row["repeat"]["differs"] = _differences(named[row["repeat"]["of"]], row, directory)
        if gate:
            why = "; ".join(differs)
            row["gates"].append({"gate": IDENTICAL_GATE, "value": len(differs), "passed": not differs, "why": why})
            row["code"] = int(worst([row["code"], *([ExitCode.GATE_FAILED] if differs else [])]))


def _differences(one: dict[str, Any], other: dict[str, Any], directory: Path) -> list[str]:
    codes = [one["exit_code"], other["exit_code"]]
    ends = [f"exit codes {codes[0]} and {codes[1]}"] if codes[0] != codes[1] else []
    folders = [directory / row["directory"] for row in (one, other) if row["directory"]]
    return ends + (file_differences(*folders) if len(folders) == len(codes) else [])


def file_differences(one: Path, other: Path) -> list[str]:
    """Return a line for each output file of two run directories whose bytes differ.

    run.json and the page are left out: they have times.
    """
    names = sorted({*digests_of(one), *digests_of(other)})
    return [f"{name}: {text}" for name in names if (text := _byte_difference(one / name, other / name))]


def _byte_difference(one: Path, other: Path) -> str:
    if not (one.is_file() and other.is_file()):
        return f"only in {(one if one.is_file() else other).parent.name}"
    a, b = (np.fromfile(path, dtype=np.uint8) for path in (one, other))
    shorter = min(len(a), len(b))
    differ = np.flatnonzero(a[:shorter] != b[:shorter])
    sizes = f", sizes {len(a)} and {len(b)}" if len(a) != len(b) else ""
    if not len(differ):
        return sizes and f"the same up to byte {shorter}{sizes}"
    return f"{len(differ)} of {shorter} bytes differ, from byte {differ[0]} to {differ[-1]}{sizes}"


def worst_first(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return rows from the worst code to the best; of one code, those of worse verdicts and changes come first."""

    def rank(row: dict[str, Any]) -> tuple[int, int, bool]:
        change = (row["baseline"] or {}).get("change")
        word = verdict_texts(row["run"])[0] or VERDICTS[0]
        return -SEVERITY.index(ExitCode(row["code"])), -VERDICTS.index(word), change != ChangeKind.WORSE

    return sorted(rows, key=rank)


def why(row: Mapping[str, Any]) -> list[str]:
    """Return the reasons why a run did not pass, one line each: its error or exit code, and its failed gates."""
    failed = list(dict.fromkeys(failure_text(gate) for gate in row["gates"] if not gate["passed"]))
    code = row["exit_code"]
    known = code == ExitCode.TRACKING_LOST and any(gate["value"] == VERDICTS[-1] for gate in row["gates"])
    own = [row["error"] or ENDS[ExitCode(code)]] if code and not known else []
    return own + failed


def remark(row: Mapping[str, Any]) -> str:
    """Say why a run did not pass, or what is suspect of it; empty for others."""
    word, reason = verdict_texts(row["run"])
    return "; ".join(why(row)) or (f"{word}: {reason}" if word not in ("", VERDICTS[0]) else "")


def unlisted_runs(rows: Sequence[Mapping[str, Any]], file: Path) -> list[str]:
    """Return the runs in ``cells`` that a batch.json or comparison.json lists of other logs than ``rows``."""
    try:
        mine = {row[key] for row in rows for key in ("log", "directory")}
        earlier = [row for row in read_json(file)["cells"] if (row["directory"] or "").startswith(f"{RUNS_FOLDER}/")]
        return [row["directory"] for row in earlier if not mine & {row["log"], row["directory"]}]
    except (OSError, ValueError, LookupError, TypeError):
        return []


def unlisted_text(runs: Sequence[str]) -> str:
    """Say that runs are listed no more."""
    of_others = f"{pluralize(len(runs), 'run')} of other logs, listed here before,"
    return f"{of_others} stayed in {RUNS_FOLDER}; list such runs apart, with another -o"


def batch_headline(document: Mapping[str, Any]) -> str:
    """Return the result of a batch in one line."""
    rows = document["cells"]
    bad = sum(bool(row["code"]) for row in rows)
    counts, since = document["counts"], document["baseline"]
    parts = [f"{len(rows) - bad} of {len(rows)} runs passed"]
    parts += [f"{count} {word}" for word, count in counts["verdicts"].items() if word != VERDICTS[0]]
    parts += [f"{counts['failed']} could not be made"] if counts["failed"] else []
    parts += [f"{counts['cached']} reused"] if counts["cached"] else []
    if since:
        parts.append(f"since the baseline {since['worse']} worse, {since['better']} better, {since['new']} new")
        parts += [f"{len(since['missing'])} missing"] if since["missing"] else []
    return ", ".join(parts)


def missing_lines(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return severity and text for every missing run of the baseline; an error if the baseline is a gate.

    So too for every metric that the baseline file lacks, unless the baseline is a gate: its runs fail for that.
    """
    since = document["baseline"] or {}
    kind = "error" if since.get("gate") else "warning"
    lines = [(kind, f"{name}: in the baseline, not in this batch") for name in absent_runs(document)]
    if other := document.get("unlisted"):
        lines.append(("warning", unlisted_text(other)))
    absent = [] if since.get("gate") else since.get("lacking", [])
    return lines + [("warning", f"{lacking_text(since['path'], name)}; it is not compared") for name in absent]


def absent_runs(document: Mapping[str, Any]) -> list[str]:
    """Return the names of the runs that only the baseline has."""
    return list((document["baseline"] or {}).get("missing", []))


def change_text(row: Mapping[str, Any]) -> str:
    """Return the change of a run since the baseline as text; empty without a baseline or a change."""
    change = row["baseline"]
    if not change or change["change"] == ChangeKind.SAME:
        return ""
    return f"{change['change']} {', '.join(item['name'] for item in change['figures'])}".strip()


ENDS: Final = {
    ExitCode.DONE: "done",
    ExitCode.GATE_FAILED: "a gate failed",
    ExitCode.USAGE: "it cannot be done",
    ExitCode.DAMAGED_INPUT: "the log is damaged; what is intact was used",
    ExitCode.NO_SCANS: "no usable scans",
    ExitCode.TRACKING_LOST: "tracking was lost for good",
    ExitCode.OUTPUT: "it could not be written",
    ExitCode.BUG: "a bug, or its process died or exceeded a limit",
    ExitCode.INTERRUPTED: "interrupted",
    ExitCode.TERMINATED: "terminated",
}
"""Meaning of the exit codes of a run, in a few words."""
