"""Where a run's time goes: seconds by stage, each without the stages inside it.

The clock is the wall's: the processor's takes 5 us to read, and a scan has twenty stages. There is one account a
process, as there is one clock; ``account`` begins a new one. Time outside of all stages is ``other``.
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
_open: list[str] = [OTHER]
_since_s = 0.0


def account(**before_s: float) -> dict[str, float]:
    """Begin a new account and return it: stage -> seconds, kept up to date whenever a stage begins or ends.

    ``before_s`` is what stages took that are over.
    """
    global _spent_s, _since_s
    _spent_s, _since_s = before_s, perf_counter()
    return _spent_s


def _turn_over() -> None:
    """Charge the time since the last change to the stage that was on."""
    global _since_s  # noqa: PLW0603
    now_s = perf_counter()
    name = _open[-1]
    _spent_s[name] = _spent_s.get(name, 0.0) + now_s - _since_s
    _since_s = now_s


class Stage:
    """A named stretch of work: ``with Stage("search"):``."""

    __slots__ = ("name",)

    def __init__(self, name: str) -> None:
        """Name the stage; it begins with the block."""
        self.name = name

    def __enter__(self) -> None:
        """Stop the stage around this one, begin this one."""
        _turn_over()
        _open.append(self.name)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End this stage, go on with the one around it."""
        _turn_over()
        _open.pop()


def timed(name: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a function whose every call is a stage."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def within(*args: P.args, **kwargs: P.kwargs) -> R:
            _turn_over()
            _open.append(name)
            try:
                return function(*args, **kwargs)
            finally:
                _turn_over()
                _open.pop()

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
