"""The paper's scan matching: minimisation (steps i-v) of the cost function in polar coordinates.

A pruned grid has the minimum of the exhaustive one: the same index, the lowest of equals, and the same cost, bit for
bit. A lower bound is computed for every candidate. The candidate with the least bound is evaluated first, then all
whose bounds are not above the best cost. The bounds are

* on wide grids the cost in single precision, from points relative to the grid's middle: beams that may be off by more
  than `RANGE_M`, or may not contribute, are counted but not summed (``wide_bounds``);
* on small grids, where most beams meet the same segment and contribute everywhere or nowhere (``fixed_beams``), the
  second-order polynomial of their sum, less twice its third-order term (``polynomial``); the other beams are summed
  for each candidate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, helper, int64, kernel
from mavnav.kernels.polar_search.bounds import bound
from mavnav.kernels.polar_search.cost import Beams, Limits, Work, evaluate, limits_of, scan_of, work_for
from mavnav.kernels.polar_search.fixed_beams import HalfWindow

MAX_ITERATIONS = 60


class Schedule(NamedTuple):
    """The argument ``schedule`` of `search`.

    Half-window in the plane (m) and in yaw (rad); shrink factor; 1 to leave no gaps between grids; final spacings
    (m, rad); cost (m2) above which the search gives up; factor of the occlusion threshold per iteration and its minimum
    (m); 1 to rotate about the laser instead of the points' centroid; 1 to stop at either final spacing instead of both.
    """

    half_m: float
    half_rad: float
    shrink: float
    leave_no_gaps: float
    stop_m: float
    stop_rad: float
    give_up_m2: float
    occlusion_shrink: float
    occlusion_least_m: float
    about_laser: float
    either: float


class GridCentre(NamedTuple):
    """The middle of a grid: position of the pivot, and yaw; and the pivot in the scan, m."""

    x_m: float
    y_m: float
    yaw_rad: float
    pivot_x_m: float
    pivot_y_m: float


@helper
def _least(scan: Beams, motions: F64_2D, bounds: F64_1D, work: Work) -> tuple[int, float, float]:
    """Return the first candidate of least cost (-1 if all are inf), its cost and the number of its beams."""
    promising = int64(np.argmin(bounds))
    best, used = evaluate(scan, motions[promising], work)
    best_i = promising if best < np.inf else -1
    for i in range(len(bounds)):
        if bounds[i] > best or bounds[i] == np.inf or i == promising:
            continue
        cost, n = evaluate(scan, motions[i], work)
        if cost < best or (cost == best and i < best_i):
            best, used, best_i = cost, n, i
    return best_i, best, used


@helper
def _turns(grid: GridCentre, half_rad: float, motions: F64_2D, offsets: F64_2D) -> None:
    """Write the motions of the yaw samples (minimisation, step i), and of their middle."""
    x, y, yaw, pivot_x, pivot_y = grid
    azimuths = len(offsets)
    step = 2.0 * half_rad / (azimuths - 1)
    for i in range(azimuths + 1):
        a = yaw - half_rad + i * step if i < azimuths else yaw
        c, s = np.cos(a), np.sin(a)
        motions[i, 0], motions[i, 1], motions[i, 4] = c, s, a
        motions[i, 2], motions[i, 3] = x - c * pivot_x + s * pivot_y, y - s * pivot_x - c * pivot_y
        if i < azimuths:
            offsets[i, 0], offsets[i, 1] = a - yaw, 0.0


@helper
def _shifts(grid: GridCentre, half_m: float, nx: int, motions: F64_2D, offsets: F64_2D) -> None:
    """Write the motions of the plane's grid (step iii), and of its middle.

    They cover a disc: the square lattice is mapped onto it, its border onto the circle, so that NxM points cost N*M
    evaluations as in the paper.
    """
    x, y, yaw, pivot_x, pivot_y = grid
    ny, c, s = len(offsets) // nx, np.cos(yaw), np.sin(yaw)
    to_x, to_y = x - c * pivot_x + s * pivot_y, y - s * pivot_x - c * pivot_y
    motions[:, 0], motions[:, 1], motions[:, 2], motions[:, 3], motions[:, 4] = c, s, to_x, to_y, yaw
    for j in range(ny):
        v = -1.0 + 2.0 * j / (ny - 1)
        for i in range(nx):
            u = -1.0 + 2.0 * i / (nx - 1)
            dx, dy = half_m * u * np.sqrt(1.0 - 0.5 * v * v), half_m * v * np.sqrt(1.0 - 0.5 * u * u)
            offsets[j * nx + i, 0], offsets[j * nx + i, 1] = dx, dy
            motions[j * nx + i, 2], motions[j * nx + i, 3] = to_x + dx, to_y + dy


@helper
def _at_occlusion(scan: Beams, occlusion_m: float) -> Beams:
    """Return the scan with another occlusion threshold."""
    first_rad, step_rad, near_m, far_m, _, edge_m, fewest_beams, counted = scan.limits
    limits = Limits(first_rad, step_rad, near_m, far_m, occlusion_m, edge_m, fewest_beams, counted)
    return Beams(scan.virtual, scan.points, limits)


@kernel
def search(virtual: F64_1D, points: F64_2D, grid: F64_1D, schedule: F64_1D, limits: F64_1D) -> F64_1D:
    """Minimise the cost; return [x, y, yaw, cost_m2, beams used, evaluations, iterations, converged].

    Parameters
    ----------
    virtual, limits : as for ``polar_cost``
    points : (n, 5), the transpose of those of ``polar_cost``
    grid, schedule : the fields of `SearchGrid`, (5,), and of `Schedule`, (11,)

    If occluded beams count, there are no bounds and every candidate is evaluated. A motion changes ranges by about its
    length. So the search gives up, not converged, if the root of the cost exceeds the root of its bound by more than
    twice the half-window.
    """
    n_azimuths, n_x, n_y, n_extensions, prune = grid
    half_m, half_rad, shrink, covered, stop_m, stop_rad, useless, occlusion_shrink, least_m, at_laser, either = schedule
    azimuths, nx, ny, extensions = int(n_azimuths), int(n_x), int(n_y), int(n_extensions)
    n, given = len(points), limits_of(limits)
    scan = part = scan_of(virtual, points.T, given)
    work, bounded = work_for(2 * n, len(virtual)), prune > 0.0 and not given.counted
    turns, by_turn, turn_bounds = np.empty((azimuths + 1, 5)), np.empty((azimuths, 2)), np.full(azimuths, -np.inf)
    shifts, by_shift, bounds = np.empty((nx * ny + 1, 5)), np.empty((nx * ny, 2)), np.full(nx * ny, -np.inf)
    # Turning about the points' centroid keeps the two searches from undoing each other.
    pivot_x, pivot_y = (0.0, 0.0) if at_laser > 0.0 else (points[:, 0].mean(), points[:, 1].mean())
    x, y, yaw = pivot_x, pivot_y, 0.0
    best, used, evaluations, iterations, converged = np.inf, 0.0, 0, 0, 0.0
    for _ in range(MAX_ITERATIONS):
        iterations += 1
        step_rad = 2.0 * half_rad / (azimuths - 1)
        for _ in range(extensions + 1):
            # Minimisation, steps i and ii
            _turns(GridCentre(x, y, yaw, pivot_x, pivot_y), half_rad, turns, by_turn)
            if bounded:
                part = bound(scan, turns, by_turn, HalfWindow(0.0, half_rad, x, y), work, turn_bounds)
            i, best, beams = _least(part, turns, turn_bounds, work)
            evaluations += azimuths
            if i >= 0:
                used, yaw = beams, yaw - half_rad + i * step_rad
            else:
                i = azimuths // 2
            if 0 < i < azimuths - 1:
                break
        for _ in range(extensions + 1):
            # Steps iii and iv
            _shifts(GridCentre(x, y, yaw, pivot_x, pivot_y), half_m, nx, shifts, by_shift)
            if bounded:
                part = bound(scan, shifts, by_shift, HalfWindow(half_m, 0.0, x, y), work, bounds)
            ji, best, beams = _least(part, shifts, bounds, work)
            evaluations += nx * ny
            if ji >= 0:
                used, x, y = beams, x + by_shift[ji, 0], y + by_shift[ji, 1]
            else:
                ji = ny // 2 * nx + nx // 2
            if 0 < ji % nx < nx - 1 and 0 < ji // nx < ny - 1:
                break
        # Step v; the spacing of the grid bounds the remaining change, even if the centre stays the best.
        spacing = 2.0 * half_m / (min(nx, ny) - 1)
        fine_xy, fine_yaw = spacing < stop_m, step_rad < stop_rad
        if (fine_xy and fine_yaw) or (either > 0.0 and (fine_xy or fine_yaw)):
            converged = 1.0
            break
        if best == np.inf or np.sqrt(best) > np.sqrt(useless) + 2.0 * half_m:
            break
        half_m *= max(shrink, covered * min(spacing / half_m, 0.9))
        half_rad *= max(shrink, covered * min(step_rad / half_rad, 0.9))
        if occlusion_shrink < 1.0:
            smaller_m = max(scan.limits.occlusion_m * occlusion_shrink, min(least_m, given.occlusion_m))
            scan = part = _at_occlusion(scan, smaller_m)
    c, s = np.cos(yaw), np.sin(yaw)
    to_x, to_y = x - c * pivot_x + s * pivot_y, y - s * pivot_x - c * pivot_y
    return np.array([to_x, to_y, yaw, best, used, evaluations, iterations, converged])
