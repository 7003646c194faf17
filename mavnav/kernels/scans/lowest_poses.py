"""The lowest separate minima of a scan's cost on a lattice of poses, by branch and bound (Hess 2016; docs/method.md).

The positions of the lattice form squares of 4 x 4. The sum of ``cost_floors`` bounds a scan's cost on a whole square.
The square with the least bound is divided next, into squares of 2 x 2, then into positions; a position with the least
bound is evaluated. So the poses are found in the order of their costs, and few are evaluated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavnav.kernels.machine.jit import (
    F64_1D,
    F64_2D,
    I32_2D,
    I32_3D,
    I64_1D,
    U8_2D,
    U8_3D,
    U16_1D,
    U16_2D,
    U32_2D,
    Out,
    helper,
    int64,
    kernel,
    uint8,
    uint16,
    uint64,
)
from mavnav.kernels.maps.layout import LEVELS, WORST
from mavnav.kernels.scans.correlative_search import is_same, pose_cost

TOP = LEVELS - 1
SIDE = 1 << TOP  # positions along a square of the top level

MOST_POINTS = 256
"""Maximum number of points whose bounds are summed, below `EMPTY`; other points are bounded by 0."""

UNSURE = 1e-6
"""Distance from an edge, in cells, within which rounding may put a point on either side: it is bounded by 0."""

ROUNDING = 1.0 - 1e-9
"""Factor on bounds against rounding: a mean of costs is off by some 1e-14."""

SLICE = 256
"""Minimum number of squares in the first slice of the order by bounds; each slice has four times as many."""

EMPTY = 65535
"""Instead of a bound, above all of them: the square has no positions."""

AT_ONCE = 20
"""Number of points after which a sum of bounds is compared with the limit."""


class Heap(NamedTuple):
    """Entries in a heap, the least first: bound or cost, m2, and the code of a square or position (`lowest_poses`)."""

    cost_m2: F64_1D
    code: I64_1D


@helper
def _grow(heap: Heap, count: int) -> Heap:
    """Return a heap with space for more than ``count`` entries."""
    had = len(heap.code)
    if count < had:
        return heap
    cost_m2, code = np.empty(2 * count), np.empty(2 * count, np.int64)
    for k in range(had):
        cost_m2[k], code[k] = heap.cost_m2[k], heap.code[k]
    return Heap(cost_m2, code)


@helper
def _is_before(heap: Heap, at: int, cost_m2: float, code: int) -> bool:
    """Return whether an entry of the heap comes before another one; of equal costs the lower code does."""
    return bool(heap.cost_m2[at] < cost_m2 or (heap.cost_m2[at] == cost_m2 and heap.code[at] < code))


@helper
def _push(heap: Heap, count: int, cost_m2: float, code: int) -> None:
    """Add an entry to ``count`` others."""
    at = count
    while at > 0:
        up = (at - 1) // 2
        if _is_before(heap, up, cost_m2, code):
            break
        heap.cost_m2[at], heap.code[at] = heap.cost_m2[up], heap.code[up]
        at = up
    heap.cost_m2[at], heap.code[at] = cost_m2, code


@helper
def _pop(heap: Heap, count: int) -> None:
    """Remove the first of ``count`` entries."""
    cost_m2, code, at = heap.cost_m2[count - 1], heap.code[count - 1], 0
    while 2 * at + 1 < count - 1:
        down = 2 * at + 1
        if down + 1 < count - 1 and _is_before(heap, down + 1, heap.cost_m2[down], heap.code[down]):
            down += 1
        if not _is_before(heap, down, cost_m2, code):
            break
        heap.cost_m2[at], heap.code[at] = heap.cost_m2[down], heap.code[down]
        at = down
    heap.cost_m2[at], heap.code[at] = cost_m2, code


@helper
def _cells(
    points: F64_2D, first_xy_m: tuple[float, float], yaws_rad: F64_1D, corner: I64_1D, geometry: F64_1D
) -> tuple[I32_3D, I64_1D]:
    """Return the cell of every point for every yaw at the first position, (yaws, 2, n), and their numbers (yaws,).

    Points within `UNSURE` of an edge are left out.
    """
    ox, oy, cell_m, _, _, _ = geometry
    cells, counts = np.empty((len(yaws_rad), 2, len(points)), np.int32), np.zeros(len(yaws_rad), np.int64)
    for q in range(len(yaws_rad)):
        c, s = np.cos(yaws_rad[q]), np.sin(yaws_rad[q])
        for k in range(min(len(points), MOST_POINTS)):
            u = (c * points[k, 0] - s * points[k, 1] + first_xy_m[0] - ox) / cell_m
            v = (s * points[k, 0] + c * points[k, 1] + first_xy_m[1] - oy) / cell_m
            col, row = np.floor(u), np.floor(v)
            if UNSURE < u - col < 1.0 - UNSURE and UNSURE < v - row < 1.0 - UNSURE:
                cells[q, 0, counts[q]], cells[q, 1, counts[q]] = int(row) - corner[0], int(col) - corner[1]
                counts[q] += 1
    return cells, counts


@helper
def _lattice(xy_m: F64_2D, step_m: float) -> tuple[I32_2D, float, float]:
    """Return the index of each position by row and column, whole squares, -1 without one, and the first x and y."""
    x0, x1 = xy_m[0, 0], xy_m[0, 0]
    for p in range(len(xy_m)):
        x0, x1 = min(x0, xy_m[p, 0]), max(x1, xy_m[p, 0])
    y0, y1 = xy_m[0, 1], xy_m[len(xy_m) - 1, 1]
    rows = int(np.rint((y1 - y0) / step_m)) // SIDE * SIDE + SIDE
    cols = int(np.rint((x1 - x0) / step_m)) // SIDE * SIDE + SIDE
    index = np.full((rows, cols), np.int32(-1))
    for p in range(len(xy_m)):
        index[int(np.rint((xy_m[p, 1] - y0) / step_m)), int(np.rint((xy_m[p, 0] - x0) / step_m))] = p
    return index, x0, y0


@helper
def _holds_any(index: I32_2D, row: int, col: int, side: int) -> bool:
    for r in range(row, row + side):
        for c in range(col, col + side):
            if index[r, c] >= 0:
                return True
    return False


@helper
def _squares(index: I32_2D) -> U16_2D:
    """Return 0 for squares with positions and `EMPTY` for others, (rows, cols) of squares."""
    rows, cols = index.shape[0] // SIDE, index.shape[1] // SIDE
    blank = np.zeros((rows, cols), np.uint16)
    for row in range(rows):
        for col in range(cols):
            if not _holds_any(index, row * SIDE, col * SIDE, SIDE):
                blank[row, col] = EMPTY
    return blank


@helper
def _pad_columns(planes: U8_3D, cols: int) -> U8_3D:
    """Return planes padded to ``cols`` columns at least, with `WORST`."""
    n, rows, had = planes.shape
    if had >= cols:
        return planes
    out = np.full((n, rows, cols), uint8(WORST))
    for plane in range(n):
        for row in range(rows):
            for col in range(had):
                out[plane, row, col] = planes[plane, row, col]
    return out


@helper
def _bound_squares(cells: I32_2D, count: int, step: int, planes: U8_3D, sums: U16_1D) -> None:
    """Write bounds of the summed cost of the points, at one yaw, on squares row by row; rows are as long as in a plane.

    All rows are added at once. A point beyond the first or last column is therefore bounded by the cell at that place
    in memory. That bound is valid, because it is not above the true one, `WORST`.
    """
    _, rows, cols = planes.shape
    apart, n = SIDE * step, len(sums)
    sums[:] = uint16(0)
    for k in range(count):
        first = cells[0, k] // apart * cols + cells[1, k] // apart
        plane = planes[cells[0, k] % apart * apart + cells[1, k] % apart].ravel()
        low = min(max(-first, 0), n)
        high = max(min(rows * cols - first, n), low)
        inside, line = sums[low:high], plane[first + low : first + high]
        for j in range(len(inside)):
            inside[j] += uint16(line[j])
        for j in range(low):
            sums[j] += uint16(WORST)
        for j in range(high, n):
            sums[j] += uint16(WORST)


@helper
def _bound_quarters(
    cells: I32_2D, count: int, row: int, col: int, side: int, floors: U8_2D, most: int
) -> tuple[int, int, int, int]:
    """Return bounds of the summed cost of the points on the quarters of a square with this first cell.

    ``side`` is that of a quarter in cells, ``floors`` (rows, cols) the level of the quarters. The sums stop once all
    exceed ``most``.
    """
    rows, cols = floors.shape
    a = b = c = d = 0
    for k in range(count):
        if k % AT_ONCE == 0 and min(a, b, c, d) > most:
            break
        y, x = cells[0, k] + row, cells[1, k] + col
        if 0 <= y < rows - side and 0 <= x < cols - side:
            r, s = uint64(y), uint64(x)
            up, right = uint64(y + side), uint64(x + side)
            a += int64(floors[r, s])
            b += int64(floors[r, right])
            c += int64(floors[up, s])
            d += int64(floors[up, right])
        else:
            low, high = 0 <= y < rows, 0 <= y + side < rows
            left, beside = 0 <= x < cols, 0 <= x + side < cols
            a += int64(floors[y, x]) if low and left else WORST
            b += int64(floors[y, x + side]) if low and beside else WORST
            c += int64(floors[y + side, x]) if high and left else WORST
            d += int64(floors[y + side, x + side]) if high and beside else WORST
    return a, b, c, d


@helper
def _upper_sum(histogram: I64_1D, after: int, least: int) -> tuple[int, int]:
    """Return the least bound such that at least ``least`` squares have a bound above ``after`` and up to it.

    Also returns the number of these squares.
    """
    count, upper = 0, after
    while count < least and upper < len(histogram) - 1:
        upper += 1
        count += histogram[upper]
    return upper, count


@helper
def _least_of_row(bounds: U16_1D, blank: U16_1D) -> int:
    """Write `EMPTY` to the bounds of squares without positions; return the least bound."""
    least = uint16(EMPTY)
    for col in range(len(blank)):
        bounds[col] = max(bounds[col], blank[col])
        least = min(least, bounds[col])
    return int(least)


@kernel
def lowest_poses(
    points: F64_2D,
    xy_map_m: F64_2D,
    yaws_rad: F64_1D,
    truncate_m: float,
    separate: F64_1D,
    limit_m2: float,
    most: int,
    step: int,
    corner: I64_1D,
    floors: U8_3D,
    planes: U8_3D,
    nearest: U32_2D,
    lines: F64_2D,
    geometry: F64_1D,
    credit: Out[I64_1D],
) -> F64_2D:
    """Return the ``most`` lowest separate minima of ``pose_costs``: cost (m2), index of yaw and of position, (m, 3).

    No cost is above ``limit_m2``. Each is the lowest that is not within ``separate`` (m, rad) of one before it; of
    equal costs, the first pose is taken. ``xy_map_m`` (p, 2) are positions of a lattice of ``step`` cells, row by row.
    ``floors`` are ``cost_floors`` of the same step from the cell ``corner`` (row, col) on, and include all cells in
    which points at these poses may be. Each square and position looked at takes one of ``credit`` (1,), to 0 at most.
    """
    index, x0, y0 = _lattice(xy_map_m, step * geometry[2])
    cells, counts = _cells(points, (x0, y0), yaws_rad, corner, geometry)
    blank = _squares(index)
    positions, n_yaws, (square_rows, square_cols) = index.size, len(yaws_rad), blank.shape
    wide = _pad_columns(planes, square_cols)
    sums = np.empty((n_yaws, square_rows, wide.shape[2]), np.uint16)
    scale = ROUNDING * truncate_m * truncate_m / (WORST * len(points))
    limit = int(min(max(limit_m2 / scale, 0.0), MOST_POINTS * WORST - 1.0)) + 1
    histogram, least = np.zeros(limit + 1, np.int64), np.empty((n_yaws, square_rows), np.int64)
    for q in range(n_yaws):
        _bound_squares(cells[q], counts[q], step, wide, sums[q].ravel())
        for row in range(square_rows):
            bounds = sums[q, row]
            least[q, row] = _least_of_row(bounds, blank[row])
            if least[q, row] <= limit:
                for col in range(square_cols):
                    if bounds[col] <= limit:
                        histogram[bounds[col]] += 1
    kind = n_yaws * positions  # code: (TOP - level, or LEVELS if exact) times this, plus yaw and position
    heap, count, upper, slice_size = Heap(np.empty(4 * SLICE), np.empty(4 * SLICE, np.int64)), 0, -1, SLICE
    minima, n = np.empty((most, 3)), 0
    while n < most and credit[0] > 0:
        if count == 0 or (upper + 1 < len(histogram) and heap.cost_m2[0] >= (upper + 1) * scale):
            if upper + 1 >= len(histogram) or (upper + 1) * scale > limit_m2:
                break
            lower = upper
            upper, more = _upper_sum(histogram, upper, slice_size)
            slice_size *= 4
            heap = _grow(heap, count + more)  # not in the loops, where each pass would count references
            for q in range(n_yaws):
                for row in range(square_rows):
                    if least[q, row] > upper:
                        continue
                    for col in range(square_cols):
                        if lower < int64(sums[q, row, col]) <= upper:
                            at = q * positions + row * SIDE * index.shape[1] + col * SIDE
                            _push(heap, count, sums[q, row, col] * scale, at)
                            count += 1
            continue
        cost_m2, code = heap.cost_m2[0], heap.code[0]
        if cost_m2 > limit_m2:
            break
        _pop(heap, count)
        count -= 1
        credit[0] -= 1
        level, at = TOP - code // kind, code % kind
        q, row, col = at // positions, at % positions // index.shape[1], at % index.shape[1]
        if level > 0:
            side = 1 << (level - 1)
            bounds = _bound_quarters(cells[q], counts[q], row * step, col * step, side * step, floors[level - 1], limit)
            heap = _grow(heap, count + 3)
            for k in range(4):
                r, c = k // 2 * side, k % 2 * side
                if bounds[k] <= limit and _holds_any(index, row + r, col + c, side):
                    code = (TOP - level + 1) * kind + at + r * index.shape[1] + c
                    _push(heap, count, bounds[k] * scale, code)
                    count += 1
            continue
        p, taken = int64(index[row, col]), False
        for k in range(n):
            other_q, other_p = int(minima[k, 1]), int(minima[k, 2])
            moved_m = xy_map_m[p, 0] - xy_map_m[other_p, 0], xy_map_m[p, 1] - xy_map_m[other_p, 1]
            taken |= is_same(moved_m, yaws_rad[q] - yaws_rad[other_q], separate)
        if taken:
            continue
        if level == 0:
            cost_m2 = pose_cost(points, xy_map_m[p], yaws_rad[q], truncate_m, nearest, lines, geometry)
            heap = _grow(heap, count)
            _push(heap, count, cost_m2, LEVELS * kind + at)
            count += 1
        else:
            minima[n, 0], minima[n, 1], minima[n, 2] = cost_m2, q, p
            n += 1
    return minima[:n].copy()
