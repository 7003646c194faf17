"""The pipeline of ``mavnav batch``: many logs with many settings, each run apart, one verdict.

A batch lives in a directory: ``cells/`` holds a run directory for every run, and a run that is there is not made again;
``batch.json``, ``batch.csv`` and ``batch.html`` are about all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING, Any, Final

from mavnav.atomic_files import discard
from mavnav.batch.baseline import missing, write_baseline
from mavnav.batch.cases import Case, make_cases
from mavnav.batch.document import batch_document, batch_row, judged
from mavnav.batch.files import BATCH_FILE, write_batch
from mavnav.batch.jobs import replay_fetched, replay_there
from mavnav.config.models import Config
from mavnav.errors import UsageError
from mavnav.jobs import Ended, Event, Fate, Job, Outcome, run_jobs, run_with_retries
from mavnav.jobs.run_cache import check_home, earlier
from mavnav.metrics.gates import check_names
from mavnav.outputs import REPORT_FILE
from mavnav.outputs.empty_run import blank_document

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from mavnav.batch.baseline import Baseline, Tolerance
    from mavnav.batch.manifest import Entry
    from mavnav.batch.settings import Setting
    from mavnav.jobs.dask import Cluster
    from mavnav.jobs.run_cache import Cell
    from mavnav.metrics.gates import Gate
    from mavnav.pipelines import replay
    from mavnav.pipelines.replay import Progress

    Row = dict[str, Any]
    OnRow = Callable[[Row], None]
    OnEvent = Callable[[Event], None]

__all__ = ["Limits", "Part", "Plan", "Request", "Rules", "plan", "run_batch"]

_OURS: Final = ("cells", BATCH_FILE)


@dataclass(frozen=True, slots=True)
class Limits:
    """How many runs at a time, how long and how large each may get, and how often one whose process died is tried.

    ``scheduler`` names a Dask cluster to run on, if given.
    """

    workers: int = 1
    timeout_s: float | None = None
    memory_mb: int | None = None
    tries: int = 3
    scheduler: str | None = None


@dataclass(frozen=True, slots=True)
class Rules:
    """What must hold of every run, besides what must of its log.

    ``accept`` are exit codes that count as done; ``baseline_gate`` says that nothing may be worse than in ``baseline``.
    """

    gates: tuple[Gate, ...] = ()
    accept: frozenset[int] = frozenset()
    baseline: Baseline | None = None
    watched: tuple[Tolerance, ...] = ()
    baseline_gate: bool = False


@dataclass(frozen=True, slots=True)
class Part:
    """One of several equal parts of a batch, counted from 1, for machines that share a directory."""

    number: int
    of: int

    def __post_init__(self) -> None:
        """Refuse a part that there is not; raises UsageError."""
        if not 1 <= self.number <= self.of:
            raise UsageError(
                f"part {self.number}/{self.of} is none; parts count from 1, for example 1/{max(self.of, 2)}"
            )


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked for.

    Relative paths of ``entries`` count from ``base``; ``force`` runs again what is there; ``report`` asks for a page of
    every run; ``new_baseline`` is a file that the figures are written to, for later batches.
    """

    entries: tuple[Entry, ...]
    settings: tuple[Setting, ...]
    base: Path
    directory: Path
    limits: Limits = Limits()
    rules: Rules = Rules()
    part: Part | None = None
    force: bool = False
    report: bool = False
    new_baseline: Path | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """The cases of a batch, and which of their run directories are there already."""

    request: Request
    cases: tuple[Case, ...]
    kept: frozenset[Path]

    @property
    def missing(self) -> list[Case]:
        """The cases that are to be run, one for each run directory."""
        by_place = {case.cell.request.directory: case for case in self.cases if case.cell}
        return [case for place, case in by_place.items() if place not in self.kept]


def plan(request: Request, progress: Progress) -> Plan:
    """Find out what is to be run and what is there.

    Raises UsageError for no logs at all, for gates and tolerances on numbers that no run has, and for folders that
    cannot be read, OutputError where the directory cannot be used: before the work. A log that cannot be read fails
    alone.
    """
    if not request.entries:
        raise UsageError("no logs; name a manifest, or logs, patterns or folders")
    check_home(request.directory, _OURS)
    common = {"directory": request.directory, "report": request.report, "force": True}
    cases = make_cases(request.entries, request.settings, request.base, common, progress)
    _check_names(cases, request.rules)
    if request.part:
        cases = cases[request.part.number - 1 :: request.part.of]
    there = [] if request.force else [case.cell for case in cases if case.cell and _is_there(case.cell)]
    return Plan(request, tuple(cases), frozenset(cell.request.directory for cell in there))


def _is_there(cell: Cell) -> bool:
    """Tell whether a run is there, and its page where that is asked for."""
    place = cell.request.directory
    return earlier(cell) is not None and (not cell.request.report or (place / REPORT_FILE).is_file())


def _check_names(cases: Sequence[Case], rules: Rules) -> None:
    """Refuse gates and tolerances on numbers that no run has, and gates on references of logs that have none."""
    blank = blank_document(Config())
    compared = {**blank, "reference": {}}
    check_names((tolerance.name for tolerance in rules.watched), compared)
    for case in cases:
        check_names((gate.name for gate in (*rules.gates, *case.gates)), compared if case.has_references else blank)


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
    desk = _Desk(plan, on_row)
    desk.settle_kept()
    _run_missing(plan, on_event, desk, cluster)
    rows, request = desk.ordered(), plan.request
    rules = request.rules
    gone = [] if rules.baseline is None or request.part else missing(rows, rules.baseline)
    document = batch_document(rows, monotonic() - began_s, rules.baseline, gone, baseline_gate=rules.baseline_gate)
    if request.part is None:
        write_batch(document, request.directory)
    if request.new_baseline:
        write_baseline(rows, request.new_baseline, rules.watched)
    return document


class _Desk:
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


def _run_missing(plan: Plan, on_event: OnEvent, desk: _Desk, cluster: Cluster | None) -> None:
    limits = plan.request.limits
    requests = [case.cell.request for case in plan.missing if case.cell]

    def once(jobs: Sequence[Job], listen: OnEvent) -> list[Outcome]:
        return run_jobs(jobs, limits.workers, _tidying(jobs, listen), limits.timeout_s, limits.memory_mb)

    def hear(event: Event) -> None:
        if isinstance(event, Ended):
            desk.settle(requests[event.index].directory, event.outcome)
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
