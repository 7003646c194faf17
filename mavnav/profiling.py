"""How a run proceeds: progress reports, and its profile, seconds by stage, each without the stages inside it.

Times are wall-clock times: reading processor time takes 5 us, and a scan has twenty stages. There is one profile per
process; ``new_profile`` starts a new one. Time outside of all stages is ``other``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from time import perf_counter
from typing import TYPE_CHECKING, ParamSpec, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from types import TracebackType

P = ParamSpec("P")
R = TypeVar("R")

Progress = Callable[[str, int, int | None], None]
"""Called with what is being done, how much of it is done, and how much there is, None if unknown."""

OTHER = "other"

_spent_s: dict[str, float] = {}
_on = OTHER
_since_s = 0.0


def silent(_phase: str, _done: int, _total: int | None) -> None:
    """Report no progress."""


def new_profile(**before_s: float) -> dict[str, float]:
    """Start a new profile and return it: stage -> seconds, updated whenever a stage begins or ends.

    ``before_s`` are the seconds of stages that are over.
    """
    global _spent_s, _since_s
    _spent_s, _since_s = before_s, perf_counter()
    return _spent_s


def _switch(name: str) -> str:
    """Add the time since the last switch to the current stage, and begin another; return the previous one."""
    global _on, _since_s
    before, now_s = _on, perf_counter()
    _spent_s[before] = _spent_s.get(before, 0.0) + now_s - _since_s
    _on, _since_s = name, now_s
    return before


class Stage:
    """A named stage of the work: ``with Stage("search"):``."""

    __slots__ = ("before", "name")

    def __init__(self, name: str) -> None:
        """Name the stage; it begins with the block."""
        self.name, self.before = name, OTHER

    def __enter__(self) -> None:
        """Pause the enclosing stage and begin this one."""
        self.before = _switch(self.name)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End this stage and continue the enclosing one."""
        _switch(self.before)


def timed(name: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator that makes every call of a function a stage."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def within(*args: P.args, **kwargs: P.kwargs) -> R:
            with Stage(name):
                return function(*args, **kwargs)

        return within

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
