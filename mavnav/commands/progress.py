"""How far a long job is, on stderr: a bar with the time left on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import gc
import sys
import threading
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING

from mavnav.commands import signals
from mavnav.commands.terminal import console, note

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rich.progress import Progress as Bars

    Report = Callable[[str, int, int | None], None]

BAR_PERIOD_S = 0.1
LINE_PERIOD_S = 5.0
SPEAK_AFTER_S = 1.0


def silent(phase: str, done: int, total: int | None) -> None:
    """Report nothing."""


@dataclass(slots=True)
class _Pace:
    """Lets a report through when its phase is new, or when a period has gone by."""

    period_s: float
    phase: str = ""
    began_s: float = 0.0
    spoke_s: float = field(default_factory=monotonic)

    def due(self, phase: str) -> bool:
        now_s = monotonic()
        fresh = phase != self.phase
        if fresh:
            self.phase, self.began_s = phase, now_s
        if not fresh and now_s - self.spoke_s < self.period_s:
            return False
        self.spoke_s = now_s
        return True

    def seconds_left(self, done: int, total: int) -> float:
        return (monotonic() - self.began_s) * (total - done) / max(done, 1)


@contextmanager
def reporting(*, quiet: bool) -> Iterator[Report]:
    """Give the function that a long job reports to: (what is being done, how much of it is done, of how much).

    It also raises the signal that arrived since, where Python has lost it.
    """
    with _reporting(quiet=quiet) as report:

        def attentive(phase: str, done: int, total: int | None) -> None:
            signals.raise_pending()
            report(phase, done, total)

        yield attentive


@contextmanager
def loading_modules() -> Iterator[None]:
    """Import within it what takes long to load; a signal ends the process at once.

    What is imported stays: garbage is not looked for in it, now or later, which would take 0.1 s.
    """
    gc.disable()
    try:
        with signals.at_once():
            yield
    finally:
        gc.freeze()
        gc.enable()


@contextmanager
def _reporting(*, quiet: bool) -> Iterator[Report]:
    if quiet:
        yield silent
    elif sys.stderr.isatty():
        with bars() as shown:
            yield _bar_report(shown)
    else:
        announcement = _Announcement()
        try:
            yield _line_report(announcement)
        finally:
            announcement.cancel()


def bars() -> Bars:
    """Return bars on stderr that vanish at the end: a description, the bar, the share, the time left."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description:12}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=console(stderr=True),
        transient=True,
    )


def _bar_report(shown: Bars) -> Report:
    pace = _Pace(BAR_PERIOD_S)

    def report(phase: str, done: int, total: int | None) -> None:
        fresh = phase != pace.phase
        if not pace.due(phase) and done != total:
            return
        if fresh:
            for task in shown.task_ids:
                shown.remove_task(task)
            shown.add_task(phase, total=total)
        shown.update(shown.task_ids[-1], completed=done)

    return report


def _line_report(announcement: _Announcement) -> Report:
    pace = _Pace(LINE_PERIOD_S)

    def report(phase: str, done: int, total: int | None) -> None:
        fresh = phase != pace.phase
        if not pace.due(phase):
            return
        if fresh:
            announcement.cancel()
            if total is None:
                announcement.after(SPEAK_AFTER_S, f"mavnav: {phase}")
        elif total:
            note(f"mavnav: {phase} {100 * done // total} %, {pace.seconds_left(done, total):.0f} s left")

    return report


@dataclass(slots=True)
class _Announcement:
    """Names a phase of unknown length if it lasts."""

    timer: threading.Timer | None = None

    def after(self, seconds: float, text: str) -> None:
        self.timer = threading.Timer(seconds, note, [text])
        self.timer.daemon = True
        self.timer.start()

    def cancel(self) -> None:
        if self.timer is not None:
            self.timer.cancel()
