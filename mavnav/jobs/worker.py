"""Jobs, their events and outcomes; and the worker process that receives jobs from a channel and sends those back."""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Callable
from enum import StrEnum
from multiprocessing import connection, parent_process
from threading import Thread
from time import monotonic
from typing import Any, NoReturn

from msgspec import Struct

from mavnav.errors import ExitCode, MavnavError, lacks_memory
from mavnav.profiling import Progress


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


REPORT_PERIOD_S = 0.2
"""Minimum time between two progress reports of one phase, in s."""


def serve(channel: connection.Connection[Any, Any], memory_mb: int | None) -> None:
    """Run jobs from the channel until it closes."""
    _prepare(memory_mb)
    while True:
        try:
            index, packed = channel.recv()
        except EOFError:
            return
        channel.send(Ended(index, _attempt(index, packed, channel)))


def _prepare(memory_mb: int | None) -> None:
    """Discard output, exit on SIGTERM or when the parent dies, and limit the memory."""
    signal.signal(signal.SIGTERM, _exit)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    sys.stdout = sys.stderr = open(nowhere, "w", closefd=False)  # noqa: SIM115  a fork has the parent's streams
    Thread(target=_follow_parent, daemon=True).start()
    if memory_mb is not None:
        import resource  # noqa: PLC0415  not on all systems

        resource.setrlimit(resource.RLIMIT_DATA, (memory_mb * 2**20, memory_mb * 2**20))


def _exit(_number: int, _frame: object) -> NoReturn:
    raise SystemExit(ExitCode.TERMINATED)  # unwinds the stack, which removes unfinished files


def _follow_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def _attempt(index: int, packed: bytes, channel: connection.Connection[Any, Any]) -> Outcome:
    """Unpickle one job and run it."""
    began_s = monotonic()
    try:
        job: Job = pickle.loads(packed)  # noqa: S301  the parent process pickled it
    except Exception as error:
        return failure(error, began_s)
    return attempt(job, _reporter(index, channel))


def attempt(job: Job, report: Progress) -> Outcome:
    """Run one job in this process; an exception becomes an outcome."""
    began_s = monotonic()
    try:
        value = job.work(*job.args, report)
    except Exception as error:
        return failure(error, began_s)
    return Outcome(Status.DONE, os.getpid(), monotonic() - began_s, value)


def failure(error: Exception, began_s: float) -> Outcome:
    """Return the outcome of a job that raised ``error`` and began at ``began_s`` of the monotonic clock."""
    known = error.exit_code if isinstance(error, MavnavError) else ExitCode.BUG
    code = ExitCode.USAGE if lacks_memory(error) else known
    return Outcome(Status.FAILED, os.getpid(), monotonic() - began_s, None, _describe(error), code)


def _describe(error: Exception) -> str:
    """Describe an exception in one line."""
    if isinstance(error, MavnavError):
        return str(error)
    if lacks_memory(error):
        return "it needs more memory than it may use"
    return f"a bug: {type(error).__name__}: {error}"


def _reporter(index: int, channel: connection.Connection[Any, Any]) -> Progress:
    """Return the progress callback of a job; it drops reports within ``REPORT_PERIOD_S`` of the last one of a phase."""
    sent_s, sent_phase = 0.0, ""

    def report(phase: str, done: int, total: int | None) -> None:
        nonlocal sent_s, sent_phase
        now_s = monotonic()
        if phase != sent_phase or now_s - sent_s >= REPORT_PERIOD_S:
            sent_s, sent_phase = now_s, phase
            channel.send(Progressed(index, phase, done, total))

    return report
