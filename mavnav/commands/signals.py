"""Ctrl-C and SIGTERM: they unwind the stack, so that unfinished files are removed, and are never lost.

Python drops an exception that a signal raises inside a finalizer, as happens while kernels compile. The signal is
therefore remembered, and whoever works long asks for it.
"""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from types import FrameType


class Terminated(BaseException):
    """SIGTERM arrived; unwinds the stack as KeyboardInterrupt does."""


_ARRIVED: list[type[BaseException]] = []


def listen() -> None:
    """Take over SIGINT and SIGTERM."""
    signal.signal(signal.SIGINT, _stop)
    signal.signal(signal.SIGTERM, _stop)


def _stop(number: int, _frame: FrameType | None) -> NoReturn:
    reason = KeyboardInterrupt if number == signal.SIGINT else Terminated
    _ARRIVED.append(reason)
    raise reason


def check() -> None:
    """Raise the signal that arrived, if it is still to be obeyed."""
    if _ARRIVED:
        raise _ARRIVED[-1]
