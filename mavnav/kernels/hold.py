"""How firmly the map's lines hold a scan in its place, in the direction that they hold least (docs/method.md)."""

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


@kernel(float64(float64, float64, float64, float64, float64, float64))
def _least_eigenvalue(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> float:
    """Return the least eigenvalue of a symmetric matrix of three rows, in closed form."""
    mean = (xx + yy + zz) / 3.0
    xx, yy, zz = xx - mean, yy - mean, zz - mean
    size = np.sqrt((xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
    if size == 0.0:
        return mean
    det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    angle = np.arccos(min(max(0.5 * det / size**3, -1.0), 1.0)) / 3.0
    least: float = mean + 2.0 * size * np.cos(angle + 2.0 * np.pi / 3.0)
    return least


@kernel(float64(_F2, _F1, _U2, _F2, _F1))
def hold(
    points: NDArray[np.float64],
    pose: NDArray[np.float64],
    nearest: NDArray[np.uint32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> float:
    """Return the least eigenvalue of the information that points (n, 2), laser frame, m, give of a pose x, y (m), yaw.

    A point on a wall tells of the motion along its normal; a point counts as one over ``n``, a turn as the way of a
    point at the mean distance. The map's arrays are described in ``linemap``.
    """
    rows, cols = nearest.shape
    c, s, inverse = np.cos(pose[2]), np.sin(pose[2]), 1.0 / geometry[2]
    xx = xy = yy = xr = yr = rr = away = 0.0
    for k in range(len(points)):
        x, y = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        away += np.sqrt(x * x + y * y)
        u, v = (x + pose[0] - geometry[0]) * inverse, (y + pose[1] - geometry[1]) * inverse
        slot = int64(nearest[int64(v), int64(u)] // NEAR) if 0.0 <= u < cols and 0.0 <= v < rows else 0
        if slot > 0:
            # Of a line's metric, 1 across and beta along it, what is left without beta: nothing of a round spot.
            beta = lines[slot, 2] + lines[slot, 4] - 1.0
            axx, axy, ayy = lines[slot, 2] - beta, lines[slot, 3], lines[slot, 4] - beta
            tx, ty = axy * x - axx * y, ayy * x - axy * y
            xx, xy, yy = xx + axx, xy + axy, yy + ayy
            xr, yr, rr = xr + tx, yr + ty, rr + ty * x - tx * y
    n, arm = float64(max(len(points), 1)), max(away / max(len(points), 1), 1e-9)
    return _least_eigenvalue(xx / n, yy / n, rr / (n * arm * arm), xy / n, xr / (n * arm), yr / (n * arm))
