"""Ctrl-C and SIGTERM: they unwind the stack, so that unfinished files are removed, and are never lost.

Python drops an exception that a signal raises inside a finalizer, as happens while kernels compile. The signal is
therefore remembered, and whoever works long asks for it. It is no KeyboardInterrupt either: one that passes an
``exec`` anywhere, as in a library that makes its classes so, makes Python end by the signal and drop the exit code.
"""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

from mavnav.errors import ExitCode

if TYPE_CHECKING:
    from collections.abc import Iterator
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


def listen() -> None:
    """Take over SIGINT and SIGTERM."""
    for number in _REASONS:
        signal.signal(number, _stop)


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


def _stop(number: int, _frame: FrameType | None) -> NoReturn:
    reason = _REASONS[signal.Signals(number)]
    _ARRIVED.append(reason)
    raise reason


def _end(number: int, _frame: FrameType | None) -> NoReturn:
    reason = _REASONS[signal.Signals(number)]
    show_cursor = "\x1b[?25h" if os.isatty(2) else ""  # a bar may have hidden it
    os.write(2, f"{show_cursor}mavnav: {reason.word}\n".encode())
    os._exit(reason.exit_code)


def check() -> None:
    """Raise the signal that arrived, if it is still to be obeyed."""
    if _ARRIVED:
        raise _ARRIVED[-1]
