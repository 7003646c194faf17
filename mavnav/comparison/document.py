"""comparison.json: the runs, the best ones by each metric, their relative cost, and the results of the gates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from mavnav.batch.document import run_row
from mavnav.comparison.figures import RELATIVE_COSTS, best, one_best, relative_costs
from mavnav.errors import ExitCode, worst
from mavnav.metrics.gates import judge_some
from mavnav.version import __version__

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mavnav.batch.cases import CaseResult
    from mavnav.jobs.run_cache import PlannedRun
    from mavnav.metrics.gates import Gate

SCHEMA_VERSION: Final = 1


def comparison_document(results: Sequence[CaseResult], directory: Path, gates: Sequence[Gate]) -> dict[str, Any]:
    """Return comparison.json of these results; the directories of the runs are relative to ``directory``."""
    runs = [result.document for result in results]
    planned = [result.case.run for result in results if result.case.run]
    costs = relative_costs([_group(run) for run in planned], runs)
    verdicts = [verdict for k, run in enumerate(runs) if run for verdict in _judge(gates, run, costs, k)]
    rows = [run_row(result, directory) for result in results]
    logs = _logs(planned, runs)
    return {
        "schema_version": SCHEMA_VERSION,
        "mavnav_version": __version__,
        "profile": next((run["map_quality"]["profile"] for run in runs if run and run.get("map_quality")), None),
        "cells": rows,
        "winners": _winners(logs, runs),
        "logs": logs,
        "price": costs,
        "gates": verdicts,
        "exit_code": worst([*(row["exit_code"] for row in rows), *(_code(verdict) for verdict in verdicts)]),
    }


def _group(run: PlannedRun) -> tuple[object, int]:
    return (run.request.log, run.config.method), run.config.grid.points + run.config.azimuth


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


def _winners(logs: Sequence[dict[str, Any]], runs: Sequence[dict[str, Any] | None]) -> dict[str, int | None]:
    """Return the best run by each metric, of equal ones the coarser.

    None where the cell sizes differ and the metric depends on them; all None if there are several logs.
    """
    every = one_best(runs)
    return every if len(logs) == 1 else dict.fromkeys(every)


def _judge(gates: Sequence[Gate], run: dict[str, Any], costs: dict[str, list[Any]], k: int) -> list[dict[str, Any]]:
    document = run | {"price": {name: costs[name][k] for name in RELATIVE_COSTS}}
    return [{"gate": verdict.gate.text, "cell": k, **verdict.row()} for verdict in judge_some(gates, document)]


def _code(verdict: dict[str, Any]) -> ExitCode:
    return ExitCode.DONE if verdict["passed"] else ExitCode.GATE_FAILED
