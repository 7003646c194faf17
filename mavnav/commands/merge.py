"""``mavnav merge RUN|LOG ... -o DIR``: one map of many sessions.

Examples
--------
mavnav merge monday.bag tuesday.bag runs/wednesday -o runs/building
mavnav merge logs/*.mcap -o runs/building --json | jq '.sessions[] | select(.joined | not)'
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from mavnav.commands import shared
from mavnav.commands.progress import loading_modules, reporting
from mavnav.commands.run_screen import spread_text
from mavnav.commands.terminal import emit_json, note, print_verdict
from mavnav.config.named_files import read_json
from mavnav.units import pluralize


def merge(
    context: typer.Context,
    inputs: Annotated[list[Path], typer.Argument(metavar="RUN|LOG", show_default=False)],
    *,
    directory: Annotated[Path | None, shared.directory_option()] = None,
    config: shared.ConfigFile = None,
    sets: shared.Sets = None,
    report_page: shared.Report = False,
    force: shared.Force = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
) -> None:
    """Join sessions of one building to one map: each is found in the map of the others.

    Parameters
    ----------
    inputs
        Run directories and logs, in any order.
    directory
        Directory of the result (default runs/merged, with a number where that exists).
    report_page
        Also write the result as one page, report.html.
    """
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.config.loading import load_config
            from mavnav.pipelines import merge as pipeline
        chosen = load_config(config, sets or [], {})
        file = Path(config) if config else None
        target = directory or shared.free_directory(context, Path("runs/merged"), force=force)
        paths = tuple(shared.without_latest(inputs))
        document = pipeline.merge(pipeline.MergeRequest(paths, target, chosen, force, report_page, file), report)
    if directory is None:
        shared.link_latest(target)
    for session in document["sessions"]:
        if not session["joined"] and (json or not sys.stdout.isatty()):
            note(f"mavnav: error: {_label(session)} did not join: {session['why']}")
        _note_input(session)
    if json:
        emit_json(document)
    else:
        spread = read_json(target / "run.json")["wall_thickness"]["spread"]
        more = ("walls", spread_text(spread)), ("written", str(target))
        print_verdict(document, [*map(_row, document["sessions"]), *more])
    raise typer.Exit(document["exit_code"])


def _label(session: dict[str, Any]) -> str:
    """Return the name of a session with its log or run: names are numbered if several logs have one name."""
    return f"{session['name']} ({session['input']})"


def _note_input(session: dict[str, Any]) -> None:
    """Print what the user must not miss of the log of a session."""
    tracking, damage = session["tracking"], session["damage"]
    if tracking and tracking["lost"]:
        share = f"{100 * tracking['tracked_share']:.0f} % of the scans have a pose"
        note(f"mavnav: error: {_label(session)}: tracking was lost for good, {share}; replay it alone to see where")
    if damage:
        first = f"{damage[0]['what']}, {damage[0]['where']}"
        note(f"mavnav: warning: {_label(session)}: damaged in {pluralize(len(damage), 'place')}, the first: {first}")


def _row(session: dict[str, Any]) -> tuple[str, str]:
    """Return the row of a session; a verdict that is not good is part of it."""
    text, known = f"{session['input']}, {_joined_text(session)}", session["verdict"]
    verdict = "" if not known or known["word"] == "good" else f"; {known['word']}: {known['reason']}"
    return session["name"], f"{text}{verdict}"


def _joined_text(session: dict[str, Any]) -> str:
    if not session["joined"]:
        return f"not joined: {session['why']}"
    to = ", ".join(other["name"] for other in session["joined_to"])
    if not to:
        return f"{session['scans']} scans, the first of the group"
    evidence = f"{session['closures']} of {session['tested']} key frames agree, {session['residual_mm']:.0f} mm"
    return f"{session['scans']} scans, joined to {to}: {evidence}"
