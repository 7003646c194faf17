"""The cost of a scan's points on the map's lines, and helpers of all grids of the search (see ``search``).

Points (2, n) are given relative to their centroid, m, along the laser's axes; sums over them are in m2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, U32_2D, helper
from mavnav.kernels.maps.lookup import line_distance2, slot_at

CHUNK = 8
"""Number of points between two comparisons with the bound."""
ROUNDING_M2 = 1e-9
"""Upper bound of the difference between two orders of summation, for maps smaller than 100 km."""


class Lines(NamedTuple):
    """The map: ``nearest`` and ``lines`` as in ``linemap``, its origin in the map frame and its cell edge, m."""

    nearest: U32_2D
    lines: F64_2D
    origin_x_m: float
    origin_y_m: float
    cell_m: float


class Middle(NamedTuple):
    """The middle of a grid: centroid of the points and yaw in the map frame, and the expected centroid, m and rad."""

    x_m: float
    y_m: float
    yaw_rad: float
    expected_x_m: float
    expected_y_m: float


class SearchWindow(NamedTuple):
    """Half-widths of a grid, the cost of a squared metre of distance from the expected centroid, and the truncation."""

    half_m: float
    half_rad: float
    prior: float
    truncate_m2: float
    prune: bool


@helper
def mean(values: F64_1D) -> float:
    """Return the mean; NumPy's own takes 0.1 s at start-up in a kernel, because it loads scipy."""
    total = 0.0
    for value in values:
        total += value
    return total / len(values)


@helper
def mean_absolute(values: F64_2D) -> float:
    """Return the mean of the absolute values of (rows, cols)."""
    total = 0.0
    for row in range(values.shape[0]):
        for col in range(values.shape[1]):
            total += abs(values[row, col])
    return total / values.size


@helper
def least(sums: F64_1D) -> tuple[float, int]:
    """Return the least sum plus a tolerance for rounding, and its index; -1 if another sum is within the tolerance."""
    at = 0
    for k in range(len(sums)):
        if sums[k] < sums[at]:
            at = k
    near, within = sums[at] + 2.0 * ROUNDING_M2, 0
    for value in sums:
        within += value <= near
    return near, at if within == 1 else -1


@helper
def rotate(points: F64_2D, yaw_rad: float, x: F64_1D, y: F64_1D) -> None:
    """Write the points (2, n), rotated by a yaw, to ``x`` and ``y`` (n,)."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    from_x, from_y = points[0], points[1]
    for k in range(len(x)):
        x[k] = c * from_x[k] - s * from_y[k]
        y[k] = s * from_x[k] + c * from_y[k]


@helper
def cost_sum(
    x: F64_1D, y: F64_1D, to_x: float, to_y: float, truncate_m2: float, line_map: Lines, bound: float
) -> float:
    """Return the sum of the squared, truncated distances of points, shifted by ``to_x``, ``to_y``, to their lines.

    The sum is incomplete once it exceeds ``bound``.
    """
    nearest, lines = line_map.nearest, line_map.lines
    ox, oy, cells_per_m = line_map.origin_x_m, line_map.origin_y_m, 1.0 / line_map.cell_m
    total, k = 0.0, 0
    while k < len(x) and total <= bound:
        for m in range(k, min(k + CHUNK, len(x))):
            px, py = x[m] + to_x, y[m] + to_y
            total += line_distance2(px, py, truncate_m2, slot_at(px, py, ox, oy, cells_per_m, nearest), lines)
        k += CHUNK
    return total
