"""``mavnav diff A B``: what changed between two maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands.gating import gated_code, gates_of
from mavnav.commands.options import Force, Json, Quiet, ReportFile, check_option, output_option
from mavnav.commands.progress import loading_modules, reporting
from mavnav.commands.terminal import LISTED, emit, emit_json, note, print_table
from mavnav.errors import UsageError
from mavnav.units import pluralize

if TYPE_CHECKING:
    from mavnav.errors import ExitCode
    from mavnav.metrics.gates import Gate

EPILOG = """
[bold]Examples[/bold]

mavnav diff runs/monday runs/friday -o diff.png

mavnav diff map.yaml runs/friday --gate 'changed_m2<=0.2'

mavnav diff runs/monday runs/friday --json | jq '.changes[] | select(.kind == "new")'
"""

_map_argument = "Run directory, or map_server map (YAML)."


def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help=f"{_map_argument} Before.", show_default=False)],
    b: Annotated[Path, typer.Argument(metavar="B", help=f"{_map_argument} After.", show_default=False)],
    *,
    output: Annotated[
        Path | None, output_option("--output", "-o", metavar="FILE.png", help="Write a picture of the changes.")
    ] = None,
    report_page: ReportFile = None,
    gates: Annotated[
        list[str] | None,
        check_option("--gate", metavar="'NAME<=X'", help="Exit with code 1 unless this holds; repeatable."),
    ] = None,
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compare two maps of one place: walls that are gone, walls that are new, objects that moved."""
    bounds = gates_of(gates)
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.pipelines.diff import NUMBERS, DiffRequest, diff_maps
        _check_names(bounds, NUMBERS)
        document = diff_maps(DiffRequest(a, b, output, report_page, force=force), report)
    code = _exit_code(document, bounds)
    if json:
        emit_json(document | {"exit_code": int(code)})
    elif document["alignment"]:
        _print_changes(document)
    raise typer.Exit(code)


def _check_names(bounds: list[Gate], known: tuple[str, ...]) -> None:
    for gate in bounds:
        if gate.name not in known:
            raise UsageError(f"--gate: diff has no number {gate.name}; it has {', '.join(known)}")


def _exit_code(document: dict[str, Any], bounds: list[Gate]) -> ExitCode:
    """Return the exit code of a comparison and its gates, and report on stderr what failed."""
    if document["alignment"] is None:
        note(
            f"mavnav: error: {document['a']} and {document['b']} cannot be aligned; too few places of one fit the other"
        )
    return gated_code(document, bounds)


def _print_changes(document: dict[str, Any]) -> None:
    pose, same = document["alignment"], f"{100 * document['same_share']:.1f} %"
    rows = [
        ("gone", f"{document['gone_m2']:.3f} m² of wall cells in {pluralize(document['gone'], 'place')}"),
        ("new", f"{document['new_m2']:.3f} m² of wall cells in {pluralize(document['new'], 'place')}"),
        ("moved", pluralize(document["moved"], "object")),
        ("compared", f"{document['compared_m2']:.1f} m²; {same} of the walls are the same"),
        (
            "B in A",
            f"{pose['x_m']:z.3f} m, {pose['y_m']:z.3f} m, {pose['yaw_deg']:z.2f} deg; rms {pose['rms_mm']:.0f} mm",
        ),
    ]
    print_table([*rows, *(_row(change) for change in document["changes"][:LISTED])])
    if len(document["changes"]) > LISTED:
        emit(f"{len(document['changes']) - LISTED} more; --json lists them")


def _row(change: dict[str, Any]) -> tuple[str, str]:
    moved = f", moved with {change['moved_with']}" if change["moved_with"] else ""
    place = f"at {change['x_m']:z.2f}, {change['y_m']:z.2f} m"
    return (
        f"change {change['number']}",
        f"{change['kind']} {place}, {change['m2']:.3f} m², {change['length_m']:.2f} m long{moved}",
    )
