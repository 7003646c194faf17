"""Where a trajectory that is scored comes from, as it is named on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from msgspec import Struct

from mavnav.config.option_kinds import recorded_topic
from mavnav.errors import UsageError
from mavnav.ground_truth.references import SWEEPS
from mavnav.outputs.files.finished_run import finished_run

LASER: Final = "laser"
RUN_POSES: Final = "trajectory.tum"
MERGED_POSES: Final = "session_*.tum"
WHOLE: Final = "whole"
"""Where in a sweep the pose holds at which the scan as recorded fits best."""


class TrajectorySource(Struct, frozen=True):
    """Where a trajectory comes from: ``in_log`` is a topic or ``tf:MAP,FRAME`` of the log, else ``path`` is a file.

    Poses of a file are those of ``frame``. With the stamp of a scan they hold at its beam ``pose_at``, or for the
    ``whole`` scan as recorded.
    """

    name: str
    text: str
    frame: str = ""
    pose_at: str = WHOLE

    @property
    def in_log(self) -> str | None:
        """The topic or the frames of the log; None for a file."""
        return recorded_topic(self.text)

    @property
    def path(self) -> Path:
        """The file; that of the poses in a run directory. Raises UsageError for a merge, which has several."""
        path = Path(self.text)
        if not (path / RUN_POSES).exists() and (sessions := sorted(path.glob(MERGED_POSES))):
            names = " or ".join(map(str, sessions))
            raise UsageError(f"{path} is a merge, with a trajectory of each session; name {names}")
        return path / RUN_POSES if path.is_dir() else path


def read_source(text: str) -> TrajectorySource:
    """Read ``[NAME=]FILE[,FRAME]``, ``[NAME=]topic:/T`` or ``[NAME=]tf:MAP,FRAME``, and after ``@`` where poses hold.

    Raises UsageError for a name that cannot be that of a directory.
    """
    name, has_name, source = text.partition("=")
    source = source if has_name else text
    before, _, at = source.rpartition("@")
    source, at = (before, at) if at in {*SWEEPS, WHOLE} else (source, _usual_instant(Path(source)))
    if recorded_topic(source) is not None:
        frame = ""
        name = name if has_name else source.rpartition("/")[2].replace(":", "_")
    else:
        file, _, after = source.rpartition(",")
        source, frame = (file, after) if file and not Path(source).exists() else (source, LASER)
        name = name if has_name else Path(source).stem
    if not name or Path(name).name != name:
        raise UsageError(f"--trajectory {text!r}: {name!r} names no directory; write NAME=FILE with a plain name")
    return TrajectorySource(name, source, frame, at)


def _usual_instant(path: Path) -> str:
    """Return where poses hold if nothing is said: those of a run in causal mode at mid-sweep."""
    if not (path / "run.json").is_file():
        return WHOLE
    return WHOLE if finished_run(path).record.config.final_pass else "middle"
