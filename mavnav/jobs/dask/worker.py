"""The worker's side: one job at a time, where the batch was called, by the same mavnav."""

from __future__ import annotations

import pickle
import sys
from contextlib import chdir
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from mavnav import __version__
from mavnav.errors import UsageError
from mavnav.jobs import Fate, Outcome, attempt, failed
from mavnav.jobs.run_cache import source_sha256

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavnav.jobs import Job

REPORT_PERIOD_S = 0.5
"""A worker reports its progress so often at most."""

_ONE_AT_A_TIME = Lock()
"""The current folder, the memory and the pictures belong to the whole process, whatever threads it has."""


@dataclass(frozen=True, slots=True)
class Terms:
    """What a worker must agree with: the modules of mavnav, the folder, and how long a job may take.

    Progress goes to ``topic``.
    """

    version: str
    modules_sha256: str
    folder: str
    topic: str
    timeout_s: float | None = None


def our_version() -> tuple[str, str]:
    """Return the version of mavnav here, and the hash of its modules."""
    return __version__, source_sha256()


def sees(path: str) -> bool:
    """Return whether a file exists here."""
    return Path(path).is_file()


def in_cluster() -> bool:
    """Return whether this thread runs a job for a scheduler on another machine."""
    if "distributed" not in sys.modules:
        return False
    from distributed import get_worker  # noqa: PLC0415  an extra

    try:
        scheduler = urlsplit(get_worker().scheduler.address)
    except ValueError:
        return False
    return scheduler.scheme != "inproc" and scheduler.hostname not in {"127.0.0.1", "::1", "localhost"}


def run_there(index: int, packed: bytes, terms: dict[str, Any]) -> Outcome:
    """Run one job in this process."""
    began_s = monotonic()
    try:
        return _run(index, packed, Terms(**terms))
    except Exception as error:
        return failed(error, began_s)


def _run(index: int, packed: bytes, terms: Terms) -> Outcome:
    if our_version() != (terms.version, terms.modules_sha256):
        raise UsageError(f"a worker has another mavnav ({__version__}); install {terms.version} there")
    with _ONE_AT_A_TIME, chdir(terms.folder):
        job: Job = pickle.loads(packed)  # noqa: S301  whoever may submit may run anything anyway
        report = _Reporter(index, terms, began_s=monotonic())
        outcome = attempt(job, report)
    if report.late and outcome.fate is Fate.FAILED:
        return replace(outcome, fate=Fate.TIMEOUT, error=f"took longer than {terms.timeout_s:g} s")
    return outcome


class _Reporter:
    """Passes on a report now and then, and ends the job at one when its time is over."""

    def __init__(self, index: int, terms: Terms, began_s: float) -> None:
        self.index, self.terms, self.began_s = index, terms, began_s
        self.late, self.sent_s, self.send = False, float("-inf"), _sender(terms.topic)

    def __call__(self, phase: str, done: int, total: int | None) -> None:
        now_s = monotonic()
        if self.terms.timeout_s is not None and now_s - self.began_s > self.terms.timeout_s:
            self.late = True
            raise TimeoutError
        if now_s - self.sent_s >= REPORT_PERIOD_S:
            self.sent_s = now_s
            self.send({"progress": [self.index, phase, done, total]})


def _sender(topic: str) -> Callable[[dict[str, Any]], None]:
    from distributed import get_worker  # noqa: PLC0415  an extra

    worker = get_worker()
    return lambda message: worker.log_event(topic, message)
