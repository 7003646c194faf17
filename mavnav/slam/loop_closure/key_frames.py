"""Key frames: the tracked scans in which loops are searched, their map, what each saw, and the drift between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.kernels.scans.points import extent
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, transform_points, wrap_angle
from mavnav.slam.matching.scan_matching import empty_line_map
from mavnav.units import DEG

Points = NDArray[np.float64]


KEY_M, KEY_RAD = 0.3, 15 * DEG
"""Path length or rotation from one key frame to the next."""

SQUARE_M = 0.1
"""Edge of the squares by which key frames are compared: points in the same square are taken as the same wall."""

_ROW = 1 << 32
"""Length of a row in the numbering of squares of the plane."""


class KeyFrame(Struct, frozen=True):
    """A tracked scan: row in the trajectory, path length so far (m), points (n, 2) in the laser frame (m), and pose."""

    row: int
    path_m: float
    points: Points
    map_T_laser: Pose


def key_rows(
    xyyaw: NDArray[np.float64], key_m: float = KEY_M, key_rad: float = KEY_RAD
) -> tuple[list[int], list[float]]:
    """Return the rows of the key frames among poses (n, 3), and the path length up to each, m."""
    steps_m = np.hypot(*np.diff(xyyaw[:, :2], axis=0).T)
    path_m = np.concatenate(([0.0], steps_m.cumsum()))
    rows: list[int] = []
    last_m = last_rad = -np.inf
    for row, (at_m, yaw_rad) in enumerate(zip(path_m.tolist(), xyyaw[:, 2].tolist(), strict=False)):
        if at_m - last_m >= key_m or abs(wrap_angle(yaw_rad - last_rad)) >= key_rad:
            rows.append(row)
            last_m, last_rad = at_m, yaw_rad
    return rows, path_m[rows].tolist()


class KeyFrameMap:
    """A part of the map, built from some of the key frames, in the frame in which their poses are given."""

    def __init__(self, config: Config, rays_m: float = np.inf) -> None:
        """Start empty; free space is drawn up to a range."""
        self.rays_m = rays_m
        self.lines = empty_line_map(config)
        self.grid = GridBuilder(self.lines.cell_m)
        self.count = 0

    def grow(self, keys: Sequence[KeyFrame], count: int) -> None:
        """Insert the next key frames, up to the number ``count``."""
        some = keys[self.count : count]
        ends_m = [transform_points(key.map_T_laser, key.points) for key in some]
        xy_map_m = np.concatenate([np.zeros((0, 2)), *ends_m])
        extent_m = extent(xy_map_m)  # of all, so that the map is enlarged only once
        self.lines.insert(xy_map_m, extent_m)  # of all, so that each line is fitted only once
        for key, seen_m in zip(some, ends_m, strict=True):
            near = np.hypot(*key.points.T) <= self.rays_m
            self.grid.insert(key.map_T_laser, seen_m[near], extent_m)
        self.count = max(count, self.count)


PART_M = 1.0
"""Path length around a key frame whose scans it is measured against, which are nearly rigid."""

RAYS_M = 8.0
"""Range up to which free space is drawn in local maps: it is what a laser at the same place looks through."""

KEPT = 8
"""Number of local maps that are kept, of some 8 MB each: a path that is followed again needs them in turn."""


class LocalMaps:
    """Maps of short parts of the path, each in the frame of its middle key frame, drawn when they are needed.

    They stay valid when the path between them is corrected.
    """

    def __init__(self, keys: Sequence[KeyFrame], config: Config) -> None:
        """Start without maps; the key frames may become more."""
        self._keys, self._config = keys, config
        self._maps: dict[int, KeyFrameMap] = {}

    def part_at(self, i: int) -> tuple[int, KeyFrameMap]:
        """Return the middle key frame of the part around key frame ``i``, and the map of the part in its frame."""
        paths_m = np.array([key.path_m for key in self._keys])
        middle = int(np.argmin(np.abs(paths_m - (paths_m[i] // PART_M + 0.5) * PART_M)))
        if middle not in self._maps:
            near = np.flatnonzero(np.abs(paths_m - paths_m[middle]) <= 1.5 * PART_M)
            if len(self._maps) == KEPT:
                self._maps.pop(next(iter(self._maps)))
            self._maps[middle] = self._draw(middle, near.tolist())
        return middle, self._maps[middle]

    def _draw(self, middle: int, near: list[int]) -> KeyFrameMap:
        """Draw the map of some key frames."""
        at, part = self._keys[middle].map_T_laser, KeyFrameMap(self._config, RAYS_M)
        some = (self._keys[k] for k in near)
        part.grow([replace(key, map_T_laser=at.between(key.map_T_laser)) for key in some], len(near))
        return part


class Visibility:
    """Index from squares of the plane to the key frames that saw them, and the local maps of these."""

    def __init__(self, keys: Sequence[KeyFrame], local: LocalMaps) -> None:
        """Start with no key frame in the index."""
        self.keys, self.local = keys, local
        self.count = 0
        self._seen_by: dict[int, list[int]] = {}

    def grow(self, count: int) -> None:
        """Add the next key frames, up to the number ``count``."""
        for k in range(self.count, count):
            for square in squares(self.keys[k]):
                self._seen_by.setdefault(square, []).append(k)
        self.count = max(count, self.count)

    def reference(self, key: KeyFrame) -> int:
        """Return the indexed key frame that saw most squares of ``key``, at the pose of ``key``.

        Of several, the nearest is returned, and of equally near ones the first. The nearest key frame alone may not
        have seen the same walls.
        """
        seen = [k for square in squares(key) for k in self._seen_by.get(square, ())]
        common = np.bincount(np.array(seen, np.intp), minlength=self.count)
        most = np.flatnonzero(common == common.max()).tolist()
        return min(most, key=lambda k: self.keys[k].map_T_laser.between(key.map_T_laser).distance_m)

    def local_map(self, key: KeyFrame) -> tuple[Pose, KeyFrameMap]:
        """Return the local map of what ``key`` seems to see, and its pose."""
        middle, part = self.local.part_at(self.reference(key))
        return self.keys[middle].map_T_laser, part


def squares(key: KeyFrame) -> set[int]:
    """Return the numbers of the squares with points of a key frame."""
    col, row = np.floor(transform_points(key.map_T_laser, key.points) / SQUARE_M).astype(np.int64).T
    return set((row * _ROW + col).tolist())


DRIFT_M, DRIFT_RAD = (0.3, 0.06, 4.0), (5 * DEG, 0.8 * DEG, 30 * DEG)
"""Drift bound: constant, increase per metre of path, and maximum."""


def drift_bound(path_m: float) -> tuple[float, float]:
    """Return the drift bound after a path of this length, m and rad."""
    (first_m, more_m, most_m), (first_rad, more_rad, most_rad) = DRIFT_M, DRIFT_RAD
    return min(first_m + more_m * path_m, most_m), min(first_rad + more_rad * path_m, most_rad)


def shortest_path(a_m: float, b_m: float, across: Sequence[tuple[float, float]]) -> float:
    """Return the length of the shortest path between two points of the track, m, over one connection at most.

    Points are given by their path lengths; ``across`` are those that closures connect: these show no drift between.
    """
    return min(abs(b_m - a_m), *(abs(start_m - a_m) + abs(end_m - b_m) for start_m, end_m in across), np.inf)
