"""Sessions of finished runs, merges and continued runs: read back from directories, and continued by a new one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.errors import NoScansError, UsageError
from mavnav.ground_truth.tables import read_tum
from mavnav.logs import Log, open_log
from mavnav.logs.formats.detect import log_name
from mavnav.mapping.occupancy_grid import Grid
from mavnav.outputs.documents.sections import Continued, EarlierSession, evidence
from mavnav.outputs.files.finished_run import FinishedRun, MergeRecord, Stored, finished_run
from mavnav.outputs.files.trajectory import session_files
from mavnav.pose import Trajectory
from mavnav.profiling import Progress
from mavnav.scan import Scan
from mavnav.sessions.group import Join, Session, SessionGroup, group_in_frame, make_session, merged_map
from mavnav.sessions.growth import alike, extend_group
from mavnav.slam.matching.observability import rotate_covariances
from mavnav.slam.result import SlamResult
from mavnav.units import NS

UNREADABLE: Final = (OSError, ValueError, LookupError, TypeError)
"""What reading a session raises besides errors of ours where a file is cut or altered."""

FASTEST_M_S, JUMP_M = 100.0, 100.0
"""Beyond this speed, and besides this distance, no laser moves from one scan of a run to the next."""


def poses_of(run: FinishedRun, name: str) -> Trajectory:
    """Read the poses of a run; its file is empty if no scan was tracked.

    Raises UsageError where they are not those that were written, or jump.
    """
    path = run.file(name)
    if not path.stat().st_size:
        return Trajectory.of([], [])
    trajectory = read_tum(path)
    steps_m = np.hypot(*np.diff(trajectory.xyyaw[:, :2], axis=0).T)
    if (steps_m > JUMP_M + FASTEST_M_S * NS * np.diff(trajectory.stamps_ns)).any():
        jump = f"the poses of {name} jump {steps_m.max():.0f} m"
        raise UsageError(f"{run.directory} is no whole run: {jump}; make it again with mavnav replay --force")
    return trajectory


def read_session(run: FinishedRun, stored: Stored, config: Config, name: str = "") -> Session:
    """Read a session of a run.

    Raises UsageError where a file is missing, or another one than was written, and NoScansError without any pose.
    """
    trajectory, recording = poses_of(run, stored.trajectory), run.file(stored.recording)
    if not len(trajectory):
        raise NoScansError("no scan was tracked")
    log = open_log(recording, odom="off")
    return make_session(name or stored.name, log.scans, trajectory, config, doubtful=stored.doubtful)


def session_of(outcome: SlamResult, log: Log, config: Config, name: str) -> Session:
    """Return the session of a log that was tracked."""
    trajectory = outcome.trajectory

    def scans() -> Iterator[Scan]:
        tracked = set(trajectory.stamps_ns.tolist())
        return (scan for scan in log.scans() if scan.stamp_ns in tracked)

    doubtful = outcome.lost_for_good or bool(outcome.doubt and outcome.doubt.high)
    return make_session(name, scans, trajectory, config, doubtful=doubtful)


def mapped_share(sessions: list[dict[str, Any]]) -> float:
    """Return the share, 0 to 1, of the scans of the sessions in a map that are in it, by the rows of merge.json."""
    shares = [(each["scans"], each["tracking"]["tracked_share"]) for each in sessions if each["joined"]]
    whole: float = sum(scans / share for scans, share in shares)
    return float(sum(scans for scans, _ in shares)) / whole


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
    record = run.record
    if record.config.method != "robust":
        raise UsageError(f"{directory} is of a method that cannot search whole maps; repeat it with --method robust")
    if isinstance(record, MergeRecord):
        return run
    if record.input.format == "scenario":
        advice = "record it with mavnav simulate --record, and replay the recording"
        raise UsageError(f"{directory} is a mission of mavnav simulate; {advice}")
    if record.localisation is not None:
        raise UsageError(f"{directory} has the map of another run (--map); continue that run")
    if record.continued and not record.continued.joined:
        raise UsageError(f"{directory} did not join the run that it continued; continue {record.continued.run}")
    return run


def earlier_sessions(run: FinishedRun, config: Config) -> list[Session]:
    """Read the sessions of a run; raises UsageError where its files are not those that it wrote."""
    try:
        return [read_session(run, stored, config) for stored in run.record.stored_sessions]
    except NoScansError as error:
        raise UsageError(f"{run.directory} cannot be continued: {error}; replay the log alone") from error
    except UNREADABLE as error:
        again = "repeat it with all its outputs and continue that"
        raise UsageError(f"{run.directory} cannot be continued: {error}; {again}") from error


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
        return Continuation(outcome, _section(run, Join(name, why="the run was stopped before"), ()))
    session = session_of(outcome, log, config, name)
    group, join = _join(session, earlier, config, progress)
    if group is None:
        return Continuation(outcome, _section(run, join, ()))
    framing = range(len(earlier))
    grid, (*moved, new) = merged_map(group, config, framing, lambda phase, *done: progress(f"both: {phase}", *done))
    return Continuation(_in_map(outcome, new, grid), _section(run, join, moved), tuple(moved))


def _join(
    session: Session, earlier: Sequence[Session], config: Config, progress: Progress
) -> tuple[SessionGroup | None, Join]:
    """Join a session to those of a run; None, and the reason, if the evidence does not suffice."""
    same = [other.name for other in earlier if alike(session, other)]
    if not session.keys or same:
        why = f"it has the scans of {same[0]}" if same else "no scan was tracked"
        return None, Join(session.name, why=why)
    progress("joining", 0, None)
    group, _, tried = extend_group(group_in_frame(earlier), [session], config, lambda _: None, ANY_PAUSE_S)
    return (None, tried[0]) if tried else (group, group.joins[-1])


def new_name(name: str, taken: list[str]) -> str:
    """Return a name of a session that is not taken: the name itself, or with the next number."""
    numbered = (f"{name}-{number}" for number in range(2, len(taken) + 3))
    return name if name not in taken else next(other for other in numbered if other not in taken)


def _in_map(outcome: SlamResult, session: Session, grid: Grid) -> SlamResult:
    """Return an outcome with the poses of its session in the map of a group, and that map."""
    turn = session.map_T_laser[0] @ outcome.trajectory[0].inverse()
    covariances = None if outcome.covariances is None else rotate_covariances(outcome.covariances, turn.yaw_rad)
    return replace(outcome, trajectory=session.map_T_laser, grid=grid, covariances=covariances)


def _section(run: FinishedRun, join: Join, earlier: Sequence[Session]) -> Continued:
    """Describe a continued run, for run.json."""
    sessions = [EarlierSession(s.name, len(s.map_T_laser), *session_files(s.name), s.doubtful) for s in earlier]
    return Continued(str(run.directory), join.name, not join.why, join.why or None, evidence(join), sessions)
