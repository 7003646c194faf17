"""``mavnav compare [LOG ...]``: maps, metrics and relative cost of several search grids, side by side.

Examples
--------
mavnav compare drive.mcap --grid 5x5 --grid 10x10 --grid 20x20
mavnav compare --grid 20x20
mavnav compare drive.mcap --set robust.cell_mm=10,20,50
mavnav compare runs/before runs/after
mavnav compare drive.mcap --trajectory toolbox=toolbox.tum --external kiss='python kiss.py {log} {out}'
mavnav compare a.bag b.mcap --method robust --method paper -j 4 -o grids
mavnav compare drive.mcap --grid 40x40 --azimuth 40 --gate 'wall_thickness.p95_mm<=150'
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands import shared
from mavnav.commands.comparison_table import print_result_of
from mavnav.commands.progress import loading_modules, reporting, watching
from mavnav.commands.terminal import note
from mavnav.config.options import READING, REFERENCES, read_options, settings_of
from mavnav.errors import UsageError
from mavnav.profiling import Progress

if TYPE_CHECKING:
    from mavnav.batch.runner import BatchPlan
    from mavnav.metrics.gates import Gate
    from mavnav.pipelines.trajectory_source import Program, TrajectorySource

    GivenPoses = tuple[Sequence[TrajectorySource], Sequence[Program], float]


@shared.with_options(*READING, "resolution_m", "online", *REFERENCES)
def compare(
    context: typer.Context,
    logs: Annotated[list[Path] | None, typer.Argument(metavar="LOG|RUN", show_default=False)] = None,
    *,
    trajectories: shared.Trajectories = None,
    programs: shared.Programs = None,
    program_s: shared.ProgramLimit = 3600.0,
    methods: shared.Methods = None,
    grids: Annotated[list[str] | None, shared.replay_option("grid")] = None,
    azimuths: shared.Azimuths = None,
    config: shared.ConfigFile = None,
    sets: shared.Sets = None,
    directory: Annotated[Path | None, shared.directory_option()] = None,
    force: shared.Force = False,
    jobs: shared.Jobs = None,
    preview: Annotated[bool, shared.output_option("--preview")] = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    gates: shared.Gates = None,
    **given: object,
) -> None:
    """Replay logs with several search grids, or methods, and compare maps, metrics and cost.

    Finished replays are reused; a replay that fails does not stop the others.

    Parameters
    ----------
    logs
        Logs (default: the sample corridor), or finished runs.
    grids
        Search grid; repeatable (default 5x5, 10x10, 20x20). To a single one, 10x10 is added.
    directory
        Output directory (default runs/compare-LOG).
    force
        Ignore finished runs and repeat them.
    preview
        Print the maps as text (on stderr with --json).
    """
    options = read_options(given)
    shared.check_logs(logs or [])
    bounds = shared.gates_of(gates)
    if any((path / "run.json").is_file() for path in logs or []):
        for flag in shared.typed_flags(context, {"logs", "directory", "json", "quiet", "gates"}):
            raise UsageError(f"{flag} is for logs; finished runs are compared as they are")
        target = directory or shared.free_directory(context, Path("runs/compare-runs"), force=False)
        document = _compare_finished(shared.without_latest(logs or []), target, bounds, json=json, quiet=quiet)
        raise typer.Exit(document["exit_code"])
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.batch.runner import load_kernels
            from mavnav.comparison import pipeline
            from mavnav.comparison.pipeline import check_given
            from mavnav.jobs.pool import usable_cores
            from mavnav.outputs.documents.provenance import Typed
            from mavnav.pipelines.trajectory_source import read_program, read_source
        target = directory or pipeline.comparison_directory(logs or ())
        if not logs:
            logs, true_map = _sample(target, report)
            options.setdefault("truth_map", true_map)
        sources = tuple(map(read_source, trajectories or ())), tuple(map(read_program, programs or ()))
        given_poses = (*sources, program_s) if any(sources) else None
        searches, usual = (methods or (), grids or (), azimuths or ()), () if given_poses else pipeline.PAPER_GRIDS
        settings = pipeline.comparison_settings(config, sets or (), *searches, settings_of(options), usual=usual)
        typed, workers = Typed(context.obj, config, tuple(sets or ())), jobs or usable_cores()
        request = pipeline.comparison_request(
            logs, settings, target, options, workers=workers, gates=bounds, force=force, typed=typed
        )
        plan = pipeline.plan_comparison(request, report)
        if given_poses:
            check_given(plan, *given_poses[:2])
        load_kernels(plan, report)
    document, page = _run_and_draw(plan, given_poses, quiet=quiet)
    print_result_of(document, page, json=json)
    for cell in document["cells"] if preview else ():
        if cell["directory"]:
            shared.show_preview(target / cell["directory"], cell["name"], stderr=json)
    raise typer.Exit(document["exit_code"])


def _compare_finished(runs: list[Path], target: Path, gates: list[Gate], *, json: bool, quiet: bool) -> dict[str, Any]:
    """Compare finished runs; return comparison.json."""
    with reporting(quiet=quiet) as report:
        with loading_modules():
            from mavnav.comparison.pipeline import compare_finished
            from mavnav.outputs.writers import REPORT_FILE, write_page
        document = compare_finished(runs, target, gates)
        report("drawing the report", 0, None)
        write_page(document, target)
    print_result_of(document, target / REPORT_FILE, json=json)
    return document


def _sample(directory: Path, report: Progress) -> tuple[list[Path], Path]:
    """Return the sample corridor, simulated and kept in the directory where it is not shipped, and its true map."""
    from mavnav.comparison.pipeline import check_comparison_directory

    check_comparison_directory(directory)
    with loading_modules():
        from mavnav.comparison.sample import sample_log, sample_truth
    return [sample_log(directory, report)], sample_truth(directory)


def _run_and_draw(plan: BatchPlan, given_poses: GivenPoses | None, *, quiet: bool) -> tuple[dict[str, Any], Path]:
    """Run what is missing, and draw the report unless it shows these results; return comparison.json and its path."""
    from mavnav.batch.document import unlisted_runs, unlisted_text
    from mavnav.batch.runner import run_cases
    from mavnav.comparison.document import COMPARISON_FILE
    from mavnav.comparison.pipeline import compare_with_poses, is_report_current, write_results
    from mavnav.outputs.writers import REPORT_FILE, write_page

    directory, drawn = plan.request.directory, is_report_current(plan)  # before comparison.json is written again
    mine = [{"log": str(c.run.request.log), "directory": f"cells/{c.run.directory.name}"} for c in plan.cases if c.run]
    if other := unlisted_runs(mine, directory / COMPARISON_FILE):
        note(f"mavnav: warning: {unlisted_text(other)}")
    with watching([case.name for case in plan.missing], quiet=quiet) as listen:
        own = run_cases(plan, listen, lambda result: result)
    with reporting(quiet=quiet) as report:
        document = compare_with_poses(plan, own, *given_poses, report) if given_poses else write_results(plan, own)
        if given_poses or not drawn:
            report("drawing the report", 0, None)
            write_page(document, directory)
    return document, directory / REPORT_FILE
