"""The exception tree and its exit codes.

::

    MavnavError                       70  a bug, if it is this class itself
    ├── UsageError                     2  the command line is not valid
    │   ├── MapTooLargeError           2  the map would not fit into the memory
    │   ├── ConfigError                2  a configuration file or value is wrong
    │   └── TopicError                 2  no such topic
    │       └── SeveralTopicsError     2  several topics to choose from
    ├── NoScansError                   4  the input has no usable scan, or is no log
    ├── StoppedError                 130  a signal stopped the work before any result (143: SIGTERM)
    ├── ProgramError                   1  another program gave no poses that can be used
    └── OutputError                    6  the output cannot be written, or exists

Each message is one line: what is wrong, where, and what to do next. Only ``cli.main`` prints it.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from enum import IntEnum
from errno import ENOMEM
from pathlib import Path


class ExitCode(IntEnum):
    """Exit codes of the command line, from good to bad."""

    DONE = 0
    DAMAGED_INPUT = 3
    GATE_FAILED = 1
    TRACKING_LOST = 5
    NO_SCANS = 4
    USAGE = 2
    OUTPUT = 6
    BUG = 70
    INTERRUPTED = 130
    TERMINATED = 143


SEVERITY = tuple(ExitCode)
"""Exit codes from good to bad: of several runs, or a run and its quality gates, the worst is returned."""


def worst(codes: Iterable[int]) -> ExitCode:
    """Return the worst of some exit codes, DONE without any."""
    return max(map(ExitCode, codes), key=SEVERITY.index, default=ExitCode.DONE)


def reason_of(error: Exception) -> str:
    """Return what an error says in plain words: of an OSError its reason, with the file if it has one."""
    if not isinstance(error, OSError) or not error.strerror:
        return str(error)
    return f"{error.filename} cannot be read, {error.strerror}" if error.filename else error.strerror


def lacks_memory(error: BaseException) -> bool:
    """Return whether the system refused memory: for data, for a file, or for a library that is loaded.

    Without memory Python itself may fail to make the exception, and raises a SystemError that says so.
    """
    if isinstance(error, SystemError):
        return "without exception set" in str(error) or "without setting an exception" in str(error)
    of_library = isinstance(error, (ImportError, OSError)) and "failed to map segment" in f"{error} {error.__context__}"
    return of_library or isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == ENOMEM)


def missing(path: Path, advice: str) -> str:
    """Say that there is no such file, and which one beside it has nearly its name, else what to do.

    A name that a message cannot show is none to write, nor that of a link that leads nowhere.
    """
    from difflib import get_close_matches  # noqa: PLC0415  only where a name is wrong

    with suppress(OSError):
        names = sorted(each.name for each in path.parent.iterdir() if each.name.isprintable() and each.exists())
        if near := get_close_matches(path.name, names, n=1, cutoff=0.75):
            return f"{path}: no such file; did you mean {path.parent / near[0]}?"
    return f"{path}: no such file; {advice}"


def brief(value: object) -> str:
    """Return a wrong value as a message names it: whole, or its beginning if it is long."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


class MavnavError(Exception):
    """Base class of all errors that mavnav raises on purpose."""

    exit_code = ExitCode.BUG


class UsageError(MavnavError):
    """The command line requests something that cannot be done."""

    exit_code = ExitCode.USAGE


class ConfigError(UsageError):
    """A configuration file or value is wrong."""


class TopicError(UsageError):
    """The requested topic is missing, or there are several scan topics and none is requested."""


class SeveralTopicsError(TopicError):
    """There are several scan topics and none is requested."""

    @property
    def what(self) -> str:
        """The message without its advice."""
        return str(self).rpartition("; ")[0]


class NoScansError(MavnavError):
    """The input is no log, or has no usable scan."""

    exit_code = ExitCode.NO_SCANS


class MapTooLargeError(UsageError):
    """The map would not fit into the memory."""


class StoppedError(MavnavError):
    """A signal stopped the work before there was any result."""

    def __init__(self, text: str, exit_code: ExitCode) -> None:
        super().__init__(text)
        self.exit_code = exit_code


class ProgramError(MavnavError):
    """Another program gave no poses that can be used."""

    exit_code = ExitCode.GATE_FAILED


class OutputError(MavnavError):
    """The output cannot be written, or exists already."""

    exit_code = ExitCode.OUTPUT
