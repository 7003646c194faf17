"""Sections through the walls of a hit-count map."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_2D, I64_1D, I64_2D, U8_2D, U8_3D, U16_2D, U16_2D_STRIDED, helper, kernel


@kernel
def column_runs(hits: U16_2D_STRIDED, min_hits: int, max_gap: int) -> I64_2D:
    """Return the runs of occupied cells along the columns.

    A cell of ``hits`` (rows, cols) is occupied from ``min_hits`` on; a run includes gaps of up to ``max_gap`` empty
    cells.

    Returns
    -------
    (runs, 4): column, first row, last row, number of occupied cells; ordered by first row, then column.
    """
    rows, cols = hits.shape
    open_run = np.full(cols, -1, np.int64)
    occupied = 0
    for r in range(rows):
        for c in range(cols):
            occupied += hits[r, c] >= min_hits
    runs = np.empty((occupied, 4), np.int64)
    n = 0
    for r in range(rows):
        for c in range(cols):
            if hits[r, c] < min_hits:
                continue
            k = open_run[c]
            if k < 0 or r - runs[k, 2] > max_gap + 1:
                k = open_run[c] = n
                runs[n, 0], runs[n, 1], runs[n, 3] = c, r, 0
                n += 1
            runs[k, 2] = r
            runs[k, 3] += 1
    return runs[:n].copy()


@helper
def _push_stretch(free: U8_2D, row: int, col: int, stack: I64_2D, depth: int) -> int:
    """Push the stretch of free cells of a row around a cell onto the stack, and mark it; return the new depth."""
    low, high = col, col
    while free[row, low - 1]:
        low -= 1
    while free[row, high + 1]:
        high += 1
    for c in range(low, high + 1):
        free[row, c] = 0
    stack[depth, 0], stack[depth, 1], stack[depth, 2] = row, low, high
    return depth + 1


@helper
def _discs(reach: int, border: int, limit: float) -> U8_3D:
    """Return the discs around the centre of a cell and around the edge to the next row; ``limit`` in half cells."""
    discs = np.zeros((2, 2 * border + 1, 2 * border + 1), np.uint8)
    for half in range(2):
        for r in range(-reach, reach + 1):
            for c in range(-reach, reach + 1):
                discs[half, border + r, border + c] = (2 * c) ** 2 + (2 * r - half) ** 2 <= limit
    return discs


@helper
def _sum_up(
    hits: U16_2D,
    first_row: int,
    first_col: int,
    half: int,
    free: U8_2D,
    stack: I64_2D,
    depth: int,
    step: int,
    sums: I64_1D,
) -> None:
    """Sum over the cells of the stretches on the stack and all connected ones.

    ``sums`` (7,): cells; hits, and weighted by hits x, y, xx, xy, yy from the middle of the window, in half cells.
    """
    middle = len(free) // 2
    sums[:] = 0
    while depth > 0:
        depth -= 1
        row, low, high = stack[depth]
        y2 = 2 * (row - middle) - half
        w = s_x = s_xx = np.int64(0)
        for c in range(low, high + 1):
            h, x2 = np.int64(hits[first_row + row, first_col + c]), 2 * (c - middle)
            w, s_x, s_xx = w + h, s_x + h * x2, s_xx + h * x2 * x2
        sums[0] += high + 1 - low
        sums[1] += w
        sums[2] += s_x
        sums[3] += w * y2
        sums[4] += s_xx
        sums[5] += s_x * y2
        sums[6] += w * y2 * y2
        for near in range(row - step, row + step + 1):
            for c in range(low - step, high + step + 1):
                if free[near, c]:
                    depth = _push_stretch(free, near, c, stack, depth)


@kernel
def run_moments(hits: U16_2D_STRIDED, runs: I64_2D, min_hits: int, max_gap: int, radius: float) -> F64_2D:
    """Return the moments of the wall around each run: count and covariance of its cells near the run's middle.

    The cells are those occupied ones within ``radius`` (in cells) that are connected to the run, with up to
    ``max_gap`` empty cells between two of them in row and column; parallel walls are not included. The covariance is
    weighted by hits. Sums are integers in half cells, so that the result does not depend on the order of summation or
    on mirroring the map.

    Returns
    -------
    (runs, 4): cells; variance along the row, covariance and variance along the column, in cells squared.
    """
    rows, cols = hits.shape
    reach, step = int(radius) + 1, max_gap + 1
    border = reach + step
    occupied = np.zeros((rows + 2 * border, cols + 2 * border), np.uint8)
    for r in range(rows):
        for c in range(cols):
            occupied[border + r, border + c] = hits[r, c] >= min_hits
    discs = _discs(reach, border, 4.0 * radius * radius)
    free = np.empty(discs.shape[1:], np.uint8)  # cells near the run that are in no stretch yet
    stack, sums = np.empty((free.size, 3), np.int64), np.empty(7, np.int64)
    out = np.zeros((len(runs), 4))
    for k in range(len(runs)):
        col, half = runs[k, 0], (runs[k, 1] + runs[k, 2]) % 2
        row, top = (runs[k, 1] + runs[k, 2]) // 2, runs[k, 1] - (runs[k, 1] + runs[k, 2]) // 2 + border
        for r in range(len(free)):
            here, near, disc = free[r], occupied[row + r, col : col + len(free)], discs[half, r]
            for c in range(len(here)):
                here[c] = near[c] & disc[c]
        depth = 0
        for r in range(max(top, 0), min(top + runs[k, 2] - runs[k, 1] + 1, len(free))):
            if free[r, border]:
                depth = _push_stretch(free, r, border, stack, depth)
        _sum_up(hits, row - border, col - border, half, free, stack, depth, step, sums)
        cells, w, s_x, s_y, s_xx, s_xy, s_yy = sums
        if cells:
            out[k, 0] = cells
            out[k, 1] = (np.float64(w) * s_xx - np.float64(s_x) * s_x) / (4.0 * w * w)
            out[k, 2] = (np.float64(w) * s_xy - np.float64(s_x) * s_y) / (4.0 * w * w)
            out[k, 3] = (np.float64(w) * s_yy - np.float64(s_y) * s_y) / (4.0 * w * w)
    return out
