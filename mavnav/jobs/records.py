"""Jobs, their events and their outcomes."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from mavnav.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Callable


class Job(Struct, frozen=True):
    """A function call to run in another process: ``work(*args, report)``.

    ``work`` is a module-level function whose result can be pickled; ``report`` is a `Progress`. ``name`` is the display
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


class Outcome(Struct, frozen=True):
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


class Started(Struct, frozen=True):
    """Job ``index`` started in process ``pid``."""

    index: int
    pid: int


class Progressed(Struct, frozen=True):
    """Job ``index`` reported its progress; see `Progress`."""

    index: int
    phase: str
    done: int
    total: int | None


class Retried(Struct, frozen=True):
    """The process of job ``index`` died with ``error``; the job will be run again."""

    index: int
    error: str


class Ended(Struct, frozen=True):
    """Job ``index`` ended."""

    index: int
    outcome: Outcome


Event = Started | Progressed | Retried | Ended
