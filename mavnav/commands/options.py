"""Options that several commands share, one set a topic; help shows each set in a panel of its own."""

from __future__ import annotations

import json
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mavnav.commands import completion
from mavnav.commands.terminal import note
from mavnav.config.given_pose import pose_problem
from mavnav.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mavnav.config.models import Config

INPUT, SEARCH, OUTPUT, CHECKS, RESOURCES = "Input", "Search", "Output", "Checks", "Resources"
"""Panels of the help."""

input_option, search_option, output_option, check_option, resource_option = (
    partial(typer.Option, show_default=False, rich_help_panel=panel)
    for panel in (INPUT, SEARCH, OUTPUT, CHECKS, RESOURCES)
)
"""An option of a panel without a default of its own."""

directory_option = partial(output_option, "--output", "-o", metavar="DIR")
grids_option = partial(search_option, "--grid", metavar="NxM")
azimuths_option = partial(search_option, "--azimuth", metavar="N")
schema_option = partial(input_option, "--schema")
"""Options whose help differs between commands."""

_log_argument = partial(
    typer.Argument, metavar="LOG", help="MCAP, ROS 1 bag, ROS 2 bag folder, .db3 or CARMEN log.", show_default=False
)
LogFile = Annotated[Path, _log_argument()]

MaybeLogFile = Annotated[Path | None, _log_argument()]
Again = Annotated[
    Path | None, input_option("--again", metavar="RUN", help="Repeat the run in this directory, with its options.")
]

Continue = Annotated[
    Path | None,
    input_option("--continue", metavar="RUN", help="Add the log to the map of a finished run, merge or continued run."),
]

_topic_option = partial(input_option, metavar="NAME", autocompletion=completion.scan_topics)
Topic = Annotated[
    list[str] | None,
    _topic_option(help="Scan topic (default the only one); repeatable, to merge lasers by /tf_static."),
]
SingleTopic = Annotated[list[str] | None, _topic_option(help="Scan topic of the laser (default the only one).")]
Start = Annotated[
    float | None,
    input_option(metavar="SECONDS", help="Start this many seconds after the first scan (default 0)."),
]
End = Annotated[
    float | None,
    input_option(metavar="SECONDS", help="Stop this many seconds after the first scan (default at the end)."),
]
Extrinsic = Annotated[
    str | None,
    input_option(metavar="X,Y,YAW", help="Pose of the laser on its base, m, m, rad (default from tf)."),
]
Odom = Annotated[
    str | None,
    input_option(
        metavar="auto|TOPIC|off",
        help="Odometry used as motion prior (robust only; default auto).",
        autocompletion=completion.odometry_topics,
    ),
]
RecordedOdom = Annotated[
    str | None,
    input_option(
        metavar="auto|TOPIC",
        help="Odometry to compare the laser with (default auto).",
        autocompletion=completion.recorded_odometry,
    ),
]
Attitude = Annotated[
    str | None,
    input_option(
        metavar="auto|TOPIC|off",
        help="Tilt and height of the laser, to level the scans by (default auto).",
        autocompletion=completion.words("auto", "off", "/attitude"),
    ),
]
Strict = Annotated[bool, input_option("--strict", help="Drop scans whose checksum does not match.")]

method_option = partial(search_option, "--method", metavar="robust|paper", autocompletion=completion.METHODS)
Method = Annotated[str | None, method_option(help="SLAM method (default robust).")]
Methods = Annotated[list[str] | None, method_option(help="SLAM method (default robust); repeatable.")]
Grid = Annotated[str | None, search_option(metavar="NxM", help="Points of the search grid in x and y (default 10x10).")]
Azimuth = Annotated[
    int | None, search_option(metavar="N", help="Yaw samples of the search (default 2N for NxN, at most 40).")
]
Online = Annotated[bool, search_option("--online", help="Causal mode: no loop closure, no final pass.")]
ConfigFile = Annotated[
    str | None,
    search_option(
        metavar="FILE",
        help="Configuration: a YAML file, or the name of a preset (default that of the method).",
        autocompletion=completion.presets,
    ),
]
sets_option = partial(search_option, "--set", metavar="KEY=VALUE")
Sets = Annotated[list[str] | None, sets_option(help="Override one configuration value; repeatable.")]
ScenarioSets = Annotated[
    list[str] | None,
    sets_option(help="Override one key of the scenario file; those of a replay are below slam. Repeatable."),
]

Outputs = Annotated[
    str | None,
    output_option(
        "--outputs",
        metavar="GROUP,...",
        help="Write only these files: trajectory, map, metrics, slices, pictures, mcap (default: these); report, svg, "
        "scale, graph; all.",
        autocompletion=completion.words(
            "trajectory", "map", "metrics", "slices", "pictures", "mcap", "report", "svg", "scale", "graph", "all"
        ),
    ),
]
ReportFile = Annotated[
    Path | None, output_option("--report", metavar="FILE.html", help="Also write the result as one page.")
]
WriteReport = Annotated[bool, output_option("--report", help="Also write the result as one page, report.html.")]
Force = Annotated[bool, output_option("--force", help="Overwrite the output if it exists.")]
RunAgain = Annotated[bool, output_option("--force", help="Ignore finished runs and repeat them.")]
Json = Annotated[bool, output_option("--json", help="Print one JSON document on stdout and nothing else.")]
Quiet = Annotated[bool, output_option("--quiet", "-q", help="Show no progress.")]
Jobs = Annotated[
    int | None,
    resource_option("--jobs", "-j", min=1, metavar="N", help="Parallel runs (default one a core)."),
]

Truth = Annotated[
    str | None,
    check_option(
        "--truth",
        metavar="FILE.tum|auto|topic:NAME",
        help="Ground-truth trajectory: ATE and RPE. A TUM file of the laser, or poses on a topic of the log.",
        autocompletion=completion.words("auto"),
    ),
]
TruthFile = Annotated[
    str | None,
    check_option("--truth", metavar="FILE.tum", help="Ground-truth trajectory of the laser, a TUM file: ATE and RPE."),
]
TruthMap = Annotated[
    Path | None,
    check_option("--truth-map", metavar="FILE.yaml", help="Ground-truth map: a scenario, or a map_server map."),
]
RelationsFile = Annotated[
    Path | None,
    check_option(
        "--relations", metavar="FILE", help="Ground-truth relations, one 't1 t2 x y z roll pitch yaw' a line."
    ),
]


def output_values(outputs: str | None, *, report: bool, preview: bool) -> dict[str, Any]:
    """Return ``report``, and ``outputs`` as the names that ``--outputs`` lists; raises UsageError."""
    if outputs is None:
        return {"report": report}
    names = tuple(dict.fromkeys([*outputs.split(","), *(["report"] if report else [])]))
    if preview and not {"map", "all"} & {*names}:
        raise UsageError("--preview is drawn from map; add it to --outputs")
    return {"report": bool({"report", "all"} & {*names}), "outputs": names}


def again_directory(again: Path) -> Path:
    """Return the default directory of a run that repeats another."""
    return Path("runs") / f"{again.resolve().name}-again"


def check_again(context: typer.Context, target: Path, *free: str) -> None:
    """Raise UsageError where ``--again`` would replace the run that it repeats, or an option that it takes from there.

    ``free`` are parameters, besides those of the output, that it does not take from there.
    """
    again = context.params["again"]
    replaced, kept = Path(os.path.realpath(target)), Path(os.path.realpath(again))
    if kept.is_relative_to(replaced):
        what = "is" if kept == replaced else "contains"
        raise UsageError(f"{target} {what} the run to repeat; choose another directory with -o")
    allowed = {"again", "directory", "force", "report", "outputs", "preview", "json", "quiet", "gates", *free}
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        if parameter.name not in allowed and source is not None and source.name == "COMMANDLINE":
            raise UsageError(f"--again takes {max(parameter.opts, key=len)} from the run; leave one of them out")


def note_repetition(again: Path, document: dict[str, Any]) -> None:
    """Print whether a repetition has the files of the run that it repeats."""
    from mavnav.pipelines.again import EarlierRun

    made = json.loads((again / "run.json").read_text(encoding="utf-8"))
    note(f"mavnav: {EarlierRun(again, made).outcome(document)}")


def given_values(**values: object) -> dict[str, Any]:
    """Return the values that are not None: options that are not given leave the configuration or manifest alone."""
    return {name: value for name, value in values.items() if value is not None}


def given_window(start_s: float | None, end_s: float | None) -> dict[str, float]:
    """Return the bounds of the window that are given; raises UsageError for an empty window, whatever the log."""
    if start_s is not None and end_s is not None and end_s <= start_s:
        raise UsageError(f"the window from {start_s:g} s to {end_s:g} s is empty; --end must be later than --start")
    return given_values(start_s=start_s, end_s=end_s)


def joined_topics(topics: list[str] | None) -> str | None:
    """Return the scan topics as one name, joined by commas as a merged log has it; None if none is given."""
    return ",".join(topics) if topics else None


def parse_pose(text: str | None, option: str = "--extrinsic") -> tuple[float, float, float] | None:
    """Read the ``x,y,yaw`` of an option in m, m, rad, None where it is not given; raises UsageError."""
    if text is None:
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3:
        raise UsageError(f"{option} {text!r} is not X,Y,YAW in m, m, rad; write for example {option} 0.1,0,1.5708")
    x_m, y_m, yaw_rad = values
    if problem := pose_problem(x_m, y_m, yaw_rad):
        raise UsageError(f"{option} {text!r} {problem}")
    return x_m, y_m, yaw_rad


def note_without_effect(config: Config, keys: Iterable[str]) -> None:
    """Warn of settings that were given by their dotted keys and that the chosen method does not read."""
    for key in config.without_effect(keys):
        note(f"mavnav: warning: {key} has no effect with method {config.method}")
