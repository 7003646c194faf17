"""``mavnav calibrate LOG``: the mounting of the laser, the time offset and the scales of the odometry, from one log.

Examples
--------
mavnav calibrate drive.mcap
mavnav calibrate drive.bag --odom /wheel_odom -o calibration.json --picture calibration.png
mavnav calibrate drive.mcap --json | jq -r .lines.static_transform
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

import typer

from mavnav.commands import shared
from mavnav.commands.progress import REPLAY, loading_modules, reporting
from mavnav.commands.sources import local_log
from mavnav.commands.terminal import Rows, emit, emit_json, note, note_problems, print_verdict
from mavnav.config.options import read_options, settings_of

MOUNTING: Final = ("x_m", "y_m", "yaw_deg")


@shared.with_options(
    "topic", "start_s", "end_s", "odom", "strict", odom={"usage": "--odom auto|TOPIC", "completer": "recorded_odometry"}
)
def calibrate(
    log: shared.LogSource,
    *,
    config: shared.ConfigFile = None,
    sets: shared.Sets = None,
    output: Annotated[Path | None, shared.output_option("--output", "-o", metavar="FILE.json")] = None,
    picture: Annotated[Path | None, shared.output_option("--picture", metavar="FILE.png")] = None,
    report_page: shared.ReportFile = None,
    force: shared.Force = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    **given: object,
) -> None:
    """Calibrate laser and odometry: mounting, time offset and wheel scales, each with a 95 % interval.

    Parameters
    ----------
    topic
        Scan topic of the laser (default the only one).
    odom
        Odometry to compare the laser with (default auto).
    output
        Write the JSON document to a file.
    picture
        Draw turn rates and errors of the fit over time.
    """
    options = read_options(given)
    with local_log([log]) as source, reporting(quiet=quiet, stages=REPLAY) as report:
        with loading_modules():
            from mavnav.config.loading import load_config
            from mavnav.pipelines import calibrate as pipeline
        chosen = load_config(config, sets or [], settings_of(options))
        files, config_file = (output, picture, report_page), Path(config) if config else None
        request = pipeline.CalibrationRequest(source.path, chosen, options, *files, force, config_file, source.name)
        document = pipeline.calibrate(request, report)
    if json:
        emit_json(document)
    else:
        if not document["refused"]:
            print_verdict(document, _rows(document))
            for line in filter(None, document["lines"].values()):
                emit(f"\n{line}")
        note_problems(document)
    if document["refused"]:
        note(f"mavnav: error: {document['input']['path']}: {document['refused']}")
    raise typer.Exit(document["exit_code"])


def _rows(document: dict[str, Any]) -> Rows:
    from mavnav.outputs.report.summary_page import QUANTITY_NAMES

    source = document["input"]
    frames = f"{source['frame_id']} on {source['base_frame']}"
    moved = f"{document['motion']['path_m']:.1f} m, {document['motion']['turned_deg']:.0f} deg in all"
    yield "calibrated", f"{frames}, {source['topic']} with {source['odometry']['topic']}; {moved}"
    for row in document["quantities"]:
        title, digits = QUANTITY_NAMES[row["name"]]
        yield title, _text(row, digits)
    for name in ("upside_down", "beams_reversed", "range_bias"):
        yield name.replace("_", " "), _switch_text(document[name])


def _text(row: dict[str, Any], digits: int) -> str:
    if row["refused"]:
        return f"not determined: {row['refused']}"
    unit = f" {row['unit']}".rstrip()
    estimate = f"{row['value']:.{digits}f}{unit} +- {row['ci95']:.{digits}f}"
    if row["in_log"] is None:
        return f"{estimate}; the log has no transform"
    said = "transforms say" if row["name"] in MOUNTING else "configured"
    verdict = "agrees" if row["agrees"] else f"differs by {row['difference']:+.{digits}f}"
    return f"{estimate}; {said} {row['in_log']:.{digits}f}: {verdict}"


def _switch_text(switch: dict[str, Any]) -> str:
    if switch["refused"]:
        return f"not determined: {switch['refused']}"
    return f"{'yes' if switch['value'] else 'no'}; {'agrees' if switch['agrees'] else 'differs'}"
