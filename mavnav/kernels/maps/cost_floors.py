"""Lower bounds of a point's cost in the cells of a map, and in squares of them (docs/method.md).

The eigenvalues of a line's metric are at most 1, so the distance of a point to its line changes by at most the motion
of the point. The distance at the centre of a cell, less half its diagonal, is a lower bound for every point in it.
"""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, I64_1D, U8_3D, U32_2D, int64, kernel, uint8
from mavnav.kernels.maps.layout import LEVELS, WORST
from mavnav.kernels.maps.lookup import line_distance2, slot_of


@kernel
def cost_floors(
    box: I64_1D, step: int, truncate_m: float, nearest: U32_2D, lines: F64_2D, geometry: F64_1D
) -> tuple[U8_3D, U8_3D]:
    """Return lower bounds of the cost of a point in the cells of a box, in units of the truncated cost / `WORST`.

    ``box`` is first row, first col, rows and cols; it may extend beyond the map, where the cost is the truncated one.
    The bounds are (`LEVELS`, rows, cols). Level 0 bounds single cells. On level l a cell has the least bound of the
    cells that a point in it reaches by up to 2 ** l - 1 shifts of ``step`` cells upwards and to the right. The box must
    begin so far before the map that the cells before it have the bound `WORST` on all levels. The last level is
    returned once more, with cells at the distance ``apart`` = ``step << LEVELS - 1`` adjacent in memory: cell
    (row, col) is ``[row % apart * apart + col % apart, row // apart, col // apart]``.
    """
    first_row, first_col, rows, cols = box
    ox, oy, cell_m, _, _, _ = geometry
    half_m, farthest_m2 = 0.5 * np.sqrt(2.0) * cell_m, (truncate_m + cell_m) ** 2
    floors = np.full((LEVELS, rows, cols), uint8(WORST))
    for row in range(max(-first_row, 0), min(rows, nearest.shape[0] - first_row)):
        y = oy + (first_row + row + 0.5) * cell_m
        for col in range(max(-first_col, 0), min(cols, nearest.shape[1] - first_col)):
            slot = int64(slot_of(nearest[first_row + row, first_col + col]))
            if slot > 0:
                x = ox + (first_col + col + 0.5) * cell_m
                least_m = max(np.sqrt(line_distance2(x, y, farthest_m2, slot, lines)) - half_m, 0.0) / truncate_m
                floors[0, row, col] = uint8(int(WORST * min(least_m * least_m, 1.0)))
    for level in range(1, LEVELS):
        reach = step << (level - 1)
        for row in range(rows):
            above = row + reach if row + reach < rows else row
            here, low, high = floors[level, row], floors[level - 1, row], floors[level - 1, above]
            for col in range(cols):
                here[col] = min(high[col], low[col])
            left, right = here[: cols - reach], here[reach:]
            for col in range(len(left)):
                left[col] = min(right[col], left[col])
    apart = step << (LEVELS - 1)
    planes = np.full((apart * apart, -(-rows // apart), -(-cols // apart)), uint8(WORST))
    for row in range(rows):
        line = floors[LEVELS - 1, row]
        for first in range(min(apart, cols)):
            part, out = line[first::apart], planes[row % apart * apart + first, row // apart]
            for col in range(len(part)):
                out[col] = part[col]
    return floors, planes
