"""The options of a replay, each stated once, and what follows for every place that has them.

The parameters of the commands and of `mavnav.replay`, the entries of manifests, the options in run.json, the words that
repeat a run and the key of the run cache are all made from `OPTIONS`. No other library is imported: help needs it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Final, Generic, TypedDict, cast, get_args, get_type_hints

from mavnav.config.option_kinds import KINDS, OUTPUT, TOPICS, Check, Input, Option, PathType, Search, descriptions
from mavnav.errors import UsageError

File = str | PathLike[str]
"""What names a file in Python."""


class SearchOptions(TypedDict, total=False):
    """The method of a track and its search grid.

    Attributes
    ----------
    method
        SLAM method (default robust).
    grid
        Points of the search grid in x and y (default 10x10).
    azimuth
        Yaw samples of the search (default 2N for NxN, at most 40).
    resolution_m
        Edge of a map cell (default that of the method: 0.02 with robust).
    """

    method: Annotated[str | None, Search("--method robust|paper", "method")]
    grid: Annotated[str | None, Search("--grid NxM", "grid")]
    azimuth: Annotated[int | None, Search("--azimuth N", "azimuth")]
    resolution_m: Annotated[float | None, Search("--resolution METERS", "resolution_m")]


class ReplayOptions(SearchOptions, Generic[PathType], total=False):
    """Options of a replay, in the order of the help; those that are not given are absent.

    Attributes
    ----------
    continue_from
        Add the log to the map of a finished run, merge or continued run.
    topic
        Scan topic (default the only one); repeatable, to merge lasers by /tf_static.
    start_s
        Start this many seconds after the first scan (default 0).
    end_s
        Stop this many seconds after the first scan (default at the end).
    odom
        Odometry that predicts motion, and is evidence (robust only; default auto).
    attitude
        Tilt and height of the laser, to level the scans by (default auto).
    extrinsic
        Pose of the laser on its base, m, m, rad (default from tf).
    strict
        Drop scans whose checksum does not match.
    search
        Exhaustive evaluates every pose of the grid: slower, same result (default pruned).
    deskew
        Correct scans for motion during the sweep (robust only; default auto).
    loop_closure
        Detect and close loops (default auto; ignored with --online).
    online
        Causal mode: no loop closure, no final pass.
    map
        Localize in this map (YAML or run) instead of mapping.
    start_pose
        Approximate first pose in the map, m, m, rad (default searched for).
    align
        Turn the walls along the axes, or put the first pose there, m, m, rad (default walls in pictures alone).
    truth
        Ground-truth trajectory: ATE and RPE. A TUM file of the laser, or poses on a topic of the log.
    truth_map
        Ground-truth map: a scenario, or a map_server map.
    relations
        Ground-truth relations, one 't1 t2 x y z roll pitch yaw' a line.
    """

    continue_from: Annotated[PathType | None, Input("--continue RUN", absent=True)]
    topic: Annotated[str | None, Input("--topic NAME", completer="scan_topics", manifest=True)]
    start_s: Annotated[float | None, Input("--start SECONDS", manifest=True)]
    end_s: Annotated[float | None, Input("--end SECONDS", manifest=True)]
    odom: Annotated[str | None, Input("--odom auto|TOPIC|off", "odom", completer="odometry_topics", recorded=True)]
    attitude: Annotated[str | None, Input("--attitude auto|TOPIC|off", "attitude", completer="attitude_topics")]
    extrinsic: Annotated[Sequence[float] | None, Input("--extrinsic X,Y,YAW", manifest=True)]
    strict: Annotated[bool, Input("--strict", manifest=True)]
    search: Annotated[str | None, Search("--search pruned|exhaustive", "search")]
    deskew: Annotated[str | None, Search("--deskew auto|on|off", "robust.deskew")]
    loop_closure: Annotated[str | None, Search("--loop-closure auto|off", "loop_closure")]
    online: Annotated[bool, Search("--online", "final_pass")]
    map: Annotated[PathType | None, Search("--map MAP")]
    start_pose: Annotated[Sequence[float] | None, Search("--start-pose X,Y,YAW")]
    align: Annotated[
        str | Sequence[float] | None, Option(OUTPUT, "--align walls|none|X,Y,YAW", absent=True, manifest=True)
    ]
    truth: Annotated[PathType | str | None, Check("--truth FILE.tum|auto|topic:NAME")]
    truth_map: Annotated[PathType | None, Check("--truth-map FILE.yaml")]
    relations: Annotated[PathType | None, Check("--relations FILE")]


TYPES: Final[dict[str, Any]] = {}
"""Name of an option -> its type in Python."""

OPTIONS: Final[dict[str, Option]] = {}
"""Name of an option, in Python and in documents -> the option, in the order of the help."""

_HELP: Final = {**descriptions(SearchOptions.__doc__)[1], **descriptions(ReplayOptions.__doc__)[1]}
for _name, _hint in get_type_hints(ReplayOptions, include_extras=True).items():
    TYPES[_name], _option = get_args(_hint)
    _kind = TOPICS if _name == "topic" else KINDS[TYPES[_name]]
    OPTIONS[_name] = _option._replace(kind=_kind, help=_HELP.get(_name, ""))

SEARCHING: Final = tuple(SearchOptions.__annotations__)
"""Options of every track, of a log or of a mission."""

READING: Final = ("topic", "start_s", "end_s", "odom", "attitude", "extrinsic")
"""Options that say what of a log is read, and how."""

REFERENCES: Final = tuple(name for name, option in OPTIONS.items() if option.reference)
"""Options that name what the result is compared with."""


def read_options(typed: Mapping[str, object]) -> ReplayOptions[Path]:
    """Return the options of a command line as values; raises UsageError, also for an empty window, whatever the log."""
    options = given_options({n: OPTIONS[n].kind.read(v, OPTIONS[n].flag) for n, v in typed.items() if _is_given(v)})
    start_s, end_s = options.get("start_s"), options.get("end_s")
    if start_s is not None and end_s is not None and end_s <= start_s:
        raise UsageError(f"the window from {start_s:g} s to {end_s:g} s is empty; --end must be later than --start")
    return options


def restore_options(document: Mapping[str, Any], path: Callable[[str], Path]) -> ReplayOptions[Path]:
    """Return the options of a document, a manifest or run.json, as values; ``path`` makes paths of its texts."""
    given = {name: value for name, value in document.items() if name in OPTIONS and _is_given(value)}
    return given_options({name: OPTIONS[name].kind.restore(value, path) for name, value in given.items()})


def given_options(values: Mapping[str, Any]) -> ReplayOptions[Path]:
    """Return the values that are given, in the order of `OPTIONS`."""
    return cast("ReplayOptions[Path]", {n: values[n] for n in OPTIONS if n in values and _is_given(values[n])})


def _is_given(value: object) -> bool:
    return value is not None and value is not False and value not in ([], ())


def settings_of(options: ReplayOptions[Path]) -> dict[str, object]:
    """Return the values of the configuration that options set, by their dotted keys; a switch sets False."""
    values = ((OPTIONS[name].setting, value) for name, value in options.items())
    return {key: False if value is True else value for key, value in values if key}


def fields_of_outputs(names: Sequence[str], *, report: bool) -> dict[str, Any]:
    """Return the groups of files to write, with the page if that is asked for, as fields of a request."""
    groups = tuple(dict.fromkeys([*names, *["report"] * report]))
    return {"report": bool({"report", "all"} & {*groups}), "outputs": groups}


def run_options(options: ReplayOptions[Path]) -> Iterator[tuple[str, Any]]:
    """Yield name and value of the options that are not part of the configuration."""
    yield from ((name, value) for name, value in options.items() if not OPTIONS[name].setting)


def reference_files(options: ReplayOptions[Path]) -> dict[str, Path]:
    """Return the files that the result is compared with, by the names of their options."""
    return {name: path for name, path in options.items() if name in REFERENCES and isinstance(path, Path)}


def paths_of(options: ReplayOptions[Path]) -> list[Path]:
    """Return all files and directories that options name."""
    return [value for value in options.values() if isinstance(value, Path)]


def absolute_options(options: ReplayOptions[Path]) -> ReplayOptions[Path]:
    """Return the options with absolute paths."""
    return given_options({n: value.absolute() if isinstance(value, Path) else value for n, value in options.items()})


def words_of(options: ReplayOptions[Path]) -> list[str]:
    """Return the words of a command line for these options, from any folder, without those of the configuration."""
    return [_word(OPTIONS[name].flag, value) for name, value in run_options(absolute_options(options))]


def _word(flag: str, value: object) -> str:
    if value is True:
        return flag
    return f"{flag}={','.join(map(repr, value)) if isinstance(value, tuple) else value}"
