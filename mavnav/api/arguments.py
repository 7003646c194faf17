"""The arguments of the Python interface: checked, and turned into what the pipelines take; all raise UsageError.

Signatures and docstrings of functions that take options of a replay are made from the record of the options.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from functools import wraps
from inspect import Parameter
from numbers import Integral
from os import PathLike, fspath
from pathlib import Path
from textwrap import fill, indent
from typing import Any, TypeVar, cast

from mavnav.config.option_kinds import FILE, PLACE, POSE, SWITCH, TOPICS, TRUTH, ValueKind, pose_problem, recorded_topic
from mavnav.config.options import OPTIONS, TYPES, File, ReplayOptions, given_options
from mavnav.errors import MavnavError, UsageError
from mavnav.pose import Pose

Function = TypeVar("Function", bound=Callable[..., Any])


def path_of(file: File, name: str) -> Path:
    """Return the path of a file or directory; a `mavnav.Run` stands for its directory."""
    try:
        return Path(fspath(file))
    except TypeError:
        raise UsageError(f"{name} is {file!r}; give a path") from None


def name_or_path(file: File, name: str) -> str:
    """Return what may be the name of a preset or scenario as well as a path."""
    return file if isinstance(file, str) else str(path_of(file, name))


def config_of(config: File | None) -> str | None:
    """Return the configuration, a file or preset, if one is given."""
    return None if config is None else name_or_path(config, "config")


def optional_path(file: File | None, name: str) -> Path | None:
    """Return the path of a file, if one is given."""
    return None if file is None else path_of(file, name)


def paths_of(files: File | Sequence[File], name: str) -> list[Path]:
    """Return the paths of one file or several."""
    several = [files] if isinstance(files, str | PathLike) else _as_list(files, name)
    if not several:
        raise UsageError(f"{name} is {files!r}; give at least one")
    return [path_of(each, name) for each in several]


def values_of(values: Any, name: str) -> list[Any]:  # noqa: ANN401
    """Return the values of an argument that may be a single one."""
    return [values] if isinstance(values, str | int) else _as_list(values, name)


def _as_list(values: Any, name: str) -> list[Any]:  # noqa: ANN401
    if isinstance(values, Mapping) or not hasattr(values, "__iter__"):
        raise UsageError(f"{name} is {values!r}; give a list")
    return list(values)


def topics_of(topics: str | Sequence[str] | None, name: str) -> str | None:
    """Return topics as one name, with commas between them as a merged log has it; None if none is given."""
    if topics is None or isinstance(topics, str):
        return topics
    several = _as_list(topics, name)
    if several and all(isinstance(each, str) for each in several):
        return ",".join(several)
    raise UsageError(f"{name} is {topics!r}; give the name of a topic, or a list of them")


def grid_of(grid: str | Sequence[int], name: str = "grid") -> str:
    """Return a search grid as text: ``(10, 10)`` is ``10x10``."""
    if isinstance(grid, str):
        return grid
    if isinstance(grid, Sequence) and len(grid) == 2 and all(isinstance(each, Integral) for each in grid):
        return "x".join(map(str, grid))
    raise UsageError(f"{name} is {grid!r}; give the points in x and y, such as (10, 10) or '10x10'")


def topic_of(truth: str | None) -> str | None:
    """Return the topic of a ground truth, given as its name, as ``topic:NAME``, or as ``auto``."""
    if truth is None or isinstance(truth, str):
        return truth and (recorded_topic(truth) or truth)
    raise UsageError(f"truth is {truth!r}; give a text")


def count_of(number: int | None, name: str) -> int | None:
    """Return a whole number of at least 1, if one is given."""
    if number is None:
        return None
    if isinstance(number, Integral) and not isinstance(number, bool) and number >= 1:
        return int(number)
    raise UsageError(f"{name} is {number!r}; give a whole number of at least 1, or leave it out")


def pose_of(values: Sequence[float] | None, name: str) -> Pose | None:
    """Return the pose of x and y in m and yaw in rad, if they are given."""
    if values is None:
        return None
    try:
        x_m, y_m, yaw_rad = map(float, values)
    except (TypeError, ValueError):
        raise UsageError(f"{name} is {values!r}; give x, y and yaw in m, m, rad") from None
    if problem := pose_problem(x_m, y_m, yaw_rad):
        raise UsageError(f"{name} {values!r} {problem}")
    return Pose(x_m, y_m, yaw_rad)


def sets_of(settings: Mapping[str, object] | None) -> list[str]:
    """Return settings as ``--set`` has them: JSON is YAML."""
    if settings is None:
        return []
    if not isinstance(settings, Mapping):
        raise UsageError(f"settings is {settings!r}; give a dictionary such as {{'robust.cell_mm': 25}}")
    try:
        return [f"{key}={json.dumps(value)}" for key, value in settings.items()]
    except (TypeError, ValueError) as error:
        raise UsageError(f"settings have a value of no plain type ({error}); give numbers, texts and lists") from None


def options_of(options: Mapping[str, Any]) -> ReplayOptions[Path]:
    """Return the options of a replay that are given, checked."""
    given = {name: value for name, value in options.items() if value is not None}
    if "grid" in given:
        given["grid"] = grid_of(given["grid"])
    return given_options(
        {n: _CHECKS[OPTIONS[n].kind](value, n) if OPTIONS[n].kind in _CHECKS else value for n, value in given.items()}
    )


def _place_of(values: str | Sequence[float], name: str) -> Any:  # noqa: ANN401
    return PLACE.read(values if isinstance(values, str) else ",".join(map(str, _as_list(values, name))), name)


def _truth_of(truth: File, name: str) -> str | Path:
    return truth if isinstance(truth, str) and recorded_topic(truth) is not None else path_of(truth, name)


_CHECKS: dict[ValueKind, Callable[[Any, str], Any]] = {
    FILE: path_of,
    PLACE: _place_of,
    POSE: pose_of,
    TOPICS: topics_of,
    TRUTH: _truth_of,
}
"""Kind of an option -> what checks its values; the configuration checks those of the others."""


_NAMES: dict[str, str] = {option.flag: name for name, option in OPTIONS.items()} | {
    "-o": "directory", "--output": "directory", "--set": "settings", "--force": "force=True", "--jobs": "workers",
    "--gate": "gates", "--outputs": "outputs",
}  # fmt: skip
"""Option of the command line -> what it is called in Python, where that is another name."""

_FLAGS = re.compile(
    r"(?P<command>mavnav [^;')]*)|--set (?P<key>[\w.]+)=(?P<value>[^\s:;]+)|(?<![\w-])(?P<flag>--?[a-z][a-z-]*)"
)


def with_python_names(function: Function) -> Function:
    """Let the errors of a function name its arguments, not the options of the command line.

    A name that it does not take raises TypeError, as in any function, with the nearest one.
    """
    names = list(inspect.signature(function).parameters)

    @wraps(function)
    def call(*args: Any, **values: Any) -> Any:  # noqa: ANN401  those of the function
        for name in (name for name in values if name not in names):
            usual = _NAMES.get(f"--{name.replace('_', '-')}", name)
            near = [usual] if usual in names else get_close_matches(name, names, cutoff=0.75)
            advice = f"did you mean {near[0]}?" if near else f"help(mavnav.{function.__name__}) lists those it has"
            raise TypeError(f"{function.__name__} has no argument {name}; {advice}")
        try:
            return function(*args, **values)
        except MavnavError as error:
            error.args = (_FLAGS.sub(_in_python, str(error)),)
            raise

    return cast("Function", call)


def _in_python(words: re.Match[str]) -> str:
    """Return the words of Python for an option in a message; command lines stay as they are."""
    if words["key"]:
        return f"settings {{'{words['key']}': {words['value']}}}"
    return _NAMES.get(words["flag"], words["flag"].lstrip("-").replace("-", "_")) if words["flag"] else words[0]


def with_options(*names: str) -> Callable[[Function], Function]:
    """Put options in the signature and the docstring of a function that takes them as ``**options``.

    In both they follow the positional arguments.
    """

    def decorate(function: Function) -> Function:
        signature = inspect.signature(function)
        own = [each for each in signature.parameters.values() if each.kind is not Parameter.VAR_KEYWORD]
        places = [each for each in own if each.kind is not Parameter.KEYWORD_ONLY]
        signature = signature.replace(parameters=[*places, *map(_parameter, names), *own[len(places) :]])

        @wraps(function)
        def call(*args: Any, **values: Any) -> Any:  # noqa: ANN401  those of the function
            signature.bind(*args, **values)
            return function(*args, **values)

        call.__signature__ = signature  # type: ignore[attr-defined]
        text = "".join(f"    {name}\n{_description(name)}\n" for name in names)
        call.__doc__ = re.sub(r" {4}\*\*options\n( {8}.*\n)+", lambda _: text, function.__doc__ or "")
        return cast("Function", call)

    return decorate


def _parameter(name: str) -> Parameter:
    hint = TYPES[name]
    default = False if OPTIONS[name].kind is SWITCH else None
    python = hint[File] if getattr(hint, "__parameters__", ()) else hint
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=python)


def _description(name: str) -> str:
    option = OPTIONS[name]
    return indent(fill(f"{option.metavar}: {option.help}" if option.metavar else option.help, 112), " " * 8)
