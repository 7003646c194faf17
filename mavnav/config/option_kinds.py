"""What an option is, and what its values are: how they are read from a command line and from a document."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from inspect import cleandoc
from math import isfinite, pi
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

from mavnav.errors import UsageError
from mavnav.units import LARGEST_COORDINATE_M


def pose_problem(x_m: float, y_m: float, yaw_rad: float) -> str:
    """Return what is wrong with a pose and what to do, to follow its name; empty if nothing is."""
    if not all(map(isfinite, (x_m, y_m, yaw_rad))):
        return "has a number that is not finite; give x, y and yaw in m, m, rad"
    if max(abs(x_m), abs(y_m)) > LARGEST_COORDINATE_M:
        return f"is farther than {LARGEST_COORDINATE_M:g} m from the origin; give x and y in m"
    if abs(yaw_rad) > 2 * pi:
        return "has a yaw of more than a turn; give it in rad, for 90 deg 1.5708"
    return ""


INPUT, SEARCH, OUTPUT, CHECKS, RESOURCES = "Input", "Search", "Output", "Checks", "Resources"
"""Panels of the help."""

AUTO: Final = "auto"
TOPIC_PREFIX, TF_PREFIX = "topic:", "tf:"


def recorded_topic(truth: str) -> str | None:
    """Return what ``--truth`` names in a log: ``auto``, ``tf:MAP``, or what follows ``topic:``; None for a file."""
    if truth == AUTO or truth.startswith(TF_PREFIX):
        return truth
    return truth.removeprefix(TOPIC_PREFIX) if truth.startswith(TOPIC_PREFIX) else None


def _same(value: Any, _: object) -> Any:  # noqa: ANN401  a value of any kind
    return value


class ValueKind(NamedTuple):
    """What the values of an option are.

    ``typed`` is the type that typer reads, ``stored`` that of documents. ``read`` makes a value of what is typed, given
    the flag for messages; it raises UsageError. ``restore`` makes a value of what a document has, given a function from
    its texts to paths.
    """

    typed: Any
    stored: Any = str
    read: Callable[[Any, str], Any] = _same
    restore: Callable[[Any, Callable[[str], Path]], Any] = _same


def _parse_pose(text: str, flag: str, otherwise: str) -> tuple[float, float, float]:
    """Read ``x,y,yaw`` in m, m, rad; raises UsageError, which says ``otherwise`` where the text is of another form."""
    try:
        x_m, y_m, yaw_rad = map(float, text.split(","))
        problem = pose_problem(x_m, y_m, yaw_rad)
    except ValueError:
        problem = otherwise
    if problem:
        raise UsageError(f"{flag} {text!r} {problem}")
    return x_m, y_m, yaw_rad


def _read_pose(text: str, flag: str) -> tuple[float, float, float]:
    """Read ``x,y,yaw`` in m, m, rad; raises UsageError."""
    return _parse_pose(text, flag, f"is not X,Y,YAW in m, m, rad; write for example {flag} 0.1,0,1.5708")


def _restore_pose(pose: Any, _: object) -> tuple[float, float, float]:  # noqa: ANN401  a list, or x_m, y_m, yaw_rad
    x_m, y_m, yaw_rad = pose.values() if isinstance(pose, Mapping) else pose
    return x_m, y_m, yaw_rad


WALLS, NOWHERE = "walls", "none"


def read_alignment(text: str, flag: str) -> str:
    """Read ``walls``, ``none``, or ``x,y,yaw`` in m, m, rad; raises UsageError."""
    if text in {WALLS, NOWHERE}:
        return text
    otherwise = f"is neither {WALLS}, none nor X,Y,YAW in m, m, rad; write for example {flag} 2.5,1,1.57"
    x_m, y_m, yaw_rad = _parse_pose(text, flag, otherwise)
    return f"{x_m},{y_m},{yaw_rad}"


def _restore_truth(text: str, path: Callable[[str], Path]) -> str | Path:
    return path(text) if recorded_topic(text) is None else text


TEXT: Final = ValueKind(str | None)
TOPICS: Final = ValueKind(list[str] | None, str, lambda topics, _: ",".join(topics))
NUMBER: Final = ValueKind(float | None, float)
COUNT: Final = ValueKind(int | None, int)
SWITCH: Final = ValueKind(bool, bool)
POSE: Final = ValueKind(str | None, tuple[float, float, float], _read_pose, _restore_pose)
FILE: Final = ValueKind(Path | None, str, _same, lambda text, path: path(text))
PLACE: Final = ValueKind(str | None, str, read_alignment, lambda text, _: read_alignment(text, "align:"))
"""How a map is placed: a text, as `read_alignment` returns it."""
TRUTH: Final = ValueKind(str | None, str, lambda text, _: _restore_truth(text, Path), _restore_truth)
"""A trajectory: a path, or a text that names a topic of the log."""


PathType = TypeVar("PathType")
"""What names a file: any name of one in Python, a path where options are read already."""

KINDS: Final[dict[Any, Any]] = {
    str | None: TEXT,
    float | None: NUMBER,
    int | None: COUNT,
    bool: SWITCH,
    Sequence[float] | None: POSE,
    str | Sequence[float] | None: PLACE,
    PathType | None: FILE,
    PathType | str | None: TRUTH,
}
"""Type of an option in Python -> its kind."""


def descriptions(docstring: str | None) -> tuple[str, dict[str, str]]:
    """Split a docstring into what is before its parameters or attributes, and the descriptions of these by name."""
    text, _, section, *_ = [*re.split(r"\n\n(Parameters|Attributes)\n-+\n", cleandoc(docstring or "")), "", ""]
    entries = re.findall(r"^(\w+)\n((?: {4}.*\n?)+)", section, re.MULTILINE)
    return text, {name: " ".join(lines.split()) for name, lines in entries}


class Option(NamedTuple):
    """One option of a replay.

    ``usage`` is the flag with what follows it. ``setting`` is the key of the configuration that the option sets.
    Options without one are in run.json, as are those that are ``recorded``; the key of an ``absent`` one is left out
    where it is not given. ``manifest`` options are in manifests. A ``reference`` is compared with the result: the run
    cache knows it by its content. ``completer`` is the function of `mavnav.commands.completion` that finds the values a
    shell offers; without one, it offers the words in ``usage``.
    """

    panel: str
    usage: str
    setting: str = ""
    completer: str = ""
    recorded: bool = False
    absent: bool = False
    manifest: bool = False
    reference: bool = False
    kind: ValueKind = TEXT
    help: str = ""

    @property
    def flag(self) -> str:
        """The word on the command line."""
        return self.usage.partition(" ")[0]

    @property
    def metavar(self) -> str | None:
        """What follows the flag; None for a switch."""
        return self.usage.partition(" ")[2] or None


Input, Search = partial(Option, INPUT), partial(Option, SEARCH)
Check = partial(Option, CHECKS, manifest=True, reference=True)
