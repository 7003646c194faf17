"""The pose at which a sweep as recorded fits best, and that of the laser at mid-sweep (docs/method.md)."""

from __future__ import annotations

from typing import Final

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, Out, kernel

JOINED_M: Final = 3.0
"""Greatest distance of the two neighbors of a point on a wall."""

BESIDE_M, BENT = 0.02, 0.1
"""Greatest distance of a point from the line through its neighbors, m and as a share of their distance."""

STILL: Final = 1e-4
"""Weight of no shift at all, as a share of the points: it decides in directions that the walls leave open."""


@kernel
def sweep_shift(
    ranges_m: F64_1D, directions: F64_2D, late_s: F64_1D, twist: F64_1D, limits_m: F64_1D, out: Out[F64_2D]
) -> None:
    """Write the normal equations of the shift that brings a de-skewed sweep closest to the sweep as recorded.

    Parameters
    ----------
    ranges_m, directions : (beams,) m, NaN without a return, and (beams, 2) cosines and sines
    late_s : (beams,) time of each beam after mid-sweep
    twist : (3,) the laser's motion in its own frame, m/s, m/s, rad/s
    limits_m : (3,) least and greatest range of used beams, and the edge of a voxel
    out : (3, 4) output, the matrix and the right side; the unknowns are x, y (m), yaw (rad)

    Distances are along the normals of the de-skewed walls, through the two neighbors of each point.
    """
    near_m, far_m, _ = limits_m
    points, n, used, out[:] = np.empty((len(ranges_m), 4)), 0, 0.0, 0.0
    for i in range(len(ranges_m)):  # where the de-skewed point is, and how far from the recorded one
        turn, r = twist[2] * late_s[i], ranges_m[i]
        if near_m < r < far_m:
            x, y = r * directions[i, 0], r * directions[i, 1]
            points[n, 0] = np.cos(turn) * x - np.sin(turn) * y + twist[0] * late_s[i]
            points[n, 1] = np.sin(turn) * x + np.cos(turn) * y + twist[1] * late_s[i]
            points[n, 2], points[n, 3] = points[n, 0] - x, points[n, 1] - y
            n += 1
    for i in range(1, n - 1):
        dx, dy = points[i + 1, 0] - points[i - 1, 0], points[i + 1, 1] - points[i - 1, 1]
        apart_m = np.sqrt(dx * dx + dy * dy)
        if not 0.0 < apart_m < JOINED_M:
            continue
        normal_x, normal_y = -dy / apart_m, dx / apart_m
        beside_m = normal_x * (points[i, 0] - points[i - 1, 0]) + normal_y * (points[i, 1] - points[i - 1, 1])
        if abs(beside_m) > BESIDE_M + BENT * apart_m:
            continue
        lever = normal_y * points[i, 0] - normal_x * points[i, 1]
        row = (normal_x, normal_y, lever, -(normal_x * points[i, 2] + normal_y * points[i, 3]))
        for j in range(3):
            for k in range(4):
                out[j, k] += row[j] * row[k]
        used += 1.0
    for j in range(3):
        out[j, j] += STILL * max(used, 1.0)
