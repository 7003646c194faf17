"""Observability of a scan's pose by the map's lines, in the worst direction (docs/method.md)."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import helper, kernel
from mavnav.kernels.machine.types import F64_1D, F64_2D, U32_2D, Out, float64, int64
from mavnav.kernels.maps.lookup import slot_of


@helper
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


@kernel
def observability(
    points: F64_2D, pose: F64_1D, nearest: U32_2D, lines: F64_2D, geometry: F64_1D, information: Out[F64_1D]
) -> float:
    """Return the least eigenvalue of a scan's information about its pose: 0 if a direction is not observable.

    ``points`` (n, 2) are in the laser frame, m; ``pose`` (3,) is x, y (m) and yaw (rad) in the map frame. A point on a
    wall constrains motion along the wall's normal, with weight 1 / n; a turn counts as the path of a point at the mean
    distance. The map's arrays are described in ``linemap``. Writes the information in the map frame, summed over the
    points, (6,): xx, xy, yy (points), x yaw, y yaw (m), yaw yaw (m2).
    """
    (rows, cols), (to_x, to_y, yaw), (origin_x, origin_y, cell_m, _, _, _) = nearest.shape, pose, geometry
    c, s, cells_per_m = np.cos(yaw), np.sin(yaw), 1.0 / cell_m
    xx = xy = yy = xr = yr = rr = away = 0.0
    for k in range(len(points)):
        x, y = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        away += np.sqrt(x * x + y * y)
        u, v = (x + to_x - origin_x) * cells_per_m, (y + to_y - origin_y) * cells_per_m
        slot = int64(slot_of(nearest[int64(v), int64(u)])) if 0.0 <= u < cols and 0.0 <= v < rows else 0
        if slot > 0:
            # The metric, 1 across the line and beta along it, less beta: it is 0 for a round spot.
            beta = lines[slot, 2] + lines[slot, 4] - 1.0
            axx, axy, ayy = lines[slot, 2] - beta, lines[slot, 3], lines[slot, 4] - beta
            tx, ty = axy * x - axx * y, ayy * x - axy * y
            xx, xy, yy = xx + axx, xy + axy, yy + ayy
            xr, yr, rr = xr + tx, yr + ty, rr + ty * x - tx * y
    information[:] = xx, xy, yy, xr, yr, rr
    n, arm = float64(max(len(points), 1)), max(away / max(len(points), 1), 1e-9)
    return _least_eigenvalue(xx / n, yy / n, rr / (n * arm * arm), xy / n, xr / (n * arm), yr / (n * arm))
