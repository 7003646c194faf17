"""``mavnav score LOG --trajectory ...``: trajectories of other programs, judged by the scans of the log.

Examples
--------
mavnav score drive.mcap --trajectory toolbox=toolbox.tum --trajectory hector=hector.csv
mavnav score drive.mcap --trajectory slam=tf:map,base_link --trajectory ekf=topic:/odometry/filtered@first
mavnav score drive.mcap --trajectory mavnav=runs/drive --trajectory other=base_poses.tum,base
mavnav score drive.mcap --trajectory mavnav=runs/drive --external kiss='python kiss.py {log} {out}' --time-limit 600
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mavnav.commands import shared
from mavnav.commands.comparison_table import print_result_of
from mavnav.commands.progress import loading_modules, reporting
from mavnav.commands.sources import local_log
from mavnav.commands.terminal import note, printable
from mavnav.config.options import REFERENCES, read_options, settings_of
from mavnav.errors import worst


@shared.with_options("topic", "odom", "start_s", "end_s", "attitude", "extrinsic", "strict", *REFERENCES)
def score(
    context: typer.Context,
    logs: shared.LogParts,
    *,
    trajectories: shared.Trajectories = None,
    programs: shared.Programs = None,
    program_s: shared.ProgramLimit = 3600.0,
    config: shared.ConfigFile = None,
    sets: shared.Sets = None,
    directory: Annotated[Path | None, shared.directory_option()] = None,
    force: shared.Force = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    gates: shared.Gates = None,
    **given: object,
) -> None:
    """Draw the map at given poses, and judge these by the scans: any program's trajectory, by the same measures.

    Parameters
    ----------
    directory
        Output directory, with a run for each (default runs/score-LOG).
    """
    options = read_options(given)
    bounds = shared.gates_of(gates)
    shared.check_gates(bounds, *(["reference"] if {*REFERENCES} & options.keys() else []))
    with local_log(logs) as source, reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.comparison.pipeline import check_score_directory, write_scores
            from mavnav.config.loading import load_config
            from mavnav.logs.formats.detect import log_name
            from mavnav.outputs.documents.provenance import Typed
            from mavnav.outputs.writers import REPORT_FILE, write_page
            from mavnav.pipelines.score import ScoreRequest, score_log
            from mavnav.pipelines.trajectory_source import read_program, read_source
        usual = Path("runs") / f"score-{log_name(source.path)}"
        target = directory or shared.free_directory(context, usual, force=force)
        chosen = load_config(config, sets or [], settings_of(options))
        request = ScoreRequest(
            source.path,
            target,
            chosen,
            options,
            force,
            typed=Typed(context.obj, config, tuple(sets or ())),
            more=source.more,
            sources=tuple(map(read_source, trajectories or ())),
            programs=tuple(map(read_program, programs or ())),
            limit_s=program_s,
        )
        check_score_directory(request, source.name)
        scored = score_log(request, report)
        document = write_scores(source.name, scored, target)
        report("drawing the report", 0, None)
        write_page(document, target)
    for warning in dict.fromkeys(text for each in scored if each.document for text in each.document["warnings"]):
        note(f"mavnav: warning: {printable(warning)}")
    print_result_of(document, target / REPORT_FILE, json=json)
    gated = [shared.gated_code(each.document, bounds) for each in scored if each.document]
    raise typer.Exit(worst([document["exit_code"], *gated]))
