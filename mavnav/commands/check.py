"""``mavnav check RUN ... --gate ...``: gates on runs that are finished.

Examples
--------
mavnav check runs/drive-robust-20-10x10 --gate 'wall_thickness.p95_mm<=150'
mavnav check runs/* --gate 'map.accepted_share>=0.95' --gate 'tracking.lost==false'
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mavnav.commands import shared
from mavnav.commands.terminal import emit, emit_json, note, printable


def check(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN", show_default=False)],
    *,
    gates: shared.Gates = None,
    accept: shared.Accept = None,
    json: shared.Json = False,
) -> None:
    """Check finished runs: their verdicts, and quality gates; exits with the worst code of the runs and their gates.

    Parameters
    ----------
    runs
        Directories of runs, comparisons or batches.
    """
    from mavnav.batch.check import check_runs
    from mavnav.metrics.gates import failure_text, read_accept

    accepted = frozenset(map(read_accept, accept or ()))
    rows, code = check_runs(shared.without_latest(runs), shared.gates_of(gates), accepted)
    if json:
        emit_json({"schema_version": 1, "runs": rows, "exit_code": int(code)})
    for row in rows:
        if not json:
            verdict = f", {row['verdict']['word']}" if row["verdict"] else ""
            emit(f"{printable(row['run'])}: {'failed' if row['exit_code'] else 'passed'}{verdict}")
        for gate in row["gates"]:
            if not gate["passed"]:
                note(f"mavnav: error: {row['run']}: {failure_text(gate)}")
        if row["error"]:
            note(f"mavnav: error: {row['run']}: {row['error']}")
    raise typer.Exit(code)
