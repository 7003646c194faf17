"""The exception tree and its exit codes.

::

    MavnavError                       70  a bug, if it is this class itself
    ├── UsageError                     2  what was typed cannot be done
    │   ├── MapTooLargeError           2  the map would not fit into the memory
    │   ├── ConfigError                2  a configuration file or value is wrong
    │   └── TopicError                 2  no such topic, or several to choose from
    ├── NoScansError                   4  the input holds no usable scan, or is no log
    ├── StoppedError                 130  a signal came before there was anything to keep (143: SIGTERM)
    └── OutputError                    6  the output cannot be written, or exists

Each is one line: what is wrong, where, and what to do next. Only ``cli.main`` prints it.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


class ExitCode(IntEnum):
    """Exit codes of the command line."""

    DONE = 0
    GATE_FAILED = 1
    USAGE = 2
    DAMAGED_INPUT = 3
    NO_SCANS = 4
    TRACKING_LOST = 5
    OUTPUT = 6
    BUG = 70
    INTERRUPTED = 130
    TERMINATED = 143


SEVERITY = (
    ExitCode.DONE,
    ExitCode.DAMAGED_INPUT,
    ExitCode.GATE_FAILED,
    ExitCode.TRACKING_LOST,
    ExitCode.NO_SCANS,
    ExitCode.USAGE,
    ExitCode.OUTPUT,
    ExitCode.BUG,
    ExitCode.INTERRUPTED,
    ExitCode.TERMINATED,
)
"""Exit codes from good to bad: several runs, or a run and its gates, end with the worst."""


def worst(codes: Iterable[int]) -> ExitCode:
    """Return the worst of some exit codes, DONE where there are none."""
    return max(map(ExitCode, codes), key=SEVERITY.index, default=ExitCode.DONE)


class MavnavError(Exception):
    """Base of everything that mavnav raises on purpose."""

    exit_code = ExitCode.BUG


class UsageError(MavnavError):
    """The command line asks for something that cannot be done."""

    exit_code = ExitCode.USAGE


class ConfigError(UsageError):
    """A configuration file or value is wrong."""


class TopicError(UsageError):
    """The topic asked for is missing, or several scan topics wait for a choice."""


class NoScansError(MavnavError):
    """The input is no log, or holds no usable scan."""

    exit_code = ExitCode.NO_SCANS


class MapTooLargeError(UsageError):
    """The map would not fit into the memory."""


class StoppedError(MavnavError):
    """A signal stopped the work before there was anything to keep."""

    def __init__(self, text: str, exit_code: ExitCode) -> None:
        super().__init__(text)
        self.exit_code = exit_code


class OutputError(MavnavError):
    """The output cannot be written, or exists already."""

    exit_code = ExitCode.OUTPUT
