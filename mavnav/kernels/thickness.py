"""Sections through the walls of a hit-count map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba as nb
import numpy as np

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

_HITS = nb.types.Array(nb.int32, 2, "A", readonly=True)
_RUNS = nb.types.Array(nb.int64, 2, "C", readonly=True)


@kernel(nb.int64[:, ::1](_HITS, nb.int64, nb.int64))
def column_runs(hits: NDArray[np.int32], min_hits: int, max_gap: int) -> NDArray[np.int64]:
    """Find the runs of occupied cells along the columns.

    A cell of ``hits`` (rows, cols) is occupied from ``min_hits`` on; a run bridges up to ``max_gap`` empty cells.

    Returns
    -------
    (runs, 4): column, first row, last row, occupied cells; ordered by first row, then column.
    """
    rows, cols = hits.shape
    open_run = np.full(cols, -1, np.int64)
    runs = np.empty((np.count_nonzero(hits >= min_hits), 4), np.int64)
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


@kernel(nb.float64[:, ::1](_HITS, _RUNS, nb.int64, nb.int64, nb.float64))
def run_moments(
    hits: NDArray[np.int32], runs: NDArray[np.int64], min_hits: int, max_gap: int, radius: float
) -> NDArray[np.float64]:
    """Tell the shape of the wall around each run: count and covariance of its cells near the run's middle.

    The cells are those occupied ones within ``radius`` (in cells) that hang together with the run, with up to
    ``max_gap`` empty cells between two of them in row and column: a parallel wall does not count. The covariance is
    weighted by hits. Everything is summed in whole half cells, so that neither the order of summation nor a mirrored
    map changes a bit of the result.

    Returns
    -------
    (runs, 4): cells; variance along the row, covariance and variance along the column, in cells squared.
    """
    rows, cols = hits.shape
    reach, step, limit = np.int64(radius) + 1, max_gap + 1, 4.0 * radius * radius
    side = 2 * reach + 1
    seen = np.full(side * side, -1, np.int64)  # the last run that came by
    stack = np.empty((side * side, 2), np.int64)
    out = np.zeros((len(runs), 4))
    for k in range(len(runs)):
        col, mid2 = runs[k, 0], runs[k, 1] + runs[k, 2]
        r0, c0 = mid2 // 2 - reach + 1, col - reach
        depth = 0
        for r in range(max(runs[k, 1], r0), min(runs[k, 2] + 1, r0 + side)):
            if hits[r, col] >= min_hits and (2 * r - mid2) ** 2 <= limit:
                seen[(r - r0) * side + reach] = k
                stack[depth, 0], stack[depth, 1] = r, col
                depth += 1
        cells = weight = s_x = s_y = s_xx = s_xy = s_yy = 0
        while depth > 0:
            depth -= 1
            r, c = stack[depth, 0], stack[depth, 1]
            h, x2, y2 = int(hits[r, c]), 2 * (c - col), 2 * r - mid2
            cells += 1
            weight += h
            s_x += h * x2
            s_y += h * y2
            s_xx += h * x2 * x2
            s_xy += h * x2 * y2
            s_yy += h * y2 * y2
            for nr in range(max(r - step, r0, 0), min(r + step + 1, r0 + side, rows)):
                for nc in range(max(c - step, c0, 0), min(c + step + 1, c0 + side, cols)):
                    at = nb.uint64((nr - r0) * side + nc - c0)
                    if hits[nb.uint64(nr), nb.uint64(nc)] < min_hits or seen[at] == k:
                        continue
                    if (2 * (nc - col)) ** 2 + (2 * nr - mid2) ** 2 <= limit:
                        seen[at] = k
                        stack[depth, 0], stack[depth, 1] = nr, nc
                        depth += 1
        if cells:
            w = np.float64(weight)
            out[k, 0] = cells
            out[k, 1] = (w * s_xx - np.float64(s_x) * s_x) / (4.0 * w * w)
            out[k, 2] = (w * s_xy - np.float64(s_x) * s_y) / (4.0 * w * w)
            out[k, 3] = (w * s_yy - np.float64(s_y) * s_y) / (4.0 * w * w)
    return out
