"""The data of a run for the report: its document, map, scans, and the true walls if they are known.

Of a merge: one map, and the sessions' scans one after the other.
"""

from __future__ import annotations

from collections.abc import Callable
from csv import DictReader
from itertools import accumulate
from pathlib import Path
from typing import Any, Final

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray
from PIL import Image

from mavnav.config.named_files import read_json
from mavnav.errors import UsageError
from mavnav.mapping.occupancy_grid import Grid
from mavnav.metrics.wall_spread import WallCuts
from mavnav.outputs.directory import RUN_FILE, checked_file
from mavnav.outputs.files import gridmap
from mavnav.outputs.files.gridmap import read_npz
from mavnav.outputs.files.trajectory import ATTITUDE_COLUMNS, TRUE_WALLS_FILE
from mavnav.outputs.pictures.map_axes import wall_lines
from mavnav.outputs.run import RunResult, WallShapes

FAILED: Final = "failed"


class ScanColumns(Struct, frozen=True):
    """The scans of a run in their order; arrays of shape (n,), unless stated; ``xy_m`` is (n, 2).

    ``stamp_s`` are the stamps; ``time_s`` counts from the first scan. ``cost_mm2`` is the cost of the match, and
    ``threshold_mm2`` its acceptance threshold (NaN without one). ``xy_m`` and ``yaw_rad`` are in the map frame (NaN for
    a scan without a pose). ``doubtful`` marks scans of a reason to doubt the track, if the doubt is high.
    ``error_m`` is the position error (NaN without ground truth). ``roll_pitch_height`` is (n, 3), rad and m (NaN if
    unknown).
    """

    stamp_s: NDArray[np.float64]
    time_s: NDArray[np.float64]
    cost_mm2: NDArray[np.float64]
    threshold_mm2: NDArray[np.float64]
    xy_m: NDArray[np.float64]
    tracked: NDArray[np.bool_]
    doubtful: NDArray[np.bool_]
    yaw_rad: NDArray[np.float64]
    error_m: NDArray[np.float64]
    roll_pitch_height: NDArray[np.float64]


class SessionPart(Struct, frozen=True):
    """A part of the scans of an entry that begins at scan ``first``, and the file of its recording."""

    name: str
    recording: str
    first: int


class Entry(Struct, frozen=True):
    """A finished run on the page; ``true_walls`` are lines (k, 2) in the map frame, m, empty if unknown.

    ``folder`` is its directory. ``goal_xy_m`` is that of a mission, (1, 2); without one (0, 2). ``view_3d`` is the
    picture of the slices by height, None without. ``sessions`` are the sessions of a merge, of whose scans
    ``scans`` has one after the other. ``run`` is the run where it has just ended: its scans need not be read again.
    """

    log: str
    name: str
    folder: Path
    document: dict[str, Any]
    grid: Grid
    scans: ScanColumns
    cuts: WallCuts
    true_walls: list[NDArray[np.float64]] = []
    goal_xy_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    view_3d: Image.Image | None = None
    sessions: tuple[SessionPart, ...] = (SessionPart("", "result.mcap", 0),)
    run: RunResult | None = None


class Failure(Struct, frozen=True):
    """A run without a result, and the reason."""

    log: str
    name: str
    why: str


def file_in(folder: Path, name: str) -> Path:
    """Return a file of a run directory; raises ValueError for a name that leads out of it."""
    if not name or Path(name).name != name:
        raise ValueError(f"{name} is no file of {folder.name}")
    return folder / name


def name_of(cell: dict[str, Any]) -> str:
    """Return the name of a run within its log: that of the given poses, else its method, and what `setting_of` says."""
    return str(cell.get("trajectory") or f"{cell.get('method')} {setting_of(cell)}")


def setting_of(cell: dict[str, Any]) -> str:
    """Return yaw samples and search grid of a run, in the paper's order, and in what else it differs from others."""
    return f"{cell.get('azimuth')}/{cell.get('grid')} {cell.get('differs') or ''}".rstrip()


def load(cell: dict[str, Any], base: Path, run: RunResult | None = None) -> Entry | Failure:
    """Read the run of a cell of comparison.json; a directory that cannot be read gives a `Failure` of this run.

    ``run`` is the run itself, where it has just ended.
    """
    log, name = str(cell.get("log")), name_of(cell)
    if cell.get("status") == FAILED or not cell.get("directory"):
        return Failure(log, name, str(cell.get("error") or f"exit code {cell.get('exit_code')}"))
    folder = base / str(cell["directory"])
    try:
        document = read_json(folder / RUN_FILE)
        true_walls, goal_xy_m = _truth(document, folder)
        return Entry(
            log=log,
            name=name,
            folder=folder,
            document=document,
            grid=read_npz(checked_file(folder, "hits.npz", {})),
            scans=_scans(checked_file(folder, "trajectory.csv", {})),
            cuts=gridmap.read_cuts(checked_file(folder, gridmap.WALLS_FILE, {})),
            true_walls=true_walls,
            goal_xy_m=goal_xy_m,
            view_3d=_view_3d(folder / "map_3d.png"),
            run=run,
        )
    except UsageError as error:
        return Failure(log, name, str(error))
    except (OSError, ValueError, LookupError, TypeError, AttributeError, Image.DecompressionBombError) as error:
        return Failure(log, name, f"its run directory {cell['directory']} cannot be read ({type(error).__name__})")


def _scans(path: Path) -> ScanColumns:
    """Read trajectory.csv; an empty field is NaN, and so are all fields of a missing column."""
    with path.open(encoding="ascii", newline="") as file:
        rows = list(DictReader(file))
    return _scan_columns(lambda name: np.array([float(row.get(name) or "nan") for row in rows], np.float64))


def _scan_columns(column: Callable[[str], NDArray[np.float64]]) -> ScanColumns:
    """Return the scans of a table, given the function that returns a column, (n,), by its name in trajectory.csv."""
    stamps_s = column("stamp")
    return ScanColumns(
        stamp_s=stamps_s,
        time_s=stamps_s - stamps_s[:1],
        cost_mm2=column("cost_m2") * 1e6,
        threshold_mm2=column("threshold_m2") * 1e6,
        xy_m=np.column_stack((column("x_m"), column("y_m"))),
        tracked=column("tracked") > 0,
        doubtful=column("doubtful") > 0,
        yaw_rad=column("yaw_rad"),
        error_m=column("position_error_m"),
        roll_pitch_height=np.column_stack([column(name) for name in ATTITUDE_COLUMNS]),
    )


def _view_3d(path: Path) -> Image.Image | None:
    if not path.is_file():
        return None
    with Image.open(path, formats=("PNG",)) as picture:
        return picture.convert("RGB")


def _truth(document: dict[str, Any], folder: Path) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
    """Return the true walls as lines, and the goal of a mission, (1, 2); as far as they are known."""
    path = folder / TRUE_WALLS_FILE
    walls = read_json(path) if path.is_file() else {"segments": [], "arcs": []}
    segments, arcs = (np.array(walls[key], np.float64).reshape(-1, n) for key, n in (("segments", 4), ("arcs", 5)))
    goal = [walls["goal"]] if document.get("mission") and walls.get("goal") else []
    return wall_lines(WallShapes(segments, arcs)), np.array(goal, np.float64).reshape(-1, 2)


PAUSE_S: Final = 2.0
"""Time on the page between the last scan of a session and the first of the next one, s."""


def load_merge(document: dict[str, Any], folder: Path) -> Entry:
    """Read a merge; raises OSError, ValueError and LookupError where its files are not those of one."""
    joined = [each for each in document["sessions"] if each["joined"]]
    poses = [_read_tum(file_in(folder, each["trajectory"])) for each in joined]
    walls = folder / gridmap.WALLS_FILE
    parts = zip(joined, [0, *accumulate(map(len, poses))], strict=False)
    return Entry(
        log=", ".join(each["name"] for each in joined),
        name="merge",
        folder=folder,
        document=document,
        grid=read_npz(folder / "hits.npz"),
        scans=_columns(poses),
        cuts=gridmap.read_cuts(walls) if walls.is_file() else WallCuts(np.zeros((0, 2)), *np.zeros((3, 0))),
        sessions=tuple(SessionPart(each["name"], each["recording"], first) for each, first in parts),
    )


def _read_tum(path: Path) -> NDArray[np.float64]:
    """Return stamp, x, y and yaw of each pose, (n, 4)."""
    table = np.loadtxt(path, np.float64, ndmin=2).reshape(-1, 8)
    return np.column_stack((table[:, :3], 2.0 * np.arctan2(table[:, 6], table[:, 7])))


def _columns(sessions: list[NDArray[np.float64]]) -> ScanColumns:
    """Return the scans of sessions, of which the poses are known, (n, 4) as of `_read_tum`."""
    poses = np.concatenate(sessions)
    known = dict(zip(("stamp", "x_m", "y_m", "yaw_rad"), poses.T, strict=True)) | {"tracked": np.ones(len(poses))}
    scans = _scan_columns(lambda name: known.get(name, np.full(len(poses), np.nan)))
    return replace(scans, time_s=_one_after_the_other([session[:, 0] for session in sessions]))


def _one_after_the_other(stamps_s: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return times that count on from session to session, as if one followed the other after `PAUSE_S`."""
    begin_s, times_s = 0.0, []
    for session in stamps_s:
        times_s.append(begin_s + session - session[0])
        begin_s = times_s[-1][-1] + PAUSE_S
    return np.concatenate(times_s)
