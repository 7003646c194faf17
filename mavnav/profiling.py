"""How a run proceeds: progress reports, and its profile, seconds by stage, each without the stages inside it.

Times are wall-clock times: reading processor time takes 5 us, and a scan has twenty stages. There is one profile per
process; ``new_profile`` starts a new one. Time outside of all stages is ``other``. `scans_s` is the time of each scan
in the tracker.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from functools import wraps
from math import nan
from time import perf_counter
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

Progress = Callable[[str, int, int | None], None]
"""Called with what is being done, how much of it is done, and how much there is, None if unknown."""

OTHER = "other"

MAXRSS_MB = 1e-6 if sys.platform == "darwin" else 1.024e-3
"""MB of 1e6 bytes in the unit in which the system counts the largest memory of a process."""

_spent_s: dict[str, float] = {}
_scans_s: list[float] = []
_enclosing: list[str] = []
_on = OTHER
_since_s = 0.0


def silent(_phase: str, _done: int, _total: int | None) -> None:
    """Report no progress."""


def new_profile(**before_s: float) -> dict[str, float]:
    """Start a new profile and return it: stage -> seconds, updated whenever a stage begins or ends.

    ``before_s`` are the seconds of stages that are over.
    """
    global _spent_s, _scans_s, _since_s
    _spent_s, _scans_s, _since_s = before_s, [], perf_counter()
    return _spent_s


def scans_s() -> list[float]:
    """Return the seconds of every scan since the profile began, from the scan at hand to its pose and the map."""
    return _scans_s


def add_scan(began_s: float) -> None:
    """Add the time of a scan on which the tracker began at ``began_s`` by the clock."""
    _scans_s.append(perf_counter() - began_s)


def peak_memory_mb() -> float:
    """Return the largest memory that this process has had, in MB of 1e6 bytes; NaN where the system does not tell."""
    try:
        from resource import RUSAGE_SELF, getrusage  # noqa: PLC0415  not on all systems
    except ImportError:
        return nan
    return getrusage(RUSAGE_SELF).ru_maxrss * MAXRSS_MB


def _switch(name: str) -> str:
    """Add the time since the last switch to the current stage, and begin another; return the previous one."""
    global _on, _since_s
    before, now_s = _on, perf_counter()
    _spent_s[before] = _spent_s.get(before, 0.0) + now_s - _since_s
    _on, _since_s = name, now_s
    return before


class Stage:
    """A named stage of the work: ``with Stage("search"):``."""

    def __init__(self, name: str) -> None:
        """Name the stage; it begins with the block."""
        self.name = name

    def __enter__(self) -> None:
        """Pause the enclosing stage and begin this one."""
        _enclosing.append(_switch(self.name))

    def __exit__(self, *_: object) -> None:
        """End this stage and continue the enclosing one."""
        _switch(_enclosing.pop())


def as_stage(name: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Make each call of a function a stage of the work, at half the time of a context manager."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            before = _switch(name)
            try:
                return function(*args, **kwargs)
            finally:
                _switch(before)

        return call

    return decorate


def each(name: str, items: Iterable[R]) -> Iterator[R]:
    """Yield the items; making each of them is a stage."""
    iterator, stage = iter(items), Stage(name)
    while True:
        with stage:
            try:
                item = next(iterator)
            except StopIteration:
                return
        yield item
