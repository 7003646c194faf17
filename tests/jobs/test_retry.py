"""A second chance for jobs whose process died, and for no others."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mavnav.jobs import Ended, Event, Job, Outcome, Retried, Started, Status, run_with_retries

JOBS = [Job(name, print) for name in ("good", "unlucky", "hopeless", "refused")]


def crew(rounds: list[list[str]]) -> Callable[[Sequence[Job], Callable[[Event], None]], list[Outcome]]:
    """Return a stand-in for `run_jobs`: the hopeless one always dies, the unlucky one in its first round."""

    def run(jobs: Sequence[Job], on_event: Callable[[Event], None]) -> list[Outcome]:
        rounds.append([job.name for job in jobs])
        outcomes = []
        for k, job in enumerate(jobs):
            dies = job.name == "hopeless" or (job.name == "unlucky" and len(rounds) == 1)
            status = Status.DIED if dies else Status.FAILED if job.name == "refused" else Status.DONE
            outcomes.append(Outcome(status, 1, 0.0, error="killed" if dies else ""))
            on_event(Started(k, 1))
            on_event(Ended(k, outcomes[-1]))
        return outcomes

    return run


def test_only_the_dead_are_tried_again() -> None:
    rounds: list[list[str]] = []
    events: list[Event] = []
    run_with_retries(JOBS, crew(rounds), events.append, 3)
    assert rounds == [["good", "unlucky", "hopeless", "refused"], ["unlucky", "hopeless"], ["hopeless"]]
    ended = {event.index: event.outcome for event in events if isinstance(event, Ended)}
    assert [ended[k].status for k in range(4)] == [Status.DONE, Status.DONE, Status.DIED, Status.FAILED]
    assert ended[2].error == "killed; given up after 3 tries"
    assert [e for e in events if isinstance(e, Retried)] == [Retried(k, "killed") for k in (1, 2, 2)]
    assert [e.index for e in events if isinstance(e, Started)] == [0, 1, 2, 3, 1, 2, 2]


def test_a_single_try() -> None:
    rounds: list[list[str]] = []
    events: list[Event] = []
    run_with_retries(JOBS[2:3], crew(rounds), events.append, 1)
    assert rounds == [["hopeless"]]
    assert isinstance(events[-1], Ended)
    assert events[-1].outcome.error == "killed"


def test_nothing_to_do() -> None:
    run_with_retries([], lambda jobs, listen: [], lambda event: None, 3)
