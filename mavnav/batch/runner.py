"""The runner of a batch or a comparison: runs every missing run in a separate process, and reports results immediately.

Finished runs are read from the cache. If the process of a run dies, its files are removed and the run is retried. The
directory of a batch contains a run directory for every run in ``cells/``, so that finished runs are not repeated.
``batch.json``, ``batch.csv`` and ``batch.html`` cover all runs.
"""

from __future__ import annotations

from contextlib import chdir
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, TypeVar

from msgspec.structs import asdict, replace

from mavnav.atomic_files import discard
from mavnav.batch.baseline import missing, write_baseline
from mavnav.batch.cases import CaseResult
from mavnav.batch.document import batch_document, judged_row
from mavnav.batch.files import write_batch
from mavnav.batch.remote import download
from mavnav.config.options import absolute_options
from mavnav.errors import ExitCode, MavnavError
from mavnav.jobs import Ended, Event, Job, Outcome, Status, run_jobs, run_with_retries
from mavnav.jobs.run_cache import finished_document
from mavnav.outputs.directory import RUN_FILE
from mavnav.outputs.documents.addresses import public_address
from mavnav.pipelines.replay import replay_log

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mavnav.batch.cases import Case
    from mavnav.batch.plan import BatchPlan
    from mavnav.batch.request import RunLimits
    from mavnav.jobs.dask import Cluster
    from mavnav.jobs.run_cache import PlannedRun
    from mavnav.pipelines.replay import ReplayRequest
    from mavnav.profiling import Progress

    OnEvent = Callable[[Event], None]
    Row = dict[str, Any]


def replay_local(request: ReplayRequest, report: Progress) -> None:
    """Replay one log into its run directory; the kernels are compiled already, and nothing is returned."""
    replay_log(request, report, compile_s=0.0)


def replay_remote(request: ReplayRequest, report: Progress) -> None:
    """Download a log and replay it; errors contain its address instead of its path."""
    report("fetching", 0, None)
    address = str(request.address)
    name = public_address(address)
    paths = {name: value for name, value in asdict(request).items() if isinstance(value, Path) and name != "log"}
    absolute = {name: path.absolute() for name, path in paths.items()}
    with download(address) as folder, chdir(folder):
        try:
            replay_local(replace(request, options=absolute_options(request.options), **absolute), report)
        except MavnavError as error:
            error.args = (str(error).replace(str(request.log), name),)
            raise


T = TypeVar("T")


def run_cases(
    plan: BatchPlan, on_event: OnEvent, describe: Callable[[CaseResult], T], cluster: Cluster | None = None
) -> list[T]:
    """Run the missing runs, each in a process of its own.

    Parameters
    ----------
    plan
        The cases and the finished runs.
    on_event
        Called with the events of the jobs, whose indices are those of ``plan.missing``.
    describe
        Called with the result of every case as soon as it is known: first for finished runs and for logs that cannot
        be read, then for each run when it ends.
    cluster
        Cluster to run on, with its own rules for retries; None for processes of this machine.

    Returns
    -------
    list
        What ``describe`` returned for each case, in the order of the plan.
    """
    described: dict[str, T] = {}

    def record(case: Case, outcome: Outcome | None) -> None:
        has_run = outcome is None or outcome.status is Status.DONE
        document = finished_document(case.run) if case.run and has_run else None
        if case.run and has_run and document is None:
            outcome = _spoilt(case.run, outcome)
        described[case.name] = describe(CaseResult(case, outcome, document))

    for case in plan.cases:
        if case.run is None or case.run.directory in plan.finished:
            record(case, None)
    _run_missing(plan, on_event, record, cluster)
    return [described[case.name] for case in plan.cases]


def _run_missing(
    plan: BatchPlan, on_event: OnEvent, record: Callable[[Case, Outcome], None], cluster: Cluster | None
) -> None:
    """Run the missing cases; when a run ends, call ``record`` for each of its cases."""
    runs = {case.name: case.run.request for case in plan.missing if case.run}
    requests, sharing = list(runs.values()), plan.by_directory()

    def listen(event: Event) -> None:
        if isinstance(event, Ended):
            request = requests[event.index]
            for case in sharing[request.directory]:
                record(case, _outcome_of(case, event.outcome, request))
        on_event(event)

    jobs = [Job(name, replay_remote if run.address else replay_local, (run,)) for name, run in runs.items()]
    limits = plan.request.limits
    if cluster:
        cluster.run_jobs(jobs, listen, limits.timeout_s)
    else:
        run_with_retries(jobs, lambda some, on_end: _run_here(some, on_end, limits), listen, limits.tries)


def _outcome_of(case: Case, outcome: Outcome, request: ReplayRequest) -> Outcome:
    """Return the outcome of a run for one of the cases that share it: the error names the log of the case."""
    if case.run is None or not outcome.error:
        return outcome
    return replace(outcome, error=outcome.error.replace(str(request.log), str(case.run.request.log)))


def _spoilt(run: PlannedRun, outcome: Outcome | None) -> Outcome:
    """Return the outcome of a run whose run.json was lost or damaged after it was finished."""
    error = f"{run.directory / RUN_FILE} was removed or damaged meanwhile; repeat this call"
    pid, seconds = (outcome.pid, outcome.seconds) if outcome else (0, 0.0)
    return Outcome(Status.FAILED, pid, seconds, error=error, exit_code=ExitCode.OUTPUT)


def _run_here(jobs: Sequence[Job], on_event: OnEvent, limits: RunLimits) -> list[Outcome]:
    """Run jobs in processes of this machine; files of a dead worker are removed before its end is reported."""

    def tidy(event: Event) -> None:
        if isinstance(event, Ended) and event.outcome.status in {Status.DIED, Status.TIMEOUT}:
            discard(jobs[event.index].args[0].directory, event.outcome.pid)
        on_event(event)

    return run_jobs(jobs, limits.workers, tidy, limits.timeout_s, limits.memory_mb)


def run_batch(
    plan: BatchPlan, on_event: Callable[[Event], None], on_row: Callable[[Row], None], cluster: Cluster | None = None
) -> Row:
    """Run the missing runs, evaluate all gates, and return batch.json.

    ``on_row`` is called with the row of every run as soon as it is known; ``on_event`` and ``cluster`` are those of
    `run_cases`. Raises OutputError if the documents cannot be written. A part of a batch writes no documents, and does
    not report runs missing since the baseline: run the whole batch for these when all parts are finished.
    """
    began_s, request = monotonic(), plan.request

    def judge(result: CaseResult) -> Row:
        row = judged_row(result, request)
        on_row(row)
        return row

    rows, rules = run_cases(plan, on_event, judge, cluster), request.rules
    missing_runs = [] if rules.baseline is None or request.part else missing(rows, rules.baseline)
    wall_s = monotonic() - began_s
    document = batch_document(rows, wall_s, rules.baseline, missing_runs, baseline_gate=rules.baseline_gate)
    if request.part is None:
        write_batch(document, request.directory)
    if request.new_baseline:
        write_baseline(rows, request.new_baseline, rules.watched)
    return document
