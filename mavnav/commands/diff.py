"""``mavnav diff A B``: what changed between two maps.

Examples
--------
mavnav diff runs/monday runs/friday -o diff.png
mavnav diff map.yaml runs/friday --gate 'changed_m2<=0.2'
mavnav diff runs/monday runs/friday --json | jq '.changes[] | select(.kind == "new")'
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mavnav.commands import shared
from mavnav.commands.progress import loading_modules, reporting
from mavnav.commands.terminal import LISTED, Rows, emit, emit_json, note, print_table
from mavnav.errors import UsageError


def diff(
    a: Annotated[Path, typer.Argument(metavar="A", show_default=False)],
    b: Annotated[Path, typer.Argument(metavar="B", show_default=False)],
    *,
    output: Annotated[Path | None, shared.output_option("--output", "-o", metavar="FILE.png")] = None,
    report_page: shared.ReportFile = None,
    gates: Annotated[list[str] | None, shared.check_option("--gate", metavar="'NAME<=X'")] = None,
    force: shared.Force = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
) -> None:
    """Compare two maps of one place: walls that are gone, walls that are new, objects that moved.

    Parameters
    ----------
    a
        Run directory, or map_server map (YAML). Before.
    b
        Run directory, or map_server map (YAML). After.
    output
        Write a picture of the changes.
    gates
        Exit with code 1 unless this holds; repeatable.
    """
    bounds = shared.gates_of(gates)
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.pipelines.diff import NUMBERS, DiffRequest, diff_maps
        for gate in bounds:
            if gate.name not in NUMBERS:
                raise UsageError(f"--gate: diff has no number {gate.name}; it has {', '.join(NUMBERS)}")
        document = diff_maps(DiffRequest(a, b, output, report_page, force=force), report)
    if document["alignment"] is None:
        early = "the search ended early: nearly every place fits"
        why = "too few places of one fit the other" if document["searched_all"] else early
        note(f"mavnav: error: {a} and {b} cannot be aligned; {why}")
    code = shared.gated_code(document, bounds)
    if json:
        emit_json(document | {"exit_code": int(code)})
    elif document["alignment"]:
        print_table(_rows(document))
        if (more := len(document["changes"]) - LISTED) > 0:
            emit(f"{more} more; --json lists them")
    raise typer.Exit(code)


def _rows(document: dict[str, Any]) -> Rows:
    pose = document["alignment"]
    yield "result", document["headline"]
    for name, known in document["verdicts"].items():
        if known and known["word"] != "good":
            yield f"map {name.upper()}", f"{document[name]} is {known['word']}: {known['reason']}"
    place = f"{pose['x_m']:z.3f} m, {pose['y_m']:z.3f} m, {pose['yaw_deg']:z.2f} deg"
    yield "B in A", f"{place}; rms {pose['rms_mm']:.0f} mm"
    for change in document["changes"][:LISTED]:
        moved = f", moved with {change['moved_with']}" if change["moved_with"] else ""
        place = f"at {change['x_m']:z.2f}, {change['y_m']:z.2f} m"
        size = f"{change['m2']:.3f} m², {change['length_m']:.2f} m long"
        yield f"change {change['number']}", f"{change['kind']} {place}, {size}{moved}"
