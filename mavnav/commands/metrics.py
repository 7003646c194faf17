"""``mavnav metrics RUN|MAP.yaml ...``: how good maps are."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mavnav.commands.options import Json, Quiet, RelationsFile, TruthFile, TruthMap
from mavnav.commands.progress import loading_modules, reporting
from mavnav.commands.quality_rows import more_rows, quality_rows, reference_rows, wall_rows
from mavnav.commands.terminal import emit, emit_json, note, print_table
from mavnav.errors import UsageError

EPILOG = """
[bold]Examples[/bold]

mavnav metrics runs/drive-robust-20-10x10

mavnav metrics other_tool/map.yaml --json | jq '.maps[0].map_quality.ghost_walls'

mavnav metrics runs/* --truth groundtruth.tum

mavnav metrics map.yaml --truth-map corridor.yaml
"""


def metrics(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="RUN|MAP.yaml", help="Run directories, or map_server maps (YAML).", show_default=False),
    ],
    *,
    truth: TruthFile = None,
    truth_map: TruthMap = None,
    relations: RelationsFile = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure maps: wall thickness, ghost walls, crispness, support, errors against a reference."""
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.ground_truth.references import load_references
            from mavnav.pipelines.evaluate import evaluate
        references = load_references(_truth_file(truth), truth_map, relations)
        document = evaluate(paths, references, report)
    for found in document["maps"]:
        if references.of_poses and found["kind"] == "map":
            note(f"mavnav: warning: {found['path']}: a map has no poses; --truth and --relations are not used for it")
    if json:
        emit_json(document)
        return
    for number, found in enumerate(document["maps"]):
        if number:
            emit("")
        print_table(_summary(found))


def _truth_file(truth: str | None) -> Path | None:
    """Return the file of a truth; raises UsageError for a topic, which only a log has."""
    from mavnav.ground_truth.topics import truth_fields

    values = truth_fields(truth)
    if "truth_topic" in values:
        raise UsageError(f"--truth {truth}: the ground truth of a log is for replay and compare; name a TUM file")
    return values.get("truth")


def _summary(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of the table on one map."""
    quality = found["map_quality"]
    return [
        (found["kind"], found["path"]),
        *wall_rows(found),
        *quality_rows(quality),
        *more_rows(quality),
        *reference_rows(found.get("reference")),
    ]
