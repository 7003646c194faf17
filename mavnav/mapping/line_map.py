"""The robust method's map: occupied cells, each with the local line through the points around it.

`CostFloors` are lower bounds of a point's cost over a part of it.
"""

from __future__ import annotations

from functools import partial
from math import floor, hypot

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.kernels.maps import cost_floors
from mavnav.kernels.maps.layout import FAR, LEVELS, NEAR, REACH_CELLS
from mavnav.kernels.maps.linemap import WINDOW_CELLS, Geometry, insert_points, rebuild
from mavnav.kernels.scans.correlative_search import pose_costs
from mavnav.kernels.scans.observability import observability
from mavnav.kernels.scans.points import LONGEST_M, extent, place_points, points_between
from mavnav.mapping.tiled_arrays import NO_EXTENT, Extent, check_size, covered_extent, covering, enlarge, within
from mavnav.pose import Pose
from mavnav.profiling import as_stage

Array = NDArray[np.float64]

_BLOCK_CELLS = 256
MAX_CELLS = 1 << 30
"""Maximum number of cells of the lattice, most of which lie in memory that is never touched."""
MARGIN_CELLS = REACH_CELLS + 2
"""Number of cells around a point that the lattice must include."""
MOST_WAITING = 1 << 12
"""Maximum number of cells with waiting points, which their neighbours do not include yet."""
_AT_ONCE = 1 << 14
"""Number of lines that are moved at a time."""

NO_PULLS = np.zeros((6, 0))
NOWHERE = (1e9, 1e9, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""The line of index 0, so far away that the cost of every point is truncated."""

FLOORS_MARGIN_M = 2.0
"""Distance by which bounds reach beyond the requested extent, so that the next search may be somewhat wider."""


class CostFloors(Struct, frozen=True):
    """Bounds in the cells from ``corner`` (row, col) on, by level and as planes; see ``kernels.maps.cost_floors``.

    They hold within ``extent_m``, for the truncated distance ``truncate_m`` and positions ``step`` cells apart.
    """

    corner: NDArray[np.int64]
    levels: NDArray[np.uint8]
    planes: NDArray[np.uint8]
    truncate_m: float
    step: int
    extent_m: Extent

    def covers(self, truncate_m: float, step: int, extent_m: Extent) -> bool:
        """Return whether the bounds are valid for a search with these settings, whose points lie in an extent."""
        return within(extent_m, self.extent_m) and (truncate_m, step) == (self.truncate_m, self.step)


class LineMap(Struct):
    """A growing map of local lines; see ``mavnav.kernels.maps.linemap`` for the arrays.

    ``origin_cells`` is the lattice index (col, row) of cell [0, 0]; the map frame's origin is always a corner of cells.
    An area is mapped where its line is fitted to ``known_points`` points or more (``line_search``).
    """

    cell_m: float
    line_sigma_m: float
    line_noise_m: float
    known_points: float = 0.0
    waiting_share: float = 0.0
    origin_cells: tuple[int, int] = (0, 0)
    count: int = 1
    nearest: NDArray[np.uint32] = field(default_factory=lambda: np.empty((0, 0), np.uint32))
    cells: NDArray[np.int32] = field(default_factory=lambda: np.empty((1, 2), np.int32))
    moments: Array = field(default_factory=lambda: np.empty((1, 12)))
    lines: Array = field(default_factory=lambda: np.array([NOWHERE]))
    waiting: Array = field(default_factory=lambda: np.zeros((MOST_WAITING + 1, 8)))

    geometry: Array = field(default_factory=partial(np.zeros, 6))
    """The fields of `Geometry`, (6,)."""
    _floors: CostFloors | None = None
    _covered_m: Extent = NO_EXTENT

    def __post_init__(self) -> None:
        """Make the array of the geometry for the kernels."""
        further = (self.cell_m, self.line_sigma_m, self.line_noise_m, self.waiting_share)
        self.geometry = np.array(Geometry(*self.origin_xy_m, *further))

    @property
    def origin_xy_m(self) -> tuple[float, float]:
        """Corner of cell [0, 0] in the map frame."""
        col, row = self.origin_cells
        return col * self.cell_m, row * self.cell_m

    def closeness_at(self, distance_m: float) -> float:
        """Return the value of ``nearest`` for a cell whose nearest occupied one is this far away, m."""
        return FAR + 1 - 1e-9 - (distance_m / self.cell_m) ** 2

    def costs(self, points: Array, xy_m: Array, yaws_rad: Array, truncate_m: float) -> Array:
        """Return the costs (q, p) of points (n, 2), m, laser frame, at positions (p, 2), m, and yaws (q,), rad; m2."""
        return pose_costs(points, xy_m, yaws_rad, truncate_m, self.nearest, self.lines, self.geometry)

    def observability(self, points: Array, map_T_laser: Pose) -> tuple[float, Array]:
        """Return the observability of a pose by points (n, 2), m, laser frame, and its information (6,), in points.

        Both are described in `kernels.scans.observability`.
        """
        pose, information = map_T_laser.as_array(), np.empty(6)
        arrays = self.nearest, self.lines, self.geometry, information, NO_PULLS
        return observability(points, pose, np.inf, 0.0, *arrays), information

    def pulls(self, points: Array, map_T_laser: Pose, within_m: float) -> tuple[Array, Array]:
        """Return the information (6,) and the pulls (6, m) of points (n, 2) within a distance of lines of mapped areas.

        Both are described in `kernels.scans.observability`; columns without points are 0.
        """
        pose, information = map_T_laser.as_array(), np.empty(6)
        pulls = np.zeros((6, 1 << len(points).bit_length()))
        arrays = self.nearest, self.lines, self.geometry, information, pulls
        observability(points, pose, within_m, self.known_points, *arrays)
        return information, pulls

    def cells_within(self, extent_m: Extent) -> float:
        """Return the approximate number of cells of the lattice within an extent."""
        (x, y), (rows, cols), (x0, y0, x1, y1) = self.origin_xy_m, self.nearest.shape, extent_m
        wide_m: float = min(x1, x + cols * self.cell_m) - max(x0, x)
        high_m: float = min(y1, y + rows * self.cell_m) - max(y0, y)
        return float(max(wide_m, 0.0) * max(high_m, 0.0) / self.cell_m**2)

    def cost_floors(self, truncate_m: float, step: int, extent_m: Extent) -> CostFloors:
        """Return bounds of the costs in an extent, for positions ``step`` cells apart; cached until the map changes."""
        if self._floors is None or not self._floors.covers(truncate_m, step, extent_m):
            self._floors = self._new_floors(truncate_m, step, extent_m)
        return self._floors

    def _new_floors(self, truncate_m: float, step: int, extent_m: Extent) -> CostFloors:
        """Return bounds of the costs in an extent, and `FLOORS_MARGIN_M` beyond."""
        x0, y0, x1, y1 = extent_m
        wider = (x0 - FLOORS_MARGIN_M, y0 - FLOORS_MARGIN_M, x1 + FLOORS_MARGIN_M, y1 + FLOORS_MARGIN_M)
        origin, cell_m, shape = self.geometry[:2], self.cell_m, np.array(self.nearest.shape[::-1])
        low = np.clip(np.floor((np.array(wider[:2]) - origin) / cell_m).astype(np.int64), 0, shape)
        high = np.clip(np.ceil((np.array(wider[2:]) - origin) / cell_m).astype(np.int64), low, shape)
        before = ((1 << (LEVELS - 1)) - 1) * step
        corner, size = (low - before)[::-1].copy(), (high - low + before)[::-1]
        box = np.concatenate((corner, size))
        bounds = cost_floors.cost_floors(box, step, truncate_m, self.nearest, self.lines, self.geometry)
        return CostFloors(corner, *bounds, truncate_m, step, wider)

    @as_stage("field update")
    def insert(self, xy_map_m: Array, extent_m: Extent | None = None) -> None:
        """Insert points (n, 2), in m, and refit the lines around them; their ``extent`` may be given."""
        if len(xy_map_m) == 0:
            return
        self._floors = None
        extent_m = extent_m or extent(np.ascontiguousarray(xy_map_m))
        if not within(extent_m, self._covered_m):
            self._cover(extent_m)
            self._covered_m = covered_extent(self.origin_xy_m, self.nearest.shape, self.cell_m, MARGIN_CELLS)
        self._reserve(self.count + len(xy_map_m))
        arrays = self.nearest, self.cells, self.moments, self.lines, self.waiting
        for first in range(0, len(xy_map_m), MOST_WAITING):
            some = np.ascontiguousarray(xy_map_m[first : first + MOST_WAITING])
            self.count = insert_points(some, self.geometry, self.count, *arrays)

    def insert_between(self, points: Array, step_rad: float, map_T_laser: Pose) -> None:
        """Insert points on the walls between beams that are too far apart for lines through their end points.

        Without them standing still fits perfectly: each point finds itself, and no wall. ``points`` (n, 2), m, laser
        frame, are those of a scan in the order of its beams, ``step_rad`` is the angle between two beams.
        """
        reach_m, spacing_m = WINDOW_CELLS * self.cell_m, max(self.line_sigma_m, self.cell_m)
        x0, y0, x1, y1 = extent(points)
        if not len(points) or abs(step_rad) * hypot(max(-x0, x1), max(-y0, y1)) <= reach_m:
            return
        out = np.empty((len(points) * int(LONGEST_M / spacing_m), 2))
        between = out[: points_between(points, abs(step_rad), reach_m, spacing_m, out)]
        place_points(between, map_T_laser.as_array(), between)
        self.insert(between)

    @as_stage("field update")
    def remove(self, xy_map_m: Array) -> None:
        """Remove the cells at some points (n, 2), in m, with all their points; some of these cells may be empty.

        Waiting points of all other cells are included.
        """
        self._floors = None
        cells = np.floor(xy_map_m / self.cell_m).astype(np.int64) - np.array(self.origin_cells)
        inside = ((cells >= 0) & (cells < np.array(self.nearest.shape[::-1]))).all(axis=1)
        col, row = cells[inside].T
        there = self.nearest[row, col]
        removed = there[there % NEAR > FAR] // NEAR
        new = self.waiting[1 : int(self.waiting[0, 0]) + 1]
        at = new[:, 6].astype(np.int64)
        self.moments[at, :6] += new[:, :6]
        self.lines[at, 6] = self.waiting[0, 0] = 0.0
        kept = np.delete(np.arange(self.count), removed)
        self.count = n = len(kept)
        for first in range(0, n, _AT_ONCE):  # in place: two copies of a large map may not fit into memory
            band = slice(first, min(first + _AT_ONCE, n))
            for held in (self.cells, self.moments, self.lines):
                held[band] = held[kept[band]]
        self.nearest = np.zeros(self.nearest.shape, np.uint32)
        rebuild(self.geometry, self.nearest, self.cells[:n], self.moments[:n], self.lines[:n])

    def _cover(self, extent_m: Extent) -> None:
        """Enlarge the lattice until it includes points of this extent and ``MARGIN_CELLS`` around them."""
        x0, y0, x1, y1 = extent_m
        low = (floor(x0 / self.cell_m) - MARGIN_CELLS, floor(y0 / self.cell_m) - MARGIN_CELLS)
        high = (floor(x1 / self.cell_m) + MARGIN_CELLS, floor(y1 / self.cell_m) + MARGIN_CELLS)
        origin = self.origin_cells
        grown = covering(low, high, self.nearest.shape, origin, _BLOCK_CELLS)
        if grown is None:
            return
        new_origin, shape = grown
        check_size(shape, self.cell_m, MAX_CELLS)
        dc, dr = origin[0] - new_origin[0], origin[1] - new_origin[1]
        self.nearest = enlarge(self.nearest, shape, dr, dc)
        self.cells[1 : self.count] += np.array([dr, dc], np.int32)
        self.origin_cells = new_origin
        self.geometry[:2] = self.origin_xy_m

    def _reserve(self, needed: int) -> None:
        """Enlarge the arrays to ``needed`` cells, or four times as many as now: unused memory costs nothing."""
        capacity = len(self.cells)
        if needed <= capacity:
            return
        capacity = max(needed, 4 * capacity, 4096)
        for name in ("cells", "moments", "lines"):
            held = getattr(self, name)
            grown = np.zeros((capacity, held.shape[1]), held.dtype)
            grown[: self.count] = held[: self.count]
            setattr(self, name, grown)
