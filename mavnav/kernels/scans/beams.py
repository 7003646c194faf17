"""The beams of a scan that the paper's method uses: valid ones without mixed pixels (cost function, step vii)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.kernels.machine.jit import kernel
from mavnav.kernels.machine.types import F64_1D, F64_2D, float64

if TYPE_CHECKING:
    from numpy.typing import NDArray


@kernel(float64[:, ::1](F64_1D, F64_2D, float64, float64, float64))
def good_beams(
    ranges_m: NDArray[np.float64],
    directions: NDArray[np.float64],
    first_rad: float,
    step_rad: float,
    mixed_pixel_m: float,
) -> NDArray[np.float64]:
    """Return the valid beams as rows x, y, beam number, range, bearing (n, 5), in m and rad.

    ``ranges_m`` (beams,) are NaN without a return, ``directions`` (beams, 2) the beams' cosines and sines. Beams that
    differ from both their neighbours by more than ``mixed_pixel_m`` are left out.
    """
    last, count, out = len(ranges_m) - 1, 0, np.empty((len(ranges_m), 5))
    for i in range(last + 1):
        r = ranges_m[i]
        alone = 0 < i < last and abs(r - ranges_m[i - 1]) > mixed_pixel_m and abs(r - ranges_m[i + 1]) > mixed_pixel_m
        if alone or not np.isfinite(r):
            continue
        out[count, 0], out[count, 1] = r * directions[i, 0], r * directions[i, 1]
        out[count, 2], out[count, 3], out[count, 4] = i, r, first_rad + step_rad * i
        count += 1
    return out[:count].copy()
