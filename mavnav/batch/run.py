"""The pipeline of ``mavnav batch``: many logs with many settings, each run apart, one verdict.

A batch lives in a directory: ``cells/`` holds a run directory for every run, and a run that is there is not made again;
``batch.json``, ``batch.csv`` and ``batch.html`` are about all of them.
"""

from __future__ import annotations

from time import monotonic
from typing import TYPE_CHECKING, Any

from mavnav.atomic_files import discard
from mavnav.batch.baseline import missing, write_baseline
from mavnav.batch.document import batch_document, batch_row, judged
from mavnav.batch.files import write_batch
from mavnav.batch.jobs import replay_fetched, replay_there
from mavnav.jobs import Ended, Event, Fate, Job, Outcome, run_jobs, run_with_retries
from mavnav.jobs.run_cache import earlier

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from mavnav.batch.cases import Case
    from mavnav.batch.plan import Plan, Request
    from mavnav.jobs.dask import Cluster
    from mavnav.pipelines import replay

    Row = dict[str, Any]
    OnRow = Callable[[Row], None]
    OnEvent = Callable[[Event], None]


def run_batch(plan: Plan, on_event: OnEvent, on_row: OnRow, cluster: Cluster | None = None) -> dict[str, Any]:
    """Run what is missing, each run in a process of its own, judge all, and return batch.json.

    Parameters
    ----------
    plan
        What is to be run, of `plan`.
    on_event
        Hears of the jobs, which are ``plan.missing`` in its order.
    on_row
        Gets the row of every run as soon as it is known: first those that were there, then each as it ends.
    cluster
        Where to run, if not in processes here; it tries again what kills its workers by rules of its own.

    Raises
    ------
    OutputError
        Where the documents cannot be written. A part of a batch writes none, and misses nothing that the baseline has:
        the whole does, when all parts are there.
    """
    began_s = monotonic()
    collector = _Collector(plan, on_row)
    collector.settle_kept()
    _run_missing(plan, on_event, collector, cluster)
    rows, request = collector.ordered(), plan.request
    rules = request.rules
    gone = [] if rules.baseline is None or request.part else missing(rows, rules.baseline)
    document = batch_document(rows, monotonic() - began_s, rules.baseline, gone, baseline_gate=rules.baseline_gate)
    if request.part is None:
        write_batch(document, request.directory)
    if request.new_baseline:
        write_baseline(rows, request.new_baseline, rules.watched)
    return document


class _Collector:
    """Where results are judged and their rows collected; runs that share a directory get a row each."""

    def __init__(self, plan: Plan, on_row: OnRow) -> None:
        self.plan, self.on_row = plan, on_row
        self.rows: dict[str, Row] = {}
        self.sharing: dict[Path, list[Case]] = {}
        for case in plan.cases:
            if case.cell:
                self.sharing.setdefault(case.cell.request.directory, []).append(case)

    def settle_kept(self) -> None:
        """Take in what was there before, and what cannot be read."""
        for case in self.plan.cases:
            if case.cell is None:
                self._take(case, None, None)
            elif case.cell.request.directory in self.plan.kept:
                self._take(case, None, earlier(case.cell))

    def settle(self, place: Path, outcome: Outcome) -> None:
        """Take in how the run of a directory ended."""
        for case in self.sharing[place]:
            self._take(case, outcome, earlier(case.cell) if case.cell and outcome.fate is Fate.DONE else None)

    def _take(self, case: Case, outcome: Outcome | None, run: dict[str, Any] | None) -> None:
        self.rows[case.name] = _row(self.plan.request, case, outcome, run)
        self.on_row(self.rows[case.name])

    def ordered(self) -> list[Row]:
        """Return the rows in the order of the cases."""
        return [self.rows[case.name] for case in self.plan.cases]


def _row(request: Request, case: Case, outcome: Outcome | None, run: dict[str, Any] | None) -> Row:
    """Describe and judge one run."""
    rules = request.rules
    return judged(
        batch_row(case, outcome, run, request.directory),
        run,
        (*rules.gates, *case.gates),
        rules.accept | case.accept,
        rules.baseline,
        rules.watched,
        baseline_gate=rules.baseline_gate or (case.baseline_gate and request.new_baseline is None),
    )


def _run_missing(plan: Plan, on_event: OnEvent, collector: _Collector, cluster: Cluster | None) -> None:
    limits = plan.request.limits
    requests = [case.cell.request for case in plan.missing if case.cell]

    def once(jobs: Sequence[Job], listen: OnEvent) -> list[Outcome]:
        return run_jobs(jobs, limits.workers, _tidying(jobs, listen), limits.timeout_s, limits.memory_mb)

    def hear(event: Event) -> None:
        if isinstance(event, Ended):
            collector.settle(requests[event.index].directory, event.outcome)
        on_event(event)

    jobs = [_job(case, request) for case, request in zip(plan.missing, requests, strict=True)]
    if cluster:
        cluster.run_jobs(jobs, hear, limits.timeout_s)
    else:
        run_with_retries(jobs, once, hear, limits.tries)


def _job(case: Case, request: replay.Request) -> Job:
    return Job(case.name, replay_fetched if request.address else replay_there, (request,))


def _tidying(jobs: Sequence[Job], listen: OnEvent) -> OnEvent:
    """Clear away what a dead worker has left, before anyone else hears of it."""

    def hear(event: Event) -> None:
        if isinstance(event, Ended) and event.outcome.fate in {Fate.DIED, Fate.TIMEOUT}:
            discard(jobs[event.index].args[0].directory, event.outcome.pid)
        listen(event)

    return hear
