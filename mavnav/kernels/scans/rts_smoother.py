"""Smoothing of a path: noisy positions of a motion whose velocity changes little (docs/method.md)."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, Out, kernel


@kernel
def smooth(xy: F64_2D, elapsed: F64_1D, stiffness: float, out: Out[F64_2D]) -> float:
    """Write the positions p that minimise sum |p - xy|^2 + stiffness * sum |acceleration|^2; return the log-likelihood.

    Parameters
    ----------
    xy : (n, 2) positions, n >= 3
    elapsed : (n - 1,) time from each to the next
    stiffness : ratio of the variances of a position and an acceleration, unit of time to the fourth
    out : (n, 2) the smoothed positions

    The log-likelihood, up to a constant and with the best variance of a position, compares values of the stiffness. The
    model is white noise on positions of a path whose velocity is a random walk (the smoother of Rauch, Tung and
    Striebel as one banded system, solved by its LDL' factors).
    """
    n = len(xy)
    d, l1, l2 = np.ones(n), np.zeros(n), np.zeros(n)  # the diagonals 0, 1 and 2 of I + stiffness B'WB
    for k in range(n - 2):
        before, after = elapsed[k], elapsed[k + 1]
        r0, r1, r2 = 1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after
        weight = stiffness * (2.0 / (before + after)) ** 2
        d[k] += weight * r0 * r0
        d[k + 1] += weight * r1 * r1
        d[k + 2] += weight * r2 * r2
        l1[k] += weight * r0 * r1
        l1[k + 1] += weight * r1 * r2
        l2[k] += weight * r0 * r2
    log_determinant, d_1, d_2, l1_1, l2_1, l2_2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # factors of the rows before, _1 and _2
    x_1 = x_2 = y_1 = y_2 = 0.0
    for k in range(n):
        pivot = d[k] - l1_1 * l1_1 * d_1 - l2_2 * l2_2 * d_2
        below, x, y = l1[k] - l1_1 * l2_1 * d_1, xy[k, 0] - l1_1 * x_1 - l2_2 * x_2, xy[k, 1] - l1_1 * y_1 - l2_2 * y_2
        log_determinant += np.log(pivot)
        d_2, l2_2, x_2, y_2 = d_1, l2_1, x_1, y_1
        d_1, l1_1, l2_1, x_1, y_1 = pivot, below / pivot, l2[k] / pivot, x, y
        d[k], l1[k], l2[k], out[k, 0], out[k, 1] = d_1, l1_1, l2_1, x, y
    x_1 = x_2 = y_1 = y_2 = 0.0
    for k in range(n - 1, -1, -1):
        x, y = out[k, 0] / d[k] - l1[k] * x_1 - l2[k] * x_2, out[k, 1] / d[k] - l1[k] * y_1 - l2[k] * y_2
        out[k, 0], out[k, 1], x_1, y_1, x_2, y_2 = x, y, x, y, x_1, y_1
    misfit = 1e-30
    for k in range(n):
        misfit += xy[k, 0] * (xy[k, 0] - out[k, 0]) + xy[k, 1] * (xy[k, 1] - out[k, 1])
    return float((n - 2) * (np.log(stiffness) - np.log(misfit)) - log_determinant)
