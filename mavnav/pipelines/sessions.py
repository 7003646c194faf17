"""Sessions of finished runs, merges and continued runs: read back from directories, and continued by a new one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.config.named_files import read_json
from mavnav.errors import MavnavError, NoScansError, UsageError
from mavnav.ground_truth.tables import read_tum
from mavnav.logs import open_log
from mavnav.logs.formats.detect import log_name
from mavnav.outputs.directory import MERGE_FILE, RUN_FILE, file_sha256
from mavnav.outputs.documents.sections import Continued, EarlierSession, evidence
from mavnav.outputs.files.trajectory import recording_file, trajectory_file
from mavnav.sessions.group import Join, group_in_frame, make_session, merged_map
from mavnav.sessions.growth import alike, extend_group
from mavnav.slam.findings import HIGH
from mavnav.slam.matching.observability import rotate_covariances
from mavnav.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from mavnav.config.models import Config
    from mavnav.logs import Log
    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.profiling import Progress
    from mavnav.scan import Scan
    from mavnav.sessions.group import Session, SessionGroup
    from mavnav.slam.result import SlamResult


OWN_FILES: Final = ("trajectory.tum", "result.mcap")

UNREADABLE: Final = (OSError, ValueError, LookupError, TypeError, MavnavError)
"""What reading a session raises where a file is missing, cut or altered."""


class Stored(Struct, frozen=True):
    """A session in a directory: its name, the files of its poses and scans, and whether its track is doubtful."""

    name: str
    trajectory: str
    recording: str
    doubtful: bool


class FinishedRun(Struct, frozen=True):
    """The directory of a run, a merge or a continued run, with its document."""

    directory: Path
    document: dict[str, Any]

    def check(self) -> None:
        """Raise LookupError, TypeError, AttributeError or ValueError where the document lacks what is needed."""
        continued = self.document.get("continued")
        names = [name for each in self.stored_sessions for name in (each.name, each.trajectory, each.recording)]
        plain = names and all(Path(name).name == name for name in names)
        whole = continued is None or {"joined", "run"} <= continued.keys()
        if not (plain and whole and all(isinstance(self.document[key], dict) for key in ("outputs", "config"))):
            raise ValueError

    @property
    def stored_sessions(self) -> list[Stored]:
        """The sessions in the map, in the order in which they were added."""
        if "sessions" in self.document:
            joined = [(s["name"], is_doubtful(s["tracking"])) for s in self.document["sessions"] if s["joined"]]
            return [Stored(name, trajectory_file(name), recording_file(name), doubtful) for name, doubtful in joined]
        if "continued" in self.document:
            earlier, name = (self.document["continued"][key] for key in ("sessions", "name"))
        else:
            earlier, name = [], log_name(Path(self.document["input"]["path"]))
        own = Stored(str(name), *OWN_FILES, is_doubtful(self.document["tracking"]))
        return [*(Stored(s["name"], s["trajectory"], s["recording"], s["doubtful"]) for s in earlier), own]

    def session(self, stored: Stored, config: Config, name: str = "") -> Session:
        """Read a session.

        Raises UsageError where a file is missing, or another one than was written, and NoScansError without any pose.
        """
        for file in (stored.trajectory, stored.recording):
            digest, path = self.document["outputs"].get(file), self.directory / file
            if digest is None or not path.is_file():
                raise UsageError(f"it has no {file}")
            if file_sha256(path) != digest:
                raise UsageError(f"{file} has been altered since it was written")
        if not (self.directory / stored.trajectory).stat().st_size:
            raise NoScansError("no scan was tracked")
        trajectory = read_tum(self.directory / stored.trajectory)
        log = open_log(self.directory / stored.recording, odom="off")
        return make_session(name or stored.name, log.scans, trajectory, config, doubtful=stored.doubtful)


def is_doubtful(tracking: dict[str, Any]) -> bool:
    """Return whether a track is not to be relied on: lost for good, or of high doubt."""
    doubt = (tracking.get("doubt") or {"probability": None})["probability"]
    return bool(tracking["lost"]) or (doubt or 0.0) > HIGH


def finished_run(directory: Path) -> FinishedRun:
    """Read the document of a directory; raises UsageError for what is none of a run or merge."""
    file = MERGE_FILE if (directory / MERGE_FILE).is_file() else RUN_FILE
    try:
        document = read_json(directory / file)
        run = FinishedRun(directory, document)
        run.check()
    except OSError as error:
        raise UsageError(f"{directory} holds no run ({file}: {error.strerror}); name a run directory") from error
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        reason = f"{file} lacks what is needed, as of an earlier version or altered"
        raise UsageError(f"{directory} is no whole run: {reason}; make it again with mavnav replay") from error
    return run


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
        return [run.session(stored, config) for stored in run.stored_sessions]
    except NoScansError as error:
        raise UsageError(f"{run.directory} cannot be continued: {error}; replay the log alone") from error
    except UNREADABLE as error:
        again = "repeat it with all its outputs and continue that"
        raise UsageError(f"{run.directory} cannot be continued: {error}; {again}") from error


def version_warning(run: FinishedRun) -> str:
    """Return a line where another version wrote the run; an empty one otherwise."""
    version = run.document["mavnav_version"]
    text = f"{run.directory} is of mavnav {version}, this is {__version__}; maps may differ"
    return "" if version == __version__ else text


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
    trajectory = outcome.trajectory

    def scans() -> Iterator[Scan]:
        tracked = set(trajectory.stamps_ns.tolist())
        return (scan for scan in log.scans() if scan.stamp_ns in tracked)

    doubtful = outcome.lost_for_good or bool(outcome.doubt and outcome.doubt.high)
    session = make_session(name, scans, trajectory, config, doubtful=doubtful)
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
    start = group_in_frame(earlier)
    group, _, tried = extend_group(start, [session], config, lambda _: None, ANY_PAUSE_S)
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
