"""Jobs, their events, and how they end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from mavnav.errors import ExitCode

Report = Callable[[str, int, int | None], None]
"""What is being done, how much of it is done, how much there is or None."""


@dataclass(frozen=True, slots=True)
class Job:
    """A call to make in another process: ``work(*args, report)``.

    ``work`` is a function of a module and returns what can be pickled; ``report`` takes what is being done, how much of
    it is done, and how much there is or None. ``name`` is its display name.
    """

    name: str
    work: Callable[..., Any]
    args: tuple[Any, ...] = ()


class Fate(StrEnum):
    """How a job ended: with a result, by an exception, with its process, or by the clock."""

    DONE = "done"
    FAILED = "failed"
    DIED = "died"
    TIMEOUT = "timeout"


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a job ended.

    ``value`` is what it returned. ``error`` is one line on why it has none; ``exit_code`` is that of its exception,
    and that of a bug where the process itself ended. ``pid`` is the process that ran it.
    """

    fate: Fate
    pid: int
    seconds: float
    value: Any = None
    error: str = ""
    exit_code: ExitCode = ExitCode.DONE


@dataclass(frozen=True, slots=True)
class Started:
    """Job ``index`` begins in process ``pid``."""

    index: int
    pid: int


@dataclass(frozen=True, slots=True)
class Progressed:
    """Job ``index`` reports: what is being done, how much of it, of how much."""

    index: int
    phase: str
    done: int
    total: int | None


@dataclass(frozen=True, slots=True)
class Retried:
    """The process of job ``index`` died of ``error``; the job is run again later."""

    index: int
    error: str


@dataclass(frozen=True, slots=True)
class Ended:
    """Job ``index`` ended."""

    index: int
    outcome: Outcome


Event = Started | Progressed | Retried | Ended
