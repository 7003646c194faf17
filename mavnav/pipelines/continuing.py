"""Continuing a run: its sessions, and a new one that is placed in their map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.errors import MavnavError, NoScansError, UsageError
from mavnav.logs.formats.detect import log_name
from mavnav.outputs.documents.sections import Continued, EarlierSession, evidence
from mavnav.outputs.files.trajectory import recording_file, trajectory_file
from mavnav.pipelines.sessions import finished_run
from mavnav.sessions.group import Join, group_in_frame
from mavnav.sessions.growth import alike, extend_group
from mavnav.sessions.merged_map import merged_map, trajectories
from mavnav.sessions.session import make_session
from mavnav.slam.matching.observability import rotate_covariances
from mavnav.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from mavnav.config.models import Config
    from mavnav.logs import Log
    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.pipelines.sessions import FinishedRun
    from mavnav.profiling import Progress
    from mavnav.scan import Scan
    from mavnav.sessions.group import SessionGroup
    from mavnav.sessions.session import Session
    from mavnav.slam.result import SlamResult

ANY_PAUSE_S: Final = np.inf
"""However long after the end of a run a log begins, it is tried there: the robot may have been switched off."""


class Continuation(Struct, frozen=True):
    """A run that was continued: the outcome of the new log in its map, and the earlier sessions in the same frame."""

    outcome: SlamResult
    section: Continued
    earlier: tuple[Session, ...] = ()


def run_to_continue(directory: Path) -> FinishedRun:
    """Return a run that can be continued; raises UsageError for what is none."""
    run = finished_run(directory)
    document = run.document
    if document.get("input", {}).get("format") == "scenario":
        advice = "record it with mavnav simulate --record, and replay the recording"
        raise UsageError(f"{directory} is a mission of mavnav simulate; {advice}")
    if "localisation" in document:
        raise UsageError(f"{directory} has the map of another run (--map); continue that run")
    if not document.get("continued", {"joined": True})["joined"]:
        raise UsageError(f"{directory} did not join the run that it continued; continue {document['continued']['run']}")
    if document["config"].get("method") != "robust":
        raise UsageError(f"{directory} is of a method that cannot search whole maps; repeat it with --method robust")
    return run


def earlier_sessions(run: FinishedRun, config: Config) -> list[Session]:
    """Read the sessions of a run; raises UsageError where its files are not those that it wrote."""
    try:
        return run.sessions(config)
    except NoScansError as error:
        raise UsageError(f"{run.directory} cannot be continued: {error}; replay the log by itself") from error
    except (OSError, ValueError, LookupError, TypeError, MavnavError) as error:
        again = "repeat it with all its outputs and continue that"
        raise UsageError(f"{run.directory} cannot be continued: {error}; {again}") from error


def version_warning(run: FinishedRun) -> str:
    """Return a line where another version wrote the run; an empty one otherwise."""
    same = run.version == __version__
    return "" if same else f"{run.directory} is of mavnav {run.version}, this is {__version__}; maps may differ"


def continue_run(
    run: FinishedRun,
    earlier: Sequence[Session],
    outcome: SlamResult,
    log: Log,
    config: Config,
    progress: Progress,
    *,
    stopped: bool = False,
) -> Continuation:
    """Place a tracked log in the map of a run, and draw the map of both.

    It is left alone where it does not join, or where the run was ``stopped``.
    """
    name = new_name(log_name(log.path), [session.name for session in earlier])
    if stopped:
        return Continuation(outcome, section(run, Join(name, why="the run was stopped before"), ()))
    trajectory = outcome.trajectory

    def scans() -> Iterator[Scan]:
        tracked = set(trajectory.stamps_ns.tolist())
        return (scan for scan in log.scans() if scan.stamp_ns in tracked)

    doubtful = outcome.lost_for_good or bool(outcome.doubt and outcome.doubt.high)
    session = make_session(name, scans, trajectory, config, doubtful=doubtful)
    group, join = _join(session, earlier, config, progress)
    if group is None:
        return Continuation(outcome, section(run, join, ()))
    placed = trajectories(group)
    total = sum(map(len, placed))
    grid, poses = merged_map(
        group.sessions, placed, config, range(len(earlier)), lambda phase, done: progress(f"both: {phase}", done, total)
    )
    moved = [replace(member, map_T_laser=path) for member, path in zip(group.sessions, poses, strict=True)]
    return Continuation(in_map(outcome, moved[-1], grid), section(run, join, moved[:-1]), tuple(moved[:-1]))


def _join(
    session: Session, earlier: Sequence[Session], config: Config, progress: Progress
) -> tuple[SessionGroup | None, Join]:
    """Join a session to those of a run; None, and the reason, if the evidence does not suffice."""
    same = [other.name for other in earlier if alike(session, other)]
    if not session.keys or same:
        why = f"it has the scans of {same[0]}" if same else "no scan was tracked"
        return None, Join(session.name, why=why)
    progress("joining", 0, None)
    start = group_in_frame(earlier)
    group, _, tried = extend_group(start, [session], config, lambda _: None, ANY_PAUSE_S)
    return (None, tried[0]) if tried else (group, group.joins[-1])


def new_name(name: str, taken: list[str]) -> str:
    """Return a name of a session that is not taken: the name itself, or with the next number."""
    numbered = (f"{name}-{number}" for number in range(2, len(taken) + 3))
    return name if name not in taken else next(other for other in numbered if other not in taken)


def in_map(outcome: SlamResult, session: Session, grid: Grid) -> SlamResult:
    """Return an outcome with the poses of its session in the map of a group, and that map."""
    turn = session.map_T_laser[0] @ outcome.trajectory[0].inverse()
    covariances = None if outcome.covariances is None else rotate_covariances(outcome.covariances, turn.yaw_rad)
    return replace(outcome, trajectory=session.map_T_laser, grid=grid, covariances=covariances)


def section(run: FinishedRun, join: Join, earlier: Sequence[Session]) -> Continued:
    """Describe a continued run, for run.json."""
    sessions = [
        EarlierSession(
            session.name,
            len(session.map_T_laser),
            trajectory_file(session.name),
            recording_file(session.name),
            session.doubtful,
        )
        for session in earlier
    ]
    return Continued(str(run.directory), join.name, not join.why, join.why or None, evidence(join), sessions)
