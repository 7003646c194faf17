"""The files of a comparison: comparison.json, and tables in CSV and Markdown.

comparison.json has the runs, the best ones by each metric, their relative cost, and the results of the gates.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from mavnav.atomic_files import beside, writing
from mavnav.batch.cases import CaseResult
from mavnav.batch.document import ENDS, run_row
from mavnav.errors import ExitCode, worst
from mavnav.metrics.gates import Gate, failure_text, judge_some, stored_verdict
from mavnav.outputs.documents import quantities
from mavnav.outputs.documents.quantities import QUANTITIES, UNUSABLE, Run, number, verdict_texts
from mavnav.outputs.documents.verdict import Verdict, worst_verdict
from mavnav.outputs.files.document import plain, to_json
from mavnav.outputs.report.entry import name_of, setting_of
from mavnav.outputs.report.headline import headline
from mavnav.outputs.report.markdown import escape, inert, table_row
from mavnav.outputs.report.tables import NamedRun
from mavnav.pipelines.replay import ReplayRequest
from mavnav.version import DOCUMENT_HEAD

COMPARISON_FILE: Final = "comparison.json"

RELATIVE_COSTS: Final = {
    "evaluations": "search.evaluations_per_scan.mean",
    "cpu": "timing.cpu_s",
    "seconds": "timing.wall_s",
}
"""Name of a relative cost -> the number of run.json that is divided by that of the run with the coarsest grid."""


def comparison_document(results: Sequence[CaseResult], directory: Path, gates: Sequence[Gate]) -> dict[str, Any]:
    """Return comparison.json of these results; the directories of the runs are relative to ``directory``.

    ``winners`` is the best run by each metric, of equal ones the coarser. It is None where the cell sizes differ and
    the metric depends on them; all are None if there are several logs.
    """
    runs = [result.document for result in results]
    requests = [result.case.run.request for result in results if result.case.run]
    groups = [((r.log, r.config.method), r.config.grid.points + r.config.azimuth) for r in requests]
    costs = relative_costs(groups, runs)
    verdicts = [verdict for k, run in enumerate(runs) if run for verdict in _judge(gates, run, costs, k)]
    rows = [run_row(result, directory) for result in results]
    logs = _logs(requests, [name_of(row) for row in rows], runs)
    codes = [*(row["exit_code"] for row in rows), *(ExitCode.GATE_FAILED for v in verdicts if not v["passed"])]
    return {
        **DOCUMENT_HEAD,
        "verdict": plain(worst_verdict(Verdict(**known) for run in runs if run and (known := stored_verdict(run)))),
        "headline": " ".join(f"{log['log']}: {log['headline']}" if len(logs) > 1 else log["headline"] for log in logs),
        "profile": next((run["map_quality"]["profile"] for run in runs if run and run.get("map_quality")), None),
        "cells": rows,
        "winners": one_best(runs) if len(logs) == 1 else dict.fromkeys(one_best(runs)),
        "logs": logs,
        "price": costs,
        "gates": verdicts,
        "exit_code": worst(codes),
    }


def _logs(
    requests: Sequence[ReplayRequest], names: Sequence[str], runs: Sequence[dict[str, Any] | None]
) -> list[dict[str, Any]]:
    """Return what was found out about every log, its runs, and the best of them by each metric."""
    groups: dict[Path, list[int]] = {}
    for place, request in enumerate(requests):
        groups.setdefault(request.log, []).append(place)
    return [
        {
            "log": str(log),
            "headline": headline([NamedRun(names[k], run) for k in group if (run := runs[k])]),
            "cells": group,
            "best": {name: [group[k] for k in places] for name, places in best([runs[k] for k in group]).items()},
        }
        for log, group in groups.items()
    ]


def _judge(gates: Sequence[Gate], run: dict[str, Any], costs: dict[str, list[Any]], k: int) -> list[dict[str, Any]]:
    document = run | {"price": {name: costs[name][k] for name in RELATIVE_COSTS}}
    return [{"gate": row["gate"], "cell": k} | row for row in judge_some(gates, document)]


def best(runs: Sequence[Run | None]) -> dict[str, list[int]]:
    """Return the indices of the best runs by each metric."""
    return {figure.name: quantities.winners(figure, runs) for figure in QUANTITIES}


def one_best(runs: Sequence[Run | None]) -> dict[str, int | None]:
    """Return the index of the first of the best runs by each metric; None where not all runs can be compared."""
    compared = {figure.name: quantities.comparable(figure, runs) for figure in QUANTITIES}
    return {name: next(iter(places), None) if compared[name] else None for name, places in best(runs).items()}


def relative_costs(groups: Sequence[tuple[object, int]], runs: Sequence[Run | None]) -> dict[str, list[Any]]:
    """Return the cost of each run relative to the coarsest of its group.

    Parameters
    ----------
    groups
        For each run its group (log and method) and the number of samples of its search; fewer samples are coarser.
    runs
        run.json of each run, None if it failed.

    Returns
    -------
    dict
        ``coarsest``: for each run the index of the coarsest run of its group that has a result. For each key of
        `RELATIVE_COSTS`: the ratio of each run to that run, None if either number is missing or the divisor is 0.
    """
    coarsest: dict[object, int] = {}
    for k in sorted(range(len(runs)), key=lambda k: (groups[k][1], k), reverse=True):
        if runs[k] is not None:
            coarsest[groups[k][0]] = k
    references = [coarsest.get(group) for group, _ in groups]
    ratios = {
        cost: [_relative_cost(runs, k, reference, name) for k, reference in enumerate(references)]
        for cost, name in RELATIVE_COSTS.items()
    }
    return {"coarsest": references, **ratios}


def _relative_cost(runs: Sequence[Run | None], k: int, reference: int | None, name: str) -> float | None:
    own, base = number(runs[k], name), None if reference is None else number(runs[reference], name)
    return None if own is None or not base else own / base


def write_comparison(results: Sequence[CaseResult], directory: Path, gates: Sequence[Gate]) -> dict[str, Any]:
    """Write the files of a comparison, each complete or not at all; return comparison.json. Raises OutputError."""
    document: dict[str, Any] = plain(comparison_document(results, directory, gates))
    for name, text in TEXTS.items():
        with writing(directory / name, "make room"), beside(directory / name) as path:
            path.write_text(text(document), "utf-8", "backslashreplace")  # names of files need not be UTF-8
    return document


HIT_QUANTITIES: Final = ("wall_thickness.2.p95_mm", "wall_thickness.2.max_mm")
"""Additional columns of the CSV file, for comparison with earlier files."""


def comparison_csv(document: dict[str, Any]) -> str:
    """Return CSV with one line per run: its settings, its metrics under their names in run.json, its relative cost."""
    rows = io.StringIO()
    table = csv.writer(rows, lineterminator="\n")
    head = ("log", "method", "grid", "azimuth", "status", "exit_code", "error", "directory")
    names = [*(figure.name for figure in QUANTITIES), *HIT_QUANTITIES]
    costs = [f"price.{name}" for name in RELATIVE_COSTS]
    table.writerow([*head, "verdict", "reason", *names, *costs, "finding", "differs"])
    findings = {k: log["headline"] for log in document["logs"] for k in log["cells"]}
    for k, cell in enumerate(document["cells"]):
        figures = [number(cell["run"], name) for name in names]
        known = cell | {"method": labels(cell)[0]}
        texts = [inert(text) for text in (*(known[key] for key in head), *verdict_texts(cell["run"]))]
        ratios = [document["price"][name][k] for name in RELATIVE_COSTS]
        table.writerow([*texts, *figures, *ratios, inert(findings[k]), inert(cell["differs"])])
    return rows.getvalue()


def comparison_markdown(document: dict[str, Any]) -> str:
    """Return a table in GitHub's Markdown with the best values in bold, and a list of failures below it."""
    rows = [_cells(document, k) for k in range(len(document["cells"]))]
    lines = [f"# mavnav {document['mavnav_version']} compare", "", escape(document["headline"]), ""]
    lines += [table_row(rows[0]), table_row(["---"] * len(rows[0])), *(table_row(row.values()) for row in rows)]
    failed = [f"- {escape(line)}" for line in (*problems(document), *remarks(document))]
    notes = [escape(line) for line in cell_size_notes(document)]
    return "\n".join([*lines, *(["", *notes] if notes else []), *(["", *failed] if failed else [])]) + "\n"


def _cells(document: dict[str, Any], k: int) -> dict[str, str]:
    """Return the texts of a run by their headings."""
    cell = document["cells"][k]
    method, grid = map(escape, labels(cell))
    texts = {"log": escape(cell["log"]), "method": method, "yaw samples/grid": grid}
    texts["verdict"] = verdict_texts(cell["run"])[0] or "-"
    for figure in QUANTITIES:
        text = figure.text_of(cell["run"])
        texts[figure.head] = f"**{text}**" if k in winning(document, figure.name) else text
    return texts | {f"{name} ratio": ratio(document, name, k) for name in ("evaluations", "cpu")}


def labels(cell: dict[str, Any]) -> tuple[str, str]:
    """Return the method and the search grid of a run; of one at given poses the name of these, and a dash."""
    name = cell.get("trajectory")
    return (name, "-") if name else (cell["method"], setting_of(cell))


def winning(document: dict[str, Any], metric: str) -> set[int]:
    """Return the indices of the runs that are the best of their log by a metric."""
    return {k for log in document["logs"] for k in log["best"][metric]}


def cell_size_notes(document: dict[str, Any]) -> list[str]:
    """Return a line for every log whose maps have several cell sizes: what is not compared, and why."""
    several = len(document["logs"]) > 1
    runs = [cell["run"] for cell in document["cells"]]
    notes = [(log["log"], quantities.size_note(runs[k] for k in log["cells"])) for log in document["logs"]]
    return [f"{log}: {why}" if several else why for log, why in notes if why]


def ratio(document: dict[str, Any], cost: str, k: int) -> str:
    """Format the cost of a run relative to the coarsest one; a dash if it is unknown."""
    number = document["price"][cost][k]
    return "-" if number is None else f"{number:.1f}"


def problems(document: dict[str, Any]) -> list[str]:
    """Return a line for every run that failed and every gate that did not hold."""
    failed = [f"{cell['name']}: {cell['error']}" for cell in document["cells"] if cell["status"] == "failed"]
    gates = [
        f"{document['cells'][gate['cell']]['name']}: {failure_text(gate)}"
        for gate in document["gates"]
        if not gate["passed"]
    ]
    return failed + gates


def remarks(document: dict[str, Any]) -> list[str]:
    """Return a line for every run that is wrong or lost, and every other one of a damaged log."""
    runs = [(c["name"], c["exit_code"], *verdict_texts(c["run"])) for c in document["cells"] if c["run"]]
    bad = [f"{name}: {word}: {reason}" for name, _, word, reason in runs if word in UNUSABLE]
    return bad + [f"{name}: {ENDS[code]}" for name, code, word, _ in runs if code and word not in UNUSABLE]


TEXTS: Final[dict[str, Callable[[dict[str, Any]], str]]] = {
    COMPARISON_FILE: to_json,
    "comparison.csv": comparison_csv,
    "comparison.md": comparison_markdown,
}
