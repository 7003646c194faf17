"""The pipeline of ``mavnav merge``: logs and runs -> sessions -> one group of them -> one map."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

from mavnav import __version__
from mavnav.config.named_files import read_json
from mavnav.errors import ExitCode, MavnavError, NoScansError, UsageError
from mavnav.ground_truth.tables import read_tum
from mavnav.logs import check_log, open_log
from mavnav.mapping.occupancy_grid import Grid, known_part, occupancy
from mavnav.outputs import merged_picture
from mavnav.outputs.directory import RUN_FILE, check_directory, staged
from mavnav.outputs.document import to_json
from mavnav.outputs.gridmap import write_npz, write_pgm, write_yaml
from mavnav.outputs.trajectory import tum_lines
from mavnav.pipelines.replay import ReplayRequest, log_name, replay_log
from mavnav.slam.joining.group import Join
from mavnav.slam.joining.growth import grown
from mavnav.slam.joining.merged_map import merged_map, trajectories
from mavnav.slam.joining.session import make_session
from mavnav.slam.registry import load_kernels
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mavnav.config.models import Config
    from mavnav.pose import Pose, Trajectory
    from mavnav.slam.joining.group import Group
    from mavnav.slam.joining.session import Session

SCHEMA_VERSION: Final = 1
MERGE_FILE: Final = "merge.json"

Progress = Callable[[str, int, int | None], None]


@dataclass(frozen=True, slots=True)
class MergeRequest:
    """Logs and run directories in any order, the configuration, and where the result goes."""

    inputs: tuple[Path, ...]
    directory: Path
    config: Config
    force: bool = False


@dataclass(frozen=True)
class MergedMap:
    """The map of all sessions, as the writers of map files take it."""

    known: Grid

    @cached_property
    def cells(self) -> NDArray[np.int8]:
        """What is free, occupied and unknown, (rows, cols)."""
        return occupancy(self.known)


def merge(request: MergeRequest, progress: Progress) -> dict[str, Any]:
    """Join sessions, write their map and return the document, which is merge.json.

    The exit code in it is 1 where a session did not join. Raises UsageError, OutputError, and what a replay raises;
    a log without usable scans is a session that did not join.
    """
    _check(request)
    names = session_names(request.inputs)
    with TemporaryDirectory(prefix="mavnav-") as folder:
        sessions, unusable = _sessions(request, names, Path(folder), progress)
        if not sessions:
            raise NoScansError("none of the logs and runs has a tracked scan; examine them with mavnav info")
        load_kernels(request.config, progress)
        group, refused = grown(sessions, request.config, lambda name: progress(f"joining {name}", 0, None))
        placed = trajectories(group, _map_T_group(group, sessions))
        total = sum(map(len, placed))
        grid, poses = merged_map(
            group.sessions, placed, request.config, lambda phase, done: progress(phase, done, total)
        )
        drawn = MergedMap(known_part(grid))
        paths = {session.name: path for session, path in zip(group.sessions, poses, strict=True)}
        document = _document(request, names, group, [*refused, *unusable], paths, sessions)
        progress("writing", 0, None)
        _write(request, drawn, paths, document)
    return document


def _check(request: MergeRequest) -> None:
    """Raise UsageError or OutputError for what can be known to fail before the work."""
    if len(request.inputs) < 2:
        raise UsageError("there is nothing to merge with one log; name two or more logs or runs")
    if request.config.method != "robust":
        raise UsageError(f"merge: method {request.config.method} cannot search whole maps; use the robust method")
    check_directory(request.directory, force=request.force, marker=MERGE_FILE)
    for path in request.inputs:
        if not _is_run(path):
            with suppress(NoScansError):
                check_log(path, None, None)


def _is_run(path: Path) -> bool:
    return (path / RUN_FILE).is_file()


def session_names(inputs: tuple[Path, ...]) -> list[str]:
    """Name sessions after their logs or run directories; those of one name are numbered."""
    plain = [log_name(path) for path in inputs]
    return [name if plain.count(name) == 1 else f"{name}-{plain[: k + 1].count(name)}" for k, name in enumerate(plain)]


def _sessions(
    request: MergeRequest, names: list[str], folder: Path, progress: Progress
) -> tuple[list[Session], list[Join]]:
    """Read the runs, replay the logs; return the sessions, and those that have no tracked scan."""
    sessions, unusable = [], []
    for name, path in zip(names, request.inputs, strict=True):
        try:
            session = _read(name, path if _is_run(path) else _replayed(name, path, request, folder, progress), request)
        except NoScansError as error:
            unusable.append(Join(name, why=str(error)))
            continue
        if session.keys:
            sessions.append(session)
        else:
            unusable.append(Join(name, why="no scan was tracked"))
    return sessions, unusable


def _replayed(name: str, log: Path, request: MergeRequest, folder: Path, progress: Progress) -> Path:
    """Replay a log; return its run directory."""
    replay_log(
        ReplayRequest(log, folder / name, request.config, outputs=("trajectory", "mcap")),
        lambda phase, done, total: progress(f"{name}: {phase}", done, total),
        0.0,
    )
    return folder / name


def _read(name: str, run: Path, request: MergeRequest) -> Session:
    """Read the scans and poses of a run; raises UsageError where it is not whole."""
    try:
        read_json(run / RUN_FILE)
        trajectory = read_tum(run / "trajectory.tum")
        return make_session(name, open_log(run / "result.mcap", odom="off").scans, trajectory, request.config)
    except NoScansError:
        raise
    except (OSError, ValueError, MavnavError) as error:
        raise UsageError(f"{run} is no whole run: {error}; make it again with mavnav replay --force") from error


def _map_T_group(group: Group, sessions: list[Session]) -> Pose:
    """Return the group's frame in that of the session that was named first."""
    inside = [session.name for session in group.sessions]
    first = next(session for session in sessions if session.name in inside)
    key = group.keys_of(inside.index(first.name))[0]
    return first.keys[0].map_T_laser @ key.map_T_laser.inverse()


def _write(request: MergeRequest, drawn: MergedMap, paths: dict[str, Trajectory], document: dict[str, Any]) -> None:
    with staged(request.directory, force=request.force, marker=MERGE_FILE) as folder:
        write_pgm(drawn, folder / "map.pgm")
        write_yaml(drawn, folder / "map.yaml")
        write_npz(drawn, folder / "hits.npz")
        merged_picture.write(drawn, paths, folder / "map.png")
        for name, path in paths.items():
            (folder / _file(name)).write_text("".join(tum_lines(path)), encoding="ascii")
        (folder / MERGE_FILE).write_text(to_json(document), encoding="utf-8")


def _file(name: str) -> str:
    return f"session_{name}.tum"


def _document(
    request: MergeRequest,
    names: list[str],
    group: Group,
    refused: list[Join],
    paths: dict[str, Trajectory],
    sessions: list[Session],
) -> dict[str, Any]:
    joins = {join.name: join for join in (*group.joins, *refused)}
    own = {session.name: session.map_T_laser for session in sessions}
    rows = [
        {
            "name": name,
            "input": str(path),
            "scans": len(own[name]) if name in own else 0,
            "joined": name in paths,
            "why": joins[name].why or None,
            "trajectory": _file(name) if name in paths else None,
            "map_T_session": _pose(paths[name][0] @ own[name][0].inverse()) if name in paths else None,
            **_evidence(joins[name]),
        }
        for name, path in zip(names, request.inputs, strict=True)
    ]
    return {
        "schema_version": SCHEMA_VERSION,
        "mavnav_version": __version__,
        "sessions": rows,
        "joined": len(paths),
        "refused": len(names) - len(paths),
        "scans": sum(map(len, paths.values())),
        "config": request.config.document(),
        "exit_code": int(ExitCode.GATE_FAILED if refused else ExitCode.DONE),
    }


def _pose(pose: Pose) -> dict[str, float]:
    return {"x_m": round(pose.x_m, 4), "y_m": round(pose.y_m, 4), "yaw_deg": round(pose.yaw_rad / DEG, 3)}


def _evidence(join: Join) -> dict[str, Any]:
    """Return what a session was joined by; of the one that the others joined there is none."""
    return {
        "searched": join.searched,
        "found": join.found,
        "agreeing": join.agreeing,
        "tested": join.tested,
        "closures": join.closures,
        "contradicting": join.contradicting,
        "overlap": round(join.closures / join.tested, 3) if join.tested else None,
        "residual_mm": round(join.residual_m / MM, 1) if join.closures else None,
        "residual_deg": round(join.residual_rad / DEG, 3) if join.closures else None,
        "joined_to": [{"name": name, "closures": closures} for name, closures in join.joined_to],
    }
