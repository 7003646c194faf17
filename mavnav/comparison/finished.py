"""Finished runs side by side, as they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mavnav.batch.cases import Case, CaseResult
from mavnav.batch.request import Setting
from mavnav.comparison.document import write_comparison
from mavnav.comparison.pipeline import check_comparison_directory, short_names
from mavnav.comparison.scores import external_result
from mavnav.config.loading import load_config
from mavnav.errors import UsageError
from mavnav.jobs.run_cache import PlannedRun
from mavnav.metrics.gates import Gate, check_known
from mavnav.outputs.directory import RUN_FILE, check_files, file_sha256
from mavnav.outputs.files.finished_run import FinishedRun, RunRecord, finished_run
from mavnav.pipelines.replay import ReplayRequest


def compare_finished(paths: Sequence[Path], directory: Path, gates: Sequence[Gate] = ()) -> dict[str, Any]:
    """Write the documents of a comparison of finished runs, each known by its directory; return comparison.json.

    Raises UsageError for what is no run, a merge, and gates on unknown names; OutputError where nothing can be written.
    """
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
