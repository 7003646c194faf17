"""Observability of a scan's pose by the map's lines, in the worst direction (docs/method.md)."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, U32_2D, Out, float64, helper, int64, kernel
from mavnav.kernels.maps.lookup import line_distance2, slot_of

PIECE_M = 0.3
"""Edge of a square of the map within which residuals have a common cause, m: results are alike from 0.1 to 1 m."""


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


@helper
def _column_of(piece: tuple[float, float], pulls: F64_2D) -> int:
    """Return the column of a square of the map in ``pulls``, a hash table with linear probing."""
    (east, north), mask = piece, pulls.shape[1] - 1
    column: int = (int64(east) * 73856093 ^ int64(north) * 19349663) & mask
    while pulls[5, column] and (pulls[3, column] != east or pulls[4, column] != north):
        column = (column + 1) & mask
    return column


@kernel
def observability(
    points: F64_2D,
    pose: F64_1D,
    within_m: float,
    known_points: float,
    nearest: U32_2D,
    lines: F64_2D,
    geometry: F64_1D,
    information: Out[F64_1D],
    pulls: Out[F64_2D],
) -> float:
    """Return the least eigenvalue of a scan's information about its pose: 0 if a direction is not observable.

    ``points`` (n, 2) are in the laser frame, m; ``pose`` (3,) is x, y (m) and yaw (rad) in the map frame. A point on a
    wall constrains motion along the wall's normal, with weight 1 / n; a turn counts as the path of a point at the mean
    distance. Points ``within_m`` of a line that is fitted to ``known_points`` or more count. The map's arrays are
    described in ``linemap``. Writes the information in the map frame, summed over the points, (6,): xx, xy, yy
    (points), x yaw, y yaw (m), yaw yaw (m2). Adds to ``pulls``, zeros (6, m) with m = 2**k > n, or m = 0: half
    the negative gradient of the squared distances by x, y (m) and yaw (m2), summed over squares of `PIECE_M`, with the
    indices of the square in x and y and its number of points.
    """
    (rows, cols), (to_x, to_y, yaw), (origin_x, origin_y, cell_m, _, _, _) = nearest.shape, pose, geometry
    c, s, cells_per_m, within_m2 = np.cos(yaw), np.sin(yaw), 1.0 / cell_m, within_m * within_m
    xx = xy = yy = xr = yr = rr = away = 0.0
    for k in range(len(points)):
        x, y = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        away += np.sqrt(x * x + y * y)
        u, v = (x + to_x - origin_x) * cells_per_m, (y + to_y - origin_y) * cells_per_m
        slot = int64(slot_of(nearest[int64(v), int64(u)])) if 0.0 <= u < cols and 0.0 <= v < rows else 0
        if slot == 0 or lines[slot, 5] < known_points:
            continue
        if line_distance2(x + to_x, y + to_y, within_m2, slot, lines) < within_m2:
            # The metric, 1 across the line and beta along it, less beta: it is 0 for a round spot.
            beta = lines[slot, 2] + lines[slot, 4] - 1.0
            axx, axy, ayy = lines[slot, 2] - beta, lines[slot, 3], lines[slot, 4] - beta
            tx, ty = axy * x - axx * y, ayy * x - axy * y
            xx, xy, yy = xx + axx, xy + axy, yy + ayy
            xr, yr, rr = xr + tx, yr + ty, rr + ty * x - tx * y
            if pulls.shape[1]:
                dx, dy = x + to_x - lines[slot, 0], y + to_y - lines[slot, 1]
                piece = np.floor((x + to_x) / PIECE_M), np.floor((y + to_y) / PIECE_M)
                at = _column_of(piece, pulls)
                pulls[0, at] -= axx * dx + axy * dy
                pulls[1, at] -= axy * dx + ayy * dy
                pulls[2, at] -= tx * dx + ty * dy
                pulls[3, at], pulls[4, at] = piece
                pulls[5, at] += 1.0
    information[:] = xx, xy, yy, xr, yr, rr
    n, arm = float64(max(len(points), 1)), max(away / max(len(points), 1), 1e-9)
    return _least_eigenvalue(xx / n, yy / n, rr / (n * arm * arm), xy / n, xr / (n * arm), yr / (n * arm))
