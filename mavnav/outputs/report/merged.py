"""A merge for the page: one map, and the sessions' scans one after the other."""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav.metrics.wall_spread import WallCuts
from mavnav.outputs.files import wall_table
from mavnav.outputs.files.gridmap import read_npz
from mavnav.outputs.report.entry import Entry, ScanColumns, SessionPart, file_in

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

PAUSE_S: Final = 2.0
"""Time on the page between the last scan of a session and the first of the next one, s."""


def load_merge(document: dict[str, Any], folder: Path) -> Entry:
    """Read a merge; raises OSError, ValueError and LookupError where its files are not those of one."""
    joined = [each for each in document["sessions"] if each["joined"]]
    poses = [_read_tum(file_in(folder, each["trajectory"])) for each in joined]
    walls = folder / wall_table.WALLS_FILE
    firsts = [0, *accumulate(map(len, poses))]
    return Entry(
        log=", ".join(each["name"] for each in joined),
        name="merge",
        folder=folder,
        document=document,
        grid=read_npz(folder / "hits.npz"),
        scans=_columns(poses),
        cuts=wall_table.read(walls) if walls.is_file() else WallCuts(np.zeros((0, 2)), *np.zeros((3, 0))),
        true_walls=[],
        goal_xy_m=np.zeros((0, 2)),
        sessions=tuple(
            SessionPart(each["name"], each["recording"], first) for each, first in zip(joined, firsts, strict=False)
        ),
    )


def _read_tum(path: Path) -> NDArray[np.float64]:
    """Return stamp, x, y and yaw of each pose, (n, 4)."""
    table = np.loadtxt(path, np.float64, ndmin=2).reshape(-1, 8)
    return np.column_stack((table[:, :3], 2.0 * np.arctan2(table[:, 6], table[:, 7])))


def _columns(sessions: list[NDArray[np.float64]]) -> ScanColumns:
    poses = np.concatenate(sessions)
    unknown = np.full(len(poses), np.nan)
    return ScanColumns(
        stamp_s=poses[:, 0],
        time_s=_one_after_the_other([session[:, 0] for session in sessions]),
        cost_mm2=unknown,
        threshold_mm2=unknown,
        xy_m=poses[:, 1:3],
        tracked=np.ones(len(poses), np.bool_),
        doubtful=np.zeros(len(poses), np.bool_),
        yaw_rad=poses[:, 3],
        error_m=unknown,
        roll_pitch_height=np.full((len(poses), 3), np.nan),
    )


def _one_after_the_other(stamps_s: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return times that count on from session to session, as if one followed the other after `PAUSE_S`."""
    begin_s, times_s = 0.0, []
    for session in stamps_s:
        times_s.append(begin_s + session - session[0])
        begin_s = times_s[-1][-1] + PAUSE_S
    return np.concatenate(times_s)
