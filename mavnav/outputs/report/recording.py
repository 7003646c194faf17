"""What the recording of a run adds to the interactive page: the range of every beam, and the path by odometry."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import ceil
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavnav.errors import MavnavError
from mavnav.logs import open_log
from mavnav.outputs.files.replay_log import nearest_pose, placed_scans
from mavnav.outputs.run import RunResult
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.scan import LaserSpec, Scan
from mavnav.units import MM, NS

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


def beams(
    logs: Sequence[Recording | None], stamps_s: NDArray[np.float64], firsts: Sequence[int], max_ranges: int
) -> dict[str, NDArray[Any]]:
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
            if _same_beams(scan.spec, spec):
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


def _whole_mm(ranges_m: NDArray[np.float64]) -> NDArray[np.uint16]:
    return np.fmin(np.fmax(ranges_m / MM, 0.0), MAX_RANGE_MM).round().astype(np.uint16)  # fmax turns NaN to 0


def _same_beams(spec: LaserSpec, other: LaserSpec) -> bool:
    return spec.directions is other.directions or np.array_equal(spec.directions, other.directions)


def _nearest(sorted_s: NDArray[np.float64], wanted_s: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the row of each wanted time in sorted times, -1 where none is within `SAME_S`."""
    if not len(sorted_s):
        return np.full(len(wanted_s), -1)
    row = np.searchsorted(0.5 * (sorted_s[1:] + sorted_s[:-1]), wanted_s)
    return np.where(np.abs(sorted_s[row] - wanted_s) <= SAME_S, row, -1)


def odometry_path(log: Recording, stamp_s: float, map_T_laser: Pose) -> NDArray[np.float64]:
    """Return the path of the laser by odometry alone, (n, 2) m, which begins at the pose at a time; may be empty."""
    path = log.odom_T_laser
    if path is None or not len(path):
        return np.zeros((0, 2))
    start = int(np.searchsorted(path.stamps_ns, round((stamp_s - SAME_S) / NS)).clip(0, len(path) - 1))
    map_T_odom = map_T_laser @ path[start].inverse()
    return transform_points(map_T_odom, path.xyyaw[start:, :2])
