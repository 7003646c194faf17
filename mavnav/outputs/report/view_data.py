"""The data of the interactive map: runs with their pictures, lines, scans, and the places to look at.

The scripts in ``templates/view`` show it; it stands in the page as JSON, its arrays compressed. A pixel of a
picture is a cell, or a block of cells of a large map. The recording of a run adds the range of every beam, and the path
by odometry.
"""

from __future__ import annotations

import io
import re
import zlib
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from math import ceil, sqrt
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mavnav.errors import MavnavError
from mavnav.logs import open_log
from mavnav.mapping.occupancy_grid import FREE, Grid, known_area, occupancy
from mavnav.mapping.tiled_arrays import max_pool
from mavnav.outputs.documents.quantities import number, verdict_texts
from mavnav.outputs.files.replay_log import nearest_pose, placed_scans
from mavnav.outputs.pictures.canvas import rgb_of
from mavnav.outputs.pictures.map_axes import HIT_COLOURS, top_of_scale
from mavnav.outputs.pictures.slices_picture import height_colours
from mavnav.outputs.report.entry import Entry, ScanColumns, file_in
from mavnav.outputs.report.panels import common_window, ghosts
from mavnav.outputs.report.pictures import Closeup
from mavnav.outputs.run import RunResult
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.scan import LaserSpec, Scan
from mavnav.units import MM, NS

Floats = NDArray[np.float64]
Arrays = dict[str, NDArray[Any]]


TRACKED, DOUBTFUL = 1, 2
"""Bits of the state of a scan."""


def view_data(entries: Sequence[Entry], closeups: Mapping[str, Sequence[Closeup]]) -> list[dict[str, Any]]:
    """Return what the page shows of each run; ``closeups`` are those of the pictures, by log.

    Runs of one log have one scale of hits. All runs share what a page holds of cells and ranges.
    """
    tops = {log: top_of_scale(e.grid for e in entries if e.log == log) for log in {e.log for e in entries}}
    return [_run(e, tops[e.log], len(entries), closeups.get(e.log, ())) for e in entries]


def _run(entry: Entry, top_hits: float, runs: int, closeups: Sequence[Closeup]) -> dict[str, Any]:
    word, reason = verdict_texts(entry.document)
    window = common_window([entry])
    slices = slice_images(entry.folder, entry.document.get("slices") or [])
    return {
        "log": entry.log.rpartition("/")[2] or entry.log,
        "name": entry.name,
        "verdict": {"word": word, "reason": reason},
        "doubt": number(entry.document, "tracking.doubt.probability"),
        "sessions": [{"name": each.name, "first": each.first} for each in entry.sessions],
        "cell_m": entry.grid.cell_m,
        "window": [window.x0_m, window.y0_m, window.x1_m, window.y1_m],
        "images": map_images(entry.grid, top_hits, MAX_PIXELS // runs) + slices,
        "places": [*_places(entry), *map(_closeup, closeups)],
        **pack(_scan_arrays(entry.scans) | _walls(entry) | _recordings(entry, MAX_RANGES // runs)),
    }


def _scan_arrays(scans: ScanColumns) -> Arrays:
    """Return of each scan ``time`` s, ``xy`` m, ``yaw`` rad, ``cost`` mm2, ``error`` mm, and the bits of ``state``."""
    return {
        "time": scans.time_s,
        "xy": scans.xy_m.astype(np.float32),
        "yaw": scans.yaw_rad.astype(np.float32),
        "cost": scans.cost_mm2.astype(np.float32),
        "error": (scans.error_m / MM).astype(np.float32),
        "state": (TRACKED * scans.tracked + DOUBTFUL * scans.doubtful).astype(np.uint8),
    }


def _walls(entry: Entry) -> Arrays:
    """Return the cuts across walls: ``walls`` (n, 5) as x, y in m, direction in rad, width in mm, length in m.

    ``truth`` are the true walls, points (n, 2) in m, with NaN between two walls.
    """
    cuts = entry.cuts
    walls = np.column_stack((cuts.xy_m, cuts.direction_rad, cuts.width_m / MM, cuts.length_m))
    gap = np.full((1, 2), np.nan)
    truth = [part for wall in entry.true_walls for part in (wall, gap)]
    return {
        "walls": walls[np.isfinite(cuts.width_m)].astype(np.float32),
        "truth": np.vstack([np.zeros((0, 2)), *truth]).astype(np.float32),
    }


def _recordings(entry: Entry, max_ranges: int) -> Arrays:
    """Return what the recordings add: the beams, and ``odometry``, the path by odometry alone, (n, 2) m."""
    files = [file_in(entry.folder, session.recording) for session in entry.sessions]
    logs = [recording_of(entry.run)] if entry.run else list(map(read_recording, files))
    arrays = beams(logs, entry.scans.stamp_s, [session.first for session in entry.sessions], max_ranges)
    tracked = np.flatnonzero(entry.scans.tracked)
    if len(logs) > 1 or logs[0] is None or not len(tracked):
        return arrays
    scans, first = entry.scans, tracked[0]
    (x_m, y_m), yaw_rad = scans.xy_m[first].tolist(), float(scans.yaw_rad[first])
    path = odometry_path(logs[0], float(scans.stamp_s[first]), Pose(x_m, y_m, yaw_rad))
    return arrays | {"odometry": path.astype(np.float32)}


def _places(entry: Entry) -> Iterator[dict[str, Any]]:
    """Yield what is worth a look, the worst first: its kind, a text, and from when to when (s), or where (m)."""
    tracking = entry.document.get("tracking") or {}
    for lost in tracking.get("intervals") or []:
        text = f"track lost, {lost['scans']} scans" if lost["scans"] else "the path jumps"
        yield _stretch("lost", text, lost["start_s"], lost["end_s"])
    for reason in (tracking.get("doubt") or {}).get("reasons") or []:
        text = f"{reason['reason']}, strength {reason['value']:.2f}"
        yield _stretch("doubt", text, reason["from_s"], reason["to_s"])
    for ghost in ghosts(entry):
        text = f"ghost wall, {ghost['length_m']:.1f} m long, {ghost['offset_mm']:.0f} mm apart"
        place = {key: ghost[key] for key in ("x_m", "y_m", "length_m", "direction_deg", "offset_mm")}
        yield {"kind": "ghost", "text": text, **place}
    for loop in (entry.document.get("loop_closure") or {}).get("closures") or []:
        text = f"loop closed, moved by {loop['correction_m'] / MM:.0f} mm"
        yield _stretch("loop", text, loop["from_s"], loop["to_s"])


def _closeup(closeup: Closeup) -> dict[str, Any]:
    text = f"{closeup.letter}, {closeup.side_m:.1f} m wide at x {closeup.x_m:z.1f}, y {closeup.y_m:z.1f} m"
    return {"kind": "differs", "text": text, "x_m": closeup.x_m, "y_m": closeup.y_m, "side_m": closeup.side_m}


def _stretch(kind: str, text: str, from_s: float, to_s: float) -> dict[str, Any]:
    return {"kind": kind, "text": text, "from_s": from_s, "to_s": to_s}


ALIGNED_BYTES: Final = 8
"""A typed array of a script begins at a multiple of its item's size."""

_LEVEL: Final = 1
"""Of zlib's levels: a fifth of the time of 6, a tenth larger."""


def pack(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return arrays as ``bytes`` (zlib, base64), and in ``arrays`` the type, offset and length of each by name.

    Types are those of numpy in little-endian order without its mark, such as ``u2``.
    """
    table, parts, offset = {}, [], 0
    for name, array in arrays.items():
        content = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
        table[name] = [array.dtype.str[1:], offset, array.size]
        content += bytes(-len(content) % ALIGNED_BYTES)
        parts.append(content)
        offset += len(content)
    return {"arrays": table, "bytes": b64encode(zlib.compress(b"".join(parts), _LEVEL)).decode("ascii")}


MAX_PIXELS: Final = 4_000_000
"""Maximum size of a picture; cells of a larger map are pooled, as few as that takes."""

PLACED: Final = re.compile(r"resolution: (\S+)\norigin: \[(\S+), (\S+), ")
"""Cell and origin in a description of a map that `mavnav.outputs.files.gridmap` wrote."""

SHADES: Final = 32
FREE_COLOUR: Final = "#dde5ee"


def map_images(grid: Grid, top_hits: float, max_pixels: int = MAX_PIXELS) -> list[dict[str, Any]]:
    """Return free space and laser hits of a map, the hits on a logarithmic scale from 1 to ``top_hits``."""
    known = known_area(grid)
    factor = max(1, ceil(sqrt(known.hits.size / max_pixels)))
    free = max_pool(occupancy(known), factor, value_of=lambda cells: (cells == FREE).astype(np.uint8))
    hits = _shades(max_pool(known.hits, factor), top_hits)
    box = _box(known.origin_xy_m, hits.shape, known.cell_m * factor)
    picked = HIT_COLOURS[np.linspace(0, len(HIT_COLOURS) - 1, SHADES).astype(np.intp)]
    return [
        {"id": "free", "title": "Free space", "box": box, "src": _png(free, np.array([rgb_of(FREE_COLOUR)], np.uint8))},
        {"id": "hits", "title": "Laser hits", "box": box, "src": _png(hits, picked)},
    ]


def slice_images(folder: Path, slices: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the occupied cells of the maps by height that a run directory has, each in the color of its height."""
    colours = height_colours(max(len(slices), 2))
    return [_slice_image(folder, layer, colour[None]) for layer, colour in zip(slices, colours, strict=False)]


def _slice_image(folder: Path, layer: dict[str, Any], colour: NDArray[np.uint8]) -> dict[str, Any]:
    path = file_in(folder, layer["map"])
    cell_m, x_m, y_m = map(float, PLACED.findall(path.read_text(encoding="ascii"))[0])
    with Image.open(path.with_suffix(".pgm"), formats=("PPM",)) as picture:
        occupied = (np.asarray(picture) == 0).astype(np.uint8)[::-1]
    box = _box((x_m, y_m), occupied.shape, cell_m)
    title = f"Slice {layer['from_m']:z.2f} to {layer['to_m']:z.2f} m"
    key = f"#{bytes(colour[0]).hex()}"
    return {"id": layer["map"], "title": title, "box": box, "src": _png(occupied, colour), "colour": key}


def _shades(hits: NDArray[Any], top_hits: float) -> NDArray[np.uint8]:
    """Return the shade of each cell, 1 to `SHADES`, 0 for cells without a hit."""
    share = np.log(np.maximum(hits, 1), dtype=np.float32) / np.float32(np.log(top_hits))
    return np.where(hits > 0, 1 + np.minimum(share * SHADES, SHADES - 1).astype(np.uint8), 0).astype(np.uint8)


def _png(pixels: NDArray[np.uint8], colours: NDArray[np.uint8]) -> str:
    """Return a PNG file as a data URI: cells (rows, cols), row 0 at the minimum y, each 0 for clear or k of n colors.

    Number 1 is the first of the ``colours`` (n, 3).
    """
    buffer = io.BytesIO()
    image = Image.fromarray(pixels[::-1])
    image.putpalette(np.vstack((np.zeros((1, 3), np.uint8), colours)).tobytes())
    image.save(buffer, format="PNG", transparency=0, compress_level=6)
    return "data:image/png;base64," + b64encode(buffer.getvalue()).decode("ascii")


def _box(origin_xy_m: Sequence[float], shape: tuple[int, ...], cell_m: float) -> list[float]:
    """Return minimum x and y, and maximum x and y of a picture, m."""
    (x_m, y_m), (rows, cols) = origin_xy_m, shape
    return [round(float(value), 6) for value in (x_m, y_m, x_m + cols * cell_m, y_m + rows * cell_m)]


MAX_RANGES: Final = 2_000_000
"""Maximum number of ranges of a page; of more only every second beam is kept, or every third, and so on."""

MAX_RANGE_MM: Final = 65_535

SAME_S: Final = 1e-3
"""Scans whose stamps differ no more are the same, s: a stamp in seconds has no nanoseconds."""

UNREADABLE: Final = (OSError, ValueError, LookupError, TypeError, MavnavError)
"""What reading a recording raises where it is missing, cut or altered."""


class Recording(NamedTuple):
    """The scans of a run that have a pose, ``length`` of them, and the laser by odometry, if there is any."""

    length: int
    sensor: LaserSpec
    scans: Callable[[], Iterable[Scan]]
    odom_T_laser: Trajectory | None


def read_recording(path: Path) -> Recording | None:
    """Open the recording of a run; None where there is none, or it cannot be read."""
    try:
        log = open_log(path) if path.is_file() else None
    except UNREADABLE:
        return None
    if log is None:
        return None
    return Recording(len(log), log.sensor, log.scans, log.odometry.odom_T_laser if log.odometry else None)


def recording_of(run: RunResult) -> Recording:
    """Return what `read_recording` would find in result.mcap, which takes longer than the rest of a page."""
    stamps_ns, path = run.slam.trajectory.stamps_ns.tolist(), None
    if odometry := run.log.odometry:
        path = Trajectory.of(stamps_ns, [nearest_pose(odometry.odom_T_laser, stamp_ns) for stamp_ns in stamps_ns])
    return Recording(len(stamps_ns), run.log.sensor, lambda: (scan for scan, _ in placed_scans(run)), path)


def beams(logs: Sequence[Recording | None], stamps_s: Floats, firsts: Sequence[int], max_ranges: int) -> Arrays:
    """Return what was seen: ``bearing`` (beams,) in rad, ``range`` (rows, beams) in mm, 0 is no return.

    ``stamps_s`` (n,) are those of the scans; those from ``firsts[k]`` on are of ``logs[k]``. ``row`` (n,) is the row of
    each in ``range``, -1 for none. A row holds the differences between neighboring beams, which compress well. Sensors
    are those of the first log; scans of others, and all without a log, have no row.
    """
    spec = next((log.sensor for log in logs if log), None)
    if spec is None:
        return {}
    step = max(1, ceil(sum(log.length for log in logs if log) * spec.beams / max_ranges))
    rows: list[NDArray[np.intp]] = []
    ranges_mm: list[NDArray[np.uint16]] = []
    for log, stamps in zip(logs, np.split(stamps_s, firsts[1:]), strict=True):
        first, recorded_s = len(ranges_mm), []
        for scan in log.scans() if log else ():
            if scan.spec.directions is spec.directions or np.array_equal(scan.spec.directions, spec.directions):
                recorded_s.append(scan.stamp_ns * NS)
                ranges_mm.append(_whole_mm(scan.ranges_m[::step]))
        row = _nearest(np.array(recorded_s), stamps)
        rows.append(np.where(row >= 0, first + row, -1))
    bearing_rad = np.arctan2(*spec.directions[::step].T[::-1])
    stacked_mm = np.array(ranges_mm, np.uint16).reshape(-1, len(bearing_rad))
    return {
        "row": np.concatenate(rows).astype(np.int32),
        "range": np.diff(stacked_mm, axis=1, prepend=np.zeros((len(stacked_mm), 1), np.uint16)),
        "bearing": bearing_rad.astype(np.float32),
    }


def _whole_mm(ranges_m: Floats) -> NDArray[np.uint16]:
    return np.fmin(np.fmax(ranges_m / MM, 0.0), MAX_RANGE_MM).round().astype(np.uint16)  # fmax turns NaN to 0


def _nearest(sorted_s: Floats, wanted_s: Floats) -> NDArray[np.intp]:
    """Return the row of each wanted time in sorted times, -1 where none is within `SAME_S`."""
    if not len(sorted_s):
        return np.full(len(wanted_s), -1)
    row = np.searchsorted(0.5 * (sorted_s[1:] + sorted_s[:-1]), wanted_s)
    return np.where(np.abs(sorted_s[row] - wanted_s) <= SAME_S, row, -1)


def odometry_path(log: Recording, stamp_s: float, map_T_laser: Pose) -> Floats:
    """Return the path of the laser by odometry alone, (n, 2) m, which begins at the pose at a time; may be empty."""
    path = log.odom_T_laser
    if path is None or not len(path):
        return np.zeros((0, 2))
    start = int(np.searchsorted(path.stamps_ns, round((stamp_s - SAME_S) / NS)).clip(0, len(path) - 1))
    map_T_odom = map_T_laser @ path[start].inverse()
    return transform_points(map_T_odom, path.xyyaw[start:, :2])
