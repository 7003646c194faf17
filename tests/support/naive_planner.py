"""Slow, simple twins of the planner's kernels."""

from __future__ import annotations

import heapq
import math
from itertools import product

import numpy as np


def occupied(hits, passes, lattice, min_hits, min_share):
    ox, oy, cell = lattice
    solid = (hits > 0) & (hits >= min_share * (hits.astype(float) + passes))
    out = []
    for row, col in np.argwhere(solid):
        around = np.s_[max(0, row - 2) : row + 3, max(0, col - 2) : col + 3]
        if (hits[around] * solid[around]).sum() >= min_hits:
            out.append((ox + (col + 0.5) * cell, oy + (row + 0.5) * cell))
    return np.array(out).reshape(-1, 2)


def repulsion(walls_xy_map_m, xy_map_m, range_m, cell_m):
    total = np.zeros(2)
    for wall in walls_xy_map_m:
        r = math.dist(wall, xy_map_m)
        if 0 < r < range_m:
            near = range_m / max(r, cell_m)
            total += cell_m / range_m * max(near - 1, 0) * near**2 * (xy_map_m - wall) / r
    return total


def clearance(walls_xy_map_m, xy_map_m):
    return np.array([min((math.dist(p, w) for w in walls_xy_map_m), default=math.inf) for p in xy_map_m])


def squared_clearance(walls, reach_cells):
    cells = np.argwhere(walls)
    out = np.full(walls.shape, reach_cells**2)
    for row, col in np.ndindex(walls.shape):
        for r, c in cells:
            out[row, col] = min(out[row, col], (r - row) ** 2 + (c - col) ** 2)
    return out


def steps_from(weights, row, col):
    """Yield every cell that one step reaches, with the length of the step."""
    rows, cols = weights.shape
    for dr, dc in product((-1, 0, 1), repeat=2):
        r, c = row + dr, col + dc
        if (dr or dc) and 0 <= r < rows and 0 <= c < cols and weights[r, c]:
            if not (dr and dc):
                yield r, c, 10
            elif weights[row, c] and weights[r, col]:
                yield r, c, 14


def wave(weights, goals):
    """Return the cost of every cell by Dijkstra's algorithm with a heap."""
    cost = {}
    heap = [(0, int(row), int(col)) for row, col in goals]
    while heap:
        at, row, col = heapq.heappop(heap)
        if (row, col) in cost:
            continue
        cost[row, col] = at
        for r, c, length in steps_from(weights, row, col):
            heapq.heappush(heap, (at + length * int(weights[r, c]), r, c))
    return cost


def downhill(cost, weights, row, col, steps):
    way = [(row, col)]
    for _ in range(steps):
        row, col = way[-1]
        lower = [
            (cost[r, c] + length * weights[row, col], r, c)
            for r, c, length in steps_from(weights, row, col)
            if cost[r, c] < cost[row, col]
        ]
        if not lower:
            break
        way.append(min(lower)[1:])
    return np.array(way)


def in_the_open(walls, shape, cell_m):
    """Count squares of 0.25 m (or one cell) with walls, within 2 m of the cell's own square."""
    side = max(1, round(0.25 / cell_m))
    reach = round(2.0 / (side * cell_m))
    squares = {(row // side, col // side) for row, col in walls.tolist()}
    out = np.zeros(shape, bool)
    for row, col in np.ndindex(shape):
        near = [s for s in squares if max(abs(s[0] - row // side), abs(s[1] - col // side)) <= reach]
        out[row, col] = len(near) * side * cell_m < 3.5
    return out
