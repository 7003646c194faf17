"""What became of the scans, one by one and on the whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from struct import Struct
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np

from mavnav.pose import Pose, Trajectory
from mavnav.slam.scan_matching import Match
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

LOST_SCANS = 5
"""So many scans in a row without an accepted pose are called lost; fewer are rejected scans, unless a jump follows."""

JUMP_M, JUMP_RAD = 0.5, 45 * DEG
"""So much motion over scans without an accepted pose is a gap in the track, however few they are."""

FASTEST_M_S, FASTEST_RAD_S = 3.0, 300 * DEG
"""A jump at more than this is a gap even where no scan is missing: the track was found again elsewhere."""


class Step(NamedTuple):
    """What became of one scan.

    ``tracked``: the match is accepted and stands in the trajectory, and the scan is in the map.
    """

    index: int  # type: ignore[assignment]  # what a tuple calls so is lost
    stamp_ns: int
    match: Match
    tracked: bool


_KINDS = {"int": ("q", "<i8"), "float": ("d", "<f8"), "bool": ("?", "?"), "Pose": ("3d", "3<f8")}
"""Type of a field -> how it is packed, and its column."""

_FIELDS = {
    "index": "int",
    "stamp_ns": "int",
    **{name: kind.__forward_arg__ for name, kind in Match.__annotations__.items()},
    "tracked": "bool",
}
"""The fields of a step, those of its match in place, in order."""

_PACKED = Struct("<" + "".join(_KINDS[kind][0] for kind in _FIELDS.values()))
_COLUMNS = np.dtype([(name, _KINDS[kind][1]) for name, kind in _FIELDS.items()])


class Steps(Sequence[Step]):
    """The steps of a run, packed: 107 bytes a scan, of which the objects take 630; a log may have 100 000 of them."""

    __slots__ = ("_rows",)

    def __init__(self, steps: Iterable[Step] = ()) -> None:
        """Take in some steps."""
        self._rows = bytearray()
        for step in steps:
            self.append(step)

    def append(self, step: Step) -> None:
        """Add a step at the end."""
        self._rows += _pack(step)

    def column(self, name: str) -> NDArray[Any]:
        """Return what a field of the steps or of their matches is, (n,); of poses x, y (m) and yaw (rad), (n, 3)."""
        return np.frombuffer(self._rows, _COLUMNS)[name].copy()

    def share(self, name: str) -> float:
        """Return the share of the steps of which something is true; 0 where there are none."""
        return np.count_nonzero(self.column(name)) / max(len(self), 1)

    def move(self, where: NDArray[np.intp], xy_m: NDArray[np.float64]) -> None:
        """Put the poses of some steps elsewhere: to positions (n, 2), m."""
        np.frombuffer(self._rows, _COLUMNS)["map_T_laser"][where, :2] = xy_m

    def __len__(self) -> int:
        """Count the steps."""
        return len(self._rows) // _PACKED.size

    def __iter__(self) -> Iterator[Step]:
        """Give the steps one after the other."""
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
        """Put another step in the place of one."""
        where = range(len(self))[at] * _PACKED.size
        self._rows[where : where + _PACKED.size] = _pack(step)


def _pack(step: Step) -> bytes:
    index, stamp_ns, (map_T_laser, *evidence), tracked = step
    return _PACKED.pack(index, stamp_ns, *map_T_laser, *evidence, tracked)


def _step(row: tuple[Any, ...]) -> Step:
    index, stamp_ns, x_m, y_m, yaw_rad, *evidence, tracked = row
    return Step(index, stamp_ns, Match(Pose(x_m, y_m, yaw_rad), *evidence), tracked)


@dataclass(frozen=True, slots=True)
class LostInterval:
    """A stretch of scans without an accepted pose, and whether the track was found again after it.

    It has no scans where the track jumped from one scan to the next.
    """

    start_ns: int
    end_ns: int
    scans: int
    recovered: bool


def tracked_trajectory(steps: Steps) -> Trajectory:
    """Return the poses that are accepted (map_T_laser)."""
    tracked = steps.column("tracked")
    return Trajectory(steps.column("stamp_ns")[tracked], steps.column("map_T_laser")[tracked])


def lost_intervals(steps: Steps) -> Iterator[LostInterval]:
    """Find the stretches without an accepted pose: of ``LOST_SCANS`` or more scans, or with a jump across them.

    A jump that no vehicle makes is one even where no scan is missing.
    """
    stamps_ns, tracked = steps.column("stamp_ns").tolist(), np.flatnonzero(steps.column("tracked"))
    jumped, leapt = (np.pad(found, 1) for found in jumps(tracked_trajectory(steps)))
    starts, ends = np.append(0, tracked + 1), np.append(tracked, len(steps))  # of what is between tracked steps
    for k in np.flatnonzero((ends > starts) | leapt[: len(ends)]).tolist():
        start, end, recovered = int(starts[k]), int(ends[k]), k < len(tracked)
        many = LOST_SCANS if recovered else min(LOST_SCANS, len(steps))
        if end == start:
            yield LostInterval(stamps_ns[start - 1], stamps_ns[end], 0, recovered=True)
        elif end - start >= many or jumped[k]:
            yield LostInterval(stamps_ns[start], stamps_ns[end - 1], end - start, recovered=recovered)


def jumps(path: Trajectory) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where the pose jumps from one scan to the next farther than a vehicle moves, (n - 1,)."""
    moved, elapsed_s = np.diff(path.xyyaw, axis=0), np.diff(path.stamps_ns) * NS
    moved_m, turned_rad = np.hypot(moved[:, 0], moved[:, 1]), np.abs((moved[:, 2] + pi) % (2.0 * pi) - pi)
    jumped = (moved_m > JUMP_M) | (turned_rad > JUMP_RAD)
    return jumped, jumped & ((moved_m > FASTEST_M_S * elapsed_s) | (turned_rad > FASTEST_RAD_S * elapsed_s))
