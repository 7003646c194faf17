"""Smoothing of an image, or its slope, by two passes of one-dimensional weights."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F32_2D, F64_1D, helper, kernel


@helper
def _add(total: F64_1D, after: F64_1D, weight: float, sign: float, before: F64_1D) -> None:
    """Add two neighbours of each cell (n,), weighted."""
    for c in range(len(total)):
        total[c] += (after[c] + sign * before[c]) * weight


@kernel
def smooth_image(image: F32_2D, down: F64_1D, across: F64_1D, down_sign: float, across_sign: float) -> F32_2D:
    """Return the weighted sums of each cell of an image (rows, cols) and its neighbours, along columns, then rows.

    ``down`` and ``across`` are the weights of the middle and of the neighbours after it; those before it have the same
    weights times the sign, 1 or -1. The image is reflected at its edges. Sums are float64, rounded to float32 after
    each pass.
    """
    rows, cols = image.shape
    far_down, far_across = len(down) - 1, len(across) - 1
    wide = image.astype(np.float64)
    out = np.empty((rows, cols), np.float32)
    total, line = np.empty(cols), np.empty(cols + 2 * far_across)
    for r in range(rows):
        for c in range(cols):
            total[c] = wide[r, c] * down[0]
        for k in range(far_down, 0, -1):
            before, after = (r - k) % (2 * rows), (r + k) % (2 * rows)
            before, after = min(before, 2 * rows - 1 - before), min(after, 2 * rows - 1 - after)
            _add(total, wide[after], down[k], down_sign, wide[before])
        for c in range(cols):
            line[far_across + c] = np.float32(total[c])
        for k in range(far_across):
            left, right = (-1 - k) % (2 * cols), (cols + k) % (2 * cols)
            line[far_across - 1 - k] = line[far_across + min(left, 2 * cols - 1 - left)]
            line[far_across + cols + k] = line[far_across + min(right, 2 * cols - 1 - right)]
        for c in range(cols):
            total[c] = line[far_across + c] * across[0]
        for k in range(far_across, 0, -1):
            _add(total, line[far_across + k :], across[k], across_sign, line[far_across - k :])
        for c in range(cols):
            out[r, c] = np.float32(total[c])
    return out
