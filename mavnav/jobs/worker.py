"""The worker's side: it takes jobs from a channel, runs them, and answers through that channel alone."""

from __future__ import annotations

import os
import pickle
import signal
import sys
from multiprocessing import parent_process
from threading import Thread
from time import monotonic
from typing import TYPE_CHECKING, Any, NoReturn

from mavnav.errors import ExitCode, MavnavError
from mavnav.jobs.records import Ended, Fate, Job, Outcome, Progressed, Report

if TYPE_CHECKING:
    from multiprocessing import connection

REPORT_PERIOD_S = 0.2
"""A worker reports its progress so often at most."""


def serve(channel: connection.Connection[Any, Any], memory_mb: int | None) -> None:
    """Be a worker: take jobs until the channel closes."""
    _prepare(memory_mb)
    while True:
        try:
            index, packed = channel.recv()
        except EOFError:
            return
        channel.send(Ended(index, _attempt(index, packed, channel)))


def _prepare(memory_mb: int | None) -> None:
    """Print nothing, end when terminated or when the parent is gone, and limit the memory."""
    signal.signal(signal.SIGTERM, _leave)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    sys.stdout = sys.stderr = open(nowhere, "w", closefd=False)  # noqa: SIM115  a forked one has its parent's
    Thread(target=_follow_parent, daemon=True).start()
    if memory_mb is not None:
        import resource  # noqa: PLC0415  not everywhere

        resource.setrlimit(resource.RLIMIT_DATA, (memory_mb * 2**20, memory_mb * 2**20))


def _leave(_number: int, _frame: object) -> NoReturn:
    raise SystemExit(ExitCode.TERMINATED)  # unwinds, so that unfinished files are removed


def _follow_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def _attempt(index: int, packed: bytes, channel: connection.Connection[Any, Any]) -> Outcome:
    """Unpack one job and run it."""
    began_s = monotonic()
    try:
        job: Job = pickle.loads(packed)  # noqa: S301  our own parent packed it
    except Exception as error:
        return failed(error, began_s)
    return attempt(job, _reporter(index, channel))


def attempt(job: Job, report: Report) -> Outcome:
    """Run one job in this process; an exception becomes an outcome."""
    began_s = monotonic()
    try:
        value = job.work(*job.args, report)
    except Exception as error:
        return failed(error, began_s)
    return Outcome(Fate.DONE, os.getpid(), monotonic() - began_s, value)


def failed(error: Exception, began_s: float) -> Outcome:
    """Return the outcome of a job that raised, and began at that time of the monotonic clock."""
    code = error.exit_code if isinstance(error, MavnavError) else ExitCode.BUG
    return Outcome(Fate.FAILED, os.getpid(), monotonic() - began_s, None, _described(error), code)


def _described(error: Exception) -> str:
    """Describe an exception in one line."""
    if isinstance(error, MavnavError):
        return str(error)
    if isinstance(error, MemoryError):
        return "it needs more memory than it may use"
    return f"a bug: {type(error).__name__}: {error}"


def _reporter(index: int, channel: connection.Connection[Any, Any]) -> Report:
    """Make the function by which a job reports its progress; it lets through a report now and then."""
    sent_s, sent_phase = 0.0, ""

    def report(phase: str, done: int, total: int | None) -> None:
        nonlocal sent_s, sent_phase
        now_s = monotonic()
        if phase != sent_phase or now_s - sent_s >= REPORT_PERIOD_S:
            sent_s, sent_phase = now_s, phase
            channel.send(Progressed(index, phase, done, total))

    return report
