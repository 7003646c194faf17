"""The data of the interactive map: runs with their pictures, lines, scans, and the places to look at."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mavnav.outputs.documents.quantities import number, verdict_texts
from mavnav.outputs.pictures.map_axes import top_of_scale
from mavnav.outputs.report.entry import file_in
from mavnav.outputs.report.map_panel import common_window, ghosts
from mavnav.outputs.report.view.images import MAX_PIXELS, map_images, slice_images
from mavnav.outputs.report.view.packing import pack
from mavnav.outputs.report.view.recording import MAX_RANGES, beams, odometry_path, read_recording, recording_of
from mavnav.pose import Pose
from mavnav.units import MM

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from mavnav.outputs.report.entry import Entry, ScanColumns
    from mavnav.outputs.report.pictures import Closeup

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
        yield _stretch("lost", f"track lost, {lost['scans']} scans", lost["start_s"], lost["end_s"])
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
