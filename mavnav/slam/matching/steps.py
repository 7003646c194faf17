"""Steps: the result of each scan, and the lost intervals and the trajectory that follow from them."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from math import pi
from typing import Any, NamedTuple, overload

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.pose import Pose, Trajectory
from mavnav.slam.matching.scan_matching import Match
from mavnav.units import DEG, NS

LOST_SCANS = 5
"""Minimum number of scans in a row without an accepted pose that are a lost interval; fewer need a jump across them."""

NEARLY_ALL = 0.9
"""Share of the scans with a pose, or with odometry, from which it does not matter that the others have none."""

JUMP_M, JUMP_RAD = 0.5, 45 * DEG
"""Motion across scans without an accepted pose that makes them a lost interval, however few they are."""

FASTEST_M_S, FASTEST_RAD_S = 3.0, 300 * DEG
"""Speed above which a jump is a lost interval even between successive scans: the laser was relocalized elsewhere."""


class Step(NamedTuple):
    """The result of one scan.

    ``tracked``: the match is accepted, its pose is in the trajectory, and the scan is in the map.
    """

    index: int  # type: ignore[assignment]  # hides ``tuple.index``, which is not used
    stamp_ns: int
    match: Match
    tracked: bool


_KINDS = {"int": ("q", "<i8"), "float": ("d", "<f8"), "bool": ("?", "?"), "Pose": ("3d", "3<f8")}
"""Type of a field -> its `struct` format and its numpy type."""

_MATCH_FIELDS = {name: kind.__forward_arg__ for name, kind in Match.__annotations__.items()}
_FIELDS = {"index": "int", "stamp_ns": "int", **_MATCH_FIELDS, "tracked": "bool"}
"""Fields of a step in order, with those of its match in place of ``match``, and their types."""

_PACKED = struct.Struct("<" + "".join(_KINDS[kind][0] for kind in _FIELDS.values()))
_COLUMNS = np.dtype([(name, _KINDS[kind][1]) for name, kind in _FIELDS.items()])


class Steps(Sequence[Step]):
    """The steps of a run, packed in 123 bytes each; as objects they take 630, and a log may have 100 000 scans."""

    __slots__ = ("_rows",)

    def __init__(self, steps: Iterable[Step] = ()) -> None:
        """Pack the given steps."""
        self._rows = bytearray()
        for step in steps:
            self.append(step)

    def append(self, step: Step) -> None:
        """Add a step at the end."""
        self._rows += _pack(step)

    def column(self, name: str) -> NDArray[Any]:
        """Return a field of all steps or of their matches, (n,); poses as x, y (m) and yaw (rad), (n, 3)."""
        return np.frombuffer(self._rows, _COLUMNS)[name].copy()

    def share(self, name: str) -> float:
        """Return the share of the steps whose field is true; 0 if there are no steps."""
        return np.count_nonzero(self.column(name)) / max(len(self), 1)

    def move(self, where: NDArray[np.intp], xy_m: NDArray[np.float64]) -> None:
        """Set the positions (n, 2), m, of the steps with the numbers ``where``."""
        np.frombuffer(self._rows, _COLUMNS)["map_T_laser"][where, :2] = xy_m

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self._rows) // _PACKED.size

    def __iter__(self) -> Iterator[Step]:
        """Yield the steps in order."""
        return map(_step, _PACKED.iter_unpack(self._rows))

    @overload
    def __getitem__(self, at: int) -> Step: ...
    @overload
    def __getitem__(self, at: slice) -> list[Step]: ...
    def __getitem__(self, at: int | slice) -> Step | list[Step]:
        """Return one step, or a list of some."""
        where = range(len(self))[at]
        if isinstance(where, range):
            return [self[k] for k in where]
        return _step(_PACKED.unpack_from(self._rows, where * _PACKED.size))

    def __setitem__(self, at: int, step: Step) -> None:
        """Replace one step."""
        where = range(len(self))[at] * _PACKED.size
        self._rows[where : where + _PACKED.size] = _pack(step)


def _pack(step: Step) -> bytes:
    index, stamp_ns, (map_T_laser, *evidence), tracked = step
    return _PACKED.pack(index, stamp_ns, *map_T_laser, *evidence, tracked)


def _step(row: tuple[Any, ...]) -> Step:
    index, stamp_ns, x_m, y_m, yaw_rad, *evidence, tracked = row
    return Step(index, stamp_ns, Match(Pose(x_m, y_m, yaw_rad), *evidence), tracked)


def refused_by(steps: Steps) -> NDArray[np.str_]:
    """Return the rule of the paper's method that refused each scan, (n,); empty if it was accepted.

    "beams": too few valid ones to match; "share": too few of these agree with the map; "cost": above its threshold.
    """
    unmatched = np.where(steps.column("evaluations") > 0, "share", "beams")
    return np.where(steps.column("tracked"), "", np.where(np.isfinite(steps.column("cost_m2")), "cost", unmatched))


class LostInterval(Struct, frozen=True):
    """An interval of scans without an accepted pose; ``recovered`` if a pose was accepted after it.

    ``scans`` is 0 for a jump between two successive scans.
    """

    start_ns: int
    end_ns: int
    scans: int
    recovered: bool


def tracked_trajectory(steps: Steps) -> Trajectory:
    """Return the accepted poses (map_T_laser)."""
    tracked = steps.column("tracked")
    return Trajectory(steps.column("stamp_ns")[tracked], steps.column("map_T_laser")[tracked])


def lost_intervals(steps: Steps) -> Iterator[LostInterval]:
    """Yield the intervals without an accepted pose: of ``LOST_SCANS`` or more scans, or with a jump across them.

    A jump faster than any vehicle is an interval of no scans.
    """
    stamps_ns, tracked = steps.column("stamp_ns").tolist(), np.flatnonzero(steps.column("tracked"))
    jumped, leapt = (np.pad(between, 1) for between in jumps(tracked_trajectory(steps)))
    starts, ends = np.append(0, tracked + 1), np.append(tracked, len(steps))  # of the scans between tracked ones
    for k in np.flatnonzero((ends > starts) | leapt[: len(ends)]).tolist():
        start, end, recovered = int(starts[k]), int(ends[k]), k < len(tracked)
        many = LOST_SCANS if recovered else min(LOST_SCANS, len(steps))
        if end == start:
            yield LostInterval(stamps_ns[start - 1], stamps_ns[end], 0, recovered=True)
        elif end - start >= many or jumped[k]:
            yield LostInterval(stamps_ns[start], stamps_ns[end - 1], end - start, recovered=recovered)


def jumps(path: Trajectory) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which motions between successive poses are jumps, and which of these are too fast, each (n - 1,)."""
    moved, elapsed_s = np.diff(path.xyyaw, axis=0), np.diff(path.stamps_ns) * NS
    moved_m, turned_rad = np.hypot(moved[:, 0], moved[:, 1]), np.abs((moved[:, 2] + pi) % (2.0 * pi) - pi)
    jumped = (moved_m > JUMP_M) | (turned_rad > JUMP_RAD)
    return jumped, jumped & ((moved_m > FASTEST_M_S * elapsed_s) | (turned_rad > FASTEST_RAD_S * elapsed_s))


def evenly(count: int, most: int) -> list[int]:
    """Choose numbers below a count, so many at most, at even distances."""
    numbers: list[int] = np.unique(np.linspace(0, count - 1, most).astype(int)).tolist()
    return numbers if count else []
