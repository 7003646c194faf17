"""What is to be run of a batch, and what is there already."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mavnav.batch.cases import Case, make_cases
from mavnav.batch.files import BATCH_FILE
from mavnav.errors import UsageError
from mavnav.jobs.run_cache import check_home, earlier
from mavnav.metrics.gates import check_names
from mavnav.outputs.schema import number_names
from mavnav.outputs.writers import REPORT_FILE

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mavnav.batch.baseline import Baseline, Tolerance
    from mavnav.batch.manifest import Entry
    from mavnav.batch.settings import Setting
    from mavnav.jobs.run_cache import PlannedRun
    from mavnav.metrics.gates import Gate
    from mavnav.pipelines.replay import Progress


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


def _is_there(cell: PlannedRun) -> bool:
    """Tell whether a run is there, and its page where that is asked for."""
    place = cell.request.directory
    return earlier(cell) is not None and (not cell.request.report or (place / REPORT_FILE).is_file())


def _check_names(cases: Sequence[Case], rules: Rules) -> None:
    """Refuse gates and tolerances on numbers that no run has, and gates on references of logs that have none."""
    check_names((tolerance.name for tolerance in rules.watched), number_names(reference=True))
    for case in cases:
        known = number_names(reference=case.has_references)
        check_names((gate.name for gate in (*rules.gates, *case.gates)), known)
