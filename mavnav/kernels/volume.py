"""The cost of a scan at every one of many poses: the raw material of a wide search (docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import float64, int64, types, uint32

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

NEAR = 128  # an entry of ``nearest`` is an index times this, as ``linemap`` has it

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)
_U2 = types.Array(uint32, 2, "C", readonly=True)


@kernel(float64[:, ::1](_F2, _F2, _F1, float64, _U2, _F2, _F1))
def volume(
    points: NDArray[np.float64],
    xy_map_m: NDArray[np.float64],
    yaws_rad: NDArray[np.float64],
    truncate_m: float,
    nearest: NDArray[np.uint32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the mean truncated squared distance to the map's lines, m2, for all yaws (q) and positions (p): (q, p).

    ``points`` (n, 2) lie in the laser's frame; the map's arrays are described in ``linemap``.
    """
    rows, cols = nearest.shape
    ox, oy, inverse = geometry[0], geometry[1], 1.0 / geometry[2]
    n, truncate_m2 = len(points), truncate_m * truncate_m
    out = np.empty((len(yaws_rad), len(xy_map_m)))
    x, y = np.empty(n), np.empty(n)
    for q in range(len(yaws_rad)):
        c, s = np.cos(yaws_rad[q]), np.sin(yaws_rad[q])
        for k in range(n):
            x[k], y[k] = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        for p in range(len(xy_map_m)):
            total = 0.0
            for k in range(n):
                px, py = x[k] + xy_map_m[p, 0], y[k] + xy_map_m[p, 1]
                fx, fy = (px - ox) * inverse, (py - oy) * inverse
                d2 = truncate_m2
                if fx >= 0.0 and fy >= 0.0 and fx < cols and fy < rows:
                    slot = int64(nearest[int64(fy), int64(fx)] // NEAR)
                    dx, dy = px - lines[slot, 0], py - lines[slot, 1]
                    xx, xy, yy = lines[slot, 2], lines[slot, 3], lines[slot, 4]
                    d2 = min(dx * dx * xx + 2.0 * dx * dy * xy + dy * dy * yy, truncate_m2)
                total += d2
            out[q, p] = total / n
    return out
