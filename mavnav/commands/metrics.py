"""``mavnav metrics RUN|MAP.yaml ...``: how good maps are.

Examples
--------
mavnav metrics runs/drive-robust-20-10x10
mavnav metrics other_tool/map.yaml --json | jq '.maps[0].map_quality.ghost_walls'
mavnav metrics runs/* --truth groundtruth.tum
mavnav metrics map.yaml --truth-map corridor.yaml
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from mavnav.commands import shared
from mavnav.commands.progress import loading_modules, reporting
from mavnav.commands.run_screen import more_rows, quality_rows, reference_rows, wall_rows
from mavnav.commands.terminal import Rows, emit, emit_json, note, print_table, verdict_rows
from mavnav.config.options import REFERENCES, read_options, reference_files
from mavnav.errors import UsageError


@shared.with_options(*REFERENCES, truth={"usage": "--truth FILE.tum"})
def metrics(
    paths: Annotated[list[Path], typer.Argument(metavar="RUN|MAP.yaml", show_default=False)],
    *,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    **given: object,
) -> None:
    """Measure maps: wall thickness, ghost walls, crispness, support, errors against a reference.

    Parameters
    ----------
    paths
        Directories of runs, comparisons or batches, or map_server maps (YAML).
    truth
        Ground-truth trajectory of the laser, a TUM file: ATE and RPE.
    """
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.batch.check import runs_in
            from mavnav.ground_truth.references import load_references
            from mavnav.pipelines.evaluate import evaluate
        options = read_options(given)
        if isinstance(truth := options.get("truth"), str):
            raise UsageError(f"--truth {truth}: the ground truth of a log is for replay and compare; name a TUM file")
        references = load_references(**reference_files(options))
        runs = dict.fromkeys(run for path in shared.without_latest(paths) for run in runs_in(path))
        document = evaluate(list(runs), references, report)
    for entry in document["maps"]:
        if references.of_poses and entry["kind"] == "map":
            note(f"mavnav: warning: {entry['path']}: a map has no poses; --truth and --relations are not used for it")
    if json:
        emit_json(document)
        return
    for number, entry in enumerate(document["maps"]):
        if number:
            emit("")
        print_table(_summary(entry))


def _summary(entry: dict[str, Any]) -> Rows:
    """Yield the rows of the table on one map."""
    if "verdict" in entry:
        yield from verdict_rows(entry["verdict"])
    yield entry["kind"], entry["path"]
    yield from wall_rows(entry)
    yield from quality_rows(entry["map_quality"])
    yield from more_rows(entry["map_quality"])
    yield from reference_rows(entry.get("reference"))
