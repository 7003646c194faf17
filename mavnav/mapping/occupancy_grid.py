"""The occupancy grid: an integer count of laser hits for every cell (paper, "Occupancy Grid Representation")."""

from __future__ import annotations

from math import floor
from typing import Any, Final

import numpy as np
from msgspec import Struct, field
from msgspec.structs import force_setattr
from numpy.typing import NDArray

from mavnav.kernels.maps import hits as hits_kernel
from mavnav.kernels.maps.dynamic_cells import dynamic_cells
from mavnav.kernels.maps.layout import MOST, MOST_SHIELDED, WIDE
from mavnav.kernels.scans.points import extent
from mavnav.mapping import tiled_arrays
from mavnav.mapping.tiled_arrays import Extent
from mavnav.pose import Pose
from mavnav.profiling import as_stage

Array = NDArray[np.float64]

BLOCK_CELLS = 64
_MARGIN_CELLS: Final = 2
MAX_CELLS = 1 << 28
"""Maximum number of cells of a map: 819 m x 819 m with cells of 50 mm."""

LARGE_BYTES: Final = 1 << 22
"""Size of an array of counts from which its largest count is not looked for."""

OCCUPIED_SHARE: Final = 0.2
"""Minimum share of hits among the beams that reached an occupied cell."""

FREE, OCCUPIED, UNKNOWN = 0, 100, -1


class Grid(Struct, frozen=True):
    """Hit counts on a square lattice.

    ``hits[row, col]`` counts laser end points, ``passes[row, col]`` beams that crossed the cell. Both are (rows, cols),
    of any integer type when given; they are stored as uint16, as in a `GridBuilder`, and saturate. Row grows with +y.
    ``origin_xy_m`` is the corner of cell [0, 0] in the map frame, always a whole number of cells.
    """

    cell_m: float
    origin_xy_m: tuple[float, float] = (0.0, 0.0)
    hits: NDArray[np.uint16] = field(default_factory=lambda: np.zeros((0, 0), np.uint16))
    passes: NDArray[np.uint16] = field(default_factory=lambda: np.zeros((0, 0), np.uint16))

    def __repr__(self) -> str:
        """Return cell size, place and shape, in a line."""
        rows, cols = self.hits.shape
        return f"Grid(cell_m={self.cell_m:g}, origin_xy_m={self.origin_xy_m}, hits=uint16[{rows}, {cols}])"

    def __post_init__(self) -> None:
        """Convert the counts as `counts` does."""
        force_setattr(self, "hits", counts(self.hits))
        force_setattr(self, "passes", counts(self.passes))

    @property
    def lattice(self) -> Array:
        """Corner of cell [0, 0] and cell edge in m, shape (3,), as the kernels take it."""
        return np.array([*self.origin_xy_m, self.cell_m])


class GridBuilder(Struct):
    """The counts of a `Grid` while it grows, in two bytes each: they saturate at 65535, ``shielded`` at 32767.

    ``passes`` are (rows, cols). ``shielded`` counts the crossings of a cell in scans with an end point near it; the
    other crossings went clear through. ``hits`` and ``shielded`` are zero except near walls, and stored in strips
    (``tiled_arrays``).
    """

    cell_m: float
    origin_xy_m: tuple[float, float] = (0.0, 0.0)
    hits: NDArray[np.uint16] = field(default_factory=lambda: tiled_arrays.blank_strips((0, 0), np.uint16))
    passes: NDArray[np.uint16] = field(default_factory=lambda: np.zeros((0, 0), np.uint16))
    shielded: NDArray[np.int16] = field(default_factory=lambda: tiled_arrays.blank_strips((0, 0), np.int16))

    _covered_m: Extent = tiled_arrays.NO_EXTENT
    _room: int = 0
    """Number of crossings that cannot fill a cell; negative where that is not known."""

    @property
    def lattice(self) -> Array:
        """Corner of cell [0, 0] and cell edge in m, shape (3,), as the kernels take it."""
        return np.array([*self.origin_xy_m, self.cell_m])

    @classmethod
    def of(cls, grid: Grid) -> GridBuilder:
        """Copy a grid into strips for look-ups; all its crossings count as shielded."""
        shielded = tiled_arrays.in_strips(np.minimum(grid.passes, MOST_SHIELDED).astype(np.int16))
        return cls(grid.cell_m, grid.origin_xy_m, tiled_arrays.in_strips(grid.hits), grid.passes.copy(), shielded)

    def by_rows(self) -> Grid:
        """Return the counts by rows and columns; the crossings are shared, not copied."""
        return Grid(self.cell_m, self.origin_xy_m, tiled_arrays.plain(self.hits), self.passes)

    @as_stage("insert")
    def insert(self, laser: Pose, xy_map_m: Array, extent_m: Extent | None = None) -> None:
        """Count the end points (n, 2) of one scan, in m, and the cells that its beams crossed.

        The ``extent`` of the points is computed unless it is given.
        """
        if len(xy_map_m) == 0:
            return
        extent_m, (x, y, _) = extent_m or extent(np.ascontiguousarray(xy_map_m)), laser
        if not (tiled_arrays.within(extent_m, self._covered_m) and tiled_arrays.within((x, y, x, y), self._covered_m)):
            x0, y0, x1, y1 = extent_m
            low = (floor(min(x0, x) / self.cell_m) - 1, floor(min(y0, y) / self.cell_m) - 1)
            high = (floor(max(x1, x) / self.cell_m) + 1, floor(max(y1, y) / self.cell_m) + 1)
            self._cover(low, high)
            self._covered_m = tiled_arrays.covered_extent(self.origin_xy_m, self.passes.shape, self.cell_m, 1)
        room = self._has_room(2 * len(xy_map_m))
        hits_kernel.add_scan(xy_map_m, np.array([x, y]), self.lattice, self.hits, self.passes, self.shielded, room)

    def _has_room(self, crossings: int) -> bool:
        """Return whether no cell can be full after so many more crossings; the most crossings are found now and then.

        They are not looked for any more once a cell is more than half full, nor in large maps.
        """
        if 0 <= self._room < crossings and self.passes.nbytes < LARGE_BYTES:
            room = MOST - int(self.passes.max(initial=0))
            self._room = room if room > MOST // 2 else -1
        if self._room < crossings:
            return False
        self._room -= crossings
        return True

    def remove_dynamic_cells(self) -> Array:
        """Remove the hits of dynamic cells; return the centres of these cells (n, 2), m."""
        row, col = dynamic_cells(self.hits, self.passes, self.shielded).T
        self.hits[col // WIDE, row, col % WIDE] = 0
        return cell_centres(self, row, col)

    @as_stage("virtual scan")
    def virtual_scan(
        self, laser: Pose, directions: Array, far_m: float, gap_cells: int, *, middle: bool = False
    ) -> Array:
        """Cast the laser's beams over the map (paper, "Virtual Scan").

        ``directions`` (beams, 2) are the beams' cosines and sines in the laser's frame. Returns ranges (beams,) in m
        to the centres of the cells seen, NaN where none lies within ``far_m``. A wall of several cells, of which up to
        ``gap_cells`` may be empty, is represented by its cell with most hits; of several such cells by the nearest one,
        or, with ``middle``, by the one nearest to the middle of the wall.
        """
        from mavnav.kernels.maps import raycast  # noqa: PLC0415  the paper's alone

        return raycast.virtual_scan(self.hits, self.lattice, laser.as_array(), directions, far_m, gap_cells, middle)

    def _cover(self, low: tuple[int, int], high: tuple[int, int]) -> None:
        """Enlarge the arrays until they include cells ``low`` to ``high`` (col, row)."""
        origin = _corner(self)
        grown = tiled_arrays.covering(low, high, self.passes.shape, origin, BLOCK_CELLS)
        if grown is None:
            return
        new_origin, shape = grown
        tiled_arrays.check_size(shape, self.cell_m, MAX_CELLS)
        dc, dr = origin[0] - new_origin[0], origin[1] - new_origin[1]
        for name in ("hits", "passes", "shielded"):  # one by one: each old array is freed before the next is copied
            setattr(self, name, tiled_arrays.enlarge(getattr(self, name), shape, dr, dc))
        self.origin_xy_m = (float(new_origin[0] * self.cell_m), float(new_origin[1] * self.cell_m))


def counts(values: NDArray[Any]) -> NDArray[np.uint16]:
    """Return non-negative integers as uint16, larger ones as the maximum; uint16 arrays are not copied."""
    if values.dtype == np.uint16:
        return values
    return (values if values.dtype.itemsize < 2 else np.minimum(values, MOST)).astype(np.uint16)


def occupancy(grid: Grid) -> NDArray[np.int8]:
    """Return free (0), occupied (100) and unknown (-1) cells as in nav_msgs/OccupancyGrid, (rows, cols).

    Occupied: hit, by at least `OCCUPIED_SHARE` of the beams that ended in the cell or crossed it. Free: any other
    cell that a beam reached.
    """
    out = np.empty(grid.hits.shape, np.int8)
    for _, _, band in tiled_arrays.bands(out.shape):
        hits, seen = grid.hits[band], grid.hits[band].astype(np.int64) + grid.passes[band]
        out[band] = np.where(seen > 0, FREE, UNKNOWN)
        out[band][(hits > 0) & (hits >= OCCUPIED_SHARE * seen)] = OCCUPIED
    return out


def cell_centres(grid: Grid | GridBuilder, row: NDArray[Any], col: NDArray[Any]) -> Array:
    """Return the centres of cells (n,) of a grid, which may lie between whole ones, (n, 2) in m, in its frame."""
    xy_m: Array = (np.column_stack((col, row)) + 0.5) * grid.cell_m + np.array(grid.origin_xy_m)
    return xy_m


def occupied_xy_m(grid: Grid) -> Array:
    """Return the centres of the occupied cells of a grid, (n, 2) in m, in its frame."""
    return cell_centres(grid, *occupied_cells(grid).T)


def occupied_cells(grid: Grid) -> NDArray[np.int64]:
    """Return row and column of the occupied cells, (n, 2), without a copy of the whole map."""
    by_band = [np.zeros((0, 2), np.int64)]
    for _, _, band in tiled_arrays.bands(grid.hits.shape):
        part = Grid(grid.cell_m, grid.origin_xy_m, grid.hits[band], grid.passes[band])
        by_band.append(np.argwhere(occupancy(part) == OCCUPIED) + np.array([band.start, 0]))
    return np.concatenate(by_band)


def known_area(grid: Grid) -> Grid:
    """Return the part of the grid with cells that a beam reached and a small margin; else one cell.

    The arrays are views of the grid's.
    """
    if not (grid.hits.any() or grid.passes.any()):
        return Grid(grid.cell_m, grid.origin_xy_m, np.zeros((1, 1), np.uint16), np.zeros((1, 1), np.uint16))
    rows, cols = (_extent(np.flatnonzero(grid.hits.any(axis=axis) | grid.passes.any(axis=axis))) for axis in (1, 0))
    return part_of(grid, rows, cols)


def measured_area(grid: Grid) -> Grid:
    """Return the known part of the grid, enlarged to whole blocks of cells counted from the map's origin.

    Metrics of this part do not depend on how far the grid extends beyond. The arrays are views of the grid's.
    """
    known = known_area(grid)
    (col, row), (known_col, known_row) = _corner(grid), _corner(known)
    rows = _in_blocks(known_row - row, known.hits.shape[0], grid.hits.shape[0], row)
    return part_of(grid, rows, _in_blocks(known_col - col, known.hits.shape[1], grid.hits.shape[1], col))


def _in_blocks(first: int, count: int, size: int, at: int) -> slice:
    """Return a span of cells without its margins, enlarged to whole blocks within the grid."""
    start = (first + at + 1) // BLOCK_CELLS * BLOCK_CELLS - at
    stop = ((first + at + count - 2) // BLOCK_CELLS + 1) * BLOCK_CELLS - at
    return slice(max(start, 0), min(max(stop, start + 1), size))


def _corner(grid: Grid | GridBuilder) -> tuple[int, int]:
    """Return column and row of cell [0, 0], counted from the map's origin."""
    x_m, y_m = grid.origin_xy_m
    return round(x_m / grid.cell_m), round(y_m / grid.cell_m)


def part_of(grid: Grid, rows: slice, cols: slice) -> Grid:
    """Return some rows and columns of a grid at their place; the arrays are views of the grid's."""
    col, row = _corner(grid)
    origin = ((col + cols.start) * grid.cell_m, (row + rows.start) * grid.cell_m)
    return Grid(grid.cell_m, origin, grid.hits[rows, cols], grid.passes[rows, cols])


def _extent(known: NDArray[np.intp]) -> slice:
    return slice(max(int(known[0]) - _MARGIN_CELLS, 0), int(known[-1]) + 1 + _MARGIN_CELLS)
