"""How far a long job is, on stderr: a bar with the time left on a terminal, a plain line now and then elsewhere."""

from __future__ import annotations

import gc
import sys
import threading
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Final

from mavnav.commands import signals
from mavnav.commands.terminal import console, note

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rich.progress import Progress as Bars

    Report = Callable[[str, int, int | None], None]

BAR_PERIOD_S = 0.1
LINE_PERIOD_S = 5.0
SPEAK_AFTER_S = 1.0
TICK_S = 0.25


def silent(phase: str, done: int, total: int | None) -> None:
    """Report nothing."""


REPLAY: Final = {
    "reading": 0, "track": 50, "close loops": 10, "final pass": 14, "draw map": 14, "measuring": 6, "writing": 6,
}  # fmt: skip
MISSION: Final = {"fly": 75, "close loops": 5, "final pass": 8, "draw map": 7, "writing": 5}
"""The stages of a job in their order, each with its usual share of the time, %; no time left is shown in one of 0."""


@dataclass(slots=True)
class _Pace:
    """What is being done, how much of it, and when it was last reported."""

    period_s: float
    stages: dict[str, int]
    phase: str = ""
    began_s: float = 0.0
    job_began_s: float | None = None
    spoke_s: float = field(default_factory=monotonic)
    done: int = 0
    total: int | None = None

    def due(self, phase: str, done: int, total: int | None) -> bool:
        """Take a report; return whether it is to be shown: where its phase is new, or a period has gone by."""
        now_s = monotonic()
        fresh = phase != self.phase
        if fresh:
            self.phase, self.began_s = phase, now_s
            if self.job_began_s is None and self.stages.get(self._stage()):
                self.job_began_s = now_s
        self.done, self.total = done, total
        if not fresh and now_s - self.spoke_s < self.period_s:
            return False
        self.spoke_s = now_s
        return True

    def text(self) -> str:
        """Return the title, how much of the phase is done, and the time left; or how long it has taken."""
        now_s = monotonic()
        left_s = self._seconds_left(self._stage(), now_s)
        if self.total and self.done:
            left = "" if left_s is None else f", {left_s:.0f} s left"
            return f"{self.title()} {100 * self.done // self.total} %{left}"
        return f"{self.title()}, for {now_s - self.began_s:.0f} s"

    def title(self) -> str:
        """Return the phase and its number among the stages."""
        names, stage = list(self.stages), self._stage()
        return self.phase + (f" ({names.index(stage) + 1} of {len(names)})" if stage else "")

    def _stage(self) -> str:
        """Return the stage that the phase is part of, as "track again" of "track"; "" where it is of none."""
        return next((name for name in self.stages if self.phase.startswith(name)), "")

    def _seconds_left(self, stage: str, now_s: float) -> float | None:
        """Estimate the time to the end of the job, or of a phase that is of no stage; None where nothing is known."""
        share = self.done / self.total if self.total else 0.0
        if not stage:
            return (now_s - self.began_s) * (1 - share) / share if share else None
        names = list(self.stages)
        past = sum(self.stages[name] for name in names[: names.index(stage)]) + share * self.stages[stage]
        if self.job_began_s is None or past == 0:
            return None
        return (now_s - self.job_began_s) * (100 - past) / past


@contextmanager
def reporting(*, quiet: bool, stages: dict[str, int] | None = None) -> Iterator[Report]:
    """Give the function that a long job reports to: (what is being done, how much of it is done, of how much).

    With its ``stages`` each line has the number of the stage, and the time left is that of the whole job. The function
    also raises the signal that arrived since, where Python has lost it.
    """
    with _reporting(stages or {}, quiet=quiet) as report:

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
def _reporting(stages: dict[str, int], *, quiet: bool) -> Iterator[Report]:
    if quiet:
        yield silent
    elif sys.stderr.isatty():
        with bars() as shown:
            yield _bar_report(shown, stages)
    else:
        pace, ended = _Pace(LINE_PERIOD_S, stages), threading.Event()
        threading.Thread(target=_fill_silence, args=(pace, ended), daemon=True).start()
        try:
            yield _line_report(pace)
        finally:
            ended.set()


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


def _bar_report(shown: Bars, stages: dict[str, int]) -> Report:
    pace = _Pace(BAR_PERIOD_S, stages)

    def report(phase: str, done: int, total: int | None) -> None:
        fresh = phase != pace.phase
        if not pace.due(phase, done, total) and done != total:
            return
        if fresh:
            for task in shown.task_ids:
                shown.remove_task(task)
            shown.add_task(phase, total=total)
        shown.update(shown.task_ids[-1], completed=done, description=pace.text() if stages else phase)

    return report


def _line_report(pace: _Pace) -> Report:
    def report(phase: str, done: int, total: int | None) -> None:
        fresh = phase != pace.phase
        if pace.due(phase, done, total) and not fresh and total:
            note(f"mavnav: {pace.text()}")

    return report


def _fill_silence(pace: _Pace, ended: threading.Event) -> None:
    """Print a line for a phase of unknown length that lasts, and for any that reports nothing for a period."""
    announced = ""
    while not ended.wait(TICK_S):
        now_s, phase = monotonic(), pace.phase
        lasts = pace.total is None and phase != announced and now_s - pace.began_s >= SPEAK_AFTER_S
        if phase and (lasts or now_s - pace.spoke_s >= pace.period_s):
            announced, pace.spoke_s = phase, now_s
            note(f"mavnav: {pace.text()}" if now_s - pace.began_s >= pace.period_s else f"mavnav: {pace.title()}")
