"""The pipeline of ``mavnav merge``: logs and runs -> sessions -> one group of them -> one map."""

from __future__ import annotations

import platform
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any, Final

from msgspec import Struct

from mavnav.atomic_files import temporary_folder
from mavnav.config.models import Config
from mavnav.errors import ExitCode, NoScansError, SeveralTopicsError, TopicError, UsageError, reason_of, worst
from mavnav.logs import check_log
from mavnav.logs.formats.detect import log_name
from mavnav.mapping.occupancy_grid import Grid, known_area, measured_area
from mavnav.metrics.floor_plan import turn_to_cuts
from mavnav.metrics.gates import stored_verdict
from mavnav.metrics.journey import one_after_another
from mavnav.metrics.map_quality import MeasuredMap, measure_map
from mavnav.metrics.wall_spread import wall_report
from mavnav.outputs.directory import MERGE_FILE, RUN_FILE, atomic_directory, check_directory, document_of, file_sha256
from mavnav.outputs.documents.provenance import versions
from mavnav.outputs.documents.run_json import RunDocument
from mavnav.outputs.documents.sections import evidence
from mavnav.outputs.documents.verdict import Verdict, joining_advice, map_verdict, worst_verdict
from mavnav.outputs.files.document import plain, to_json
from mavnav.outputs.files.finished_run import FinishedRun, MergeRecord, finished_run
from mavnav.outputs.files.gridmap import WALLS_FILE, GridMap, map_section, write_cuts, write_npz, write_pgm, write_yaml
from mavnav.outputs.files.trajectory import session_files, write_poses, write_scans
from mavnav.outputs.pictures.map_picture import write_merged
from mavnav.outputs.report.summary_page import merge_summary, write_summary
from mavnav.outputs.run import RunResult
from mavnav.outputs.writers import REPORT_FILE
from mavnav.pipelines.maps import rounded_pose
from mavnav.pipelines.replay import ReplayRequest, replay_log
from mavnav.pipelines.sessions import UNREADABLE, mapped_share, read_session, session_of
from mavnav.pose import Trajectory
from mavnav.profiling import Progress
from mavnav.sessions.group import Join, Session, frame_of, merged_map
from mavnav.sessions.growth import join_sessions
from mavnav.slam.methods.registry import load_kernels
from mavnav.units import pluralize
from mavnav.version import DOCUMENT_HEAD

Json = dict[str, Any]
"""A document, or a row of one."""

TRACKING: Final = ("lost", "tracked_share", "intervals", "doubt")
"""What merge.json repeats of the tracking of each session."""

OF_LOGS: Final = (ExitCode.DAMAGED_INPUT, ExitCode.TRACKING_LOST)
"""Exit codes of a run that a merge takes over."""


class MergeRequest(Struct, frozen=True):
    """Logs and run directories in any order, the configuration, where the result goes, and whether with report.html.

    ``config_file`` is the file of the configuration, if it is of one.
    """

    inputs: tuple[Path, ...]
    directory: Path
    config: Config
    force: bool = False
    report: bool = False
    config_file: Path | None = None


class Input(Struct, frozen=True):
    """A log or run that was named, its session, and the run.json of its track; both None without a tracked scan."""

    name: str
    path: Path
    session: Session | None = None
    run: Json | None = None
    why: str = ""


def merge(request: MergeRequest, progress: Progress) -> Json:
    """Join sessions, write their map and return the document, which is merge.json.

    The exit code in it is the worst of those of the sessions, and 1 where one did not join. Raises UsageError,
    OutputError, and what a replay raises; a log without usable scans is a session that did not join.
    """
    _check(request)
    with temporary_folder() as folder:
        names = session_names(request.inputs)
        inputs = [_input(*pair, request, folder, progress) for pair in zip(names, request.inputs, strict=True)]
        sessions = [each.session for each in inputs if each.session]
        if not sessions:
            raise NoScansError("none of the logs and runs has a tracked scan; examine them with mavnav info")
        load_kernels(request.config, progress, rare=True)
        group, refused = join_sessions(sessions, request.config, lambda name: progress(f"joining {name}", 0, None))
        numbers = {session.name: number for number, session in enumerate(group.sessions)}
        first = next(numbers[session.name] for session in sessions if session.name in numbers)
        grid, members = merged_map(group, request.config, [first], progress)
        paths = {session.name: session.map_T_laser for session in members}
        joins = {join.name: join for join in (*group.joins, *refused)}
        rows = [_row(each, joins.get(each.name) or Join(each.name, why=each.why), paths) for each in inputs]
        progress("measuring", 0, None)
        tracks = [(session.map_T_laser, session.scans) for session in members]
        measured = measure_map(measured_area(grid), one_after_another(tracks, mapped_share(rows)))
        grid = known_area(grid)
        of_map = _map_document(grid, measured, request.config, mapped_share(rows))
        runs = [each.run for each in inputs if each.run]
        document = _document(request, rows, merge_verdict(rows, plain(of_map)), runs)
        progress("writing", 0, None)
        return _write(request, grid, measured, members, document, of_map)


def _check(request: MergeRequest) -> None:
    """Raise UsageError or OutputError for what can be known to fail before the work."""
    if len(request.inputs) < 2:
        raise UsageError("there is nothing to merge with one log; name two or more logs or runs")
    if request.config.method != "robust":
        raise UsageError(f"merge: method {request.config.method} cannot search whole maps; use the robust method")
    inputs = *request.inputs, request.config_file
    check_directory(request.directory, force=True, marker=MERGE_FILE, inputs=inputs)
    for path in request.inputs:
        if document_of(path):
            _run(path)
        else:
            with suppress(NoScansError):
                check_log(path, None, None)
    check_directory(request.directory, force=request.force, marker=MERGE_FILE)  # that it exists is said last


def session_names(inputs: tuple[Path, ...]) -> list[str]:
    """Name sessions after their logs or run directories; those of one name get numbers that no other name has."""
    plain = [log_name(path) for path in inputs]
    names: list[str] = []
    for name in plain:
        numbered = (f"{name}-{number}" for number in count(1))
        free = (other for other in numbered if other not in plain and other not in names)
        names.append(name if plain.count(name) == 1 else next(free))
    return names


def _input(name: str, path: Path, request: MergeRequest, folder: Path, progress: Progress) -> Input:
    """Read a run, or replay a log."""
    run = None
    try:
        if document_of(path):
            run = (stored := _run(path)).document
            session = _read(name, stored, request.config)
        else:
            result, run = _replay(name, path, request, folder, progress)
            session = session_of(result.slam, result.log, request.config, name)
    except NoScansError as error:
        return Input(name, path, run=run, why=str(error))
    return Input(name, path, session if session.keys else None, run, "no scan was tracked")


def _replay(name: str, log: Path, request: MergeRequest, folder: Path, progress: Progress) -> tuple[RunResult, Json]:
    """Replay a log; return its run, without a map of its own, and run.json."""
    wanted = ReplayRequest(log, folder / name, request.config, outputs=("trajectory",))
    try:
        return replay_log(wanted, lambda phase, *done: progress(f"{name}: {phase}", *done), 0.0)
    except SeveralTopicsError as error:
        raise TopicError(f"{error.what}; write mavnav replay {log} --topic NAME, and merge that run") from error


def _run(path: Path) -> FinishedRun:
    """Return the run in a directory; raises UsageError where it is none of one session."""
    run = finished_run(path)
    if len(run.record.stored_sessions) != 1 or isinstance(run.record, MergeRecord):
        raise UsageError(f"{path} has several sessions; add others to it with mavnav replay --continue {path} LOG")
    return run


def _read(name: str, run: FinishedRun, config: Config) -> Session:
    """Read the scans and poses of a run; raises UsageError where it is not whole."""
    try:
        return read_session(run, run.record.stored_sessions[0], config, name)
    except UNREADABLE as error:
        reason = f"{run.directory} is no whole run: {reason_of(error)}"
        raise UsageError(f"{reason}; make it again with mavnav replay --force") from error


def _write(
    request: MergeRequest, grid: Grid, measured: MeasuredMap, members: list[Session], document: Json, of_map: Json
) -> Json:
    """Write all files, ``of_map`` in run.json; return the document with their digests."""
    drawn = GridMap(grid)
    paths = {session.name: session.map_T_laser for session in members}
    with atomic_directory(request.directory, force=request.force, marker=MERGE_FILE) as folder:
        write_pgm(drawn, folder / "map.pgm")
        write_yaml(drawn, folder / "map.yaml")
        write_npz(drawn, folder / "hits.npz")
        write_merged(drawn, paths, Verdict(**document["verdict"]), folder / "map.png", turn_to_cuts(measured.cuts))
        write_cuts(measured.cuts, folder / WALLS_FILE)
        for session in members:
            poses, recording = session_files(session.name)
            write_poses(session.map_T_laser, folder / poses)
            write_scans(session.scans, folder / recording)
        if request.report:
            write_summary(merge_summary(document, (folder / "map.png").read_bytes()), folder / REPORT_FILE)
        digests = {file.name: file_sha256(file) for file in sorted(folder.iterdir())}
        document = document | {"outputs": digests}
        own = of_map | {key: document[key] for key in ("verdict", "outputs", "exit_code")}
        own |= {"damage": [damage for each in document["sessions"] for damage in each["damage"]], "warnings": []}
        ordered = {key: own[key] for key in RunDocument.__struct_fields__ if key in own}
        (folder / RUN_FILE).write_text(to_json(ordered), encoding="utf-8")
        (folder / MERGE_FILE).write_text(to_json(document), encoding="utf-8")
    return document


def _map_document(grid: Grid, measured: MeasuredMap, config: Config, accepted_share: float) -> Json:
    """Return the keys of run.json for a map alone: what it was made with, and how good it is."""
    return {
        **DOCUMENT_HEAD,
        "python": platform.python_version(),
        "libraries": versions(),
        "config": config,
        "method": config.method,
        "grid": str(config.grid),
        "azimuth": config.azimuth,
        "wall_thickness": wall_report(measured.sections, measured.published, measured.cuts, grid.cell_m),
        "map_quality": measured.quality,
        "map": map_section(grid, accepted_share),
        "partial": False,
    }


def _document(request: MergeRequest, rows: list[Json], verdict: Verdict, runs: list[Json]) -> Json:
    joined = [row for row in rows if row["joined"]]
    codes = [run["exit_code"] for run in runs if run["exit_code"] in OF_LOGS]
    refused = len(rows) - len(joined)
    return {
        **DOCUMENT_HEAD,
        "verdict": plain(verdict),
        "headline": merge_headline(rows),
        "sessions": rows,
        "joined": len(joined),
        "refused": refused,
        "scans": sum(row["scans"] for row in joined),
        "config": request.config.document(),
        "exit_code": int(worst([ExitCode.GATE_FAILED if refused else ExitCode.DONE, *codes])),
    }


def merge_verdict(sessions: list[Json], of_map: Json) -> Verdict:
    """Return the verdict on the map of sessions: the worst of theirs and its own; suspect where one did not join."""
    known = [each for each in sessions if each["joined"] and each["verdict"]]
    own = [Verdict(**each["verdict"] | {"reason": f"{each['name']}: {each['verdict']['reason']}"}) for each in known]
    apart = [each for each in sessions if not each["joined"]]
    advised = [(f"{e['name']} did not join: {e['why']}", joining_advice(e["why"], e["scans"])) for e in apart]
    unmeasured = map_verdict(of_map)
    others = [*(Verdict("suspect", *each) for each in advised), *([unmeasured] if unmeasured else [])]
    worst = worst_verdict([*own, *others])
    return worst if worst and worst.word != "good" else Verdict("good", "every session joined and is good", "")


def merge_headline(sessions: list[Json]) -> str:
    """Say how many of the sessions are in one map."""
    joined = [each for each in sessions if each["joined"]]
    scans = pluralize(sum(each["scans"] for each in joined), "scan")
    if len(joined) == 1:
        return f"No session joined another; the map is that of {joined[0]['name']} alone, with {scans}."
    return f"{len(joined)} of {len(sessions)} sessions are in one map, with {scans}."


def _row(given: Input, join: Join, paths: dict[str, Trajectory]) -> Json:
    """Describe what became of an input."""
    own, run, joined = given.session and given.session.map_T_laser, given.run or {}, given.name in paths
    return {
        "name": given.name,
        "input": str(given.path),
        "scans": len(own) if own else 0,
        "joined": joined,
        "verdict": stored_verdict(run),
        "why": join.why or None,
        **dict(zip(("trajectory", "recording"), session_files(given.name) if joined else (None, None), strict=True)),
        "map_T_session": rounded_pose(frame_of([own], [paths[given.name]])) if own and joined else None,
        **plain(evidence(join)),
        "tracking": {key: run["tracking"].get(key) for key in TRACKING} if run else None,
        "damage": run.get("damage", []),
    }
