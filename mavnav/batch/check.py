"""Finished runs, and their verdicts and quality gates, which ``mavnav check`` judges."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

from mavnav.config.named_files import read_json, what_is_wrong
from mavnav.errors import ExitCode, UsageError, worst
from mavnav.metrics.gates import VERDICTS, Gate, accepts_code, check_known, judge_some, judge_verdict, stored_verdict
from mavnav.outputs.directory import RUN_FILE, check_files

WHOLE_FILES: Final = ("batch.json", "comparison.json")
"""The documents of all runs of a directory. Repeated: the modules that write them load longer than a check takes."""


def check_runs(
    paths: Sequence[Path], bounds: list[Gate], accept: frozenset[int | str]
) -> tuple[list[dict[str, Any]], ExitCode]:
    """Judge the runs of directories; return a row for each, and the worst exit code.

    ``accept`` are the verdicts and exit codes that pass. Raises UsageError for what is no finished run, and for gates
    on unknown names.
    """
    finished = [run for path in paths for run in _runs_at(path)]
    check_known(bounds, [run.document for run in finished if run.document is not None])
    rows = [_judge(run, bounds, accept) for run in finished]
    return rows, worst(row["exit_code"] for row in rows)


class _CheckedRun(NamedTuple):
    """A finished run; or one that a batch could not make: it has no ``document``, and ``error`` says why.

    ``accept`` are the verdicts that the batch accepts.
    """

    name: str
    exit_code: ExitCode
    document: dict[str, Any] | None
    accept: frozenset[int | str] = frozenset()
    error: str = ""


def _runs_at(path: Path) -> list[_CheckedRun]:
    """Return the run of a directory, or all of a comparison or a batch.

    Those are the runs of its own document: ``cells`` may hold others, of earlier versions of logs. A comparison or
    batch that was never finished has none; then all runs below it are returned.
    """
    if path.name in (RUN_FILE, *WHOLE_FILES):
        path = path.parent
    for file in (path / name for name in WHOLE_FILES):
        if file.is_file():
            return _runs_of(file)
    return [_run(file.parent) for file in sorted(path.glob(f"cells/*/{RUN_FILE}"))] or [_run(path)]


def runs_in(path: Path) -> list[Path]:
    """Return the directories of the runs of a comparison or batch that have a result; else the path alone."""
    runs = _runs_at(path) if any((path / name).is_file() for name in WHOLE_FILES) else []
    return [Path(os.path.normpath(run.name)) for run in runs if run.document is not None] or [path]


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
                runs.append(_CheckedRun(cell["name"], code, None, error=cell["error"] if code else ""))
            else:
                run = _run(file.parent / cell["directory"])._replace(accept=_accepted(cell))
                if costs and run.document is not None:
                    run.document["price"] = {name: each[k] for name, each in costs.items()}
                runs.append(run)
    return runs


def _accepted(cell: dict[str, Any]) -> frozenset[int | str]:
    """Return the exit code and the verdict that a batch accepts of a run."""
    words = [
        name.rpartition("=")[2] for gate in cell.get("gates", []) if (name := gate["gate"]).startswith("verdict<=")
    ]
    return frozenset([*words, *([cell["exit_code"]] if cell.get("accepted") else [])])


def _run(directory: Path) -> _CheckedRun:
    file = directory / RUN_FILE
    with _reading(file):
        document: dict[str, Any] = read_json(file)
        check_files(directory, document.get("outputs", {}))
        return _CheckedRun(str(directory), ExitCode(document["exit_code"]), document)


@contextmanager
def _reading(file: Path) -> Iterator[None]:
    advice = "name the directory of a finished run, or make it again"
    try:
        yield
    except OSError as error:
        raise UsageError(f"{file.parent}: no {file.name} ({error.strerror}); {advice}") from error
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        reason = what_is_wrong(error, "is not one of mavnav's")
        raise UsageError(f"{file} {reason}; {advice}") from error


def _judge(run: _CheckedRun, bounds: list[Gate], given: frozenset[int | str]) -> dict[str, Any]:
    """Return the row of a run.

    A verdict that is ``given`` is accepted instead of that of its batch, of which that a track is lost is one; exit
    codes are accepted besides.
    """
    words = frozenset[int | str]({*VERDICTS, ExitCode.TRACKING_LOST})
    document, accept = run.document or {}, given | (run.accept - words if given & words else run.accept)
    results = [*judge_verdict(accept, document), *judge_some(bounds, document)] if document else []
    code = ExitCode.DONE if accepts_code(accept, run.exit_code) else run.exit_code
    verdict = stored_verdict(document)
    lost = code == ExitCode.TRACKING_LOST and verdict is not None  # the verdict says it
    return {
        "run": run.name,
        "verdict": verdict,
        "gates": results,
        "error": run.error or (f"it ended with exit code {code}" if code and not lost else None),
        "exit_code": int(worst([code, *(ExitCode.GATE_FAILED for each in results if not each["passed"])])),
    }
