"""The request of a batch or a comparison: logs, settings, limits and gates."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct, field

from mavnav.config.options import ReplayOptions
from mavnav.errors import UsageError
from mavnav.outputs.documents.provenance import Typed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from mavnav.batch.baseline import Baseline, Tolerance
    from mavnav.batch.manifest import Origins
    from mavnav.batch.settings import Setting
    from mavnav.metrics.gates import Gate


class RunLimits(Struct, frozen=True):
    """Number of runs at a time, their time and memory limits, and the number of attempts if a run's process dies.

    ``scheduler`` is a Dask cluster to run on, None for this machine.
    """

    workers: int = 1
    timeout_s: float | None = None
    memory_mb: int | None = None
    tries: int = 3
    scheduler: str | None = None


class Rules(Struct, frozen=True):
    """Gates of every run, in addition to those of its log.

    ``accept`` are exit codes that count as done; ``watched`` are the tolerances of the metrics compared with
    ``baseline``. With ``baseline_gate``, nothing may be worse than in the baseline.
    """

    gates: tuple[Gate, ...] = ()
    accept: frozenset[int] = frozenset()
    baseline: Baseline | None = None
    watched: tuple[Tolerance, ...] = ()
    baseline_gate: bool = False


class BatchPart(Struct, frozen=True):
    """One of several equal parts of a batch, counted from 1, for machines that share a directory."""

    number: int
    of: int

    def __post_init__(self) -> None:
        """Raise UsageError unless ``number`` is from 1 to ``of``."""
        if not 1 <= self.number <= self.of:
            raise UsageError(
                f"part {self.number}/{self.of} is none; parts count from 1, for example 1/{max(self.of, 2)}"
            )


class BatchLogs(Struct, frozen=True):
    """Logs with the same options, and gates and accepted exit codes for them in addition to those of the batch."""

    log: tuple[str, ...]
    options: ReplayOptions[Path] = field(default_factory=ReplayOptions[Path])
    gates: tuple[str, ...] = ()
    accept: tuple[int, ...] = ()


class BatchRequest(Struct, frozen=True):
    """Logs, settings, output directory, limits and gates of a batch or a comparison.

    Relative logs of ``entries`` start at ``base``; with ``patterns`` they may be patterns and folders, else they are
    single logs. ``force`` repeats finished runs; ``report`` writes a report of every run. The metrics are written to
    the file ``new_baseline`` for later batches. ``typed`` is the command line. ``files`` are the files that are written
    outside of ``directory`` by their options, ``inputs`` those that are read besides logs and references.
    ``origins`` are the lines of a manifest.
    """

    entries: tuple[BatchLogs, ...]
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
    files: Mapping[str, Path] = field(default_factory=dict)
    inputs: tuple[Path, ...] = ()
    origins: Origins = field(default_factory=dict)
