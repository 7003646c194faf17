"""The one reader of the documents of runs and merges, which may come from strangers: types and bounds of what is used.

Models are lenient: what only some versions or kinds of runs have may be absent, what no command reads is not looked at.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal

from msgspec import Meta, Struct, convert

from mavnav.config.named_files import read_json, what_is_wrong
from mavnav.errors import UsageError
from mavnav.logs.formats.detect import log_name
from mavnav.outputs.directory import MERGE_FILE, RUN_FILE, checked_file, plain_digests
from mavnav.outputs.files.trajectory import session_files
from mavnav.slam.findings import HIGH
from mavnav.units import LARGEST_COORDINATE_M

OWN_FILES: Final = ("trajectory.tum", "result.mcap")
"""The poses and the scans of a run's own session."""

_Share = Annotated[float, Meta(ge=0.0, le=1.0)]
_Count = Annotated[int, Meta(ge=0)]


class DoubtReason(Struct, frozen=True):
    """A reason to doubt a track."""

    reason: str


class DoubtRecord(Struct, frozen=True):
    """The doubt of a track; older runs have none."""

    probability: _Share | None = None
    reasons: tuple[DoubtReason, ...] = ()


class TrackRecord(Struct, frozen=True):
    """How a run was tracked; its poses hold ``holds_s`` after their stamps."""

    lost: bool
    doubt: DoubtRecord | None = None
    holds_s: Annotated[float, Meta(ge=0.0, le=3600.0)] = 0.0

    @property
    def is_doubtful(self) -> bool:
        """Whether the track is not to be relied on: lost for good, or of high doubt."""
        return self.lost or self.reasons is not None

    @property
    def reasons(self) -> set[str] | None:
        """The reasons of a high doubt, None without one."""
        high = self.doubt is not None and (self.doubt.probability or 0.0) > HIGH
        return {each.reason for each in self.doubt.reasons} if self.doubt and high else None


class ScanCounts(Struct, frozen=True):
    """What became of the scans."""

    accepted: _Count
    processed: _Count


class LogRecord(Struct, frozen=True):
    """The log, or the scenario."""

    path: str
    format: str = ""
    first_stamp_s: Annotated[float, Meta(ge=-9e9, le=9e9)] | None = None


class Settings(Struct, frozen=True):
    """What is read of the configuration as it stands; the whole of it is checked where it is used."""

    method: str = ""
    final_pass: bool = True
    truth_at: Literal["first", "middle", "last"] = "first"


class GivenOptions(Struct, frozen=True):
    """The options by which the map of a run begins elsewhere than at the first scan of its log, or lies elsewhere."""

    start_s: float | None = None
    align: str | None = None
    map: str | None = None
    continue_from: str | None = None


_Position = Annotated[float, Meta(ge=-LARGEST_COORDINATE_M, le=LARGEST_COORDINATE_M)]


class AlignmentRecord(Struct, frozen=True):
    """Where the scan that begins the map was put in the map frame."""

    x_m: _Position
    y_m: _Position
    yaw_deg: Annotated[float, Meta(ge=-360.0, le=360.0)]


class Origin(Struct, frozen=True):
    """Where a run comes from."""

    options: GivenOptions | None = None


class Stored(Struct, frozen=True):
    """A session in a directory: its name, the files of its poses and scans, and whether its track is doubtful."""

    name: str
    trajectory: str
    recording: str
    doubtful: bool


class MergedSession(Struct, frozen=True):
    """A session of a merge."""

    name: str
    joined: bool
    tracking: TrackRecord | None = None


class ContinuedRecord(Struct, frozen=True):
    """The run that was continued, and its sessions."""

    run: str
    name: str
    joined: bool
    sessions: tuple[Stored, ...]


class MergeRecord(Struct, frozen=True):
    """What commands read of a merge.json."""

    mavnav_version: str
    outputs: dict[str, str]
    config: Settings
    sessions: tuple[MergedSession, ...]

    @property
    def stored_sessions(self) -> list[Stored]:
        """The sessions in the map, in the order in which they were added."""
        joined = [each for each in self.sessions if each.joined]
        doubtful = [bool(each.tracking and each.tracking.is_doubtful) for each in joined]
        return [Stored(s.name, *session_files(s.name), doubt) for s, doubt in zip(joined, doubtful, strict=True)]


class RunRecord(Struct, frozen=True):
    """What commands read of a run.json."""

    mavnav_version: str
    outputs: dict[str, str]
    config: Settings
    input: LogRecord
    scans: ScanCounts
    tracking: TrackRecord
    exit_code: int = 0
    provenance: Origin | None = None
    continued: ContinuedRecord | None = None
    localisation: dict[str, Any] | None = None
    alignment: AlignmentRecord | None = None

    @property
    def stored_sessions(self) -> list[Stored]:
        """The sessions in the map, in the order in which they were added."""
        name = self.continued.name if self.continued else log_name(Path(self.input.path))
        earlier = self.continued.sessions if self.continued else ()
        return [*earlier, Stored(name, *OWN_FILES, self.tracking.is_doubtful)]


class FinishedRun(Struct, frozen=True):
    """The directory of a run, a merge or a continued run, with its document, and what is read of that."""

    directory: Path
    document: dict[str, Any]
    record: RunRecord | MergeRecord

    def file(self, name: str) -> Path:
        """Return the path of a file; raises UsageError where it is missing, or another one than was written."""
        return checked_file(self.directory, name, self.record.outputs)


def of_document(directory: Path, document: Any) -> FinishedRun:  # noqa: ANN401  any JSON
    """Return the run or merge of a document; raises ValueError where it lacks what is needed."""
    merged = isinstance(document, dict) and "sessions" in document
    record: RunRecord | MergeRecord = convert(document, MergeRecord) if merged else convert(document, RunRecord)
    plain_digests(record.outputs)
    names = [name for each in record.stored_sessions for name in (each.name, each.trajectory, each.recording)]
    if not names or any(Path(name).name != name for name in names):
        raise ValueError
    return FinishedRun(directory, document, record)


def finished_run(directory: Path) -> FinishedRun:
    """Read the document of a directory; raises UsageError for what is none of a run or merge."""
    file = MERGE_FILE if (directory / MERGE_FILE).is_file() else RUN_FILE
    try:
        return of_document(directory, read_json(directory / file))
    except OSError as error:
        raise UsageError(f"{directory} holds no run ({file}: {error.strerror}); name a run directory") from error
    except ValueError as error:  # msgspec's are such, too
        reason = f"{file} {what_is_wrong(error, 'lacks what is needed, as of an earlier version or altered')}"
        raise UsageError(f"{directory} is no whole run: {reason}; make it again with mavnav replay") from error
