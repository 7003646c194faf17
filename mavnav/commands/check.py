"""``mavnav check RUN ... --gate ...``: gates on runs that are finished."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands.gating import Gates, gates_of
from mavnav.commands.terminal import emit, note, printable
from mavnav.errors import ExitCode, UsageError, worst

if TYPE_CHECKING:
    from mavnav.gates import Gate

EPILOG = """
[bold]Examples[/bold]

mavnav check runs/drive-robust-10x10 --gate 'wall_thickness.p95_cells<=7'

mavnav check runs/* --gate 'map.accepted_share>=0.95' --gate 'tracking.lost==false'
"""


def check(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN ...", help="Run directories, or of comparisons and batches.", show_default=False),
    ],
    *,
    gates: Gates = None,
    json: Annotated[bool, typer.Option("--json", help="Print the verdicts on stdout and nothing else.")] = False,
) -> None:
    """Hold gates against finished runs; ends with the worst exit code of the runs and their gates."""
    bounds = gates_of(gates)
    rows = [_checked(directory, bounds) for directory in _runs(runs)]
    code = worst(row["exit_code"] for row in rows)
    _tell(rows, code, json=json)
    raise typer.Exit(code)


def _checked(directory: Path, bounds: list[Gate]) -> dict[str, Any]:
    from mavnav.gates import judge

    document = _document(directory)
    verdicts = [
        {"gate": v.gate.text, "value": v.value, "passed": v.passed, "why": v.why} for v in judge(bounds, document)
    ]
    code = worst([document["exit_code"], *(ExitCode.GATE_FAILED for v in verdicts if not v["passed"])])
    return {"run": str(directory), "gates": verdicts, "exit_code": int(code)}


def _runs(paths: list[Path]) -> list[Path]:
    """Return run directories; a comparison or a batch stands for all of its own."""
    found: list[Path] = []
    for path in paths:
        cells = sorted(path.glob("cells/*/run.json"))
        found += [file.parent for file in cells] or [path.parent if path.name == "run.json" else path]
    return found


def _document(directory: Path) -> dict[str, Any]:
    from json import loads

    advice = "name the directory of a finished run"
    try:
        document: dict[str, Any] = loads((directory / "run.json").read_bytes())
        ExitCode(document["exit_code"])
    except OSError as error:
        raise UsageError(f"{directory}: no run.json ({error.strerror}); {advice}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(f"{directory / 'run.json'} is not one of mavnav's; {advice}") from error
    return document


def _tell(rows: list[dict[str, Any]], code: ExitCode, *, json: bool) -> None:
    """Print the verdicts on stdout, and what failed on stderr too with ``json``."""
    if json:
        from json import dumps

        emit(dumps({"schema_version": 1, "runs": rows, "exit_code": int(code)}, indent=2))
    for row in rows:
        if not json:
            emit(f"{printable(row['run'])}: {'passed' if not row['exit_code'] else 'failed'}")
        for gate in row["gates"]:
            if not gate["passed"]:
                note(f"mavnav: error: {row['run']}: gate {gate['gate']} failed: {gate['why']}")
        if row["exit_code"] and all(gate["passed"] for gate in row["gates"]):
            note(f"mavnav: error: {row['run']} ended with exit code {row['exit_code']}")
