"""The pipeline of ``mavnav compare``: a batch of logs and settings with documents and a report of its own.

The directory of a comparison contains a run directory for every run in ``cells/``, so that finished runs are not
repeated. ``comparison.json``, ``comparison.csv``, ``comparison.md`` and ``report.html`` compare the runs. Runs that no
batch made stand side by side as well: finished ones as they are, and scored trajectories, alone or beside others.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from msgspec.structs import replace

from mavnav.batch import request as batch
from mavnav.batch.cases import Case, CaseResult, make_cases
from mavnav.batch.request import Setting
from mavnav.batch.runner import BatchPlan, check_gates, plan_cases, run_cases
from mavnav.comparison.document import COMPARISON_FILE, RELATIVE_COSTS, write_comparison
from mavnav.config.loading import load_config
from mavnav.config.models import Config
from mavnav.config.named_files import read_json
from mavnav.config.options import ReplayOptions, reference_files
from mavnav.errors import ExitCode, OutputError, UsageError
from mavnav.ground_truth.tables import read_trajectory
from mavnav.jobs.run_cache import RUNS_FOLDER, PlannedRun, check_cache_directory
from mavnav.jobs.worker import Event, Outcome, Status
from mavnav.logs.formats.detect import log_name
from mavnav.metrics.gates import Gate, check_known
from mavnav.outputs.directory import RUN_FILE, check_files, file_sha256
from mavnav.outputs.documents.provenance import Typed
from mavnav.outputs.documents.quantities import without_search
from mavnav.outputs.files.finished_run import FinishedRun, RunRecord, finished_run
from mavnav.outputs.writers import REPORT_FILE
from mavnav.pipelines.replay import ReplayRequest
from mavnav.pipelines.score import Scored, ScoreRequest, check_names, score_log, scored_options
from mavnav.pipelines.trajectory_source import LASER, RUN_POSES, Program, TrajectorySource
from mavnav.profiling import Progress

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
    check_cache_directory(directory, (RUNS_FOLDER, "logs", COMPARISON_FILE))


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
    by_key: dict[str, tuple[Case, ReplayRequest]] = {}
    for case in cases:
        if case.run:
            by_key.setdefault(case.run.key, (case, case.run.request))
    logs = short_names({request.log for _, request in by_key.values()})
    return [
        replace(
            case,
            name=f"{logs[request.log]} {request.config.method} {request.config.azimuth}/{request.config.grid} "
            f"{case.setting.differs}".rstrip(),
        )
        for case, request in by_key.values()
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
    return write_scores(log, score_log(given, progress), request.directory, own, request.rules.gates)


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
