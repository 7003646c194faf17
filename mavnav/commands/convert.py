"""``mavnav convert LOG OUT.mcap``: what can be read of a log, as a sound and indexed MCAP.

Examples
--------
mavnav convert crashed.bag.active drive.mcap
mavnav convert rosbag2_folder drive.mcap --strict --json | jq .left_out
mavnav convert drive.bag drive_with_map.mcap --run runs/drive
ssh robot cat drive.bag | mavnav convert - drive.mcap
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from mavnav.commands import shared
from mavnav.commands.progress import reporting
from mavnav.commands.sources import local_log
from mavnav.commands.terminal import Rows, note_problems, print_result


@shared.with_options("strict")
def convert(
    log: shared.LogSource,
    target: Annotated[Path, typer.Argument(metavar="OUT.mcap", show_default=False)],
    *,
    run: Annotated[Path | None, shared.input_option("--run", metavar="RUN")] = None,
    force: shared.Force = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    **given: object,
) -> None:
    """Convert a log, as far as it can be read, to an indexed MCAP with ROS 2 messages.

    Parameters
    ----------
    target
        The file to write.
    run
        Add the result of a run of this log: /tf from the map, /map, /pose, markers.
    """
    from mavnav.pipelines.convert import convert_to

    with local_log([log]) as source, reporting(quiet=quiet) as report:
        strict, progress = bool(given["strict"]), partial(report, "converting")
        result = convert_to(source.path, target, run, strict=strict, force=force, progress=progress)
        result["input"]["path"] = source.name
    print_result(result, _rows(result), json=json)
    if not json:
        note_problems(result)
    raise typer.Exit(result["exit_code"])


def _rows(result: dict[str, Any]) -> Rows:
    """Return the rows of the table."""
    file = result["output"]
    rows = [("written", f"{file['path']}, {file['size_bytes'] / 1e6:.1f} MB, {result['messages']} messages")]
    rows += [("", f"{t['name']}  {t['type']}  {t['encoding']}  {t['count']}") for t in result["topics"]]
    return rows + [("left out", f"{count} {reason}") for reason, count in result["left_out"].items()]
