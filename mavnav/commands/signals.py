"""Ctrl-C and SIGTERM: they unwind the stack, so that unfinished files are removed, and are never lost.

Python drops an exception that a signal raises inside a finalizer, as happens while kernels compile. The signal is
therefore remembered, and whoever works long asks for it. It is no KeyboardInterrupt either: one that passes an
``exec`` anywhere, as in a library that makes its classes so, makes Python end by the signal and drop the exit code.

While scans are tracked there is something to keep: there the first signal lets the run end early and be written.
"""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, NoReturn

from mavnav.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType


class Stopped(BaseException):
    """A signal asks the process to end."""

    word: str
    exit_code: ExitCode


class Interrupted(Stopped):
    """SIGINT, as from Ctrl-C."""

    word = "interrupted"
    exit_code = ExitCode.INTERRUPTED


class Terminated(Stopped):
    """SIGTERM, as from a job scheduler."""

    word = "terminated"
    exit_code = ExitCode.TERMINATED


_REASONS = {signal.SIGINT: Interrupted, signal.SIGTERM: Terminated}
_ARRIVED: list[type[Stopped]] = []
_FORGIVEN = [0]
"""So many signals do not end the work by themselves: whoever works within ``keeping`` asks for them."""


def listen() -> None:
    """Take over SIGINT and SIGTERM."""
    for number in _REASONS:
        signal.signal(number, _stop)


@contextmanager
def keeping() -> Iterator[Callable[[], ExitCode | None]]:
    """Let the first signal only be asked for, so that what is done so far can be kept; the second ends the work.

    Gives the function to ask: the exit code of the signal that arrived, None while there is none. Where it was never
    asked again, the signal came when the work was done: the result is whole, and is what counts.
    """
    heard: list[ExitCode] = []

    def ask() -> ExitCode | None:
        if _ARRIVED:
            heard.append(_ARRIVED[-1].exit_code)
        return heard[-1] if heard else None

    _FORGIVEN[0] = 1
    try:
        yield ask
        if _ARRIVED and not heard:
            _say("mavnav: the signal came after the work was done: the result is complete\n")
    finally:
        _FORGIVEN[0] = 0
        _ARRIVED.clear()


@contextmanager
def at_once() -> Iterator[None]:
    """End by a signal on the spot: for what cannot be unwound, as the compiler, and has nothing to put away."""
    for number in _REASONS:
        signal.signal(number, _end)
    yield
    listen()


def ignore() -> None:
    """Let no further signal disturb a process that is ending."""
    for number in _REASONS:
        signal.signal(number, signal.SIG_IGN)


def _stop(number: int, _frame: FrameType | None) -> None:
    reason = _REASONS[signal.Signals(number)]
    _ARRIVED.append(reason)
    if len(_ARRIVED) > _FORGIVEN[0]:
        raise reason
    _say(f"mavnav: {reason.word}: writing the results so far; interrupt again to discard them\n")


def _say(text: str) -> None:
    """Write to stderr past its buffer, which may be in use; nothing happens where it is full or closed."""
    with suppress(OSError):
        os.write(2, text.encode())


def _end(number: int, _frame: FrameType | None) -> NoReturn:
    reason = _REASONS[signal.Signals(number)]
    show_cursor = "\x1b[?25h" if os.isatty(2) else ""  # a bar may have hidden it
    _say(f"{show_cursor}mavnav: {reason.word}\n")
    os._exit(reason.exit_code)


def raise_pending() -> None:
    """Raise the signal that arrived, if it is still to be obeyed."""
    if len(_ARRIVED) > _FORGIVEN[0]:
        raise _ARRIVED[-1]
