"""``mavnav check RUN ... --gate ...``: gates on runs that are finished."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

import typer

from mavnav.commands import shared
from mavnav.commands.terminal import emit, emit_json, note, printable
from mavnav.config.named_files import read_json
from mavnav.errors import ExitCode, UsageError, worst

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavnav.metrics.gates import Gate

WHOLE_FILES: Final = ("batch.json", "comparison.json")
"""The documents of all runs of a directory. Repeated: the modules that write them load longer than a check takes."""

EPILOG = """
[bold]Examples[/bold]
mavnav check runs/drive-robust-20-10x10 --gate 'wall_thickness.spread.p95_mm<=150'
mavnav check runs/* --gate 'map.accepted_share>=0.95' --gate 'tracking.lost==false'
"""


def check(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN", help="Directories of runs, comparisons or batches.", show_default=False),
    ],
    *,
    gates: shared.Gates = None,
    json: shared.Json = False,
) -> None:
    """Check finished runs against quality gates; exits with the worst code of the runs and their gates."""
    from mavnav.metrics.gates import check_known

    bounds = shared.gates_of(gates)
    finished = [run for path in runs for run in _runs_at(path)]
    check_known(bounds, [run.document for run in finished if run.document is not None])
    rows = [_judge(run, bounds) for run in finished]
    code = worst(row["exit_code"] for row in rows)
    _print_result(rows, code, json=json)
    raise typer.Exit(code)


class _CheckedRun(NamedTuple):
    """A finished run; or one that a batch could not make: it has no ``document``, and ``error`` says why."""

    name: str
    exit_code: ExitCode
    document: dict[str, Any] | None
    error: str | None


def _runs_at(path: Path) -> list[_CheckedRun]:
    """Return the run of a directory, or all of a comparison or a batch.

    Those are the runs of its own document: ``cells`` may hold others, of earlier versions of logs. A comparison or
    batch that was never finished has none; then all runs below it are returned.
    """
    from mavnav.outputs.directory import RUN_FILE

    if path.name in (RUN_FILE, *WHOLE_FILES):
        path = path.parent
    for file in (path / name for name in WHOLE_FILES):
        if file.is_file():
            return _runs_of(file)
    return [_run(file.parent) for file in sorted(path.glob(f"cells/*/{RUN_FILE}"))] or [_run(path)]


def _runs_of(file: Path) -> list[_CheckedRun]:
    """Return the runs of batch.json or comparison.json; what a batch accepts counts as done.

    Runs of a comparison have their relative costs, which are in its own document only.
    """
    runs = []
    with _reading(file):
        whole = read_json(file)
        costs = {name: each for name, each in whole.get("price", {}).items() if name != "coarsest"}
        for k, cell in enumerate(whole["cells"]):
            accepted = bool(cell.get("accepted"))
            if cell["directory"] is None:
                code = ExitCode.DONE if accepted else ExitCode(cell["exit_code"])
                runs.append(_CheckedRun(cell["name"], code, None, cell["error"] if code else None))
            else:
                run = _run(file.parent / cell["directory"], accepted=accepted)
                if costs and run.document is not None:
                    run.document["price"] = {name: each[k] for name, each in costs.items()}
                runs.append(run)
    return runs


def _run(directory: Path, *, accepted: bool = False) -> _CheckedRun:
    from mavnav.outputs.directory import RUN_FILE

    file = directory / RUN_FILE
    with _reading(file):
        document: dict[str, Any] = read_json(file)
        code = ExitCode(document["exit_code"])
    code = ExitCode.DONE if accepted else code
    return _CheckedRun(str(directory), code, document, f"it ended with exit code {code}" if code else None)


@contextmanager
def _reading(file: Path) -> Iterator[None]:
    advice = "name the directory of a finished run"
    try:
        yield
    except OSError as error:
        raise UsageError(f"{file.parent}: no {file.name} ({error.strerror}); {advice}") from error
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise UsageError(f"{file} is not one of mavnav's; {advice}") from error


def _judge(run: _CheckedRun, bounds: list[Gate]) -> dict[str, Any]:
    from mavnav.metrics.gates import judge_some

    verdicts = [] if run.document is None else judge_some(bounds, run.document)
    code = worst([run.exit_code, *(ExitCode.GATE_FAILED for v in verdicts if not v.passed)])
    return {
        "run": run.name,
        "gates": [verdict.row() for verdict in verdicts],
        "error": run.error,
        "exit_code": int(code),
    }


def _print_result(rows: list[dict[str, Any]], code: ExitCode, *, json: bool) -> None:
    """Print the verdicts on stdout, and what failed on stderr too with ``json``."""
    if json:
        emit_json({"schema_version": 1, "runs": rows, "exit_code": int(code)})
    for row in rows:
        if not json:
            emit(f"{printable(row['run'])}: {'passed' if not row['exit_code'] else 'failed'}")
        for gate in row["gates"]:
            if not gate["passed"]:
                note(f"mavnav: error: {row['run']}: gate {gate['gate']} failed: {gate['why']}")
        if row["error"]:
            note(f"mavnav: error: {row['run']}: {row['error']}")
