"""Distances on a coarse grid: to the nearest wall, and to the goal around all walls."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import BOOL_2D, I32_2D, I64_2D, int32, int64, kernel

STRAIGHT, DIAGONAL = 10, 14
"""Costs of a straight and of a diagonal step, per weight of the cell."""

UNREACHED = np.int32(2**30)
"""Cost of a cell that was not reached."""


@kernel
def squared_clearance(walls: BOOL_2D, reach_cells: int) -> I32_2D:
    """Return the squared distance (rows, cols) in cells to the nearest wall, ``reach_cells**2`` at most."""
    rows, cols = walls.shape
    reach = int32(reach_cells)
    across = np.full((rows, cols), reach, np.int32)  # distance to the nearest wall of the same column
    for row in range(rows):
        for col in range(cols):
            if walls[row, col]:
                across[row, col] = 0
            elif row > 0:
                across[row, col] = min(reach, int32(across[row - 1, col] + 1))
    for row in range(rows - 2, -1, -1):
        for col in range(cols):
            across[row, col] = min(across[row, col], int32(across[row + 1, col] + 1))
    out = across * across
    squared = out.copy()
    for row in range(rows):
        for aside in range(1, min(reach_cells, cols)):  # whole rows side by side: several cells at once, in SIMD lanes
            add = int32(aside * aside)
            to, left, right = out[row, aside:], out[row, : cols - aside], squared[row, : cols - aside]
            for col in range(cols - aside):
                to[col] = min(to[col], int32(right[col] + add))
            right = squared[row, aside:]
            for col in range(cols - aside):
                left[col] = min(left[col], int32(right[col] + add))
    return out


@kernel
def wave(weights: I32_2D, goals: I32_2D, row: int, col: int) -> I32_2D:
    """Return the cost (rows, cols) of the cheapest path from each cell to a goal, UNREACHED without one.

    A step costs STRAIGHT or DIAGONAL times the weight of the cell that it leaves. Weight 0 is blocked, and a diagonal
    step needs both adjacent cells to be free. ``goals`` (n, 2) are rows and columns of free cells. This is Dijkstra's
    algorithm with one bucket per cost. It ends once cell [row, col] and all cheaper ones are final; other costs may
    then be too high or UNREACHED.
    """
    rows, cols = weights.shape
    framed = np.zeros((rows + 2, cols + 2), np.int32)  # with a frame of blocked cells, so that no step leaves the grid
    for r in range(rows):
        for c in range(cols):
            framed[r + 1, c + 1] = weights[r, c]
    w, wide = framed.ravel(), cols + 2
    cost = np.full(len(w), UNREACHED, np.int32)
    straight = np.array([-wide, -1, 1, wide])
    buckets = DIAGONAL * int64(weights.max()) + 1
    head = np.full(buckets, -1, np.int32)  # first entry of each bucket's list
    cell = np.empty(8 * len(w) + len(goals), np.int32)
    behind = np.empty(8 * len(w) + len(goals), np.int32)
    entries = 0
    for k in range(len(goals)):
        at = (goals[k, 0] + 1) * wide + goals[k, 1] + 1
        cost[at], cell[entries], behind[entries], head[0] = 0, at, head[0], entries
        entries += 1
    start = (row + 1) * wide + col + 1
    waiting, now = entries, 0
    while waiting > 0 and now <= cost[start]:
        bucket = now % buckets
        entry = head[bucket]
        head[bucket] = -1
        while entry >= 0:
            at = cell[entry]
            entry = behind[entry]
            waiting -= 1
            if cost[at] != now:  # a cheaper entry of the same cell came first
                continue
            for k in range(8):
                if k < 4:
                    to, length = at + straight[k], STRAIGHT
                else:
                    up, aside = (-wide if k < 6 else wide), 1 - 2 * (k % 2)
                    to, length = at + up + aside, DIAGONAL
                    if w[at + up] == 0 or w[at + aside] == 0:
                        continue
                new = now + length * w[to]
                if w[to] > 0 and new < cost[to]:
                    cost[to], cell[entries], behind[entries] = new, to, head[new % buckets]
                    head[new % buckets] = entries
                    entries += 1
                    waiting += 1
        now += 1
    return cost.reshape(rows + 2, cols + 2)[1:-1, 1:-1].copy()


@kernel
def downhill(cost: I32_2D, weights: I32_2D, row: int, col: int, steps: int) -> I64_2D:
    """Return the cells (n, 2), row and col, of the cheapest path from [row, col] towards the goal, ``steps`` at most.

    The first is [row, col] itself. Of equally cheap steps, that to the lowest row, then column, is taken.
    """
    rows, cols = cost.shape
    out = np.empty((steps + 1, 2), np.int64)
    out[0, 0], out[0, 1] = row, col
    for k in range(steps):
        r, c = out[k, 0], out[k, 1]
        best, out[k + 1, 0], out[k + 1, 1] = int64(UNREACHED), r, c
        for y in range(max(0, r - 1), min(rows, r + 2)):
            for x in range(max(0, c - 1), min(cols, c + 2)):
                aslant = y != r and x != c
                if cost[y, x] >= cost[r, c] or (aslant and (weights[r, x] == 0 or weights[y, c] == 0)):
                    continue
                total = cost[y, x] + (DIAGONAL if aslant else STRAIGHT) * int64(weights[r, c])
                if total < best:
                    best, out[k + 1, 0], out[k + 1, 1] = total, y, x
        if best == UNREACHED:
            return out[: k + 1].copy()
    return out
