"""Text files of true poses: trajectories in TUM format, relations in that of Kuemmerle et al. (2009)."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from math import isfinite
from typing import TYPE_CHECKING, Final

import numpy as np

from mavnav.config.named_files import read_named
from mavnav.errors import UsageError
from mavnav.metrics.reference import Relations
from mavnav.pose import Trajectory, yaw_of_quaternion

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

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

    Rows may have any order of time. Raises UsageError with file and line.
    """
    poses = {}
    for where, columns in _rows(path, "a TUM trajectory, t x y z qx qy qz qw"):
        x, y, _, *quaternion = (_number(where, text) for text in columns[1:])
        if not _is_unit(quaternion):
            raise UsageError(f"{where}: the quaternion is not of length 1; mend that line")
        poses[_stamp_ns(where, columns[0])] = (x, y, yaw_of_quaternion(*quaternion))
    stamps_ns = sorted(poses)
    return Trajectory(np.array(stamps_ns, np.int64), np.array([poses[t] for t in stamps_ns], np.float64))


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
    try:
        text = read_named(path, MAX_BYTES).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise UsageError(f"{path} cannot be read, {reason}; name a file of {what}") from error
    rows = [(f"{path}:{n}", line.partition("#")[0].split()) for n, line in enumerate(text.splitlines(), start=1)]
    rows = [row for row in rows if row[1]]
    if not rows:
        raise UsageError(f"{path} is empty; name a file of {what}")
    for where, columns in rows:
        if len(columns) != COLUMNS:
            raise UsageError(f"{where}: {len(columns)} columns in place of {COLUMNS}; name a file of {what}")
        yield where, columns


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
