"""Handling of Ctrl-C, SIGTERM and SIGHUP: an exception unwinds the stack, so that unfinished files are removed.

Python drops an exception that a signal handler raises inside a finalizer, as happens while kernels compile. The signal
is therefore stored, and long tasks check for it. The exception is no KeyboardInterrupt: if that passes through an
``exec``, as in a library that generates classes, Python ends by the signal and drops the exit code.

While scans are tracked, the first signal only ends the run early, and the results so far are written.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import NoReturn

from mavnav.errors import ExitCode


class Stopped(BaseException):
    """A signal requests the end of the process."""

    word: str
    exit_code: ExitCode


class Interrupted(Stopped):
    """SIGINT, as from Ctrl-C."""

    word = "interrupted"
    exit_code = ExitCode.INTERRUPTED


class Terminated(Stopped):
    """SIGTERM, as from a job scheduler, or SIGHUP, as from a terminal that is closed."""

    word = "terminated"
    exit_code = ExitCode.TERMINATED


_REASONS = {signal.SIGINT: Interrupted, signal.SIGTERM: Terminated}
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # nohup ignores it
    _REASONS[signal.SIGHUP] = Terminated
_ARRIVED: list[type[Stopped]] = []
_DEFERRED = [0]
"""Number of signals that raise no exception: code within ``deferring`` checks for them."""


def listen() -> None:
    """Install the handlers."""
    for number in _REASONS:
        signal.signal(number, _stop)


@contextmanager
def deferring() -> Iterator[Callable[[], ExitCode | None]]:
    """Defer the first signal, so that the results so far can be kept; the second one raises an exception.

    Yields a function that returns the exit code of the signal that arrived, None if there is none. If it is not called
    after the signal, the work was already done: the result is complete, and the signal is ignored.
    """
    received: list[ExitCode] = []

    def pending_code() -> ExitCode | None:
        if _ARRIVED:
            received.append(_ARRIVED[-1].exit_code)
        return received[-1] if received else None

    _DEFERRED[0] = 1
    try:
        yield pending_code
        if _ARRIVED and not received:
            _write_stderr("mavnav: the signal came after the work was done: the result is complete\n")
    finally:
        _DEFERRED[0] = 0
        _ARRIVED.clear()


@contextmanager
def at_once() -> Iterator[None]:
    """Exit immediately on a signal: for code that cannot be unwound, such as the compiler, and needs no cleanup."""
    for number in _REASONS:
        signal.signal(number, _end)
    yield
    listen()


def ignore() -> None:
    """Ignore further signals, because the process is exiting."""
    for number in _REASONS:
        signal.signal(number, signal.SIG_IGN)


def _stop(number: int, _frame: FrameType | None) -> None:
    reason = _REASONS[signal.Signals(number)]
    _ARRIVED.append(reason)
    if len(_ARRIVED) > _DEFERRED[0]:
        raise reason
    _write_stderr(f"mavnav: {reason.word}: writing the results so far; interrupt again to discard them\n")


def _write_stderr(text: str) -> None:
    """Write to stderr without its buffer, which may be in use; errors of a full or closed stream are ignored."""
    with suppress(OSError):
        os.write(2, text.encode())


def _end(number: int, _frame: FrameType | None) -> NoReturn:
    reason = _REASONS[signal.Signals(number)]
    show_cursor = "\x1b[?25h" if os.isatty(2) else ""  # a progress bar may have hidden it
    _write_stderr(f"{show_cursor}mavnav: {reason.word}\n")
    os._exit(reason.exit_code)


def pending_stop() -> type[Stopped] | None:
    """Return the exception of a signal that arrived, None if there is none or it is deferred."""
    return _ARRIVED[-1] if len(_ARRIVED) > _DEFERRED[0] else None


def raise_pending() -> None:
    """Raise the exception of a signal that arrived, unless it is deferred."""
    if reason := pending_stop():
        raise reason
