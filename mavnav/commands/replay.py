"""``mavnav replay LOG``: from a recorded log to a trajectory, a map and its quality."""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands import signals
from mavnav.commands.gating import Gates, gated_code, gates_of
from mavnav.commands.ground_truth import RelationsFile, Truth, TruthMap
from mavnav.commands.map_preview import Preview, show_preview
from mavnav.commands.options import (
    OUTPUT,
    SEARCH,
    Azimuth,
    ConfigFile,
    End,
    Extrinsic,
    Force,
    Grid,
    Json,
    LogFile,
    Method,
    Odom,
    Online,
    Quiet,
    Report,
    Sets,
    Start,
    Strict,
    Topic,
    given,
)
from mavnav.commands.progress import loading_kernels, reporting
from mavnav.commands.quality_rows import quality_rows, reference_rows
from mavnav.commands.terminal import console, emit, note, printable
from mavnav.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from mavnav.config.models import Config
    from mavnav.pose import Pose

_FEW_BEAMS = 20
"""A scan of fewer returns hardly tells one pose from another."""

EPILOG = """
[bold]Examples[/bold]

mavnav replay drive.mcap

mavnav replay drive.bag -o runs/drive --odom off --start 5 --end 60

mavnav replay rosbag2_folder --method paper --grid 20x20 --azimuth 40

mavnav replay drive.mcap --map office.yaml --start-pose 2.1,0.4,1.57

mavnav replay drive.mcap --set robust.cell_mm=25 --json | jq .wall_thickness
"""


def replay(
    log: LogFile,
    *,
    topic: Topic = None,
    start: Start = None,
    end: End = None,
    odom: Odom = None,
    extrinsic: Extrinsic = None,
    strict: Strict = False,
    method: Method = None,
    grid: Grid = None,
    azimuth: Azimuth = None,
    search: Annotated[
        str | None,
        given(
            metavar="pruned|exhaustive",
            help="Exhaustive evaluates every pose of the grid: slower, same result.",
            rich_help_panel=SEARCH,
        ),
    ] = None,
    deskew: Annotated[
        str | None,
        given(
            metavar="auto|on|off", help="Correct scans for motion during the sweep (robust).", rich_help_panel=SEARCH
        ),
    ] = None,
    loop_closure: Annotated[
        str | None,
        given(metavar="auto|off", help="Detect and close loops (ignored with --online).", rich_help_panel=SEARCH),
    ] = None,
    online: Online = False,
    known: Annotated[
        Path | None,
        given(
            "--map",
            metavar="MAP",
            help="Localize in this map (YAML or run) instead of mapping.",
            rich_help_panel=SEARCH,
        ),
    ] = None,
    start_pose: Annotated[
        str | None,
        given(metavar="X,Y,YAW", help="Approximate first pose in the map (m, m, rad).", rich_help_panel=SEARCH),
    ] = None,
    config: ConfigFile = None,
    sets: Sets = None,
    directory: Annotated[
        Path | None,
        given(
            "--output",
            "-o",
            metavar="DIR",
            help="Run directory (default runs/LOG-METHOD-GRID).",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    force: Force = False,
    report: Report = False,
    preview: Preview = False,
    profile: Annotated[
        bool, typer.Option("--profile", help="Print the time of each stage.", rich_help_panel=OUTPUT)
    ] = False,
    json: Json = False,
    quiet: Quiet = False,
    gates: Gates = None,
    truth: Truth = None,
    truth_map: TruthMap = None,
    relations: RelationsFile = None,
) -> None:
    """Map a recorded log: trajectory, map, pictures and wall thickness."""
    options = {"method": method, "grid": grid, "azimuth": azimuth, "search": search, "odom": odom}
    options |= {"loop_closure": loop_closure}
    sweep = [] if deskew is None else [f"robust.deskew={deskew}"]
    chosen = _config(config, [*(sets or []), *sweep], online=online, **options)
    bounds = gates_of(gates)
    mounting = None if extrinsic is None else pose(extrinsic)
    began = None if start_pose is None else pose(start_pose, "--start-pose")
    _check_map(known, began, chosen)
    if not log.exists():
        raise UsageError(f"{log}: no such file; name a log")
    with reporting(quiet=quiet) as progress:
        startup_s, started_s = process_time(), perf_counter()
        with loading_kernels(progress):
            from mavnav.pipelines import replay as pipeline
            from mavnav.slam.registry import load_kernels

            load_kernels(chosen)
        compile_s = perf_counter() - started_s
        target = directory or pipeline.default_directory(log, chosen)
        request = pipeline.Request(
            log=log,
            directory=target,
            config=chosen,
            topic=topic,
            start_s=start,
            end_s=end,
            extrinsic=mounting,
            force=force,
            report=report,
            truth=truth,
            truth_map=truth_map,
            relations=relations,
            strict=strict,
            map=known,
            start_pose=began,
        )
        _, document = pipeline.replay(request, progress, compile_s, signals.keeping, startup_s)
    _tell(document, target, json=json)
    if profile:
        tell_stages(document["timing"]["stages"], stderr=json)
    if preview:
        show_preview(target, stderr=json)
    raise typer.Exit(gated_code(document, bounds))


def _config(file: str | None, sets: list[str], *, online: bool, **options: object) -> Config:
    """Load the configuration; options that were not given leave it alone."""
    from mavnav.config.loading import load_config

    overrides = {name: value for name, value in options.items() if value is not None}
    return load_config(file, sets, overrides | ({"final_pass": False} if online else {}))


def _check_map(known: Path | None, start_pose: Pose | None, config: Config) -> None:
    if start_pose and known is None:
        raise UsageError("--start-pose is a pose in a known map; name the map with --map")
    if known is not None and config.method != "robust":
        raise UsageError(f"--map: method {config.method} makes a map of its own; use --method robust")
    if known is not None and not known.exists():
        raise UsageError(f"{known}: no such file; name the YAML file of a map, or a run directory")


def pose(text: str, option: str = "--extrinsic") -> Pose:
    """Read the ``x,y,yaw`` of an option in m, m, rad; raises UsageError."""
    from math import isfinite

    from mavnav.pose import Pose

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3 or not all(map(isfinite, values)):
        raise UsageError(f"{option} {text!r} is not X,Y,YAW in m, m, rad; write for example {option} 0.1,0,1.5708")
    return Pose(*values)


def _tell(document: dict[str, Any], directory: Path, *, json: bool) -> None:
    """Print the result on stdout, and on stderr what the user must not miss."""
    if json:
        from json import dumps

        emit(dumps(document, indent=2))
    else:
        print_table(_summary(document, directory))
    for warning in document["warnings"]:
        note(f"mavnav: warning: {warning}")
    if document["damage"]:
        first = document["damage"][0]
        note(
            f"mavnav: warning: the input is damaged in {len(document['damage'])} place(s), the first: {first['what']},"
            f" {first['where']}; what is intact was used"
        )
    if document["exit_code"] == ExitCode.TRACKING_LOST:
        note(lost_line(document))
    if document["partial"]:
        scans = document["scans"]
        note(f"mavnav: stopped after {scans['processed']} of {scans['usable']} scans; the run is partial")


def lost_line(document: dict[str, Any]) -> str:
    """Say that the track was lost for good: since when, for how much of the log, and what to try."""
    poses = f"{100 * document['tracking']['tracked_share']:.0f} % of the scans have a pose"
    since = _lost_since(document["tracking"]["intervals"])
    if "localisation" in document:
        return (
            f"mavnav: error: the laser was lost for good in the map{since}, {poses}; see whether the map is of this "
            "place, and try --start-pose"
        )
    advice = "--method robust" if document["method"] == "paper" else "--odom auto or a finer --grid"
    beams = document["search"]["beams_used"]["median"] or 0
    if beams < _FEW_BEAMS:
        return (
            f"mavnav: error: the scans see too little to be matched ({beams:.0f} usable beams in the median); "
            "what could be tracked is written, look at the ranges with 'mavnav info', and at near_mm and far_mm"
        )
    return (
        f"mavnav: error: tracking was lost for good{since}, {poses}; what could be tracked is written, try {advice}, "
        "and look at map.png"
    )


def _lost_since(intervals: list[dict[str, Any]]) -> str:
    """Say when the track ended; nothing where it came back, for too few of the scans."""
    if not intervals or intervals[-1]["recovered"]:
        return ""
    return f" {intervals[-1]['start_s']:.1f} s after the first scan"


def _summary(document: dict[str, Any], directory: Path) -> list[tuple[str, str]]:
    """Return the rows of the table that ends a run."""
    scans, tracking, timing = document["scans"], document["tracking"], document["timing"]
    lost = sum(interval["scans"] for interval in tracking["intervals"])
    rows = [
        ("scans", f"{scans['processed']} of {scans['total']}"),
        ("accepted", f"{100 * scans['accepted'] / max(scans['processed'], 1):.1f} %"),
        ("rejected", f"{scans['rejected'] - lost} scans"),
        ("lost", f"{lost} scans in {len(tracking['intervals'])} stretch(es)" if tracking["intervals"] else "never"),
        ("path", f"{tracking['path_length_m']:.2f} m"),
    ]
    if "localisation" in document:
        rows.append(("found in the map", _found(document["localisation"])))
    rows += [*wall_rows(document), *quality_rows(document["map_quality"]), *reference_rows(document.get("reference"))]
    rows += [
        ("speed", f"{timing['scans_per_s']:.0f} scans/s, {timing['realtime_factor']:.1f} times real time"),
        ("pictures", f"{directory / 'map.png'}, {directory / 'wall_thickness.png'}"),
    ]
    return rows + page_row(directory)


def _found(localisation: dict[str, Any]) -> str:
    found = localisation["found"]
    if not found:
        return "nowhere"
    return f"x {found['x_m']:.2f} m, y {found['y_m']:.2f} m, yaw {found['yaw_deg']:.1f} deg, scan {found['scan']}"


def page_row(directory: Path) -> list[tuple[str, str]]:
    """Return the row that names the run's page, where there is one."""
    page = directory / "report.html"
    return [("report", str(page))] if page.exists() else []


def tell_stages(stages: dict[str, float], *, stderr: bool) -> None:
    """Print the seconds by stage, the longest first, and each one's share."""
    total_s = max(sum(stages.values()), 1e-9)
    for name, spent_s in sorted(stages.items(), key=lambda stage: -stage[1]):
        line = f"{name:<14}{spent_s:>9.3f} s {spent_s / total_s:>6.1%}"
        if stderr:
            note(line)
        else:
            emit(line)


def wall_rows(document: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the rows on wall thickness of a summary table."""
    return [(f"wall thickness, >= {hits} hits", _thickness(wall)) for hits, wall in document["wall_thickness"].items()]


def _thickness(wall: dict[str, Any]) -> str:
    if not wall["sections"]:
        return "no straight wall"
    return f"p95 {wall['p95_mm']:.0f} mm, max {wall['max_mm']:.0f} mm ({wall['max_cells']:.1f} cells)"


def print_table(rows: list[tuple[str, str]]) -> None:
    """Print names and values on stdout: on a terminal as a table, else in plain lines, for which nothing is loaded."""
    if not sys.stdout.isatty():
        width = max((len(name) for name, _ in rows), default=0)
        emit("\n".join(f"{name:<{width}}  {printable(value)}" for name, value in rows))
        return
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, pad_edge=False)
    for name, value in rows:
        table.add_row(Text(name, style="bold"), Text(printable(value), overflow="fold"))
    console().print(table)
