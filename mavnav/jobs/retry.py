"""Retries of jobs whose process died; a job that raised an exception is not run again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from mavnav.jobs.records import Ended, Event, Job, Outcome, Retried, Status

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    Listener = Callable[[Event], None]
    Run = Callable[[Sequence[Job], Listener], Sequence[Outcome]]


def run_with_retries(jobs: Sequence[Job], run: Run, on_event: Listener, tries: int) -> None:
    """Run jobs; run those whose process died again after all others, up to ``tries`` times in all.

    ``run`` runs some jobs, as `run_jobs` does. ``on_event`` gets an `Ended` for every job once, with its index in
    ``jobs``; a death before the last try is reported as `Retried`.
    """
    left = list(range(len(jobs)))
    for number in range(1, tries + 1):
        outcomes = run([jobs[k] for k in left], _renumber(left, on_event, number, tries))
        left = [k for k, outcome in zip(left, outcomes, strict=True) if outcome.status is Status.DIED]
        if not left:
            return


def _renumber(numbers: Sequence[int], on_event: Listener, number: int, tries: int) -> Listener:
    """Return a listener that replaces the index of a job in this round by its index among all jobs."""

    def listen(event: Event) -> None:
        event = replace(event, index=numbers[event.index])
        if isinstance(event, Ended) and event.outcome.status is Status.DIED:
            event = _retry_event(event, number, tries)
        on_event(event)

    return listen


def _retry_event(event: Ended, number: int, tries: int) -> Event:
    error = event.outcome.error
    if number < tries:
        return Retried(event.index, error)
    given_up = f"{error}; given up after {tries} tries" if tries > 1 else error
    return replace(event, outcome=replace(event.outcome, error=given_up))
