"""Scored trajectories side by side, alone or beside mavnav's own runs of the log, in the form of a comparison."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavnav.batch.cases import Case, CaseResult
from mavnav.batch.document import without_search
from mavnav.batch.request import Setting
from mavnav.comparison.document import comparison_document, write_comparison
from mavnav.config.loading import load_config
from mavnav.errors import ExitCode
from mavnav.jobs.run_cache import PlannedRun
from mavnav.jobs.worker import Outcome, Status
from mavnav.outputs.files.document import plain
from mavnav.pipelines.replay import ReplayRequest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mavnav.metrics.gates import Gate
    from mavnav.pipelines.score import Scored


def write_scores(
    log: str, scored: Sequence[Scored], directory: Path, own: Sequence[CaseResult] = (), gates: Sequence[Gate] = ()
) -> dict[str, Any]:
    """Write the documents of the runs of a log at given poses, after mavnav's ``own``; return comparison.json.

    The runs of ``scored`` are in folders of their names in ``directory``, or in its folder ``poses`` beside others.
    """
    folder = directory / POSES if own else directory
    results = [
        *own,
        *(external_result(log, each.name, folder / each.name, each.document, each.error) for each in scored),
    ]
    document: dict[str, Any] = plain(comparison_document(results, directory, gates))
    write_comparison(document, directory)
    return document


POSES = "poses"
"""Folder of the runs at given poses in the directory of a comparison."""


def external_result(
    log: str, name: str, directory: Path, document: dict[str, Any] | None, error: str = "", key: str = ""
) -> CaseResult:
    """Describe a run at given poses as the case of a comparison."""
    setting = Setting(name, load_config())
    planned = PlannedRun(ReplayRequest(Path(log), directory, setting.config), key)
    shown = document and without_search(document)
    code = ExitCode.DONE if document else ExitCode.GATE_FAILED
    case = Case(name, log, setting, planned, error=error, exit_code=code, given=name)
    return CaseResult(case, Outcome(Status.DONE, 0, 0.0) if document else None, shown)
