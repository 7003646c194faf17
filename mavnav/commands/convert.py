"""``mavnav convert LOG OUT.mcap``: what can be read of a log, as a sound and indexed MCAP."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands import shared
from mavnav.commands.progress import reporting
from mavnav.commands.terminal import Rows, note_problems, print_result
from mavnav.errors import ExitCode

if TYPE_CHECKING:
    from mavnav.logs.records import RawMessage
    from mavnav.logs.writing.convert import Conversion

SCHEMA_VERSION = 1

EPILOG = """
[bold]Examples[/bold]
mavnav convert crashed.bag.active drive.mcap
mavnav convert rosbag2_folder drive.mcap --strict --json | jq .left_out
mavnav convert drive.bag drive_with_map.mcap --run runs/drive
"""


@shared.with_options("strict")
def convert(
    log: shared.LogFile,
    target: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="The file to write.", show_default=False)],
    *,
    run: Annotated[
        Path | None,
        shared.input_option(
            "--run", metavar="RUN", help="Add the result of a run of this log: /tf from the map, /map, /pose, markers."
        ),
    ] = None,
    force: shared.Force = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    **given: object,
) -> None:
    """Convert a log, as far as it can be read, to an indexed MCAP with ROS 2 messages."""
    from mavnav.logs.writing.convert import convert_log

    with reporting(quiet=quiet) as report:
        strict, progress = bool(given["strict"]), partial(report, "converting")
        added = _added(run, log) if run else ()
        done = convert_log(log, target, strict=strict, force=force, progress=progress, added=added)
    code = ExitCode.DAMAGED_INPUT if done.damage else ExitCode.DONE
    result = document(log, target, done, code)
    print_result(result, _rows(result), json=json)
    if not json:
        note_problems(result)
    raise typer.Exit(code)


def _added(run: Path, log: Path) -> list[RawMessage]:
    from mavnav.pipelines.augment import messages_of_run

    return messages_of_run(run, log)


def document(log: Path, target: Path, done: Conversion, code: ExitCode) -> dict[str, Any]:
    """Return what ``--json`` prints."""
    from msgspec.structs import asdict

    return {
        "schema_version": SCHEMA_VERSION,
        "input": {"path": str(log)},
        "output": {"path": str(target), "size_bytes": target.stat().st_size},
        "topics": [asdict(topic) for topic in done.topics],
        "messages": done.messages,
        "left_out": done.left_out,
        "damage": [asdict(damage) for damage in done.damage],
        "warnings": list(done.warnings),
        "exit_code": int(code),
    }


def _rows(result: dict[str, Any]) -> Rows:
    """Return the rows of the table."""
    file = result["output"]
    rows = [("written", f"{file['path']}, {file['size_bytes'] / 1e6:.1f} MB, {result['messages']} messages")]
    rows += [("", f"{t['name']}  {t['type']}  {t['encoding']}  {t['count']}") for t in result["topics"]]
    return rows + [("left out", f"{count} {reason}") for reason, count in result["left_out"].items()]
