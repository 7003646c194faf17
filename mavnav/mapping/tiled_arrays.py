"""Arrays over a growing lattice of cells: memory is proportional to the cells that were written, not to the extent.

Counts that are zero except near walls are stored in strips, (cols / `WIDE`, rows, `WIDE`): cell (row, col) is
``[col // WIDE, row, col % WIDE]``. A memory page then holds a block of about 64 x 32 cells. In a row-major array it
holds a part of one row, and a wall across the rows touches a page for each of its cells. The offset in memory is a sum
of a column's and a row's part, ``col + col // WIDE * WIDE * (rows - 1) + WIDE * row``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavnav.errors import MapTooLargeError
from mavnav.kernels.maps.layout import WIDE

Cell = tuple[int, int]
Extent = tuple[float, float, float, float]
"""Least x, least y, largest x and largest y of points, m."""
CellFunction = Callable[[NDArray[Any]], NDArray[Any]]
"""Function from the values of cells to one value for each."""

NO_EXTENT = (inf, inf, -inf, -inf)
"""Extent of a lattice without cells."""

BAND_CELLS, LEAST_ROWS = 1 << 18, 64
"""Number of cells, and minimum number of rows, of a band: operations with much memory a cell go band by band."""
AT_ONCE = 1 << 17
"""Number of cells that are copied at a time, in whole rows or strips."""

MARGIN = 8
"""Divisor of the extent by which a lattice grows at least: it is copied rarely, and unwritten margins cost nothing."""


def blank_strips(cells: Cell, dtype: Any) -> NDArray[Any]:  # noqa: ANN401
    """Return strips of zeros for (rows, cols)."""
    return np.zeros((cells[1] // WIDE, cells[0], WIDE), dtype)


def enlarge(cells: NDArray[Any], extent: Cell, row: int, col: int) -> NDArray[Any]:
    """Return a larger array (rows, cols), row-major or in strips as this one, with this one at cell (row, col).

    All columns are whole strips. Memory of zeros is not touched.
    """
    in_strips = cells.ndim == 3
    grown = blank_strips(extent, cells.dtype) if in_strips else np.zeros(extent, cells.dtype)
    first, along = (col // WIDE, row) if in_strips else (row, col // WIDE)
    new, old = _runs(grown)[first:], _runs(cells)
    step = max(1, AT_ONCE // max(old[:1].size, 1))
    for at in range(0, len(old), step):
        i, j = np.nonzero(np.bitwise_or.reduce(old[at : at + step].view(np.uint64), axis=2))
        new[i + at, j + along] = old[i + at, j]
    return grown


def _runs(cells: NDArray[Any]) -> NDArray[Any]:
    """View an array as runs of `WIDE` cells of a row, (n, m, `WIDE`)."""
    return cells.reshape(len(cells), cells.size // max(len(cells), 1) // WIDE, WIDE)


def plain(strips: NDArray[Any]) -> NDArray[Any]:
    """Return a row-major copy of strips, (rows, cols); memory of zeros is not touched."""
    rows, cols = strips.shape[1], strips.shape[0] * WIDE
    out = np.zeros((rows, cols), strips.dtype)
    by_rows = strips.transpose(1, 0, 2)
    for first in range(0, rows, WIDE):
        band = by_rows[first : first + WIDE]
        row, strip = np.nonzero(band.any(axis=2))
        out[first : first + WIDE].reshape(len(band), -1, WIDE)[row, strip] = band[row, strip]
    return out


def in_strips(cells: NDArray[Any]) -> NDArray[Any]:
    """Return cells (rows, cols) in strips, padded with zeros to whole strips."""
    rows, cols = cells.shape
    out = blank_strips((rows, -(-cols // WIDE) * WIDE), cells.dtype)
    for strip, first in zip(out, range(0, cols, WIDE), strict=False):
        part = cells[:, first : first + WIDE]
        strip[:, : part.shape[1]] = part
    return out


def bands(shape: tuple[int, ...], margin: int = 0) -> Iterator[tuple[slice, slice, slice]]:
    """Divide the rows of an array into bands; yield the rows of a band with margins, the band in these, and in all."""
    rows, step = shape[0], max(LEAST_ROWS, margin, BAND_CELLS // max(shape[1], 1))
    for first in range(0, rows, step):
        end, start = min(first + step, rows), max(first - margin, 0)
        yield slice(start, min(end + margin, rows)), slice(first - start, end - start), slice(first, end)


def where(cells: NDArray[Any], test: CellFunction) -> NDArray[np.intp]:
    """Return row and column, (n, 2), of the cells that pass a test, in row-major order, without a mask of all cells."""
    by_band = [np.argwhere(test(cells[band])) + np.array([band.start, 0]) for _, _, band in bands(cells.shape)]
    return np.concatenate([np.zeros((0, 2), np.intp), *by_band])


def count(cells: NDArray[Any], test: CellFunction) -> int:
    """Return the number of cells that pass a test, without a mask of all cells."""
    return sum(int(np.count_nonzero(test(cells[band]))) for _, _, band in bands(cells.shape))


def farther(cells: NDArray[np.bool_], beyond_m: float, cell_m: float, *, outside: bool) -> NDArray[np.bool_]:
    """Return which cells of a mask (rows, cols) are farther than a distance, m, from every cell that is not in it.

    What lies ``outside`` is in the mask or not. The time hardly depends on the distance: how far a cell is from the
    next such cell of its column gives how far along its row the disc around that one reaches.
    """
    reach, out = int(beyond_m / cell_m) + 2, np.empty(cells.shape, np.bool_)
    squares = np.arange(reach + 1) ** 2
    half_widths = np.array([np.count_nonzero(np.sqrt(squares + each) * cell_m <= beyond_m) for each in squares])
    for rows, inner, band in bands(cells.shape, reach):
        within = np.pad(cells[rows], 1, constant_values=outside)
        width, col = half_widths[_column_steps(within, reach)], np.arange(within.shape[1])
        near = np.maximum.accumulate(col + width, axis=1) > col
        near |= np.minimum.accumulate((col - width)[:, ::-1], axis=1)[:, ::-1] < col
        out[band] = ~near[1:-1, 1:-1][inner]
    return out


def _column_steps(cells: NDArray[np.bool_], most: int) -> NDArray[np.int32]:
    """Return how many rows each cell is from the nearest one of its column that is not in a mask, up to ``most``."""
    steps = np.where(cells, np.int32(most), np.int32(0))
    for way in (steps, steps[::-1]):
        for before, row in pairwise(way):
            np.minimum(row, before + 1, out=row)
    return steps


def covering(low: Cell, high: Cell, shape: Cell, origin: Cell, block: int) -> tuple[Cell, Cell] | None:
    """Return the lattice of whole blocks that covers cells ``low`` to ``high`` (col, row) and the present lattice.

    On the sides on which it grows it extends farther than needed. Returns the new origin (col, row) and shape
    (rows, cols), or None if the present lattice covers all.
    """
    end = (origin[0] + shape[1], origin[1] + shape[0])
    if shape[0] and low[0] >= origin[0] and low[1] >= origin[1] and high[0] < end[0] and high[1] < end[1]:
        return None
    (first_col, cols), (first_row, rows) = (_span(low[k], high[k], (origin[k], end[k]), block) for k in (0, 1))
    return (first_col, first_row), (rows, cols)


def check_size(shape: Cell, cell_m: float, most: int) -> None:
    """Raise MapTooLargeError for a lattice (rows, cols) of more than ``most`` cells."""
    if shape[0] * shape[1] <= most:
        return
    height_m, width_m = (cells * cell_m for cells in shape)
    raise MapTooLargeError(
        f"the map would be {width_m:.0f} m x {height_m:.0f} m in cells of {cell_m * 1e3:g} mm, "
        "too large for the memory: a pose or a range is far off, "
        "or the cells are too small; see the ranges with 'mavnav info', or --set ...cell_mm"
    )


def covered_extent(origin_xy_m: tuple[float, float], shape: tuple[int, ...], cell_m: float, beyond: int) -> Extent:
    """Return the extent of points that a lattice of (rows, cols) covers with ``beyond`` cells around each."""
    (x, y), (rows, cols), rim_m = origin_xy_m, shape, (beyond + 1) * cell_m  # one more for rounding errors
    return x + rim_m, y + rim_m, x + cols * cell_m - rim_m, y + rows * cell_m - rim_m


def within(extent_m: Extent, covered_m: Extent) -> bool:
    """Return whether an extent lies within another one: in a third of the time of computing the points' cells."""
    (x0, y0, x1, y1), (low_x, low_y, high_x, high_y) = extent_m, covered_m
    return low_x <= x0 and low_y <= y0 and x1 <= high_x and y1 <= high_y


def _span(low: int, high: int, present: tuple[int, int], block: int) -> Cell:
    """Return the first cell and the number of cells of whole blocks that cover two spans along one axis."""
    first, end = present
    if end > first:
        more = (end - first) // MARGIN
        low = first if low >= first else low - more
        high = end - 1 if high < end else high + more
    low = low // block * block
    return low, (high // block + 1) * block - low


def crop(cells: NDArray[Any], known: NDArray[np.bool_]) -> NDArray[Any]:
    """Leave out the rows and columns at the borders in which nothing is known; a cell is left at least."""
    rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    return cells[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1] if len(rows) else cells[:1, :1]


def max_pool(cells: NDArray[Any], factor: int, fill: int = 0, value_of: CellFunction = np.asarray) -> NDArray[Any]:
    """Return the maximum of ``value_of(cells)`` over each ``factor`` x ``factor`` block, which keeps walls of one cell.

    Blocks that reach beyond the cells are padded with ``fill``.
    """
    rows, cols = (-(-n // factor) for n in cells.shape)
    out = np.full((rows, cols), fill, value_of(cells[:0]).dtype)
    for i in range(factor):
        for j in range(factor):
            part = value_of(cells[i::factor, j::factor])
            shown = out[: part.shape[0], : part.shape[1]]
            np.maximum(shown, part, out=shown)
    return out
