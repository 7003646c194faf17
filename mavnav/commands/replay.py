"""``mavnav replay LOG``: from a recorded log to a trajectory, a map and its quality.

Examples
--------
mavnav replay drive.mcap
mavnav replay drive_0.mcap drive_1.mcap
mavnav replay drive.bag -o runs/drive --odom off --start 5 --end 60
mavnav replay rosbag2_folder --method paper --grid 20x20 --azimuth 40
mavnav replay drive.mcap --map office.yaml --start-pose 2.1,0.4,1.57
mavnav replay drive.mcap --set robust.cell_mm=25 --json | jq .wall_thickness
mavnav replay --again runs/drive-robust-20-10x10 -o runs/repeated
ssh robot cat drive.mcap | mavnav replay - -o runs/drive
"""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Annotated

import typer

from mavnav.commands import shared, signals
from mavnav.commands.progress import REPLAY, loading_modules, reporting
from mavnav.commands.run_screen import log_rows, map_rows, print_run, reference_rows, scan_time_text
from mavnav.commands.sources import LocalLog, local_log
from mavnav.commands.terminal import Json, Rows, emit, note
from mavnav.config.options import OPTIONS, REFERENCES, ReplayOptions, read_options, settings_of
from mavnav.errors import UsageError, missing
from mavnav.units import pluralize

if TYPE_CHECKING:
    from mavnav.config.models import Config


@shared.with_options(*OPTIONS)
def replay(
    context: typer.Context,
    logs: shared.MaybeLogParts = None,
    *,
    again: shared.Again = None,
    config: shared.ConfigFile = None,
    sets: shared.Sets = None,
    directory: Annotated[Path | None, shared.directory_option()] = None,
    force: shared.Force = False,
    report: shared.Report = False,
    outputs: shared.Outputs = None,
    preview: shared.Preview = None,
    verbose: shared.Verbose = False,
    profile: Annotated[bool, shared.output_option("--profile")] = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    gates: shared.Gates = None,
    **given: object,
) -> None:
    """Map a recorded log: trajectory, map, pictures and wall thickness.

    Parameters
    ----------
    directory
        Run directory (default runs/LOG-METHOD-YAW-GRID, with a number where that exists).
    profile
        Print the time of each stage.
    """
    with local_log(logs) if logs else nullcontext() as source:
        fields = {} if again is None else _earlier_fields(context, again, source, directory)
        path = fields.pop("log", source.path if source else None)
        if path is None:
            raise UsageError("no log; name one, or a run directory with --again")
        options = fields.pop("options", None) or read_options(given)
        chosen = fields.pop("config", None) or _config(config, sets or [], options)
        bounds, written = shared.gates_of(gates), shared.output_values(outputs, report=report, preview=preview)
        more = fields.setdefault("more", source.more if source else ())
        _check_files([path, *more], options)
        optional = {"reference": {*REFERENCES}, "localisation": {"map"}, "continued": {"continue_from"}}
        shared.check_gates(bounds, *(section for section, names in optional.items() if names & options.keys()))
        with reporting(quiet=quiet, stages=REPLAY) as progress:
            startup_s, started_s = process_time(), perf_counter()
            with loading_modules():
                from mavnav.metrics.gates import MAP_SECTIONS
                from mavnav.outputs.documents.provenance import Typed
                from mavnav.pipelines.replay import ReplayRequest, replay_directory, replay_log
            compile_s = perf_counter() - started_s
            usual = shared.again_directory(again) if again else replay_directory(path, chosen)
            target = directory or shared.free_directory(context, usual, force=force)
            fields = {"typed": Typed(context.obj, config, tuple(sets or ())), **written, **fields}
            fields |= {"address": source.address} if source else {}
            fields |= {"gated": any(gate.name.startswith(MAP_SECTIONS) for gate in bounds)}
            request = ReplayRequest(path, target, chosen, options, force, **fields)
            _, document = replay_log(request, progress, compile_s, signals.deferring, startup_s)
        if directory is None:
            shared.link_latest(target)
        about, measures = log_rows(document), _measures(document)
        print_run(document, target, about, measures, json=json, preview=preview, verbose=verbose)
        if "continued" in document:
            _note_continued(document["continued"])
        if again:
            shared.note_repetition(again, document)
        if profile:
            print_profile(document["timing"], stderr=json)
        raise typer.Exit(shared.gated_code(document, bounds))


def _earlier_fields(context: typer.Context, again: Path, source: LocalLog | None, directory: Path | None) -> Json:
    """Return the fields of a request that repeat a run, and report what differs; its log is given if it has moved."""
    from mavnav.pipelines.again import replay_again, typed_again

    run = shared.run_to_repeat(context, again, directory, "logs", "profile", simulated=False)
    fields = replay_again(run, *((source.path, source.more) if source else (None,)))
    return fields | {"typed": typed_again(run, context.obj)}


def _config(file: str | None, sets: list[str], options: ReplayOptions[Path]) -> Config:
    """Load the configuration: that of the run which is continued, unless there is a file."""
    from mavnav.config.loading import load_config

    base, overrides = None, settings_of(options)
    if file is None and (continued := options.get("continue_from")):
        from mavnav.pipelines.again import run_layer

        base = run_layer(continued)
    config = load_config(file, sets, overrides, base)
    for key in config.without_effect([*(text.partition("=")[0] for text in sets), *overrides]):
        note(f"mavnav: warning: {key} has no effect with method {config.method}")
    return config


def _check_files(logs: list[Path], options: ReplayOptions[Path]) -> None:
    known = options.get("map")
    if "start_pose" in options and known is None:
        raise UsageError("--start-pose is a pose in a known map; name the map with --map")
    if known is not None and not known.exists():
        raise UsageError(missing(known, "name the YAML file of a map, or a run directory"))
    shared.check_logs(logs)


def _note_continued(continued: Json) -> None:
    """Print the warning where the run to which a log was added is of another version."""
    from mavnav.pipelines.sessions import run_to_continue
    from mavnav.version import __version__

    version = run_to_continue(Path(continued["run"])).record.mavnav_version
    if version != __version__:
        text = f"{continued['run']} is of mavnav {version}, this is {__version__}; maps may differ"
        note(f"mavnav: warning: {text}")


def _measures(document: Json) -> Rows:
    """Yield the rows below the map."""
    yield from map_rows(document)
    if "continued" in document and document["continued"]["joined"]:
        yield "continued", _continuation_text(document["continued"])
    if "localisation" in document:
        yield "found in the map", _pose_text(document["localisation"])
    yield from reference_rows(document.get("reference"))


def _continuation_text(continued: Json) -> str:
    evidence = continued["evidence"]
    place = f", at the end of {evidence['after']}" if evidence["after"] else ""
    agree = f"{evidence['closures']} of {evidence['tested']} key frames agree, {evidence['residual_mm']:.0f} mm"
    return f"{continued['run']}, {pluralize(len(continued['sessions']), 'session')}{place}: {agree}"


def _pose_text(localisation: Json) -> str:
    pose = localisation["found"]
    if not pose:
        return "nowhere"
    return f"x {pose['x_m']:z.2f} m, y {pose['y_m']:z.2f} m, yaw {pose['yaw_deg']:z.1f} deg, scan {pose['scan']}"


def print_profile(timing: Json, *, stderr: bool) -> None:
    """Print the seconds by stage, the longest first, and each one's share; then what a scan takes."""
    stages, put = timing["stages"], note if stderr else emit
    total_s = max(sum(stages.values()), 1e-9)
    for name, spent_s in sorted(stages.items(), key=lambda stage: -stage[1]):
        put(f"{name:<14}{spent_s:>9.3f} s {100 * spent_s / total_s:>5.1f} %")
    put(f"a scan takes {scan_time_text(timing)}")
