"""Counting hits, and the beams that passed, in the slices of a map by height."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, U16_3D, Out, float64, int64, kernel
from mavnav.kernels.maps.hits import BLOCK, path_cells
from mavnav.kernels.maps.layout import MOST


@kernel
def add_to_slices(
    xyz_map_m: F64_2D, laser_xyz_m: F64_1D, lattice: F64_1D, levels_m: F64_1D, hits: Out[U16_3D], passes: Out[U16_3D]
) -> None:
    """Count every end point (n, 3) in ``hits`` of its slice, and the cells that its beam crossed at heights of a slice.

    Both are (slices, rows, cols), and end at `MOST`. ``laser_xyz_m`` (3,) is the place of the laser, ``lattice`` (3,) x
    and y of the corner of cell [0, 0] and the cell edge, ``levels_m`` (2,) the height at which the first slice begins
    and the thickness of each, all in m. Beams that begin or end outside of the lattice are left out.
    """
    (ox, oy, cell), (x, y, z), (lowest, thick) = lattice, laser_xyz_m, levels_m
    slices, rows, cols = hits.shape
    steps, path = np.arange(float(max(rows, cols) + BLOCK)), np.empty(rows + cols + BLOCK, np.int32)
    flat = passes.ravel()
    u0, v0, s0 = (x - ox) / cell, (y - oy) / cell, (z - lowest) / thick
    if not (0.0 <= u0 < cols and 0.0 <= v0 < rows):
        return
    for k in range(len(xyz_map_m)):
        u1, v1 = (xyz_map_m[k, 0] - ox) / cell, (xyz_map_m[k, 1] - oy) / cell
        if not (0.0 <= u1 < cols and 0.0 <= v1 < rows):
            continue
        s1 = (xyz_map_m[k, 2] - lowest) / thick
        rise, last = s1 - s0, int(np.floor(s1))
        for s in range(max(int(np.floor(min(s0, s1))), 0), min(int(np.floor(max(s0, s1))), slices - 1) + 1):
            start, stop = 0.0, 1.0
            if abs(rise) > 1e-12:
                to_low, to_high = (s - s0) / rise, (s + 1 - s0) / rise
                start, stop = max(min(to_low, to_high), 0.0), min(max(to_low, to_high), 1.0)
            a, b = u0 + start * (u1 - u0), v0 + start * (v1 - v0)
            c, d = (u1, v1) if s == last else (u0 + stop * (u1 - u0), v0 + stop * (v1 - v0))
            first = int(np.floor(b)) * cols + int(np.floor(a))
            base = s * rows * cols
            flat[base + first] += flat[base + first] < MOST
            for i in range(path_cells(a, b, c, d, float64(cols), steps, path)):
                at = base + int64(path[i])
                flat[at] += flat[at] < MOST
            if s == last:
                row, col = int(np.floor(v1)), int(np.floor(u1))
                passes[s, row, col] -= passes[s, row, col] < MOST  # it ends there
                hits[s, row, col] += hits[s, row, col] < MOST
