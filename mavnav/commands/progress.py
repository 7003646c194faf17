"""Progress on stderr: bars on a terminal; else plain lines, of a long job every 5 s, of many runs when one ends."""

from __future__ import annotations

import gc
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from math import inf
from time import monotonic
from typing import TYPE_CHECKING, Final, ParamSpec

from mavnav.commands import signals
from mavnav.commands.terminal import console, note, printable
from mavnav.profiling import Progress, silent

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

    from mavnav.jobs.worker import Event, Outcome, Retried

    Listener = Callable[[Event], None]

P = ParamSpec("P")

BAR_PERIOD_S = 0.1
LINE_PERIOD_S = 5.0
ANNOUNCE_AFTER_S = 1.0
TICK_S = 0.25


REPLAY: Final = {
    "reading": 0, "track": 50, "close loops": 10, "final pass": 28, "measuring": 6, "writing": 6,
}  # fmt: skip
MISSION: Final = {"fly": 75, "close loops": 5, "final pass": 15, "writing": 5}
"""The stages of a job in their order, each with its typical share of the time, in %; a share of 0 is not estimated."""


class _ProgressState:
    """State of the progress: phase, amount done, and time of the last report."""

    def __init__(self, period_s: float, stages: dict[str, int]) -> None:
        """Start without a phase."""
        self.period_s, self.stages = period_s, stages
        self.phase, self.done, self.began_s, self.reported_s = "", 0, 0.0, monotonic()
        self.total: int | None = None
        self.job_began_s: float | None = None
        self.printed_s = -inf

    def note(self, text: str) -> None:
        """Print a line, unless another one was printed less than a period ago."""
        now_s = monotonic()
        if now_s - self.printed_s >= self.period_s:
            self.printed_s = now_s
            note(f"mavnav: {text}")

    def due(self, phase: str, done: int, total: int | None) -> bool:
        """Store a report; return whether to show it: its phase is new, or a period has passed since the last one."""
        now_s = monotonic()
        fresh = phase != self.phase
        if fresh:
            self.phase, self.began_s = phase, now_s
            if self.job_began_s is None and self.stages.get(self._stage()):
                self.job_began_s = now_s
        self.done, self.total = done, total
        if not fresh and now_s - self.reported_s < self.period_s:
            return False
        self.reported_s = now_s
        return True

    def text(self) -> str:
        """Return the title with the share done of the phase and the remaining time, or with the elapsed time."""
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
        """Return the stage that the phase belongs to, such as "track" for "track again"; empty if there is none."""
        return next((name for name in self.stages if self.phase.startswith(name)), "")

    def _seconds_left(self, stage: str, now_s: float) -> float | None:
        """Estimate the remaining time of the job, or of a phase without a stage; None if there is no estimate."""
        share = self.done / self.total if self.total else 0.0
        if not stage:
            return (now_s - self.began_s) * (1 - share) / share if share else None
        names = list(self.stages)
        past = sum(self.stages[name] for name in names[: names.index(stage)]) + share * self.stages[stage]
        if self.job_began_s is None or past == 0:
            return None
        return (now_s - self.job_began_s) * (100 - past) / past


@contextmanager
def reporting(*, quiet: bool, stages: dict[str, int] | None = None) -> Iterator[Progress]:
    """Yield the progress callback of a long job: it takes the phase, the amount done, and the total, None if unknown.

    With ``stages``, each line contains the number of the stage, and the remaining time is that of the whole job. The
    callback also raises the exception of a signal that arrived and that Python has dropped.
    """
    if quiet:
        yield _raising(silent)
    elif sys.stderr.isatty():
        with _bars() as shown:
            yield _raising(_bar_report(shown, stages or {}))
    else:
        state, ended = _ProgressState(LINE_PERIOD_S, stages or {}), threading.Event()
        threading.Thread(target=_print_when_idle, args=(state, ended), daemon=True).start()
        try:
            yield _raising(_line_report(state))
        finally:
            ended.set()


def _raising(call: Callable[P, None]) -> Callable[P, None]:
    """Return a callback that first raises the exception of a signal that arrived and that Python has dropped."""

    def raise_or_call(*args: P.args, **values: P.kwargs) -> None:
        signals.raise_pending()
        call(*args, **values)

    return raise_or_call


@contextmanager
def loading_modules() -> Iterator[None]:
    """Context for imports that take long; a signal ends the process immediately.

    Garbage collection is disabled, and the imported objects are excluded from it later: that saves 0.1 s.
    """
    gc.disable()
    try:
        with signals.at_once():
            yield
    finally:
        gc.freeze()
        gc.enable()


def _bars() -> Bars:
    """Return progress bars on stderr that vanish at the end: description, bar, share, remaining time."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    times = TaskProgressColumn(), TimeRemainingColumn()
    title = TextColumn("{task.description:12}", markup=False)
    return Progress(title, BarColumn(), *times, console=console(stderr=True), transient=True)


def _bar_report(shown: Bars, stages: dict[str, int]) -> Progress:
    state = _ProgressState(BAR_PERIOD_S, stages)

    def report(phase: str, done: int, total: int | None) -> None:
        fresh = phase != state.phase
        if not state.due(phase, done, total) and done != total:
            return
        if fresh:
            for task in shown.task_ids:
                shown.remove_task(task)
            shown.add_task(phase, total=total)
        shown.update(shown.task_ids[-1], completed=done, description=state.text() if stages else phase)

    return report


def _line_report(state: _ProgressState) -> Progress:
    def report(phase: str, done: int, total: int | None) -> None:
        fresh = phase != state.phase
        if state.due(phase, done, total) and not fresh and total:
            state.note(state.text())

    return report


def _print_when_idle(state: _ProgressState, ended: threading.Event) -> None:
    """Print a line for a phase of unknown length that takes over 1 s, and for a phase without reports for a period."""
    announced = ""
    while not ended.wait(TICK_S):
        now_s, phase = monotonic(), state.phase
        lasts = state.total is None and phase != announced and now_s - state.began_s >= ANNOUNCE_AFTER_S
        if phase and (lasts or now_s - state.reported_s >= state.period_s):
            announced, state.reported_s = phase, now_s
            state.note(state.text() if now_s - state.began_s >= state.period_s else state.title())


@contextmanager
def watching(names: Sequence[str], *, quiet: bool, lines: bool = True) -> Iterator[Listener]:
    """Yield a listener to the events of the jobs ``names``; it also raises a signal that Python has dropped.

    Without a terminal, it prints a line for every run that ends, unless ``lines`` is false.
    """
    if quiet or not names:
        yield _raising(lambda _event: None)
    elif sys.stderr.isatty():
        with _bars() as shown:
            yield _raising(_bar_listener(shown, names))
    else:
        yield _raising(_line_listener(names, ends=lines))


def _line_listener(names: Sequence[str], *, ends: bool) -> Listener:
    from mavnav.jobs.worker import Ended, Retried

    numbers = count(1)

    def listen(event: Event) -> None:
        if isinstance(event, Retried):
            note(_retry_text(names[event.index], event))
        elif isinstance(event, Ended) and ends:
            note(f"mavnav: {next(numbers)} of {len(names)}: {names[event.index]} {_ending(event.outcome)}")

    return listen


def _retry_text(name: str, event: Retried) -> str:
    return f"mavnav: {name}: {event.error}; it is tried again at the end"


def _ending(outcome: Outcome) -> str:
    """Return the text of how a job ended."""
    from mavnav.jobs.worker import Status

    return f"done in {outcome.seconds:.1f} s" if outcome.status is Status.DONE else f"failed: {outcome.error}"


def _bar_listener(shown: Bars, names: Sequence[str]) -> Listener:
    """Show a bar for all runs and one for each current run; print a line for each failure."""
    from mavnav.jobs.worker import Ended, Progressed, Retried, Started, Status

    failures, whole = count(1), shown.add_task(f"{len(names)} runs", total=len(names))
    tasks: dict[int, TaskID] = {}

    def listen(event: Event) -> None:
        match event:
            case Started(index):
                tasks[index] = shown.add_task(printable(names[index]), total=None)
            case Progressed(index, phase, done, total):
                text = printable(f"{names[index]}: {phase}")
                shown.update(tasks[index], description=text, completed=done, total=total)
            case Retried(index):
                shown.remove_task(tasks.pop(index))
                note(_retry_text(names[index], event))
            case Ended(index, outcome):
                shown.remove_task(tasks.pop(index))
                shown.advance(whole)
                if outcome.status is not Status.DONE:
                    shown.update(whole, description=f"{len(names)} runs, {next(failures)} failed")
                    note(f"mavnav: {names[index]} {_ending(outcome)}")

    return listen
