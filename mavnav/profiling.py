"""Where a run's time goes: seconds by stage, each without the stages inside it.

The clock is the wall's: the processor's takes 5 us to read, and a scan has twenty stages. There is one profile a
process, as there is one clock; ``new_profile`` begins a new one. Time outside of all stages is ``other``.
"""

from __future__ import annotations

from functools import wraps
from time import perf_counter
from typing import TYPE_CHECKING, ParamSpec, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from types import TracebackType

P = ParamSpec("P")
R = TypeVar("R")

OTHER = "other"

_spent_s: dict[str, float] = {}
_on = OTHER
_since_s = 0.0


def new_profile(**before_s: float) -> dict[str, float]:
    """Begin a new profile and return it: stage -> seconds, kept up to date whenever a stage begins or ends.

    ``before_s`` is what stages took that are over.
    """
    global _spent_s, _since_s
    _spent_s, _since_s = before_s, perf_counter()
    return _spent_s


def _switch(name: str) -> str:
    """Charge the time since the last change to the stage that was on, and begin another; returns the one before."""
    global _on, _since_s
    before, now_s = _on, perf_counter()
    _spent_s[before] = _spent_s.get(before, 0.0) + now_s - _since_s
    _on, _since_s = name, now_s
    return before


class Stage:
    """A named stretch of work: ``with Stage("search"):``."""

    __slots__ = ("before", "name")

    def __init__(self, name: str) -> None:
        """Name the stage; it begins with the block."""
        self.name, self.before = name, OTHER

    def __enter__(self) -> None:
        """Stop the stage around this one, begin this one."""
        self.before = _switch(self.name)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End this stage, go on with the one around it."""
        _switch(self.before)


def timed(name: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function whose every call is a stage."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def within(*args: P.args, **kwargs: P.kwargs) -> R:
            before = _switch(name)
            try:
                return function(*args, **kwargs)
            finally:
                _switch(before)

        return within

    return decorate


def each(name: str, items: Iterable[R]) -> Iterator[R]:
    """Yield the items; what it takes to make each of them is a stage."""
    iterator, stage = iter(items), Stage(name)
    while True:
        with stage:
            try:
                item = next(iterator)
            except StopIteration:
                return
        yield item
