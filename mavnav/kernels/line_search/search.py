"""Coarse-to-fine search over grids for the pose at which a scan's points fit the map best (docs/method.md).

Grids are searched in turn as in the paper's minimisation, steps i-v: yaw with the position fixed (``azimuth``), then
the plane with the yaw fixed (``plane``); the scan rotates about its points' centroid. The cost of a point is its
squared distance to the line of the cell that contains it (``cost``; arrays of ``linemap``). If the window is a few
cells wide, every point first keeps its line at the middle: one quadratic form then gives the cost on a joint grid of
yaw and plane (``quadratic_form``).

Every grid has an exhaustive and a pruned form with the same minimum: the same index, the lowest of equals, and the
same cost, bit for bit. Pruning uses three facts:

* a sum of squares that exceeds the best total so far only increases: the rest of that candidate is left out;
* while a point stays in one cell, its cost is a polynomial of the motion, so that a few sums over the points give the
  costs of all candidates except for rounding; those within `ROUNDING_M2` of the best are summed point by point;
* the eigenvalues of a metric are at most 1, so that a cost bounds how far its point may move before it is truncated,
  or no longer truncated.

Both forms end early where the scan fits nowhere in the window (`HOPELESS`), except in the final pass.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavnav.kernels.line_search.azimuth import least_turn, turns_of
from mavnav.kernels.line_search.cost import Lines, Middle, SearchWindow, mean, rotate
from mavnav.kernels.line_search.plane import least_shift
from mavnav.kernels.line_search.quadratic_form import least_of_form, quadratic_form
from mavnav.kernels.machine.jit import F64_1D, F64_2D, U32_2D, helper, kernel, uint64
from mavnav.kernels.maps.lookup import closeness_of, line_distance2, slot_at, slot_of

MAX_LEVELS = 40
LEAST_MAPPED_SHARE = 0.5
"""Share of points on mapped area below which all points are used."""

HOPELESS = 0.8
"""Mean cost after the first grids of yaw and plane, as a share of the truncated cost, above which a search ends.

Of 30 420 searches of disturbed logs 6 % are above it. Of the 20 311 whose final pose has at least 60 % inliers it is 3,
with 67 % at most.
"""


class Grid(NamedTuple):
    """Numbers of yaw samples and of nodes of the plane in x and y, and maximum number of border extensions."""

    azimuths: int
    nx: int
    ny: int
    extensions: int


class SearchLimits(NamedTuple):
    """The argument ``limits`` of `search`.

    Half-window in the plane (m) and yaw (rad); final spacing (m, rad); truncation (m); number of points until those on
    mapped area are selected; rounds per level down to a cell; cost per point of a squared metre from the start; largest
    half-window (m) with fixed correspondences; largest half-window (m) within a cell (0: none); closeness and points of
    a line on mapped area; least number of points of a dense scan. Within a cell, points elsewhere than on mapped area
    are left out; only dense scans fix correspondences there, and alternate between yaw and plane on the first and the
    last of these levels only.
    """

    half_m: float
    half_rad: float
    stop_m: float
    stop_rad: float
    truncate_m: float
    few_points: float
    alternations: float
    prior: float
    fixed_below_m: float
    within_below_m: float
    closeness: float
    known_points: float
    dense_points: float


@helper
def _shift(middle: Middle, right_m: float, up_m: float) -> Middle:
    return Middle(middle.x_m + right_m, middle.y_m + up_m, middle.yaw_rad, middle.expected_x_m, middle.expected_y_m)


@helper
def _turn(middle: Middle, turn_rad: float) -> Middle:
    return Middle(middle.x_m, middle.y_m, middle.yaw_rad + turn_rad, middle.expected_x_m, middle.expected_y_m)


@helper
def _move_back(points: F64_2D, right_m: float, up_m: float) -> None:
    """Subtract a shift from points (2, n); an expression with whole arrays would take 1 s to compile."""
    for k in range(points.shape[1]):
        points[0, k] -= right_m
        points[1, k] -= up_m


@helper
def _joint_search(
    points: F64_2D, middle: Middle, window: SearchWindow, grid: Grid, turns: F64_2D, rounds: int, line_map: Lines
) -> tuple[Middle, int]:
    """Search yaw and plane jointly with fixed correspondences, ``rounds`` times, or more if the best is on the border.

    Returns the best pose and the number of grids searched.
    """
    azimuths, nx, ny, extensions = grid
    form, no_list = np.zeros((5, 5)), np.empty(0, np.int64)
    step_x, step_y = 2 * window.half_m / (nx - 1), 2 * window.half_m / (ny - 1)
    step_rad, grids = 2 * window.half_rad / (azimuths - 1), 0
    for turn in range(rounds + extensions):
        quadratic_form(points, middle, window, form, no_list, line_map)
        best = least_of_form(form, window, turns, nx, ny)
        i, j, a = best % nx, (best // nx) % ny, best // (nx * ny)
        middle = _shift(middle, i * step_x - window.half_m, j * step_y - window.half_m)
        middle = _turn(middle, a * step_rad - window.half_rad)
        grids += 1
        if turn + 1 >= rounds and 0 < i < nx - 1 and 0 < j < ny - 1 and 0 < a < azimuths - 1:
            break
    return middle, grids


@helper
def _evaluate(points: F64_2D, middle: Middle, truncate_m2: float, line_map: Lines) -> tuple[float, int]:
    """Return the cost sum of the points at the middle, m2, and the number within half the truncation distance."""
    nearest, lines, ox, oy, cell = line_map
    n, total, inliers = points.shape[1], 0.0, 0
    x, y = np.empty(n), np.empty(n)
    rotate(points, middle.yaw_rad, x, y)
    for k in range(n):
        px, py = x[k] + middle.x_m, y[k] + middle.y_m
        d2 = line_distance2(px, py, truncate_m2, slot_at(px, py, ox, oy, 1.0 / cell, nearest), lines)
        total += d2
        inliers += d2 < 0.25 * truncate_m2
    return total, inliers


@helper
def _alternating_search(
    points: F64_2D,
    middle: Middle,
    window: SearchWindow,
    grid: Grid,
    turns: F64_2D,
    rounds: int,
    most_m2: float,
    line_map: Lines,
) -> tuple[Middle, int, int, bool]:
    """Alternate between yaw and plane ``rounds`` times, with the lines found separately for every candidate.

    Returns the best pose, the numbers of yaw grids and plane grids searched, and whether the search ended after the
    first round because the cost sum was above ``most_m2``.
    """
    azimuths, nx, ny, extensions = grid
    step_x, step_y = 2 * window.half_m / (nx - 1), 2 * window.half_m / (ny - 1)
    step_rad, of_yaw, of_plane = 2 * window.half_rad / (azimuths - 1), 0, 0
    for turn in range(rounds):
        for _ in range(extensions + 1):
            i = least_turn(points, middle, window, turns, line_map)
            middle = _turn(middle, i * step_rad - window.half_rad)
            of_yaw += 1
            if 0 < i < azimuths - 1:
                break
        for _ in range(extensions + 1):
            ji = least_shift(points, middle, window, nx, ny, line_map)
            i, j = ji % nx, ji // nx
            middle = _shift(middle, i * step_x - window.half_m, j * step_y - window.half_m)
            of_plane += 1
            if 0 < i < nx - 1 and 0 < j < ny - 1:
                break
        if turn == 0 and most_m2 < np.inf:
            total, _ = _evaluate(points, middle, window.truncate_m2, line_map)
            if total > most_m2:
                return middle, of_yaw, of_plane, True
    return middle, of_yaw, of_plane, False


@helper
def on_mapped_area(points: F64_2D, middle: Middle, closeness: float, known_points: float, line_map: Lines) -> F64_2D:
    """Return the points (2, m) on mapped area; all points if these are too few.

    Mapped area has an occupied cell near, with a closeness in ``nearest`` of at least ``closeness``, and its line is
    fitted to at least ``known_points`` points.
    """
    nearest, lines, ox, oy, cell = line_map
    n, count = points.shape[1], 0
    kept = np.empty(n, np.int64)
    x, y = np.empty(n), np.empty(n)
    rotate(points, middle.yaw_rad, x, y)
    for k in range(n):
        fx, fy = (x[k] + middle.x_m - ox) / cell, (y[k] + middle.y_m - oy) / cell
        if not (0 <= fx < nearest.shape[1] and 0 <= fy < nearest.shape[0]):
            continue
        row, col = uint64(fy), uint64(fx)
        there = nearest[row, col]
        if closeness_of(there) >= closeness and lines[uint64(slot_of(there)), 5] >= known_points:
            kept[count] = k
            count += 1
    if count < LEAST_MAPPED_SHARE * n:
        return points.copy()
    out = np.empty((2, count))
    for k in range(count):
        out[0, k], out[1, k] = points[0, kept[k]], points[1, kept[k]]
    return out


@kernel
def search(
    points: F64_2D, start: F64_1D, grid: F64_1D, limits: F64_1D, nearest: U32_2D, lines: F64_2D, geometry: F64_1D
) -> tuple[float, float, float, float, float, int, int, bool]:
    """Find the pose of the scan in the map; returns x, y, yaw, cost_m2, inliers, evaluations, grids, converged.

    Parameters
    ----------
    points : (n, 2) points in the laser's frame, m, in an order that makes any prefix a fair sample
    start : (3,) predicted pose in the map frame: x, y (m), yaw (rad)
    grid, limits : the fields of `SearchGrid`, (5,), and of `SearchLimits`, (13,)
    nearest, lines, geometry : the map, see ``linemap``
    """
    (n_azimuths, n_x, n_y, n_extensions, prune), n = grid, len(points)
    (
        half_m, half_rad, stop_m, stop_rad, truncate_m, few_points, alternations,
        prior, fixed_below_m, within_below_m, closeness, known_points, dense_points,
    ) = limits  # fmt: skip
    origin_x_m, origin_y_m, cell_m, _, _, _ = geometry
    line_map = Lines(nearest, lines, origin_x_m, origin_y_m, cell_m)
    nodes = Grid(int(n_azimuths), int(n_x), int(n_y), int(n_extensions))
    azimuths, nx, ny, _ = nodes
    truncate_m2, joint_rounds = truncate_m * truncate_m, int(alternations)

    x, y, yaw = start
    pivot_x, pivot_y = mean(points[:, 0]), mean(points[:, 1])
    centred = np.empty((2, n))
    for k in range(n):
        centred[0, k], centred[1, k] = points[k, 0] - pivot_x, points[k, 1] - pivot_y
    start_c, start_s = np.cos(yaw), np.sin(yaw)
    at_x, at_y = x + start_c * pivot_x - start_s * pivot_y, y + start_s * pivot_x + start_c * pivot_y
    middle = Middle(at_x, at_y, yaw, at_x, at_y)

    active, selected, few = centred, closeness == 0, int(min(n, few_points))
    dense, rounds = n >= dense_points, joint_rounds
    evaluations, grids, converged = 0, 0, False
    for level in range(MAX_LEVELS):
        window = SearchWindow(half_m, half_rad, prior, truncate_m2, prune > 0)
        step_m, step_rad = max(2 * half_m / (nx - 1), 2 * half_m / (ny - 1)), 2 * half_rad / (azimuths - 1)
        last = step_m < stop_m and step_rad < stop_rad
        within = half_m <= within_below_m
        sampled, fixed = within and not selected, half_m <= fixed_below_m and (dense or not within)
        used = active if selected or (fixed and not sampled) else active[:, :few].copy()
        turns = turns_of(half_rad, azimuths)
        if fixed:
            middle, of_both = _joint_search(used, middle, window, nodes, turns, joint_rounds, line_map)
            evaluations += of_both * azimuths * nx * ny
            grids += of_both
            rounds_now = int(sampled or (within and last))
        else:
            rounds_now = rounds
        most_m2 = HOPELESS * truncate_m2 * used.shape[1] if level == 0 and not fixed else np.inf
        middle, of_yaw, of_plane, hopeless = _alternating_search(
            used, middle, window, nodes, turns, rounds_now, most_m2, line_map
        )
        evaluations += of_yaw * azimuths + of_plane * nx * ny
        grids += of_yaw + of_plane
        if hopeless:
            break
        if sampled:
            # Points on unmapped area lower the cost by falling back onto the map: from here on they are left out.
            selected, active = True, on_mapped_area(centred, middle, closeness, known_points, line_map)
            right, up = mean(active[0]), mean(active[1])
            pivot_x, pivot_y = pivot_x + right, pivot_y + up
            _move_back(centred, right, up)
            _move_back(active, right, up)
            at_x, at_y, yaw, expected_x, expected_y = middle
            c, s = np.cos(yaw), np.sin(yaw)
            at_x, at_y = at_x + (c * right - s * up), at_y + (s * right + c * up)
            expected_x += start_c * right - start_s * up
            expected_y += start_s * right + start_c * up
            middle = Middle(at_x, at_y, yaw, expected_x, expected_y)
            continue
        if last:
            converged = True
            break
        if within:
            rounds = 1  # finer levels start close to their result
        half_m, half_rad = min(1.5 * step_m, 0.9 * half_m), min(1.5 * step_rad, 0.9 * half_rad)

    total, inliers = _evaluate(centred, middle, truncate_m2, line_map)
    c, s = np.cos(middle.yaw_rad), np.sin(middle.yaw_rad)
    to_x, to_y = middle.x_m - c * pivot_x + s * pivot_y, middle.y_m - s * pivot_x - c * pivot_y
    return to_x, to_y, middle.yaw_rad, total / n, inliers / n, evaluations, grids, converged
