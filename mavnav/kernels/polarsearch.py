"""The paper's scan matching: cost function (steps iii-xi) and minimisation (steps i-v) in polar coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import float64, int64, types, uint64, void

from mavnav.kernels._jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_ITERATIONS = 60

_F1 = types.Array(float64, 1, "C", readonly=True)
_F2 = types.Array(float64, 2, "C", readonly=True)


@kernel(types.boolean(_F2, _F1, _F1, float64[::1], float64[::1]))
def _see(
    points: NDArray[np.float64],
    motion: NDArray[np.float64],
    limits: NDArray[np.float64],
    r: NDArray[np.float64],
    beam: NDArray[np.float64],
) -> bool:
    """Write range and beam number of the moved points; False where one turns too far for the series.

    Between neighbouring poses a point's bearing changes little: a series of the tangent is then good to 1e-11. Without
    branches the loop works on four points at a time.
    """
    c, s, x, y, yaw = motion
    per_step, turn = 1.0 / limits[1], 2.0 * np.pi / abs(limits[1])
    per_turn, first, wide = 1.0 / turn, limits[0], 0
    from_x, from_y, bearing = points[0], points[1], points[4]
    for k in range(len(r)):
        px, py = c * from_x[k] - s * from_y[k], s * from_x[k] + c * from_y[k]
        qx, qy = px + x, py + y
        r[k] = np.sqrt(qx * qx + qy * qy)
        cross, dot = px * qy - py * qx, px * qx + py * qy
        t = cross / dot
        u = t * t
        wide += (u >= 0.04) | (dot <= 0.0)
        between = t * (1.0 - u * (1 / 3 - u * (1 / 5 - u * (1 / 7 - u * (1 / 9 - u * (1 / 11 - u * (1 / 13)))))))
        at = (bearing[k] + yaw + between - first) * per_step
        beam[k] = at - turn * np.floor(at * per_turn)
    return bool(wide == 0)


@kernel(void(_F2, _F1, _F1, float64[::1]))
def _see_far(
    points: NDArray[np.float64], motion: NDArray[np.float64], limits: NDArray[np.float64], beam: NDArray[np.float64]
) -> None:
    """Write the beam numbers of points some of which turn far."""
    c, s, x, y, yaw = motion
    per_step, turn = 1.0 / limits[1], 2.0 * np.pi / abs(limits[1])
    for k in range(len(beam)):
        px, py = c * points[0, k] - s * points[1, k], s * points[0, k] + c * points[1, k]
        qx, qy = px + x, py + y
        between = np.arctan2(px * qy - py * qx, px * qx + py * qy)
        at = (points[4, k] + yaw + between - limits[0]) * per_step
        beam[k] = at - turn * np.floor(at * (1.0 / turn))


@kernel(void(_F2, float64[::1], float64[::1], float64, float64, float64[::1]))
def _lay(
    points: NDArray[np.float64],
    r: NDArray[np.float64],
    beam: NDArray[np.float64],
    turn: float,
    edge: float,
    seen: NDArray[np.float64],
) -> None:
    """Write what each virtual beam sees of the moved points: nearer surfaces hide farther ones.

    Only between neighbouring beams of one surface, where it turns its front to the virtual laser (step iv).
    """
    seen[:] = np.inf
    beams = len(seen)
    number, own = points[2], points[3]
    for k in range(1, len(r)):
        if (number[k] != number[k - 1] + 1.0) | (abs(own[k] - own[k - 1]) >= edge):
            continue
        start, ahead = beam[k - 1], beam[k] - beam[k - 1]
        if ahead < -0.5 * turn:
            ahead += turn
        if not (ahead > 0.0) & (ahead < 0.25 * turn):
            continue
        from_r, slope = r[k - 1], (r[k] - r[k - 1]) / ahead
        for _ in range(2):
            end = min(int64(np.floor(start + ahead)), beams - 1)
            for j in range(max(int64(np.ceil(start)), 0), end + 1):
                at = uint64(j)
                seen[at] = min(seen[at], from_r + (j - start) * slope)
            if start + ahead < turn:
                break
            start -= turn  # a segment across the seam goes on at beam 0


@kernel(types.UniTuple(float64, 2)(_F1, _F2, float64, float64, float64, _F1, float64[:, ::1]))
def polar_cost(
    virtual: NDArray[np.float64],
    points: NDArray[np.float64],
    x: float,
    y: float,
    yaw: float,
    limits: NDArray[np.float64],
    scratch: NDArray[np.float64],
) -> tuple[float, float]:
    """Mean squared radius difference (m2) between virtual and roto-translated scan, and the number of beams in it.

    Parameters
    ----------
    virtual : (beams,) ranges of the virtual scan, m, NaN where it saw no cell
    points : (5, n) the scan's good points in beam order: x, y (m), beam number, its range (m) and bearing (rad)
    x, y, yaw : proposed motion from the virtual scan's pose, m, rad
    limits : (7,) bearing of beam 0 and bearing step (rad); near, far, occlusion threshold, range jump between
        surfaces (m); least number of beams
    scratch : (3, beams or more) for the roto-translated scan

    The cost is inf where fewer beams than the least number contribute.
    """
    n, beams = points.shape[1], len(virtual)
    near, far, occlusion, least = limits[2], limits[3], limits[4], limits[6]
    r, beam, seen = scratch[0, :n], scratch[1, :n], scratch[2, :beams]
    motion = np.array([np.cos(yaw), np.sin(yaw), x, y, yaw])
    # Cost function, step iii
    if not _see(points, motion, limits, r, beam):
        _see_far(points, motion, limits, beam)
    # Step iv
    _lay(points, r, beam, 2.0 * np.pi / abs(limits[1]), limits[5], seen)
    total, used = 0.0, 0
    for j in range(beams):
        # Step ix: empty cells match nothing. Step vi: too close or too far. Steps v and viii
        d = seen[j] - virtual[j]
        if (near < virtual[j]) & (virtual[j] < far) & (near < seen[j]) & (seen[j] < far) & (abs(d) < occlusion):
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
    virtual, limits : as for ``polar_cost``
    points : (n, 5), the columns of ``polar_cost``'s as rows
    grid : (4,) points of the azimuth grid, of the plane in x and in y, border extensions at most
    schedule : (6,) half-window in the plane (m) and in azimuth (rad), shrink factor, 1 to leave no gaps between grids,
        spacings to stop at (m, rad)

    The points of the plane cover a circular area (step iii): the square lattice is mapped onto the disc, its border
    onto the circle, so that NxM points cost N*M evaluations as in the paper.
    """
    azimuths, nx, ny, extensions = int(grid[0]), int(grid[1]), int(grid[2]), int(grid[3])
    half_m, half_rad, shrink, covered, stop_m, stop_rad = schedule
    scratch = np.empty((3, max(len(virtual), len(points))))
    columns = np.ascontiguousarray(points.T)
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
                cost, n = polar_cost(virtual, columns, to_x, to_y, a, limits, scratch)
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
                    cost, n = polar_cost(virtual, columns, to_x + dx, to_y + dy, yaw, limits, scratch)
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
