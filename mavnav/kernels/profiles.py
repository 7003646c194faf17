"""Profiles across walls: counts along the normal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.kernels._jit import kernel
from mavnav.kernels._types import F64_2D, U16_2D_STRIDED, float64, int32, int64

if TYPE_CHECKING:
    from numpy.typing import NDArray


@kernel(float64[:, :, :, ::1](U16_2D_STRIDED, U16_2D_STRIDED, F64_2D, int64, int64))
def wall_profiles(
    hits: NDArray[np.uint16],
    passes: NDArray[np.uint16],
    stations: NDArray[np.float64],
    half_length: int,
    reach: int,
) -> NDArray[np.float64]:
    """Return the mean hits and crossings at each distance from a wall, for both halves of a stretch of it.

    Parameters
    ----------
    hits, passes : (rows, cols); counts outside are 0
    stations : (n, 3) column and row, in cells (whole numbers are centres), and direction of the wall in rad
    half_length : length of the wall on either side of a station, in cells
    reach : distance to either side of the wall, in cells

    Returns
    -------
    (2, n, 2, 4 * reach + 1): mean hits a cell, then crossings, on the half behind the station and on the half ahead of
    it, every half cell along the normal (to the left of the direction) from ``-reach`` to ``reach``.
    """
    rows, cols = hits.shape
    bins, samples = 4 * reach + 1, 2 * half_length
    out, at = np.empty((2, len(stations), 2, bins)), np.empty((2, samples), np.int32)
    along = 0.5 * np.arange(samples) + 0.25
    for k in range(len(stations)):
        c, s = np.cos(stations[k, 2]), np.sin(stations[k, 2])
        for half in range(2):
            sign = 2.0 * half - 1.0
            for b in range(bins):
                v = 0.5 * b - reach
                for i in range(samples):  # in a loop without the sums, which uses SIMD lanes
                    u = sign * along[i]
                    at[0, i] = int32(np.floor(stations[k, 0] + u * c - v * s + 0.5))
                    at[1, i] = int32(np.floor(stations[k, 1] + u * s + v * c + 0.5))
                hit, passed = 0, 0
                for i in range(samples):
                    col, row = at[0, i], at[1, i]
                    if 0 <= row < rows and 0 <= col < cols:
                        hit += hits[row, col]
                        passed += passes[row, col]
                out[0, k, half, b], out[1, k, half, b] = hit / samples, passed / samples
    return out
