"""The shortest path to the goal round the known walls: a wavefront on a coarse grid; what is unknown is free."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from mavnav.config.models import PlannerConfig
from mavnav.kernels.planning import wavefront

XY = NDArray[np.float64]
"""A point or a vector in the map frame, (2,) in m (a force: without unit), or several, (n, 2)."""


_MARGIN_M = 1.0  # round all walls, vehicle and goal: there is a path round the end of every wall
_BLOCKED_CELLS2 = 2  # a cell with a wall and the eight around it are blocked
_AHEAD_M = 2.0  # a straight line to the path is sought this far
_UNIT = 4  # weight of a cell in the open
_NEAR_SAFETY, _UNDER_SAFETY, _UNDER_LEAST = 3, 10, 100  # times as much: a metre there costs a detour of so many
_SEEDS_CELLS = 4  # a goal in a blocked cell is reached from within this distance


def aim_on_shortest_path(walls_xy_map_m: XY, xy_map_m: XY, goal_xy_map_m: XY, config: PlannerConfig) -> XY | None:
    """Return the point (2,) in m, map frame, to head for in a straight line; None where walls close the goal off.

    Cells nearer to a wall than the safety clearance cost more, far more below the least one: the inflation of the walls
    shrinks by itself where there is no other path.
    """
    origin, shape = _covering(np.vstack((walls_xy_map_m, xy_map_m, goal_xy_map_m)), config.plan_cell_m)
    cell_m = config.plan_cell_m
    weights = _weights(_cells(walls_xy_map_m, origin, cell_m), shape, config)
    start = _open_cells(weights, _cells(xy_map_m[None], origin, cell_m)[0])[:1]
    goals = _open_cells(weights, _cells(goal_xy_map_m[None], origin, cell_m)[0])
    if len(start) == 0 or len(goals) == 0:
        return None
    row, col = start[0].tolist()
    cost = wavefront.wave(weights, goals, row, col)
    if cost[row, col] == wavefront.UNREACHED:
        return None
    path = wavefront.downhill(cost, weights, row, col, ceil(_AHEAD_M / cell_m))
    seen = _farthest_in_sight(weights, path, (xy_map_m / cell_m) - origin)
    if (path[seen] == goals[0]).all():
        return goal_xy_map_m
    return np.asarray((path[seen, ::-1] + 0.5 + origin) * cell_m, np.float64)


def _covering(xy_map_m: XY, cell_m: float) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Return the origin (x, y) in cells and the shape (rows, cols) of a lattice about all points (n, 2)."""
    by_axis = np.ascontiguousarray(xy_map_m.T)  # along the last axis numpy finds extremes 20 times as fast
    low = np.floor((by_axis.min(axis=1) - _MARGIN_M) / cell_m).astype(np.int64)
    high = np.floor((by_axis.max(axis=1) + _MARGIN_M) / cell_m).astype(np.int64)
    return low, (int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1)


def _cells(xy_map_m: XY, origin: NDArray[np.int64], cell_m: float) -> NDArray[np.int64]:
    """Return row and column (n, 2) of points (n, 2)."""
    return (np.floor(xy_map_m / cell_m).astype(np.int64) - origin)[:, ::-1]


def _weights(walls: NDArray[np.int64], shape: tuple[int, int], config: PlannerConfig) -> NDArray[np.int32]:
    """Return what each cell (rows, cols) costs to cross, 0 where it is blocked."""
    mask = np.zeros(shape, np.bool_)
    mask[walls[:, 0], walls[:, 1]] = True
    reach = max(2, ceil(2.0 * config.safety_mm / config.plan_cell_mm))
    return np.take(_weight_table(reach, config), wavefront.squared_clearance(mask, reach))


def _weight_table(reach_cells: int, config: PlannerConfig) -> NDArray[np.int32]:
    """Return the weight of a cell by its squared distance, in cells, from the nearest wall."""
    squared = np.arange(reach_cells**2 + 1)
    distance_mm = np.sqrt(squared) * config.plan_cell_mm
    beyond = np.clip(distance_mm / max(config.safety_mm, 1e-9) - 1.0, 0.0, 1.0)  # 0 at the safety clearance, 1 at twice
    factor = _NEAR_SAFETY + (1 - _NEAR_SAFETY) * beyond
    factor[distance_mm < config.safety_mm] = _UNDER_SAFETY
    factor[distance_mm < config.least_safety_mm] = _UNDER_LEAST
    factor[squared <= _BLOCKED_CELLS2] = 0
    return np.round(factor * _UNIT).astype(np.int32)


def _open_cells(weights: NDArray[np.int32], at: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return the cell itself (1, 2) if it is not blocked, else the open ones near by (n, 2), nearest first."""
    row, col = at.tolist()
    if weights[row, col] > 0:
        return at[None].astype(np.int32)
    reach = np.arange(-_SEEDS_CELLS, _SEEDS_CELLS + 1)
    offsets = np.stack(np.meshgrid(reach, reach, indexing="ij"), axis=-1).reshape(-1, 2)
    offsets = offsets[np.argsort((offsets**2).sum(axis=1), kind="stable")]
    around = at + offsets  # inside: the lattice has a margin
    return np.ascontiguousarray(around[weights[around[:, 0], around[:, 1]] > 0], np.int32)


def _farthest_in_sight(weights: NDArray[np.int32], path: NDArray[np.int64], at_cells: NDArray[np.float64]) -> int:
    """Return the index of the farthest cell of the path (n, 2) that a straight line reaches through cells no worse.

    ``at_cells`` (x, y) is where the line begins, in cells from the lattice's corner; the line's cells must not weigh
    more than the worst of the path so far.
    """
    centres = path[:, ::-1] + 0.5
    shares = np.linspace(0.0, 1.0, 2 * len(path))[:, None, None]
    line = np.floor(at_cells + shares * (centres - at_cells)).astype(np.int64)
    crossed = weights[line[..., 1], line[..., 0]]
    worst = np.maximum.accumulate(weights[path[:, 0], path[:, 1]])
    seen = (crossed > 0).all(axis=0) & (crossed.max(axis=0) <= worst)
    seen[: min(3, len(path))] = True  # at least to the next cells
    return int(np.flatnonzero(seen)[-1])
