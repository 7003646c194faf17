"""Profiles across walls: counts along the normal."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_2D, F64_3D, U16_2D_STRIDED, int32, kernel, uint64


@kernel
def wall_profiles(counts: U16_2D_STRIDED, stations: F64_2D, half_length: int, reach: int) -> F64_3D:
    """Return the mean count at each distance from a wall, for both halves of a stretch of it.

    Parameters
    ----------
    counts : (rows, cols) hits or crossings; those outside are 0
    stations : (n, 3) column and row, in cells (whole numbers are centres), and direction of the wall in rad
    half_length : length of the wall on either side of a station, in cells
    reach : distance to either side of the wall, in cells

    Returns
    -------
    (n, 2, 4 * reach + 1): mean count a cell on the half behind the station and on the half ahead of it, every half cell
    along the normal (to the left of the direction) from ``-reach`` to ``reach``.
    """
    rows, cols = uint64(counts.shape[0]), uint64(counts.shape[1])
    bins, samples = 4 * reach + 1, 2 * half_length
    out, at = np.empty((len(stations), 2, bins)), np.empty((2, samples), np.int32)
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
                total = 0
                for i in range(samples):
                    col, row = uint64(at[0, i]), uint64(at[1, i])  # a negative number becomes a large one
                    if row < rows and col < cols:
                        total += counts[row, col]
                out[k, half, b] = total / samples
    return out
