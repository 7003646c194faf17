"""What is done against local minima: techniques from scene and memory to a force (paper, "Path Planning")."""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, ceil, pi

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.config.models import PlannerConfig
from mavnav.kernels.planning import potential, wavefront
from mavnav.pose import wrap_angle

XY = NDArray[np.float64]
"""A point or a vector in the map frame, (2,) in m (a force: without unit), or several, (n, 2)."""

_SAME_PLACE_M, _MOST_AT_A_PLACE = 0.1, 3  # virtual obstacles, then they help no more
_VIRTUAL_AHEAD_M = 0.15
_VIRTUAL_RANGE_M = 0.9
_VIRTUAL_FORCE = 1.5
_NEARER_M = 0.1  # than where the field stalled: a wall is followed no longer
_FOLLOW_SPEED = 0.6  # of the speed in the open: or the vehicle overshoots at corners
_FOLLOW_MARGIN_M = 0.1  # a wall is followed at the safety clearance and this
_MARGIN_M = 1.0  # round all walls, vehicle and goal: there is a path round the end of every wall
_BLOCKED_CELLS2 = 2  # a cell with a wall and the eight around it are blocked
_AHEAD_M = 2.0  # a straight line to the path is sought this far
_UNIT = 4  # weight of a cell with all clearance
_NEAR_SAFETY, _UNDER_SAFETY, _UNDER_LEAST = 3, 10, 100  # times as much: a metre there costs a detour of so many
_WALL_NEAR_M, _LEAST_WALL_M = 2.0, 3.5  # with less wall within this distance along either axis a cell is in the open
_SQUARE_M = 0.25  # walls are counted in squares of this size
_SEEDS_CELLS = 4  # a goal in a blocked cell is reached from within this distance


class Scene(Struct, frozen=True):
    """What a technique sees: walls (n, 2), those near by, vehicle and goal, in m, map frame."""

    config: PlannerConfig
    cell_m: float
    walls_xy_map_m: XY
    near_xy_map_m: XY
    xy_map_m: XY
    goal_xy_map_m: XY

    @property
    def goal_m(self) -> float:
        """Distance to the goal as the crow flies."""
        return float(np.hypot(*(self.goal_xy_map_m - self.xy_map_m)))

    @property
    def attraction(self) -> XY:
        """Force of the goal: towards it, of the same strength everywhere."""
        return self.config.attraction_gain * unit(self.goal_xy_map_m - self.xy_map_m)

    @property
    def repulsion(self) -> XY:
        """Force of all walls within range."""
        force = potential.repulsion(self.walls_xy_map_m, self.xy_map_m, self.config.repulsion_range_m, self.cell_m)
        return self.config.repulsion_gain * force


class Following(Struct, frozen=True):
    """A wall that is being followed, since the field stalled at ``goal_m`` from the goal.

    ``start_xy_map_m`` and ``heading_rad`` are where the path along the wall began; ``path_m`` is its length so far.
    """

    goal_m: float
    start_xy_map_m: XY
    heading_rad: float
    path_m: float = 0.0


class Memory(Struct, frozen=True):
    """All that a planner remembers from command to command; map frame.

    All but the velocity is forgotten when the goal changes. ``velocity_m`` (2,) is the virtual mass's, in m a step.
    The vehicle has been within ``stall_mm`` of ``anchor_xy_map_m`` for ``idle_steps``; it has looked round for
    ``looks`` steps without finding a path. ``virtual_map_m`` are the virtual obstacles: x, y, range in m. ``side`` is
    that of the followed wall: +1 has them on the right hand, -1 on the left, 0 before any was.
    """

    goal_xy_map_m: XY
    velocity_m: XY
    anchor_xy_map_m: XY
    idle_steps: int = 0
    looks: int = 0
    virtual_map_m: tuple[tuple[float, float, float], ...] = ()
    following: Following | None = None
    side: int = 0


class Drive(Struct, frozen=True):
    """What a technique wants: a force (2,) on the virtual mass, or to look round (None), or to give up (a reason).

    With ``squeezes`` a step may give up the safety clearance where the path leads through narrower places.
    """

    force: XY | None
    memory: Memory
    reason: str = ""
    squeezes: bool = False


def unit(vector: XY) -> XY:
    """Return the vector at length 1; the zero vector stays."""
    length = float(np.hypot(*vector))
    return vector / length if length > 1e-9 else np.zeros(2)


# ---- techniques against local minima ---------------------------------------------------------------------------------


def _is_stalled(scene: Scene, memory: Memory) -> bool:
    return memory.idle_steps >= scene.config.stall_steps


def _field(scene: Scene, memory: Memory) -> Drive:
    """Drive by the paper's plain field; gives up where it stalls."""
    reason = "the forces are in balance" if _is_stalled(scene, memory) else ""
    return Drive(scene.attraction + scene.repulsion, memory, reason)


def _wavefront(scene: Scene, memory: Memory) -> Drive:
    """Drive along the shortest path round the known walls; these bend the path but do not hold the vehicle back."""
    aim = aim_on_shortest_path(scene.walls_xy_map_m, scene.xy_map_m, scene.goal_xy_map_m, scene.config)
    if aim is None:
        return _look_round(scene, memory)
    towards = unit(aim - scene.xy_map_m)
    push = scene.repulsion
    push = push - min(0.0, float(push @ towards)) * towards
    push *= min(1.0, scene.config.attraction_gain / max(1e-9, float(np.hypot(*push))))
    reason = "no step leads on" if _is_stalled(scene, memory) else ""
    return Drive(scene.config.attraction_gain * towards + push, replace(memory, looks=0), reason, squeezes=True)


def _look_round(scene: Scene, memory: Memory) -> Drive:
    """Turn round once, new scans may open a path; then give up."""
    reason = "walls close off the goal" if memory.looks * scene.config.max_turn_deg >= 360.0 else ""
    return Drive(None, replace(memory, looks=memory.looks + 1, idle_steps=0), reason)


def _virtual_obstacles(scene: Scene, memory: Memory) -> Drive:
    """Drive by the field, and by an obstacle at every place where it stalled: they fill a trap up."""
    if memory.idle_steps >= scene.config.stall_steps // 2:
        dropped = _virtual_obstacle(scene, memory)
        if _near(dropped, memory, _SAME_PLACE_M) >= _MOST_AT_A_PLACE:
            return Drive(None, memory, "virtual obstacles fill every way")
        memory = replace(memory, virtual_map_m=(*memory.virtual_map_m, dropped), idle_steps=0)
    return Drive(scene.attraction + scene.repulsion + _virtual_push(scene, memory), memory)


def _virtual_obstacle(scene: Scene, memory: Memory) -> tuple[float, float, float]:
    """Return x, y and range of a new virtual obstacle: ahead and a little aside, the larger the more are near by."""
    ahead = unit(scene.goal_xy_map_m - scene.xy_map_m)
    x, y = scene.xy_map_m + _VIRTUAL_AHEAD_M * (ahead + 0.5 * _left(ahead))
    near = _near((float(x), float(y), 0.0), memory, _VIRTUAL_RANGE_M)
    return float(x), float(y), _VIRTUAL_RANGE_M * min(1.0 + 0.3 * near, 2.0)


def _near(virtual: tuple[float, float, float], memory: Memory, within_m: float) -> int:
    """Count the virtual obstacles near another one."""
    return sum(bool(np.hypot(virtual[0] - x, virtual[1] - y) < within_m) for x, y, _ in memory.virtual_map_m)


def _virtual_push(scene: Scene, memory: Memory) -> XY:
    """Return the force of all virtual obstacles: the strongest at their centres, nothing from their range on."""
    virtual = np.array(memory.virtual_map_m).reshape(-1, 3)
    away = scene.xy_map_m - virtual[:, :2]
    distance = np.maximum(np.hypot(*away.T), 1e-3)
    strength = _VIRTUAL_FORCE * scene.config.attraction_gain * np.maximum(0.0, 1.0 - distance / virtual[:, 2])
    return np.asarray((strength / distance) @ away)


def _left(vector: XY) -> XY:
    return np.array([-vector[1], vector[0]])


def _wall_following(scene: Scene, memory: Memory) -> Drive:
    """Drive by the field; where it stalls, along the wall until the goal is nearer than there (Bug algorithms)."""
    following = memory.following
    if following is not None and (scene.goal_m < following.goal_m - _NEARER_M or len(scene.near_xy_map_m) == 0):
        memory, following = replace(memory, following=None, idle_steps=0), None
    if following is None and not (_is_stalled(scene, memory) and len(scene.near_xy_map_m)):
        return _field(scene, memory)
    if following is None:
        memory = replace(memory, idle_steps=0)
    reason = "no step leads along the wall" if _is_stalled(scene, memory) else ""
    return _along_wall(scene, memory, reason)


def _along_wall(scene: Scene, memory: Memory, reason: str) -> Drive:
    away = scene.xy_map_m - scene.near_xy_map_m
    distances = np.hypot(*away.T)
    nearest = int(np.argmin(distances))
    normal = unit(away[nearest])
    side = memory.side or (1 if float(_left(normal) @ scene.attraction) >= 0 else -1)
    along = side * _left(normal)
    wanted_m = scene.config.safety_m + _FOLLOW_MARGIN_M
    error = float(np.clip((wanted_m - distances[nearest]) / wanted_m, -1.0, 1.0))
    force = _FOLLOW_SPEED * scene.config.attraction_gain * unit(along + 2.0 * error * normal)
    following = memory.following or Following(scene.goal_m, scene.xy_map_m, atan2(along[1], along[0]))
    if _came_round(following, scene, along):
        reason = "the wall leads round to where it began"
    return Drive(force, replace(memory, side=side, following=following), reason)


def _came_round(following: Following, scene: Scene, along: XY) -> bool:
    turned = wrap_angle(atan2(along[1], along[0]) - following.heading_rad)
    back_m = float(np.hypot(*(scene.xy_map_m - following.start_xy_map_m)))
    return following.path_m > 2.0 and back_m < 0.3 and abs(turned) < pi / 4


TECHNIQUES: dict[str, Callable[[Scene, Memory], Drive]] = {
    "field": _field,
    "wavefront": _wavefront,
    "wall_following": _wall_following,
    "virtual_obstacles": _virtual_obstacles,
}
"""Name -> what it drives at, given scene and memory."""


# ---- the shortest path round the known walls: a wavefront on a coarse grid; what is unknown is free ------------------


def aim_on_shortest_path(walls_xy_map_m: XY, xy_map_m: XY, goal_xy_map_m: XY, config: PlannerConfig) -> XY | None:
    """Return the point (2,) in m, map frame, to head for in a straight line; None where walls close the goal off.

    Cells nearer to a wall than the safety clearance cost more, far more below the least one: the path
    comes closer to walls only where there is no other. Cells in the open cost ``open_cost`` times as much, as walls
    show the pose (coastal navigation; Roy, Burgard, Fox and Thrun 1999).
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
    weights = np.take(_weight_table(reach, config), wavefront.squared_clearance(mask, reach))
    if config.open_cost == 1.0:
        return weights
    factor = np.where(in_the_open(walls, shape, config.plan_cell_m), config.open_cost, 1.0)
    return np.round(weights * factor).astype(np.int32)


def in_the_open(walls: NDArray[np.int64], shape: tuple[int, int], cell_m: float) -> NDArray[np.bool_]:
    """Return which cells (rows, cols) have little wall around them; ``walls`` (n, 2) are rows and columns."""
    side = max(1, round(_SQUARE_M / cell_m))
    reach = round(_WALL_NEAR_M / (side * cell_m))
    squares = np.zeros([-(-cells // side) for cells in shape], np.int64)
    squares[walls[:, 0] // side, walls[:, 1] // side] = 1
    around = np.pad(squares, reach)
    for axis in (0, 1):
        around = np.lib.stride_tricks.sliding_window_view(around, 2 * reach + 1, axis).sum(axis=-1)
    few = around * side * cell_m < _LEAST_WALL_M
    return few.repeat(side, axis=0).repeat(side, axis=1)[: shape[0], : shape[1]]


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
