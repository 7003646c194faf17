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
from msgspec.structs import replace

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
        reporter = Reporter(index, channel.send, REPORT_PERIOD_S)
        channel.send(Ended(index, attempt(packed, reporter, limited=memory_mb is not None)))


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


def attempt(packed: bytes, report: Progress, *, limited: bool = False) -> Outcome:
    """Unpickle one job and run it in this process, whose memory may be ``limited``; an exception becomes an outcome."""
    began_s = monotonic()
    try:
        job: Job = pickle.loads(packed)  # noqa: S301  the caller pickled it; who can submit jobs can run any code anyway
        value = job.work(*job.args, report)
    except Exception as error:
        outcome = failure(error, began_s)
        if limited and lacks_memory(error):  # native code without memory ends the process, which is no usage either
            text = f"{outcome.error}; allow more with --memory-mb"
            return replace(outcome, error=text, exit_code=ExitCode.BUG)
        return outcome
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


class Reporter:
    """Progress callback: sends reports of new phases, else one every ``period_s``; ends a job at its time limit."""

    def __init__(
        self, index: int, send: Callable[[Progressed], None], period_s: float, timeout_s: float | None = None
    ) -> None:
        self.index, self.send, self.period_s, self.timeout_s = index, send, period_s, timeout_s
        self.began_s, self.sent_s, self.sent_phase, self.late = monotonic(), 0.0, "", False

    def __call__(self, phase: str, done: int, total: int | None) -> None:
        """Send a report, or drop it; raises TimeoutError after the time limit."""
        now_s = monotonic()
        if self.timeout_s is not None and now_s - self.began_s > self.timeout_s:
            self.late = True
            raise TimeoutError
        if phase != self.sent_phase or now_s - self.sent_s >= self.period_s:
            self.sent_s, self.sent_phase = now_s, phase
            self.send(Progressed(self.index, phase, done, total))
