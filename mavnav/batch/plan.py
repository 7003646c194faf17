"""The plan of a batch or a comparison: its runs, and which of them are finished."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from mavnav.batch.baseline import EXAMPLE
from mavnav.batch.cases import Case, make_cases, read_paths
from mavnav.batch.document import BATCH_FILE
from mavnav.batch.files import check_files
from mavnav.batch.manifest import GATE_EXAMPLE, errors_at
from mavnav.errors import UsageError
from mavnav.jobs.run_cache import RUNS_FOLDER, check_cache_directory, is_finished
from mavnav.metrics.gates import check_names
from mavnav.outputs.documents.schema import number_names
from mavnav.slam.methods import registry

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mavnav.batch.request import BatchRequest
    from mavnav.profiling import Progress

_OWN_FILES: Final = (RUNS_FOLDER, BATCH_FILE)


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
    cannot be used. A log that cannot be read only fails its own cases.
    """
    if not request.entries:
        raise UsageError("no logs; name a manifest, or logs, patterns or folders")
    if request.files:
        check_files(request.files, (*request.inputs, *read_paths(request)), request.directory)
    check_cache_directory(request.directory, _OWN_FILES)
    cases = make_cases(request, progress)
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
