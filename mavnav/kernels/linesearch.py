"""Brute-force, coarse-to-fine search for the pose that lays a scan's points on the map's lines (docs/method.md).

The arrays of the map are those of ``linemap``. Grids are searched in turn as in the paper's minimisation, steps i-v:
azimuth with the position fixed, then the plane with the azimuth fixed; the scan turns about its points' centroid.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import float64, int32, int64, types, void

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_LEVELS = 40

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)
_I2 = types.Array(int32, 2, "C", readonly=True)


@kernel(float64(float64[::1], float64[::1], float64[::1], float64, _I2, _F2, _F1, float64))
def _cost_sum(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    offset: NDArray[np.float64],
    truncate_m2: float,
    nearest: NDArray[np.int32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
    bound: float,
) -> float:
    """Sum of the points' squared, truncated distances to their lines; gives up once it exceeds ``bound``."""
    rows, cols = nearest.shape
    ox, oy, inverse = geometry[0], geometry[1], 1.0 / geometry[2]
    total = 0.0
    for k in range(len(x)):
        px, py = x[k] + offset[0], y[k] + offset[1]
        # Beyond the lower edge the conversion towards zero could fall on row or column 0: test before it.
        fx, fy = (px - ox) * inverse, (py - oy) * inverse
        d2 = truncate_m2
        if fx >= 0.0 and fy >= 0.0 and fx < cols and fy < rows:
            slot = nearest[int64(fy), int64(fx)]
            if slot >= 0:
                dx, dy = px - lines[slot, 0], py - lines[slot, 1]
                d2 = min(
                    dx * dx * lines[slot, 2] + 2.0 * dx * dy * lines[slot, 3] + dy * dy * lines[slot, 4], truncate_m2
                )
        total += d2
        if total > bound:
            break
    return total


@kernel(void(_F2, int64, float64[::1], float64, float64[::1], float64[::1]))
def _rotate(
    points: NDArray[np.float64],
    n: int,
    pivot: NDArray[np.float64],
    yaw: float,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> None:
    """Turn the first ``n`` points about the pivot."""
    c, s = np.cos(yaw), np.sin(yaw)
    for k in range(n):
        dx, dy = points[k, 0] - pivot[0], points[k, 1] - pivot[1]
        x[k] = c * dx - s * dy
        y[k] = s * dx + c * dy


@kernel(float64[::1](_F2, _F1, _F1, _F1, _I2, _F2, _F1))
def search(
    points: NDArray[np.float64],
    start: NDArray[np.float64],
    grid: NDArray[np.float64],
    limits: NDArray[np.float64],
    nearest: NDArray[np.int32],
    lines: NDArray[np.float64],
    geometry: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Find the pose of the scan in the map; returns [x, y, yaw, cost_m2, inliers, evaluations, grids, converged].

    Parameters
    ----------
    points : (n, 2) points in the laser's frame, m, in an order that makes any prefix a fair sample
    start : (3,) predicted pose: x, y (m), yaw (rad)
    grid : (4,) points of the azimuth grid and of the plane in x and y, border extensions a grid at most
    limits : (8,) half-window in the plane (m) and azimuth (rad), spacing to stop at (m, rad), truncation (m),
        points of the first level, alternations a level, and what a squared metre away from the start costs a point
    nearest, lines, geometry : the map, see ``linemap``
    """
    n = len(points)
    azimuths, nx, ny, extensions = int(grid[0]), int(grid[1]), int(grid[2]), int(grid[3])
    half_m, half_rad, stop_m, stop_rad, truncate_m = limits[:5]
    truncate_m2 = truncate_m * truncate_m
    alternations = int(limits[6])

    pivot = np.zeros(2)
    for k in range(n):
        pivot[0] += points[k, 0] / n
        pivot[1] += points[k, 1] / n
    yaw = start[2]
    c, s = np.cos(yaw), np.sin(yaw)
    at = np.array([start[0] + c * pivot[0] - s * pivot[1], start[1] + s * pivot[0] + c * pivot[1]])

    expected_x, expected_y = at[0], at[1]

    x, y, offset = np.empty(n), np.empty(n), np.empty(2)
    evaluations, grids, converged = 0, 0, 0.0
    for level in range(MAX_LEVELS):
        used = min(n, int(limits[5])) if level == 0 else n
        step_x, step_y, step_rad = 2 * half_m / (nx - 1), 2 * half_m / (ny - 1), 2 * half_rad / (azimuths - 1)
        for _ in range(alternations):
            for _ in range(extensions + 1):
                best, best_i = np.inf, 0
                for i in range(azimuths):
                    _rotate(points, used, pivot, yaw - half_rad + i * step_rad, x, y)
                    cost = _cost_sum(x[:used], y[:used], at, truncate_m2, nearest, lines, geometry, best)
                    if cost < best:
                        best, best_i = cost, i
                evaluations += azimuths
                grids += 1
                yaw += best_i * step_rad - half_rad
                if 0 < best_i < azimuths - 1:
                    break
            _rotate(points, used, pivot, yaw, x, y)
            for _ in range(extensions + 1):
                best, best_i, best_j = np.inf, 0, 0
                for j in range(ny):
                    offset[1] = at[1] - half_m + j * step_y
                    for i in range(nx):
                        offset[0] = at[0] - half_m + i * step_x
                        dx, dy = offset[0] - expected_x, offset[1] - expected_y
                        cost = used * limits[7] * (dx * dx + dy * dy)
                        cost += _cost_sum(
                            x[:used], y[:used], offset, truncate_m2, nearest, lines, geometry, best - cost
                        )
                        if cost < best:
                            best, best_i, best_j = cost, i, j
                evaluations += nx * ny
                grids += 1
                at[0] += best_i * step_x - half_m
                at[1] += best_j * step_y - half_m
                if 0 < best_i < nx - 1 and 0 < best_j < ny - 1:
                    break
        if max(step_x, step_y) < stop_m and step_rad < stop_rad:
            converged = 1.0
            break
        half_m = min(1.5 * max(step_x, step_y), 0.9 * half_m)
        half_rad = min(1.5 * step_rad, 0.9 * half_rad)

    _rotate(points, n, pivot, yaw, x, y)
    total, inliers = 0.0, 0
    for k in range(n):
        d2 = _cost_sum(x[k : k + 1], y[k : k + 1], at, truncate_m2, nearest, lines, geometry, np.inf)
        total += d2
        inliers += d2 < 0.25 * truncate_m2
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array(
        [
            at[0] - c * pivot[0] + s * pivot[1],
            at[1] - s * pivot[0] - c * pivot[1],
            yaw,
            total / n,
            inliers / n,
            evaluations,
            grids,
            converged,
        ]
    )
