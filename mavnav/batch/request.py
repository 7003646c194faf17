"""The request of a batch or a comparison: logs, settings, limits, and what must hold of every run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mavnav.errors import UsageError
from mavnav.outputs.provenance import Typed

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.batch.baseline import Baseline, Tolerance
    from mavnav.batch.manifest import Entry
    from mavnav.batch.settings import Setting
    from mavnav.metrics.gates import Gate


@dataclass(frozen=True, slots=True)
class RunLimits:
    """How many runs at a time, their time and memory limits, and the attempts if the process of a run dies.

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
class BatchPart:
    """One of several equal parts of a batch, counted from 1, for machines that share a directory."""

    number: int
    of: int

    def __post_init__(self) -> None:
        """Raise UsageError unless ``number`` is one of the parts."""
        if not 1 <= self.number <= self.of:
            raise UsageError(
                f"part {self.number}/{self.of} is none; parts count from 1, for example 1/{max(self.of, 2)}"
            )


@dataclass(frozen=True, slots=True)
class BatchRequest:
    """The logs and settings of a batch or a comparison, where its results go, and how its runs are made and judged.

    Relative paths of ``entries`` count from ``base``; with ``patterns`` they may be patterns and folders, without they
    are single logs. ``force`` runs again what is finished; ``report`` writes a page of every run; the metrics are
    written to the file ``new_baseline``, for later batches. ``typed`` is the command line.
    """

    entries: tuple[Entry, ...]
    settings: tuple[Setting, ...]
    base: Path
    directory: Path
    limits: RunLimits = RunLimits()
    rules: Rules = Rules()
    part: BatchPart | None = None
    force: bool = False
    report: bool = False
    new_baseline: Path | None = None
    patterns: bool = True
    typed: Typed = field(default_factory=Typed)
