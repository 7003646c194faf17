"""Text files of poses: trajectories in TUM format and as CSV, relations in the format of Kuemmerle et al. (2009)."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Iterator
from decimal import Decimal, InvalidOperation
from math import isfinite
from operator import itemgetter
from pathlib import Path
from typing import Final

import numpy as np

from mavnav.config.named_files import read_named
from mavnav.errors import UsageError
from mavnav.metrics.reference import Relations
from mavnav.pose import Trajectory, yaw_of_quaternion

_Row = tuple[int, tuple[float, float, float]]
"""Stamp in ns, and x (m), y (m), yaw (rad)."""


COLUMNS: Final = 8
UNIT_TOLERANCE: Final = 0.01
LEAST_UNITS: Final = 3
"""Rows of relations that all end in a quaternion of length 1 are those of a TUM file; fewer rows may by chance."""

MAX_BYTES: Final = 100_000_000
"""Maximum size of a file, about a million rows; the arrays take several times as much memory."""

LATEST_S: Final = 9_000_000_000
"""Latest time in seconds: later ones do not fit in 64 bits of nanoseconds."""


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory: rows of ``t x y z qx qy qz qw`` (s, m, unit quaternion), ``#`` begins a comment.

    Rows may have any order of time; of several with one stamp the last counts. Raises UsageError with file and line.
    """
    return _in_order(_of_tum(path))[0]


def _of_tum(path: Path) -> Iterator[_Row]:
    for where, columns in _rows(path, "a TUM trajectory, t x y z qx qy qz qw"):
        x, y, _, *quaternion = (_number(where, text) for text in columns[1:])
        yield _stamp_ns(where, columns[0]), (x, y, _yaw_rad(where, quaternion))


TRAJECTORIES: Final = "a trajectory: TUM, CSV with t,x,y,yaw (s, m, rad), trajectory.csv of a run, or EuRoC"
KITTI_COLUMNS: Final = 12
EUROC_COLUMNS: Final = 8
"""Least number of columns of EuRoC's state estimates: time in ns, position, quaternion from w on, and more."""


def read_trajectory(path: Path) -> tuple[Trajectory, int]:
    """Read a trajectory by its content, and count its stamps with poses that differ, of which the last counts.

    It is TUM, or comma-separated rows of one of three kinds:

    ``t,x,y,yaw`` (s, m, m, rad); ``trajectory.csv`` of a run, whose scans without a pose are left out; and the state
    estimates of EuRoC, ``t,x,y,z,qw,qx,qy,qz`` (ns, m). Raises UsageError with file and line, also for KITTI's poses,
    which have no times.
    """
    lines = [line for line in _text(path, TRAJECTORIES).splitlines() if line.strip()]
    data = next((line for line in lines if not line.startswith("#")), "")
    if "," in data:
        return _in_order(_of_table(path, list(csv.reader(lines))))
    if len(data.split()) == KITTI_COLUMNS:
        advice = "make a TUM file of poses and times with evo's kitti_poses_and_timestamps_to_trajectory.py"
        raise UsageError(f"{path} has poses without times (KITTI); {advice}")
    return _in_order(_of_tum(path))


def _of_table(path: Path, rows: list[list[str]]) -> list[_Row]:
    """Return the poses of comma-separated rows, the first of which may be a head."""
    head = [name.strip(" #") for name in rows[0]]
    names = {name: k for k, name in enumerate(head)}
    euroc = any("[ns]" in name for name in head)
    wanted = ("stamp", "x_m", "y_m", "yaw_rad") if "stamp" in names else ("t", "x", "y", "yaw")
    columns = [names.get(name, k) for k, name in enumerate(wanted)]
    poses = []
    for number, row in enumerate(rows, start=1):
        where = f"{path}, row {number}"
        if row[0].startswith("#") or (number == 1 and not _is_number(row[0])):
            continue
        if not euroc and wanted[3] not in names and len(row) != len(wanted):
            raise UsageError(f"{where}: {len(row)} columns, of which none is named yaw; name a file of {TRAJECTORIES}")
        if len(row) < (EUROC_COLUMNS if euroc else 1 + max(columns)):
            raise UsageError(f"{where}: {len(row)} columns are too few; name a file of {TRAJECTORIES}")
        if euroc:
            x, y, _, w, *xyz = (_number(where, text) for text in row[1:EUROC_COLUMNS])
            poses.append((_stamp_ns(where, f"{row[0]}e-9"), (x, y, _yaw_rad(where, [*xyz, w]))))
        elif all(row[k].strip() for k in columns):
            x, y, yaw = (_number(where, row[k]) for k in columns[1:])
            poses.append((_stamp_ns(where, row[columns[0]]), (x, y, yaw)))
    if not poses:
        raise UsageError(f"{path} has no pose; name a file of {TRAJECTORIES}")
    return poses


def _in_order(rows: Iterable[_Row]) -> tuple[Trajectory, int]:
    """Return a trajectory with the last pose of each stamp, and how many stamps have poses that differ."""
    pairs = set(rows := list(rows))
    poses = dict(sorted(rows, key=itemgetter(0)))
    several = sum(count > 1 for count in Counter(stamp_ns for stamp_ns, _ in pairs).values())
    return Trajectory(np.array([*poses], np.int64), np.array([*poses.values()], np.float64)), several


def _yaw_rad(where: str, quaternion: list[float]) -> float:
    if not _is_unit(quaternion):
        raise UsageError(f"{where}: the quaternion is not of length 1; mend that line")
    return yaw_of_quaternion(*quaternion)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_relations(path: Path) -> Relations:
    """Read relations: rows of ``t1 t2 x y z roll pitch yaw`` (s, s, m, rad), the pose at t2 in the frame of that at t1.

    Raises UsageError with file and line, and for a TUM trajectory.
    """
    stamps_ns, xyyaw, units = [], [], 0
    for where, columns in _rows(path, "relations, t1 t2 x y z roll pitch yaw"):
        x, y, *others = (_number(where, text) for text in columns[2:])
        units += _is_unit(others)
        stamps_ns.append([_stamp_ns(where, text) for text in columns[:2]])
        xyyaw.append((x, y, others[-1]))
    if units == len(xyyaw) >= LEAST_UNITS:
        raise UsageError(f"{path} is a TUM trajectory, t x y z qx qy qz qw; give it with --truth")
    return Relations(np.array(stamps_ns, np.int64), np.array(xyyaw, np.float64))


def _is_unit(quaternion: list[float]) -> bool:
    return abs(sum(q * q for q in quaternion) - 1.0) <= UNIT_TOLERANCE


def _rows(path: Path, what: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the location (``file:line``) and the columns of each row."""
    lines = _text(path, what).splitlines()
    rows = [(f"{path}:{n}", line.partition("#")[0].split()) for n, line in enumerate(lines, start=1)]
    rows = [row for row in rows if row[1]]
    if not rows:
        raise UsageError(f"{path} is empty; name a file of {what}")
    for where, columns in rows:
        if len(columns) != COLUMNS:
            raise UsageError(f"{where}: {len(columns)} columns in place of {COLUMNS}; name a file of {what}")
        yield where, columns


def _text(path: Path, what: str) -> str:
    try:
        return read_named(path, MAX_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise UsageError(f"{path} cannot be read, {reason}; name a file of {what}") from error


def _number(where: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not isfinite(value):
        raise UsageError(f"{where}: {text!r} is no number; mend that line")
    return value


def _stamp_ns(where: str, text: str) -> int:
    """Return a time in ns from text in seconds, with all digits: a float would round the nanoseconds."""
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        seconds = Decimal("NaN")
    if not seconds.is_finite() or abs(seconds) > LATEST_S:
        raise UsageError(f"{where}: {text!r} is no time in seconds; mend that line")
    return round(seconds * 1_000_000_000)
