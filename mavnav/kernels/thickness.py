"""Sections through the walls of a hit-count map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba as nb
import numpy as np

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

_HITS = nb.types.Array(nb.int32, 2, "C", readonly=True)
_RUNS = nb.types.Array(nb.int64, 2, "C", readonly=True)


@kernel(nb.int64[:, ::1](_HITS, nb.int64, nb.int64))
def column_runs(hits: NDArray[np.int32], min_hits: int, max_gap: int) -> NDArray[np.int64]:
    """Find the runs of occupied cells along the columns.

    A cell of ``hits`` (rows, cols) is occupied from ``min_hits`` on; a run bridges up to ``max_gap`` empty cells.

    Returns
    -------
    (runs, 5): column, first row, last row, occupied cells, sum of their hits; ordered by first row, then column.
    """
    rows, cols = hits.shape
    open_run = np.full(cols, -1, np.int64)
    runs = np.empty((np.count_nonzero(hits >= min_hits), 5), np.int64)
    n = 0
    for r in range(rows):
        for c in range(cols):
            if hits[r, c] < min_hits:
                continue
            k = open_run[c]
            if k < 0 or r - runs[k, 2] > max_gap + 1:
                k = open_run[c] = n
                runs[n, 0], runs[n, 1], runs[n, 3], runs[n, 4] = c, r, 0, 0
                n += 1
            runs[k, 2] = r
            runs[k, 3] += 1
            runs[k, 4] += hits[r, c]
    return runs[:n].copy()


@kernel(nb.float64[:, ::1](_HITS, _RUNS, nb.int64, nb.int64, nb.float64))
def run_moments(
    hits: NDArray[np.int32], runs: NDArray[np.int64], min_hits: int, min_cells: int, radius: float
) -> NDArray[np.float64]:
    """Tell the shape of the map around the middle of each run: the covariance of the occupied cells, weighted by hits.

    ``radius`` of the neighbourhood is in cells. Everything is summed in whole half cells, so that neither the order
    of summation nor a mirrored map changes a bit of the result.

    Returns
    -------
    (runs, 4): variance along the row, covariance, variance along the column, in cells squared, and sum of hits;
    NaN where fewer than ``min_cells`` cells of the neighbourhood are occupied.
    """
    rows, cols = hits.shape
    reach = np.int64(radius)
    out = np.full((len(runs), 4), np.nan)
    for k in range(len(runs)):
        col, mid2 = runs[k, 0], runs[k, 1] + runs[k, 2]
        cells = weight = s_x = s_y = s_xx = s_xy = s_yy = 0
        for r in range(max(0, mid2 // 2 - reach), min(rows, (mid2 + 1) // 2 + reach + 1)):
            for c in range(max(0, col - reach), min(cols, col + reach + 1)):
                h, x2, y2 = int(hits[r, c]), 2 * (c - col), 2 * r - mid2
                if h < min_hits or x2 * x2 + y2 * y2 > 4.0 * radius * radius:
                    continue
                cells += 1
                weight += h
                s_x += h * x2
                s_y += h * y2
                s_xx += h * x2 * x2
                s_xy += h * x2 * y2
                s_yy += h * y2 * y2
        if cells >= min_cells:
            w = out[k, 3] = np.float64(weight)
            out[k, 0] = (w * s_xx - np.float64(s_x) * s_x) / (4.0 * w * w)
            out[k, 1] = (w * s_xy - np.float64(s_x) * s_y) / (4.0 * w * w)
            out[k, 2] = (w * s_yy - np.float64(s_y) * s_y) / (4.0 * w * w)
    return out
