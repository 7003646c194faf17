"""The virtual scan: the ranges that a laser would measure in the map from a given pose (paper, "Virtual Scan")."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, U16_3D, int64, kernel, uint64
from mavnav.kernels.maps.layout import SHIFT, WIDE

ROUNDING_M = 1e-9
"""Tolerance for equal distances from the middle of a cluster."""


@kernel
def virtual_scan(
    hits: U16_3D, lattice: F64_1D, pose: F64_1D, directions: F64_2D, far_m: float, gap_cells: int, middle: bool
) -> F64_1D:
    """Return the range (beams,) in m in each direction, NaN without an occupied cell within ``far_m``.

    A ray passes through the cells to the first occupied one, and on through the cluster of occupied cells behind it,
    with gaps of up to ``gap_cells``. The cell of the cluster with most hits is the wall; the range is that to its
    centre. Of cells with equally many hits, the wall is the one nearest to the laser, or, with ``middle``, the one
    nearest to the middle of the cluster (of two, the nearer to the laser).

    ``lattice`` is (3,): x and y of the corner of cell [0, 0] and the cell edge in m; ``pose`` (3,) x, y, yaw of the
    laser in the map; ``directions`` (beams, 2) cosines and sines in the laser's frame.
    """
    rows, cols = uint64(hits.shape[1]), uint64(hits.shape[0] * WIDE)
    (ox, oy, cell), (x, y, yaw) = lattice, pose
    c, s = np.cos(yaw), np.sin(yaw)
    u0, v0 = (x - ox) / cell, (y - oy) / cell
    far = far_m / cell
    out = np.full(len(directions), np.nan)
    equal = np.empty(hits.shape[1] + hits.shape[0] * WIDE if middle else 0)  # ranges of the cells with most hits
    for k in range(len(directions)):
        du = c * directions[k, 0] - s * directions[k, 1]
        dv = s * directions[k, 0] + c * directions[k, 1]
        col, row = int(np.floor(u0)), int(np.floor(v0))
        step_col, step_row = (1 if du > 0 else -1), (1 if dv > 0 else -1)
        next_u = ((col + (du > 0)) - u0) / du if du != 0.0 else np.inf
        next_v = ((row + (dv > 0)) - v0) / dv if dv != 0.0 else np.inf
        each_u = abs(1.0 / du) if du != 0.0 else np.inf
        each_v = abs(1.0 / dv) if dv != 0.0 else np.inf
        most, empty, at, ties, start, end = 0, 0, 0.0, 0, 0.0, 0.0
        while at <= far:
            inside = (uint64(row) < rows) & (uint64(col) < cols)
            n = int64(hits[uint64(col >> SHIFT), uint64(row), uint64(col & (WIDE - 1))]) if inside else 0
            if n > 0:
                empty = 0
                if middle:
                    end = cell * np.hypot(col + 0.5 - u0, row + 0.5 - v0)
                    start = start if most else end
                    ties = 0 if n > most else ties
                    if n >= most:
                        most = n
                        equal[ties] = end
                        ties += 1
                elif n > most:
                    most = n
                    out[k] = cell * np.hypot(col + 0.5 - u0, row + 0.5 - v0)
            elif most > 0:
                empty += 1
                if empty > gap_cells:
                    break
            along = next_u < next_v  # no branch, because its prediction would often fail
            at = next_u if along else next_v
            col, next_u = col + (step_col if along else 0), next_u + (each_u if along else 0.0)
            row, next_v = row + (0 if along else step_row), next_v + (0.0 if along else each_v)
        for i in range(ties):
            if i == 0 or abs(2.0 * equal[i] - start - end) < abs(2.0 * out[k] - start - end) - ROUNDING_M:
                out[k] = equal[i]
    return out
