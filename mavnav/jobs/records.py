"""Jobs, their events and their outcomes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from mavnav.errors import ExitCode

Report = Callable[[str, int, int | None], None]
"""Progress callback: the current phase, the amount done, and the total amount, None if unknown."""


@dataclass(frozen=True, slots=True)
class Job:
    """A function call to run in another process: ``work(*args, report)``.

    ``work`` is a module-level function whose result can be pickled; ``report`` is a `Report`. ``name`` is the display
    name.
    """

    name: str
    work: Callable[..., Any]
    args: tuple[Any, ...] = ()


class Status(StrEnum):
    """How a job ended: with a result, an exception, the death of its process, or its time limit."""

    DONE = "done"
    FAILED = "failed"
    DIED = "died"
    TIMEOUT = "timeout"


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a job.

    ``value`` is its result. If there is none, ``error`` is the reason in one line, and ``exit_code`` is that of the
    exception, or that of a bug if the process died. ``pid`` is the process that ran the job.
    """

    status: Status
    pid: int
    seconds: float
    value: Any = None
    error: str = ""
    exit_code: ExitCode = ExitCode.DONE


@dataclass(frozen=True, slots=True)
class Started:
    """Job ``index`` started in process ``pid``."""

    index: int
    pid: int


@dataclass(frozen=True, slots=True)
class Progressed:
    """Job ``index`` reported its progress; see `Report`."""

    index: int
    phase: str
    done: int
    total: int | None


@dataclass(frozen=True, slots=True)
class Retried:
    """The process of job ``index`` died with ``error``; the job will be run again."""

    index: int
    error: str


@dataclass(frozen=True, slots=True)
class Ended:
    """Job ``index`` ended."""

    index: int
    outcome: Outcome


Event = Started | Progressed | Retried | Ended
