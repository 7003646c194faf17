"""The pipeline of ``mavnav compare``: a batch of logs and settings with documents and a report of its own.

The directory of a comparison contains a run directory for every run in ``cells/``, so that finished runs are not
repeated. ``comparison.json``, ``comparison.csv``, ``comparison.md`` and ``report.html`` compare the runs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from msgspec.structs import replace

from mavnav.batch import request as batch
from mavnav.batch.cases import Case, CaseResult, make_cases
from mavnav.batch.runner import BatchPlan, check_gates, plan_cases, run_cases
from mavnav.comparison.document import COMPARISON_FILE, RELATIVE_COSTS, write_comparison
from mavnav.config.models import Config
from mavnav.config.named_files import read_json
from mavnav.config.options import ReplayOptions, reference_files
from mavnav.errors import UsageError
from mavnav.jobs.run_cache import RUNS_FOLDER, PlannedRun, check_cache_directory
from mavnav.jobs.worker import Event
from mavnav.logs.formats.detect import log_name
from mavnav.metrics.gates import Gate
from mavnav.outputs.documents.provenance import Typed
from mavnav.outputs.writers import REPORT_FILE
from mavnav.profiling import Progress

_OWN_FILES: Final = (RUNS_FOLDER, "logs", COMPARISON_FILE)

PAPER_GRIDS: Final = ("5x5", "10x10", "20x20")
"""The search grids of the paper's Fig. 8, compared by default."""


def comparison_settings(
    file: str | None,
    sets: Sequence[str],
    methods: Sequence[str],
    grids: Sequence[str],
    azimuths: Sequence[int],
    options: dict[str, object],
    usual: Sequence[str] = PAPER_GRIDS,
) -> list[batch.Setting]:
    """Return a setting for every method and grid, methods in order, grids from coarse to fine.

    Parameters
    ----------
    file, sets, options
        The common configuration, as in `load_config`; a key of ``sets`` may have several values, as in `swept`.
    methods
        Names of methods; if empty, the method of the configuration.
    grids
        Search grids ``NxM``; if empty, the ``usual`` ones, in a sweep that of the configuration. A single grid
        without a sweep is compared with that of the configuration (10x10).
    azimuths
        Yaw samples: none, one number for all named grids, or one per grid. If empty, those of the configuration, else
        `mavnav.config.models.paired_yaw_samples`.

    Raises
    ------
    ConfigError
        A value is not valid in a configuration.
    UsageError
        The number of yaw samples is neither 0, 1, nor the number of grids.
    """
    configs: list[Config] = []
    sweep = len(batch.swept(sets)) > 1
    for method in [[name] for name in methods] or [[]]:
        settings = batch.crossed_settings(file, sets, method, grids or (() if sweep else usual), azimuths, options)
        if len(grids) == 1 and not sweep:
            settings += batch.crossed_settings(file, sets, method, (), (), options)
        configs += sorted((each.config for each in settings), key=lambda c: (c.grid.points, c.azimuth))
    return batch.named_settings(configs)


def comparison_request(
    logs: Sequence[Path],
    settings: Sequence[batch.Setting],
    directory: Path,
    options: ReplayOptions[Path],
    *,
    workers: int = 1,
    gates: Sequence[Gate] = (),
    force: bool = False,
    typed: Typed | None = None,
) -> batch.BatchRequest:
    """Return the batch of every log with every setting.

    Raises UsageError for reference files with several logs.
    """
    if len(logs) > 1 and reference_files(options):
        raise UsageError("--truth, --truth-map and --relations are about one log; compare one log at a time with them")
    return batch.BatchRequest(
        entries=tuple(batch.BatchLogs((str(log),), options) for log in logs),
        settings=tuple(settings),
        base=Path(),
        directory=directory,
        limits=batch.RunLimits(workers),
        rules=batch.Rules(tuple(gates)),
        force=force,
        patterns=False,
        typed=typed or Typed(),
    )


def comparison_directory(logs: Sequence[Path]) -> Path:
    """Return ``runs/compare-<log>``, or ``runs/compare`` for several logs and for the sample."""
    return Path("runs") / (f"compare-{log_name(logs[0])}" if len(logs) == 1 else "compare")


def check_comparison_directory(directory: Path) -> None:
    """Create the directory of a comparison; raise OutputError if that fails or if it contains other files."""
    check_cache_directory(directory, _OWN_FILES)


def plan_comparison(request: batch.BatchRequest, progress: Progress) -> BatchPlan:
    """Return the plan of a comparison: its cases, and which of their runs are finished.

    Raises, before any run: UsageError for logs and files that cannot be read and for gates on unknown names, and
    OutputError if the directory cannot be used.
    """
    cases = make_cases(request, progress)
    for case in cases:
        if case.run is None:
            raise UsageError(case.error)
    check_gates(request, cases, [f"price.{name}" for name in RELATIVE_COSTS])
    check_comparison_directory(request.directory)
    return plan_cases(request, _named_cases(cases))


def _named_cases(cases: Iterable[Case]) -> list[Case]:
    """Return the cases without duplicates (copies of a log have the same keys), named ``drive.mcap robust 40/20x20``.

    The yaw samples are before the grid as in the paper; what else differs between the settings follows.
    """
    by_key: dict[str, tuple[Case, PlannedRun]] = {}
    for case in cases:
        if case.run:
            by_key.setdefault(case.run.key, (case, case.run))
    logs = short_names({run.request.log for _, run in by_key.values()})
    return [
        replace(
            case,
            name=f"{logs[run.request.log]} {run.config.method} {run.config.azimuth}/{run.config.grid} "
            f"{case.setting.differs}".rstrip(),
        )
        for case, run in by_key.values()
    ]


def short_names(paths: Collection[Path]) -> dict[Path, str]:
    """Return for each path its file name, with as many of its folders as no other path ends with."""
    ends = {path: [Path(*path.parts[-length:]) for length in range(1, len(path.parts) + 1)] for path in paths}
    number = Counter(end for of_path in ends.values() for end in of_path)
    return {path: str(next((end for end in ends[path] if number[end] == 1), path)) for path in paths}


def is_report_current(plan: BatchPlan) -> bool:
    """Return whether all runs are finished, and report.html shows exactly these runs in this order."""
    keys = [case.run.key for case in plan.cases if case.run]
    try:
        before = read_json(plan.request.directory / COMPARISON_FILE)
        shown = [cell["key"] for cell in before["cells"] if cell["status"] != "failed"]
    except (OSError, ValueError, LookupError, TypeError):
        return False
    return not plan.missing and shown == keys and (plan.request.directory / REPORT_FILE).is_file()


def run_comparison(plan: BatchPlan, on_event: Callable[[Event], None]) -> dict[str, Any]:
    """Run the missing runs, write all files except report.html, and return comparison.json.

    ``on_event`` is that of `run_cases`. A run that fails is reported there and does not stop the others. Raises
    OutputError if the comparison cannot be written.
    """
    return write_results(plan, run_cases(plan, on_event, lambda result: result))


def write_results(plan: BatchPlan, results: Sequence[CaseResult]) -> dict[str, Any]:
    """Write all files of a comparison except report.html, and return comparison.json; raises OutputError."""
    return write_comparison(results, plan.request.directory, plan.request.rules.gates)
