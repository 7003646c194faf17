"""The walls of a map as points, and their repulsion (paper, "Path Planning")."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, U16_2D, U16_3D, float64, int64, kernel
from mavnav.kernels.maps.lookup import count_at


@kernel
def wall_centres(hits: U16_3D, passes: U16_2D, lattice: F64_1D, min_hits: int, min_share: float) -> F64_2D:
    """Return the centres (n, 2) in m of the cells that are walls, in row-major order.

    A wall cell was hit, by at least ``min_share`` of the beams that reached it. It and the cells around it (5 x 5) that
    pass the same test must have ``min_hits`` hits together: a stray reading is no wall.
    ``lattice`` (3,) is the corner of cell [0, 0] and the cell edge in m.
    """
    rows, cols = passes.shape
    ox, oy, cell = lattice
    out = np.empty((hits.size, 2))  # memory is allocated for the used part only
    kept = 0
    for row in range(rows):
        for col in range(cols):
            n = int64(count_at(hits, row, col))
            if n == 0 or n < min_share * (float64(n) + passes[row, col]):
                continue
            together = n
            for r in range(max(0, row - 2), min(rows, row + 3)):
                if together >= min_hits:  # most walls have enough hits in one cell
                    break
                for c in range(max(0, col - 2), min(cols, col + 3)):
                    m = int64(count_at(hits, r, c))
                    share = min_share * (float64(m) + passes[r, c])
                    if (r != row or c != col) and m > 0 and m >= share:
                        together += m
            if together >= min_hits:
                out[kept, 0] = ox + (col + 0.5) * cell
                out[kept, 1] = oy + (row + 0.5) * cell
                kept += 1
    return out[:kept].copy()


@kernel
def repulsion(walls_xy_map_m: F64_2D, xy_map_m: F64_1D, range_m: float, cell_m: float) -> F64_1D:
    """Return the sum (2,) of the forces of all walls (n, 2) within ``range_m`` on a vehicle at ``xy_map_m`` (2,).

    A cell at distance r repels with ``cell / range (range / r - 1) (range / r)^2``: except for a factor, the gradient
    of the potential ``(range / r - 1)^2 / 2``, per length of wall, so that it does not depend on the size of cells. The
    force does not increase within one cell.
    """
    out = np.zeros(2)
    for k in range(len(walls_xy_map_m)):
        dx, dy = xy_map_m[0] - walls_xy_map_m[k, 0], xy_map_m[1] - walls_xy_map_m[k, 1]
        r2 = dx * dx + dy * dy
        if 0.0 < r2 < range_m * range_m:
            r = np.sqrt(r2)
            near = range_m / max(r, cell_m)
            push = cell_m / range_m * max(near - 1.0, 0.0) * near * near / r
            out[0] += push * dx
            out[1] += push * dy
    return out


@kernel
def clearance(walls_xy_map_m: F64_2D, xy_map_m: F64_2D) -> F64_1D:
    """Return the distance (m,) in m from each point (m, 2) to the nearest wall (n, 2); inf where there is none."""
    out = np.empty(len(xy_map_m))
    for k in range(len(xy_map_m)):
        best = np.inf
        for i in range(len(walls_xy_map_m)):
            dx, dy = xy_map_m[k, 0] - walls_xy_map_m[i, 0], xy_map_m[k, 1] - walls_xy_map_m[i, 1]
            best = min(best, dx * dx + dy * dy)
        out[k] = np.sqrt(best)
    return out
