"""Arrays over a lattice of cells that grows: memory goes with the cells that were touched, not with the extent."""

from __future__ import annotations

import mmap
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Cell = tuple[int, int]

SMALL_BYTES = 1 << 22
"""Below, memory is not worth the care; from there on numpy asks for pages of 2 MB, each of which counts as a whole."""

STRIP_ROWS, STRIP_COLS = 16, 1024
BAND_CELLS, LEAST_ROWS = 1 << 20, 64
"""What takes much memory a cell is done for so many cells at a time, and for so many rows at least."""
MARGIN = 8
"""A lattice grows by an eighth of its extent at least: so it is copied rarely, and blank margins cost nothing."""


def blank(shape: tuple[int, int], dtype: Any) -> NDArray[Any]:  # noqa: ANN401
    """Return zeros (rows, cols) whose pages take memory once they are written to."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    if size < SMALL_BYTES or not hasattr(mmap, "MAP_PRIVATE"):
        return np.zeros(shape, dtype)
    pages = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    if hasattr(mmap, "MADV_NOHUGEPAGE"):
        pages.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(pages, dtype).reshape(shape)


def moved(array: NDArray[Any], shape: tuple[int, int], row: int, col: int) -> NDArray[Any]:
    """Return a larger array that holds this one from cell (row, col) on; parts without content are not touched."""
    out, (rows, cols) = blank(shape, array.dtype), array.shape
    for r in range(0, rows, STRIP_ROWS):
        for c in range(0, cols, STRIP_COLS):
            part = array[r : r + STRIP_ROWS, c : c + STRIP_COLS]
            if part.any():
                out[row + r : row + r + part.shape[0], col + c : col + c + part.shape[1]] = part
    return out


def bands(shape: tuple[int, ...], margin: int = 0) -> Iterator[tuple[slice, slice, slice]]:
    """Divide the rows of an array: those of a band with a margin on both sides, the band in these, and in all."""
    rows, step = shape[0], max(LEAST_ROWS, BAND_CELLS // max(shape[1], 1))
    for first in range(0, rows, step):
        end, start = min(first + step, rows), max(first - margin, 0)
        yield slice(start, min(end + margin, rows)), slice(first - start, end - start), slice(first, end)


def covering(low: Cell, high: Cell, shape: Cell, origin: Cell, block: int) -> tuple[Cell, Cell] | None:
    """Find the lattice of whole blocks that covers cells ``low`` to ``high`` (col, row) and the present one.

    It reaches farther than needed on the sides on which it grows. Returns the new origin (col, row) and shape
    (rows, cols), or None where the present lattice covers all.
    """
    end = (origin[0] + shape[1], origin[1] + shape[0])
    if shape[0] and low[0] >= origin[0] and low[1] >= origin[1] and high[0] < end[0] and high[1] < end[1]:
        return None
    (first_col, cols), (first_row, rows) = (_span(low[k], high[k], (origin[k], end[k]), block) for k in (0, 1))
    return (first_col, first_row), (rows, cols)


def _span(low: int, high: int, present: tuple[int, int], block: int) -> Cell:
    """Return the first cell and the number of cells of whole blocks that cover two spans along one axis."""
    first, end = present
    if end > first:
        more = (end - first) // MARGIN
        low = first if low >= first else low - more
        high = end - 1 if high < end else high + more
    low = low // block * block
    return low, (high // block + 1) * block - low


def pooled(cells: NDArray[Any], factor: int, fill: int = 0) -> NDArray[Any]:
    """Shrink by taking the largest of each ``factor`` x ``factor`` block, so that a wall of one cell stays visible.

    Blocks that reach beyond the cells are filled up with ``fill``.
    """
    rows, cols = (-(-n // factor) for n in cells.shape)
    out = np.full((rows, cols), fill, cells.dtype)
    for i in range(factor):
        for j in range(factor):
            part = cells[i::factor, j::factor]
            shown = out[: part.shape[0], : part.shape[1]]
            np.maximum(shown, part, out=shown)
    return out
