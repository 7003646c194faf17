"""Look-ups in a map: counts in strips, the nearest occupied cell, the distance to its line."""

from __future__ import annotations

from mavnav.kernels.machine.jit import F64_2D, I16_3D, U16_3D, U32_2D, helper, int64, uint64
from mavnav.kernels.maps.layout import NEAR, SHIFT, WIDE


@helper
def count_at(counts: U16_3D | I16_3D, row: int, col: int) -> int:
    """Return the count of a cell from strips (cols / `WIDE`, rows, `WIDE`)."""
    count: int = counts[col >> SHIFT, row, col & (WIDE - 1)]
    return count


@helper
def slot_of(entry: int) -> int:
    """Return the index of the occupied cell in an entry of ``nearest``; 0 without one."""
    return entry // NEAR


@helper
def closeness_of(entry: int) -> int:
    """Return the closeness in an entry of ``nearest``: `FAR` + 1 less the squared distance in cells."""
    return entry % NEAR


@helper
def slot_at(x_m: float, y_m: float, origin_x_m: float, origin_y_m: float, cells_per_m: float, nearest: U32_2D) -> int:
    """Return the index of the line of a point in the map frame; 0 without one. Outside, the edge cell counts."""
    u, v = (x_m - origin_x_m) * cells_per_m, (y_m - origin_y_m) * cells_per_m
    col = int64(min(max(u, 0.0), nearest.shape[1] - 1.0))
    row = int64(min(max(v, 0.0), nearest.shape[0] - 1.0))
    return int(slot_of(nearest[uint64(row), uint64(col)]))


@helper
def line_distance2(x_m: float, y_m: float, truncate_m2: float, slot: int, lines: F64_2D) -> float:
    """Return the squared, truncated distance of a point in the map frame to a line, m2; ``slot`` 0 has no line."""
    line = uint64(slot)
    dx, dy = x_m - lines[line, 0], y_m - lines[line, 1]
    xx, xy, yy = lines[line, 2], lines[line, 3], lines[line, 4]
    return float(min(dx * dx * xx + 2.0 * dx * dy * xy + dy * dy * yy, truncate_m2))
