"""Execution of a job on a worker of a Dask cluster: one at a time, in the folder of the caller."""

from __future__ import annotations

import pickle
import sys
from contextlib import chdir
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import Any
from urllib.parse import urlsplit

from msgspec import Struct
from msgspec.structs import replace

from mavnav.errors import UsageError
from mavnav.jobs import Job, Outcome, Status, attempt, failure
from mavnav.jobs.run_cache import source_sha256
from mavnav.version import __version__

REPORT_PERIOD_S = 0.5
"""Minimum time between two progress reports of a worker, in s."""

_ONE_AT_A_TIME = Lock()
"""Prevents concurrent jobs: the current folder, memory and drawing state are shared by all threads of a process."""


class JobContext(Struct, frozen=True):
    """Context of a job: the required version of mavnav, the current folder, and the time limit.

    Progress is sent to ``topic``.
    """

    version: str
    modules_sha256: str
    folder: str
    topic: str
    timeout_s: float | None = None


def our_version() -> tuple[str, str]:
    """Return the version of mavnav in this process, and the hash of its modules."""
    return __version__, source_sha256()


def sees(path: str) -> bool:
    """Return whether a file exists on this machine."""
    return Path(path).is_file()


def in_cluster() -> bool:
    """Return whether this thread runs a job of a scheduler on another machine."""
    if "distributed" not in sys.modules:
        return False
    from distributed import get_worker  # noqa: PLC0415  an extra

    try:
        scheduler = urlsplit(get_worker().scheduler.address)
    except ValueError:
        return False
    return scheduler.scheme != "inproc" and scheduler.hostname not in {"127.0.0.1", "::1", "localhost"}


def run_on_worker(index: int, packed: bytes, context: dict[str, Any]) -> Outcome:
    """Run one job in this process."""
    began_s = monotonic()
    try:
        return _run(index, packed, JobContext(**context))
    except Exception as error:
        return failure(error, began_s)


def _run(index: int, packed: bytes, context: JobContext) -> Outcome:
    if our_version() != (context.version, context.modules_sha256):
        raise UsageError(f"a worker has another mavnav ({__version__}); install {context.version} there")
    with _ONE_AT_A_TIME, chdir(context.folder):
        job: Job = pickle.loads(packed)  # noqa: S301  who can submit jobs can run any code anyway
        report = _Reporter(index, context, began_s=monotonic())
        outcome = attempt(job, report)
    if report.late and outcome.status is Status.FAILED:
        return replace(outcome, status=Status.TIMEOUT, error=f"took longer than {context.timeout_s:g} s")
    return outcome


class _Reporter:
    """Progress callback: sends a report every ``REPORT_PERIOD_S`` at most, and ends a job at its time limit."""

    def __init__(self, index: int, context: JobContext, began_s: float) -> None:
        from distributed import get_worker  # noqa: PLC0415  an extra

        self.index, self.context, self.began_s = index, context, began_s
        self.late, self.sent_s, self.worker = False, float("-inf"), get_worker()

    def __call__(self, phase: str, done: int, total: int | None) -> None:
        now_s = monotonic()
        if self.context.timeout_s is not None and now_s - self.began_s > self.context.timeout_s:
            self.late = True
            raise TimeoutError
        if now_s - self.sent_s >= REPORT_PERIOD_S:
            self.sent_s = now_s
            self.worker.log_event(self.context.topic, {"progress": [self.index, phase, done, total]})
