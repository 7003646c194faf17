"""The paper's scan matching: cost function (steps iii-xi) and minimisation (steps i-v) in polar coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import float64, int64, types

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_ITERATIONS = 60

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)


@kernel(float64(float64, float64, float64, float64))
def _angle_between(px: float, py: float, qx: float, qy: float) -> float:
    """Angle from p to q in rad: for small ones, as between neighbouring poses, a series good to 1e-11."""
    cross, dot = px * qy - py * qx, px * qx + py * qy
    if abs(cross) >= 0.2 * dot:
        return float(np.arctan2(cross, dot))
    t = cross / dot
    u = t * t
    return t * (1.0 - u * (1 / 3 - u * (1 / 5 - u * (1 / 7 - u * (1 / 9 - u * (1 / 11 - u * (1 / 13)))))))


@kernel(types.UniTuple(float64, 2)(_F1, _F2, float64, float64, float64, _F1, float64[::1]))
def polar_cost(
    virtual: NDArray[np.float64],
    points: NDArray[np.float64],
    x: float,
    y: float,
    yaw: float,
    limits: NDArray[np.float64],
    seen: NDArray[np.float64],
) -> tuple[float, float]:
    """Mean squared radius difference (m2) between virtual and roto-translated scan, and the number of beams in it.

    Parameters
    ----------
    virtual : (beams,) ranges of the virtual scan, m, NaN where it saw no cell
    points : (n, 5) the scan's good points in beam order: x, y (m), beam number, its range (m) and bearing (rad)
    x, y, yaw : proposed motion from the virtual scan's pose, m, rad
    limits : (7,) bearing of beam 0 and bearing step (rad); near, far, occlusion threshold, range jump between
        surfaces (m); least number of beams
    seen : (beams,) scratch, the roto-translated scan at the virtual bearings

    The cost is inf where fewer beams than the least number contribute.
    """
    beams = len(virtual)
    first, step, near, far, occlusion, edge, least = limits
    c, s = np.cos(yaw), np.sin(yaw)
    seen[:] = np.inf
    last_angle, last_r, last_beam = 0.0, 0.0, -2.0
    turn = 2.0 * np.pi / abs(step)
    per_step, per_turn = 1.0 / step, 1.0 / turn
    for k in range(len(points)):
        # Cost function, step iii
        px = c * points[k, 0] - s * points[k, 1]
        py = s * points[k, 0] + c * points[k, 1]
        qx, qy = px + x, py + y
        r = np.sqrt(qx * qx + qy * qy)
        angle = (points[k, 4] + yaw + _angle_between(px, py, qx, qy) - first) * per_step
        angle -= turn * np.floor(angle * per_turn)
        # Step iv: between neighbouring beams of one surface, where it turns its front to the virtual laser.
        if points[k, 2] == last_beam + 1.0:
            ahead = angle - last_angle
            if ahead < -0.5 * turn:
                ahead += turn
            if 0.0 < ahead < 0.25 * turn and abs(points[k, 3] - points[k - 1, 3]) < edge:
                start = last_angle
                for _ in range(2):
                    j = max(int64(np.ceil(start)), 0)
                    while j <= start + ahead and j < beams:
                        # Of two surfaces in one direction the nearer hides the other.
                        seen[j] = min(seen[j], last_r + (j - start) / ahead * (r - last_r))
                        j += 1
                    if start + ahead < turn:
                        break
                    start -= turn  # a segment across the seam goes on at beam 0
        last_angle, last_r, last_beam = angle, r, points[k, 2]
    total, used = 0.0, 0
    for j in range(beams):
        # Step ix: empty cells match nothing. Step vi: too close or too far.
        if not near < virtual[j] < far or not near < seen[j] < far:
            continue
        # Steps v and viii
        d = seen[j] - virtual[j]
        if abs(d) < occlusion:
            total += d * d
            used += 1
    # Steps x and xi
    if used < least or used == 0:
        return np.inf, float(used)
    return total / used, float(used)


@kernel(float64[::1](_F1, _F2, _F1, _F1, _F1))
def search(
    virtual: NDArray[np.float64],
    points: NDArray[np.float64],
    grid: NDArray[np.float64],
    schedule: NDArray[np.float64],
    limits: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Minimise the cost; returns [x, y, yaw, cost_m2, beams used, evaluations, iterations, converged].

    Parameters
    ----------
    virtual, points, limits : as for ``polar_cost``
    grid : (4,) points of the azimuth grid, of the plane in x and in y, border extensions at most
    schedule : (6,) half-window in the plane (m) and in azimuth (rad), shrink factor, 1 to leave no gaps between grids,
        spacings to stop at (m, rad)

    The points of the plane cover a circular area (step iii): the square lattice is mapped onto the disc, its border
    onto the circle, so that NxM points cost N*M evaluations as in the paper.
    """
    azimuths, nx, ny, extensions = int(grid[0]), int(grid[1]), int(grid[2]), int(grid[3])
    half_m, half_rad, shrink, covered, stop_m, stop_rad = schedule
    seen = np.empty(len(virtual))
    # Turning about the points' centroid keeps the two searches from undoing each other.
    pivot_x, pivot_y = points[:, 0].mean(), points[:, 1].mean()
    x, y, yaw = pivot_x, pivot_y, 0.0
    best, used, evaluations, iterations, converged = np.inf, 0.0, 0, 0, 0.0
    for _ in range(MAX_ITERATIONS):
        iterations += 1
        step_rad = 2.0 * half_rad / (azimuths - 1)
        for _ in range(extensions + 1):
            # Minimisation, steps i and ii
            best, best_i, centre = np.inf, azimuths // 2, yaw
            for i in range(azimuths):
                a = centre - half_rad + i * step_rad
                c, s = np.cos(a), np.sin(a)
                to_x, to_y = x - c * pivot_x + s * pivot_y, y - s * pivot_x - c * pivot_y
                cost, n = polar_cost(virtual, points, to_x, to_y, a, limits, seen)
                if cost < best:
                    best, used, best_i = cost, n, i
            evaluations += azimuths
            if best < np.inf:
                yaw = centre - half_rad + best_i * step_rad
            if 0 < best_i < azimuths - 1:
                break
        for _ in range(extensions + 1):
            # Steps iii and iv
            best, best_i, best_j, x0, y0 = np.inf, nx // 2, ny // 2, x, y
            c, s = np.cos(yaw), np.sin(yaw)
            to_x, to_y = x0 - c * pivot_x + s * pivot_y, y0 - s * pivot_x - c * pivot_y
            for j in range(ny):
                v = -1.0 + 2.0 * j / (ny - 1)
                for i in range(nx):
                    u = -1.0 + 2.0 * i / (nx - 1)
                    dx, dy = half_m * u * np.sqrt(1.0 - 0.5 * v * v), half_m * v * np.sqrt(1.0 - 0.5 * u * u)
                    cost, n = polar_cost(virtual, points, to_x + dx, to_y + dy, yaw, limits, seen)
                    if cost < best:
                        best, used, best_i, best_j = cost, n, i, j
                        x, y = x0 + dx, y0 + dy
            evaluations += nx * ny
            if 0 < best_i < nx - 1 and 0 < best_j < ny - 1:
                break
        # Step v; the grid's spacing bounds the change still to come, also where the centre stays the best.
        spacing = 2.0 * half_m / (min(nx, ny) - 1)
        if spacing < stop_m and step_rad < stop_rad:
            converged = 1.0
            break
        if best == np.inf:
            break
        half_m *= max(shrink, covered * min(spacing / half_m, 0.9))
        half_rad *= max(shrink, covered * min(step_rad / half_rad, 0.9))
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = x - c * pivot_x + s * pivot_y, y - s * pivot_x - c * pivot_y
    return np.array([x, y, yaw, best, used, evaluations, iterations, converged])
