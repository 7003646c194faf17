"""A way made smooth: positions as they were measured against a velocity that changes little (docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import float64, types

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)


@kernel(float64(_F2, _F1, float64, float64[:, ::1]))
def smooth(xy: NDArray[np.float64], elapsed: NDArray[np.float64], stiffness: float, out: NDArray[np.float64]) -> float:
    """Write the positions p that minimise sum |p - xy|^2 + stiffness * sum |acceleration|^2; returns how likely.

    Parameters
    ----------
    xy : (n, 2) positions, n >= 3
    elapsed : (n - 1,) time from each to the next
    stiffness : variance of a position over that of an acceleration, to the unit of time to the fourth
    out : (n, 2) the smooth positions

    The logarithm of the likelihood (but for a constant, and with the best variance of a position) compares values of
    the stiffness: white noise on positions of a way whose velocity walks at random (Rauch, Tung and Striebel's smoother
    as one banded system, solved by its LDL' factors).
    """
    n = len(xy)
    band = np.zeros((3, n))  # the diagonal of I + stiffness B'WB, and the two beside it
    band[0] = 1.0
    row = np.empty(3)
    for k in range(n - 2):
        before, after = elapsed[k], elapsed[k + 1]
        row[0], row[1], row[2] = 1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after
        weight = stiffness * (2.0 / (before + after)) ** 2
        for i in range(3):
            for j in range(3 - i):
                band[i, k + j] += weight * row[j] * row[j + i]
    log_determinant = 0.0
    out[:] = xy
    for k in range(n):
        for i in range(1, min(k, 2) + 1):
            # Rows before hold d, l1, l2 of the factors already.
            at = k - i
            factor, pivot = band[i, at], band[0, at]
            band[0, k] -= factor * factor * pivot
            if i == 1 and at + 2 < n:
                band[1, k] -= factor * band[2, at] * pivot
            out[k] -= factor * out[at]
        log_determinant += np.log(band[0, k])
        band[1, k] /= band[0, k]
        band[2, k] /= band[0, k]
    for k in range(n - 1, -1, -1):
        out[k] /= band[0, k]
        for i in range(1, min(n - 1 - k, 2) + 1):
            out[k] -= band[i, k] * out[k + i]
    misfit = 1e-30
    for k in range(n):
        misfit += xy[k, 0] * (xy[k, 0] - out[k, 0]) + xy[k, 1] * (xy[k, 1] - out[k, 1])
    return float((n - 2) * (np.log(stiffness) - np.log(misfit)) - log_determinant)
