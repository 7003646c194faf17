"""``--gate`` of the commands that make one run: bounds on its numbers, and what they do to the exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands.terminal import note
from mavnav.config.option_kinds import CHECKS
from mavnav.errors import ExitCode, worst

if TYPE_CHECKING:
    from mavnav.metrics.gates import Gate

Gates = Annotated[
    list[str] | None,
    typer.Option(
        "--gate",
        metavar="'NAME<=X'",
        help="Exit with code 1 unless this holds of run.json, e.g. 'tracking.lost==false'; repeatable.",
        show_default=False,
        rich_help_panel=CHECKS,
    ),
]


def gates_of(texts: list[str] | None) -> list[Gate]:
    """Read the gates; raises UsageError, before the work."""
    if not texts:
        return []
    from mavnav.metrics.gates import parse_gate

    return [parse_gate(text) for text in texts]


def check_gates(gates: list[Gate], *sections: str) -> None:
    """Raise UsageError for a gate on a number that run.json will not have, before the work.

    ``sections`` are the optional sections of run.json that it will have.
    """
    if not gates:
        return
    from mavnav.metrics.gates import check_names
    from mavnav.outputs.documents.schema import number_names, run_keys

    more = [key for key in run_keys() if key.partition(".")[0] in sections]
    check_names((gate.name for gate in gates), [*number_names(reference="reference" in sections), *more])


def gated_code(document: dict[str, Any], gates: list[Gate]) -> ExitCode:
    """Return the exit code of a document and its gates, and report on stderr which of them do not hold.

    Raises UsageError for a name that is a number in other runs only: a run is written by then.
    """
    if not gates:
        return ExitCode(document["exit_code"])
    from mavnav.metrics.gates import judge

    failed = [verdict for verdict in judge(gates, document) if not verdict.passed]
    for verdict in failed:
        note(f"mavnav: error: gate {verdict.gate.text} failed: {verdict.why}")
    return worst([document["exit_code"], *(ExitCode.GATE_FAILED for _ in failed)])
