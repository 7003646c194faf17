"""Progress of a comparison or a batch on stderr: bars on a terminal, else a plain line for every run that ends."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

from mavnav.commands import signals
from mavnav.commands.progress import bars
from mavnav.commands.terminal import note, printable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mavnav.jobs import Event, Outcome, Retried

    Listener = Callable[[Event], None]


@contextmanager
def watching(names: Sequence[str], *, quiet: bool, lines: bool = True) -> Iterator[Listener]:
    """Yield a listener to the events of the jobs ``names``; it also raises a signal that Python has dropped.

    Without a terminal, it prints a line for every run that ends, unless ``lines`` is false.
    """
    with _listener(names, quiet=quiet, lines=lines) as listen:

        def listen_or_raise(event: Event) -> None:
            signals.raise_pending()
            listen(event)

        yield listen_or_raise


@contextmanager
def _listener(names: Sequence[str], *, quiet: bool, lines: bool) -> Iterator[Listener]:
    if quiet or not names:
        yield _silent
    elif sys.stderr.isatty():
        with _bars(names) as listen:
            yield listen
    else:
        yield _lines(names, ends=lines)


def _silent(event: Event) -> None:
    """Ignore an event."""


def _lines(names: Sequence[str], *, ends: bool) -> Listener:
    from mavnav.jobs import Ended, Retried

    ended = 0

    def listen(event: Event) -> None:
        nonlocal ended
        if isinstance(event, Retried):
            note(_retry_text(names[event.index], event))
        elif isinstance(event, Ended) and ends:
            ended += 1
            note(f"mavnav: {ended} of {len(names)}: {names[event.index]} {_ending(event.outcome)}")

    return listen


def _retry_text(name: str, event: Retried) -> str:
    return f"mavnav: {name}: {event.error}; it is tried again at the end"


def _ending(outcome: Outcome) -> str:
    """Return the text of how a job ended."""
    from mavnav.jobs import Status

    return f"done in {outcome.seconds:.1f} s" if outcome.status is Status.DONE else f"failed: {outcome.error}"


@contextmanager
def _bars(names: Sequence[str]) -> Iterator[Listener]:
    """Show a bar for all runs and one for each current run; print a line for each failure."""
    from mavnav.jobs import Ended, Progressed, Retried, Started, Status

    with bars() as shown:
        failed = 0
        whole = shown.add_task(f"{len(names)} runs", total=len(names))
        tasks: dict[int, object] = {}

        def listen(event: Event) -> None:
            nonlocal failed
            match event:
                case Started(index):
                    tasks[index] = shown.add_task(printable(names[index]), total=None)
                case Progressed(index, phase, done, total):
                    text = printable(f"{names[index]}: {phase}")
                    shown.update(tasks[index], description=text, completed=done, total=total)  # type: ignore[arg-type]
                case Retried(index):
                    shown.remove_task(tasks.pop(index))  # type: ignore[arg-type]
                    note(_retry_text(names[index], event))
                case Ended(index, outcome):
                    shown.remove_task(tasks.pop(index))  # type: ignore[arg-type]
                    shown.advance(whole)
                    if outcome.status is not Status.DONE:
                        failed += 1
                        shown.update(whole, description=f"{len(names)} runs, {failed} failed")
                        note(f"mavnav: {names[index]} {_ending(outcome)}")

        yield listen
