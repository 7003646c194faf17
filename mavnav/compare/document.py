"""comparison.json: the cells, who is best by each figure, what it costs, and which gates hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from mavnav import __version__
from mavnav.compare.figures import PRICES, best, prices
from mavnav.errors import ExitCode, worst
from mavnav.jobs.run_cache import run_row
from mavnav.metrics.gates import judge_some

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from mavnav.jobs import Outcome
    from mavnav.jobs.run_cache import PlannedRun
    from mavnav.metrics.gates import Gate

SCHEMA_VERSION: Final = 1


def comparison(
    cells: Sequence[PlannedRun],
    kept: Mapping[str, dict[str, Any]],
    outcomes: Mapping[str, Outcome],
    directory: Path,
    gates: Sequence[Gate],
) -> dict[str, Any]:
    """Set cells side by side.

    ``kept`` holds the documents (run.json) of earlier runs by key, ``outcomes`` what became of the others;
    directories are told from ``directory`` on.
    """
    runs = [kept.get(cell.key) or outcomes[cell.key].value for cell in cells]
    price = prices([_group(cell) for cell in cells], runs)
    verdicts = [verdict for k, run in enumerate(runs) if run for verdict in _judge(gates, run, price, k)]
    rows = [run_row(cell, outcomes.get(cell.key), run, directory) for cell, run in zip(cells, runs, strict=True)]
    logs = _logs(cells, runs)
    return {
        "schema_version": SCHEMA_VERSION,
        "mavnav_version": __version__,
        "profile": next((run["map_quality"]["profile"] for run in runs if run and run.get("map_quality")), None),
        "cells": rows,
        "winners": _winners(logs),
        "logs": logs,
        "price": price,
        "gates": verdicts,
        "exit_code": worst([*(row["exit_code"] for row in rows), *(_code(verdict) for verdict in verdicts)]),
    }


def _group(cell: PlannedRun) -> tuple[object, int]:
    return (cell.request.log, cell.config.method), cell.config.grid.points + cell.config.azimuth


def _logs(cells: Sequence[PlannedRun], runs: Sequence[dict[str, Any] | None]) -> list[dict[str, Any]]:
    """Return for every log its cells, and by figure which of them are the best."""
    groups: dict[Path, list[int]] = {}
    for k, cell in enumerate(cells):
        groups.setdefault(cell.request.log, []).append(k)
    return [
        {
            "log": str(log),
            "cells": group,
            "best": {name: [group[k] for k in places] for name, places in best([runs[k] for k in group]).items()},
        }
        for log, group in groups.items()
    ]


def _winners(logs: Sequence[dict[str, Any]]) -> dict[str, int | None]:
    """Return by figure the winner, of equals the coarser; none where several logs have one each."""
    found = {name: next(iter(places), None) for name, places in logs[0]["best"].items()}
    return found if len(logs) == 1 else dict.fromkeys(found)


def _judge(gates: Sequence[Gate], run: dict[str, Any], price: dict[str, list[Any]], k: int) -> list[dict[str, Any]]:
    document = run | {"price": {name: price[name][k] for name in PRICES}}
    return [
        {"gate": verdict.gate.text, "cell": k, "value": verdict.value, "passed": verdict.passed, "why": verdict.why}
        for verdict in judge_some(gates, document)
    ]


def _code(verdict: dict[str, Any]) -> ExitCode:
    return ExitCode.DONE if verdict["passed"] else ExitCode.GATE_FAILED
