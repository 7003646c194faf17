"""The pipeline of ``mavnav compare``: logs x settings -> replays in processes of their own -> one comparison.

A comparison lives in a directory: ``cells/`` holds a run directory for every cell, and a cell that is there is not run
again; ``comparison.json``, ``comparison.csv``, ``comparison.md`` and ``report.html`` set them side by side.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mavnav.atomic_files import discard
from mavnav.compare.document import comparison
from mavnav.compare.figures import PRICES
from mavnav.compare.files import COMPARISON_FILE, write_comparison
from mavnav.compare.grids import settings
from mavnav.errors import UsageError
from mavnav.jobs import Ended, Event, Fate, Job, run_jobs
from mavnav.jobs.run_cache import REFERENCES, PlannedRun, check_home, earlier, make_runs, replay_run
from mavnav.metrics.gates import check_names
from mavnav.outputs.document import plain
from mavnav.outputs.schema import number_names
from mavnav.outputs.writers import REPORT_FILE, write_page
from mavnav.pipelines.replay import log_name

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from mavnav.config.models import Config
    from mavnav.metrics.gates import Gate
    from mavnav.pipelines.replay import Progress

__all__ = [
    "Plan",
    "Request",
    "check_directory",
    "compare",
    "default_directory",
    "draw",
    "plan",
    "settings",
]

_OURS: Final = ("cells", "logs", COMPARISON_FILE)


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked for: logs, settings, where to, how many at a time, and what must hold.

    ``options`` are further values of the `pipelines.replay.Request` of every cell; ``force`` runs again what is there.
    """

    logs: tuple[Path, ...]
    configs: tuple[Config, ...]
    directory: Path
    workers: int = 1
    gates: tuple[Gate, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    force: bool = False


@dataclass(frozen=True, slots=True)
class Plan:
    """The cells of a comparison, and by key the documents of those that were run before.

    ``drawn`` tells whether there is a report of exactly these results.
    """

    request: Request
    cells: tuple[PlannedRun, ...]
    kept: Mapping[str, dict[str, Any]]
    drawn: bool

    @property
    def missing(self) -> list[PlannedRun]:
        """The cells that are to be run."""
        return [cell for cell in self.cells if cell.key not in self.kept]


def default_directory(logs: Sequence[Path]) -> Path:
    """Return ``runs/compare-<log>``, or ``runs/compare`` for several logs and for the sample."""
    return Path("runs") / (f"compare-{log_name(logs[0])}" if len(logs) == 1 else "compare")


def plan(request: Request, progress: Progress) -> Plan:
    """Find out what is to be run and what is there.

    Raises UsageError for logs and files that cannot be read and for gates on unknown names, OutputError where the
    directory cannot be used: before the work.
    """
    check_directory(request.directory)
    if len(request.logs) > 1 and any(request.options.get(name) for name in REFERENCES):
        raise UsageError("--truth, --truth-map and --relations tell of one log; compare one log at a time with them")
    progress("reading", 0, None)
    found = make_runs(request.logs, request.configs, request.options, request.directory)
    check_names((gate.name for gate in request.gates), _gate_names(request))
    documents = {} if request.force else {cell.key: document for cell in found if (document := earlier(cell))}
    drawn = len(documents) == len(found) and _drawn(request.directory, [cell.key for cell in found])
    return Plan(request, tuple(found), documents, drawn)


def _gate_names(request: Request) -> list[str]:
    """Return the names that gates may have."""
    compared = any(request.options.get(name) for name in REFERENCES)
    return [*number_names(reference=compared), *(f"price.{name}" for name in PRICES)]


def _drawn(directory: Path, keys: list[str]) -> bool:
    """Return whether the report in a directory shows the results of these cells, in this order."""
    try:
        before = json.loads((directory / COMPARISON_FILE).read_bytes())
        shown = [cell["key"] for cell in before["cells"] if cell["status"] != "failed"]
    except (OSError, ValueError, LookupError, TypeError):
        return False
    return shown == keys and (directory / REPORT_FILE).is_file()


def check_directory(directory: Path) -> None:
    """Make the directory of a comparison; raise OutputError where it cannot be, or where something else is there."""
    check_home(directory, _OURS)


def compare(plan: Plan, on_event: Callable[[Event], None]) -> dict[str, Any]:
    """Run the missing cells, each in a process of its own, set all side by side, and return comparison.json.

    ``on_event`` hears of the jobs, which are ``plan.missing`` in its order. A cell that fails is named there and takes
    no other along. Raises OutputError where the comparison cannot be written.
    """
    missing = plan.missing

    def watch(event: Event) -> None:
        if isinstance(event, Ended) and event.outcome.fate in {Fate.DIED, Fate.TIMEOUT}:
            discard(missing[event.index].request.directory, event.outcome.pid)
        on_event(event)

    jobs = [Job(cell.name, replay_run, (cell.request,)) for cell in missing]
    outcomes = run_jobs(jobs, plan.request.workers, watch)
    ran = dict(zip((cell.key for cell in missing), outcomes, strict=True))
    document: dict[str, Any] = plain(comparison(plan.cells, plan.kept, ran, plan.request.directory, plan.request.gates))
    write_comparison(document, plan.request.directory)
    return document


def draw(plan: Plan, document: dict[str, Any]) -> Path:
    """Draw report.html, unless there is one of the same results, and return its path; raises OutputError."""
    directory = plan.request.directory
    if not plan.drawn:
        write_page(document, directory)
    return directory / REPORT_FILE
