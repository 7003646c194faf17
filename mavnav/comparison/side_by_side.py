"""Runs that no batch made, side by side: finished ones as they are, and scored trajectories, alone or beside others."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from mavnav.batch.cases import Case, CaseResult
from mavnav.batch.request import Setting
from mavnav.batch.runner import BatchPlan
from mavnav.comparison.document import COMPARISON_FILE, write_comparison
from mavnav.comparison.pipeline import check_comparison_directory, short_names
from mavnav.config.loading import load_config
from mavnav.config.named_files import read_json
from mavnav.errors import ExitCode, OutputError, UsageError
from mavnav.ground_truth.tables import read_trajectory
from mavnav.jobs.run_cache import PlannedRun, check_cache_directory
from mavnav.jobs.worker import Outcome, Status
from mavnav.metrics.gates import Gate, check_known
from mavnav.outputs.directory import RUN_FILE, check_files, file_sha256
from mavnav.outputs.documents.quantities import without_search
from mavnav.outputs.files.finished_run import FinishedRun, RunRecord, finished_run
from mavnav.pipelines.replay import ReplayRequest
from mavnav.pipelines.score import Scored, ScoreRequest, check_names, score_log, scored_options
from mavnav.pipelines.trajectory_source import LASER, RUN_POSES, Program, TrajectorySource
from mavnav.profiling import Progress


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
    return write_comparison(results, directory, gates)


def check_score_directory(request: ScoreRequest, log: str) -> None:
    """Raise OutputError for a directory that holds other files than scores of this log, of another log without force.

    ``log`` is the log as `write_scores` names it.
    """
    directory = request.directory
    if not os.path.lexists(directory):
        return
    check_cache_directory(directory, (*check_names(request.sources, request.programs), COMPARISON_FILE))
    if not request.force and (file := directory / COMPARISON_FILE).exists() and not _is_of_scores(file, log):
        advice = "choose another directory with -o, or --force to replace it"
        raise OutputError(f"{file} exists, of other runs; {advice}")


def _is_of_scores(file: Path, log: str) -> bool:
    """Return whether a document compares nothing but given poses of a log, drawn in its own folders."""
    try:
        return all(
            (cell["log"], cell["trajectory"]) == (log, cell["directory"] or cell["name"])
            for cell in read_json(file)["cells"]
        )
    except (OSError, ValueError, LookupError, TypeError):
        return False


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


OWN: Final = "mavnav"
"""Name of the poses of mavnav's run; several are numbered."""


def check_given(plan: BatchPlan, sources: Sequence[TrajectorySource], programs: Sequence[Program]) -> None:
    """Raise UsageError for several logs, names that cannot be used and files without poses, before any run."""
    if len({case.log for case in plan.cases}) > 1:
        raise UsageError("--trajectory and --external are about one log; compare one log at a time with them")
    if own := [name for name in check_names(sources, programs) if name.partition("-")[0] == OWN]:
        raise UsageError(f"{own[0]} names the poses of mavnav's own run; write NAME=FILE with another name")
    for source in sources:
        if source.in_log is None:
            read_trajectory(source.path)


def compare_with_poses(
    plan: BatchPlan,
    own: Sequence[CaseResult],
    sources: Sequence[TrajectorySource],
    programs: Sequence[Program],
    limit_s: float,
    progress: Progress,
) -> dict[str, Any]:
    """Score the poses of mavnav's ``own`` runs and those that are given, and return comparison.json of all.

    Raises as `score_log`.
    """
    request, log, config = plan.request, plan.cases[0].log, plan.cases[0].setting.config
    every, options = (*_own_poses(own), *sources), scored_options(request.entries[0].options)
    given = ScoreRequest(
        Path(log),
        request.directory / POSES,
        config,
        options,
        force=True,
        typed=request.typed,
        sources=every,
        programs=tuple(programs),
        limit_s=limit_s,
    )
    scored = score_log(given, progress)
    return write_scores(log, scored, request.directory, own, request.rules.gates)


def _own_poses(own: Sequence[CaseResult]) -> list[TrajectorySource]:
    """Return the poses of the runs that have some."""
    folders = [result.case.run.directory for result in own if result.case.run and result.document]
    files = [folder / RUN_POSES for folder in folders if (folder / RUN_POSES).is_file()]
    names = [f"{OWN}-{k}" for k in range(1, len(files) + 1)] if len(files) > 1 else [OWN]
    return [TrajectorySource(name, str(file), LASER) for name, file in zip(names, files, strict=False)]


def compare_finished(paths: Sequence[Path], directory: Path, gates: Sequence[Gate] = ()) -> dict[str, Any]:
    """Write the documents of a comparison of finished runs, each known by its directory; return comparison.json.

    A run that is named twice counts once. Raises UsageError for what is no run, a merge, an edited run, and gates on
    unknown names; OutputError where nothing can be written.
    """
    paths = list({os.path.realpath(path): path for path in paths}.values())
    if len(paths) < 2:
        raise UsageError(f"{paths[0]} is a finished run; name another to compare it with, or a log")
    if others := [path for path in paths if not (path / RUN_FILE).is_file()]:
        raise UsageError(f"{others[0]} is no finished run, others are; compare finished runs, or logs")
    runs = [_read(path) for path in paths]
    check_known(gates, [run.document for run in runs])
    check_comparison_directory(directory)
    names, logs = short_names({run.directory for run in runs}), dict[str, str]()
    results = []
    for run in runs:
        source = run.document["input"]
        log = logs.setdefault(source.get("sha256") or source["path"], source["path"])
        results.append(_finished_result(run, log, names[run.directory]))
    return write_comparison(results, directory, gates)


def _read(path: Path) -> FinishedRun:
    run = finished_run(path)
    if not isinstance(run.record, RunRecord):
        raise UsageError(f"{path} is a merge; compare its map with another by mavnav diff")
    if run.record.provenance and run.document["provenance"].get("edits"):
        raise UsageError(f"{path} was edited, and its numbers are of the map before; measure it with mavnav metrics")
    check_files(path, run.document["outputs"])
    return run


def _finished_result(run: FinishedRun, log: str, name: str) -> CaseResult:
    """Describe a run as the case of a comparison; of its configuration only method and search grid are named."""
    if "external" in run.document:
        return external_result(log, name, run.directory, run.document, key=file_sha256(run.directory / RUN_FILE))
    config = load_config(overrides={key: run.document.get(key) for key in ("method", "grid", "azimuth")})
    planned = PlannedRun(ReplayRequest(Path(log), run.directory, config), file_sha256(run.directory / RUN_FILE))
    setting = Setting(f"{config.method} {config.azimuth}/{config.grid}", config, name)
    return CaseResult(Case(f"{log} {setting.name} {name}", log, setting, planned), None, run.document)
