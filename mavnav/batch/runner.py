"""The plan and the runner of a batch or a comparison: every missing run in a separate process, its result at once.

Finished runs are read from the cache. If the process of a run dies, its files are removed and the run is retried. The
directory of a batch contains a run directory for every run in ``cells/``, so that finished runs are not repeated.
``batch.json``, ``batch.csv`` and ``batch.html`` cover all runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import chdir
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar

from msgspec import Struct
from msgspec.structs import asdict, replace

from mavnav.atomic_files import discard
from mavnav.batch.baseline import EXAMPLE, is_any_unwritten, missing, write_baseline
from mavnav.batch.cases import Case, CaseResult, make_cases, read_paths
from mavnav.batch.document import BATCH_FILE, batch_document, compare_repeats, judged_row, of_program, unlisted_runs
from mavnav.batch.files import check_files, write_batch
from mavnav.batch.manifest import GATE_EXAMPLE, errors_at
from mavnav.batch.remote import download
from mavnav.batch.request import BatchRequest, RunLimits
from mavnav.config.options import absolute_options
from mavnav.errors import ExitCode, MavnavError, NoScansError, UsageError
from mavnav.jobs.dask import Cluster
from mavnav.jobs.pool import Listener, run_jobs, run_with_retries
from mavnav.jobs.run_cache import RUNS_FOLDER, PlannedRun, check_cache_directory, finished_document, is_finished
from mavnav.jobs.worker import Ended, Event, Job, Outcome, Status
from mavnav.metrics.gates import check_names
from mavnav.outputs.directory import RUN_FILE
from mavnav.outputs.documents.addresses import public_address
from mavnav.outputs.documents.schema import number_names
from mavnav.pipelines.replay import ReplayRequest, replay_log
from mavnav.pipelines.score import ScoreRequest, score_program
from mavnav.profiling import Progress
from mavnav.slam.methods import registry

Row = dict[str, Any]


class BatchPlan(Struct, frozen=True):
    """The cases of a request, and those of their run directories that are finished."""

    request: BatchRequest
    cases: tuple[Case, ...]
    finished: frozenset[Path]

    def by_directory(self) -> dict[Path, list[Case]]:
        """Return the cases of each run directory; cases with the same directory share one run."""
        cases: dict[Path, list[Case]] = {}
        for case in self.cases:
            if case.run:
                cases.setdefault(case.run.directory, []).append(case)
        return cases

    @property
    def missing(self) -> list[Case]:
        """The cases to run, one for each run directory."""
        return [cases[0] for directory, cases in self.by_directory().items() if directory not in self.finished]


def plan_batch(request: BatchRequest, progress: Progress) -> BatchPlan:
    """Return the plan of a batch: its cases, and which of their runs are finished.

    Raises, before any run: UsageError if there are no logs, for gates and tolerances on unknown numbers, for folders
    that cannot be read, and for files to write that the batch reads or writes otherwise; OutputError if the directory
    cannot be used. A log that cannot be read only fails its own cases; where none can, an earlier batch is not lost.
    """
    if not request.entries:
        raise UsageError("no logs; list them in a manifest, or name logs, patterns or folders")
    if request.files:
        check_files(request.files, (*request.inputs, *read_paths(request)), request.directory)
    check_cache_directory(request.directory, (RUNS_FOLDER, BATCH_FILE))
    cases = make_cases(request, progress)
    if not any(case.run for case in cases) and (request.directory / BATCH_FILE).exists():
        kind = NoScansError if cases[0].exit_code == ExitCode.NO_SCANS else UsageError
        raise kind(cases[0].error)
    check_gates(request, cases)
    part = request.part
    return plan_cases(request, cases[part.number - 1 :: part.of] if part else cases)


def plan_cases(request: BatchRequest, cases: Sequence[Case]) -> BatchPlan:
    """Return the plan of these cases, with those of their runs that are finished."""
    runs = () if request.force else (case.run for case in cases if case.run)
    return BatchPlan(request, tuple(cases), frozenset(run.directory for run in runs if is_finished(run)))


def load_kernels(plan: BatchPlan, progress: Progress) -> None:
    """Compile the kernels of the missing runs before they start; workers of a cluster compile their own."""
    for case in plan.missing if plan.request.limits.scheduler is None else ():
        registry.load_kernels(case.setting.config, progress)


def check_gates(request: BatchRequest, cases: Sequence[Case], more: Sequence[str] = ()) -> None:
    """Raise UsageError for a gate or tolerance on an unknown number, or on ground truth that a log does not have.

    ``more`` are names allowed in gates in addition to those of run.json.
    """
    rules, origins = request.rules, request.origins
    known = {has_references: number_names(reference=has_references) for has_references in (True, False)}
    for tolerance in rules.watched:
        with errors_at(origins.get(("tolerances", tolerance.name))):
            check_names([tolerance.name], known[True], EXAMPLE)
    for gate, has_references in dict.fromkeys(
        (gate, case.has_references) for case in cases for gate in (*rules.gates, *case.gates)
    ):
        where = origins.get(("gates", gate.text))
        with errors_at(where):
            check_names([gate.name], [*known[has_references], *more], *([GATE_EXAMPLE] if where else []))


def replay_local(request: ReplayRequest, report: Progress) -> None:
    """Replay one log into its run directory; the kernels are compiled already, and nothing is returned."""
    if isinstance(request, ScoreRequest):
        score_program(request, report)
    else:
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
    plan: BatchPlan, on_event: Listener, describe: Callable[[CaseResult], T], cluster: Cluster | None = None
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
        document = of_program(document) if document and case.external else document
        described[case.name] = describe(CaseResult(case, outcome, document))

    for case in plan.cases:
        if case.run is None or case.run.directory in plan.finished:
            record(case, None)
    _run_missing(plan, on_event, record, cluster)
    return [described[case.name] for case in plan.cases]


def _run_missing(
    plan: BatchPlan, on_event: Listener, record: Callable[[Case, Outcome], None], cluster: Cluster | None
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
    own = case.run.request.log if case.run else request.log
    return replace(outcome, error=outcome.error.replace(str(request.log), str(own)))


def _spoilt(run: PlannedRun, outcome: Outcome | None) -> Outcome:
    """Return the outcome of a run whose run.json was lost or damaged after it was finished."""
    error = f"{run.directory / RUN_FILE} was removed or damaged meanwhile; repeat this call"
    pid, seconds = (outcome.pid, outcome.seconds) if outcome else (0, 0.0)
    return Outcome(Status.FAILED, pid, seconds, error=error, exit_code=ExitCode.OUTPUT)


def _run_here(jobs: Sequence[Job], on_event: Listener, limits: RunLimits) -> list[Outcome]:
    """Run jobs in processes of this machine; files of a dead worker are removed before its end is reported."""

    def tidy(event: Event) -> None:
        if isinstance(event, Ended) and event.outcome.status in {Status.DIED, Status.TIMEOUT}:
            discard(jobs[event.index].args[0].directory, event.outcome.pid)
        on_event(event)

    return run_jobs(jobs, limits.workers, tidy, limits.timeout_s, limits.memory_mb)


def run_batch(
    plan: BatchPlan, on_event: Listener, on_row: Callable[[Row], None], cluster: Cluster | None = None
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
    compare_repeats(rows, request.directory, gate=rules.identical_gate)
    missing_runs = [] if rules.baseline is None or request.part or request.only else missing(rows, rules.baseline)
    document = batch_document(rows, monotonic() - began_s, rules, missing_runs)
    if request.part is None:
        document["unlisted"] = [] if request.only else unlisted_runs(rows, request.directory / BATCH_FILE)
        write_batch(document, request.directory)
    if request.new_baseline and not is_any_unwritten(rows):
        write_baseline(rows, request.new_baseline, rules.watched)
    return document
