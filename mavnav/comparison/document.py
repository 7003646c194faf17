"""comparison.json: the runs, the best ones by each metric, their relative cost, and the results of the gates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from mavnav.errors import ExitCode, worst
from mavnav.jobs.run_cache import run_row
from mavnav.metrics.gates import judge_some
from mavnav.outputs.documents.quantities import QUANTITIES, comparable, number, ranked_values, winners
from mavnav.version import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mavnav.batch.cases import CaseResult
    from mavnav.jobs.run_cache import PlannedRun
    from mavnav.metrics.gates import Gate
    from mavnav.outputs.documents.quantities import Run

SCHEMA_VERSION: Final = 1

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
    cases = [(result.case.name, result.case.run) for result in results if result.case.run]
    planned = [run for _, run in cases]
    groups = [((r.request.log, r.config.method), r.config.grid.points + r.config.azimuth) for r in planned]
    costs = relative_costs(groups, runs)
    verdicts = [verdict for k, run in enumerate(runs) if run for verdict in _judge(gates, run, costs, k)]
    rows = [run_row(*case, r.outcome, r.document, directory) for case, r in zip(cases, results, strict=True)]
    logs = _logs(planned, runs)
    codes = [*(row["exit_code"] for row in rows), *(ExitCode.GATE_FAILED for v in verdicts if not v["passed"])]
    return {
        "schema_version": SCHEMA_VERSION,
        "mavnav_version": __version__,
        "profile": next((run["map_quality"]["profile"] for run in runs if run and run.get("map_quality")), None),
        "cells": rows,
        "winners": one_best(runs) if len(logs) == 1 else dict.fromkeys(one_best(runs)),
        "logs": logs,
        "price": costs,
        "gates": verdicts,
        "exit_code": worst(codes),
    }


def _logs(planned: Sequence[PlannedRun], runs: Sequence[dict[str, Any] | None]) -> list[dict[str, Any]]:
    """Return the runs of every log, and the best of them by each metric."""
    groups: dict[Path, list[int]] = {}
    for k, run in enumerate(planned):
        groups.setdefault(run.request.log, []).append(k)
    return [
        {
            "log": str(log),
            "cells": group,
            "best": {name: [group[k] for k in places] for name, places in best([runs[k] for k in group]).items()},
        }
        for log, group in groups.items()
    ]


def _judge(gates: Sequence[Gate], run: dict[str, Any], costs: dict[str, list[Any]], k: int) -> list[dict[str, Any]]:
    document = run | {"price": {name: costs[name][k] for name in RELATIVE_COSTS}}
    return [{"gate": verdict.gate.text, "cell": k, **verdict.row()} for verdict in judge_some(gates, document)]


def best(runs: Sequence[Run | None]) -> dict[str, list[int]]:
    """Return the indices of the best runs by each metric."""
    return {figure.name: winners(figure, runs) for figure in QUANTITIES}


def one_best(runs: Sequence[Run | None]) -> dict[str, int | None]:
    """Return the index of the first of the best runs by each metric; None where not all runs can be compared."""
    compared = {f.name: comparable(f, [runs[k] for k in ranked_values(f, runs)]) for f in QUANTITIES}
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
    for k in sorted(range(len(runs)), key=lambda k: groups[k][1], reverse=True):
        if runs[k] is not None:
            coarsest[groups[k][0]] = k
    references = [coarsest.get(group) for group, _ in groups]
    ratios = {
        cost: [_ratio(runs, k, reference, name) for k, reference in enumerate(references)]
        for cost, name in RELATIVE_COSTS.items()
    }
    return {"coarsest": references, **ratios}


def _ratio(runs: Sequence[Run | None], k: int, reference: int | None, name: str) -> float | None:
    own, base = number(runs[k], name), None if reference is None else number(runs[reference], name)
    return None if own is None or not base else own / base
