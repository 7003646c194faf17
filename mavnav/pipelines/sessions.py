"""Sessions that were mapped before, read back from the directories of runs, merges and continued runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from mavnav.config.named_files import read_json
from mavnav.errors import NoScansError, UsageError
from mavnav.ground_truth.tables import read_tum
from mavnav.logs import open_log
from mavnav.logs.formats.detect import log_name
from mavnav.outputs.directory import MERGE_FILE, RUN_FILE, file_sha256
from mavnav.outputs.files.trajectory import recording_file, trajectory_file
from mavnav.sessions.session import make_session
from mavnav.slam.findings import HIGH

if TYPE_CHECKING:
    from mavnav.config.models import Config
    from mavnav.sessions.session import Session

OWN_FILES: Final = ("trajectory.tum", "result.mcap")


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
    def version(self) -> str:
        """The version of mavnav that wrote it."""
        return str(self.document["mavnav_version"])

    @property
    def stored_sessions(self) -> list[Stored]:
        """The sessions in the map, in the order in which they were added."""
        if "sessions" in self.document:
            return [_stored_session(row) for row in self.document["sessions"] if row["joined"]]
        earlier = self.document.get("continued", {"sessions": []})["sessions"]
        own = Stored(self.own_name, *OWN_FILES, is_doubtful(self.document["tracking"]))
        return [*(Stored(s["name"], s["trajectory"], s["recording"], s["doubtful"]) for s in earlier), own]

    @property
    def own_name(self) -> str:
        """The name of the session of a run."""
        continued = self.document.get("continued")
        return str(continued["name"] if continued else log_name(Path(self.document["input"]["path"])))

    def sessions(self, config: Config) -> list[Session]:
        """Read all sessions; raises UsageError where a file is missing, or another one than was written."""
        return [self.session(stored, config) for stored in self.stored_sessions]

    def session(self, stored: Stored, config: Config, name: str = "") -> Session:
        """Read a session.

        Raises UsageError where a file is missing, or another one than was written, and NoScansError without any pose.
        """
        for file in (stored.trajectory, stored.recording):
            self._check(file)
        if not (self.directory / stored.trajectory).stat().st_size:
            raise NoScansError("no scan was tracked")
        trajectory = read_tum(self.directory / stored.trajectory)
        log = open_log(self.directory / stored.recording, odom="off")
        return make_session(name or stored.name, log.scans, trajectory, config, doubtful=stored.doubtful)

    def _check(self, name: str) -> None:
        digest = self.document["outputs"].get(name)
        path = self.directory / name
        if digest is None or not path.is_file():
            raise UsageError(f"it has no {name}")
        if file_sha256(path) != digest:
            raise UsageError(f"{name} has been altered since it was written")


def _stored_session(row: dict[str, Any]) -> Stored:
    doubtful = is_doubtful(row["tracking"])
    return Stored(row["name"], trajectory_file(row["name"]), recording_file(row["name"]), doubtful)


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
