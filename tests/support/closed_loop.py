"""A small exact world for the planner: walls drawn into a grid, a vehicle that executes commands, and the result."""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from mavnav.config.models import PlannerConfig
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, transform_points
from mavnav.simulation.planner.potential_field import Plan, Planner
from support import synthetic
from support.synthetic import Segments, box, polyline

BEARINGS = np.linspace(-120, 120, 681) * synthetic.DEG


class World(Struct, frozen=True):
    """Walls, start and goal, in the map frame."""

    walls: Segments
    start: Pose
    goal_m: tuple[float, float]


class Flight(Struct, frozen=True):
    """Result of a mission: the true path (n, 2), m, and its minimum distance to the true walls."""

    reached: bool
    reason: str
    xy_m: np.ndarray
    clearance_m: float
    plans: list[Plan]

    @property
    def length_m(self) -> float:
        return float(np.hypot(*np.diff(self.xy_m, axis=0).T).sum())


OPEN = World(polyline((-5, -5), (10, -5), (10, 10), (-5, 10), closed=True), Pose(0.0, 0.0, 2.0), (4.0, 1.0))
CORNER = World(
    polyline((0, 0), (4, 0), (4, 4), (2.6, 4), (2.6, 1.4), (0, 1.4), closed=True), Pose(0.6, 0.7, 0.0), (3.3, 3.4)
)
DOORWAY = World(
    np.vstack(
        (polyline((0, 0), (6, 0), (6, 4), (0, 4), closed=True), polyline((3, 0), (3, 2.4)), polyline((3, 3.3), (3, 4)))
    ),
    Pose(0.8, 0.8, 0.0),
    (5.2, 0.8),
)
U_TRAP = World(
    np.vstack(
        (polyline((0, 0), (7, 0), (7, 5), (0, 5), closed=True), polyline((2.2, 3.4), (4, 3.4), (4, 1.6), (2.2, 1.6)))
    ),
    Pose(0.8, 2.5, 0.0),
    (6.0, 2.5),
)
CLOSED = World(
    np.vstack((polyline((0, 0), (4, 0), (4, 3), (0, 3), closed=True), box(6.0, 1.5, 1.0, 1.0))),
    Pose(1.0, 1.5, 0.0),
    (5.0, 1.5),
)


def true_clearance_m(walls: Segments, xy_m: tuple[float, float]) -> float:
    """Return the distance of a point to the nearest segment."""
    a, e = walls[:, :2], walls[:, 2:] - walls[:, :2]
    share = np.clip(((np.array(xy_m) - a) * e).sum(axis=1) / (e * e).sum(axis=1), 0, 1)
    return float(np.hypot(*(np.array(xy_m) - a - share[:, None] * e).T).min())


def paint(grid: GridBuilder, walls: Segments, laser: Pose, hits: int = 3) -> None:
    """Insert the full length of all walls, as if seen from the laser."""
    for x1, y1, x2, y2 in walls:
        n = int(np.hypot(x2 - x1, y2 - y1) / (0.5 * grid.cell_m)) + 2
        share = np.linspace(0, 1, n)[:, None]
        grid.insert(laser, np.repeat((1 - share) * (x1, y1) + share * (x2, y2), hits, axis=0))
    grid.passes[:] = 0


def insert_scan(
    grid: GridBuilder, walls: Segments, laser: Pose, rng: np.random.Generator, noise: float, max_range_m: float = 5.0
) -> None:
    """Insert one scan: 240 degrees ahead, 681 beams."""
    ranges = synthetic.cast(walls, (laser.x_m, laser.y_m), BEARINGS + laser.yaw_rad)
    ranges = ranges * (1.0 + noise * rng.standard_normal(len(ranges)))
    xy = np.column_stack((ranges * np.cos(BEARINGS), ranges * np.sin(BEARINGS)))[ranges < max_range_m]
    grid.insert(laser, transform_points(laser, xy))


def fly(
    world: World,
    technique: str = "wavefront",
    *,
    known: bool = False,
    noisy: bool = False,
    seed: int = 0,
    steps: int = 400,
    cell_m: float = 0.02,
    **settings: float,
) -> Flight:
    """Fly until within 250 mm of the goal, stuck, or out of steps; with ``known`` the whole map is drawn first."""
    rng, grid = np.random.default_rng(seed), GridBuilder(cell_m)
    planner = Planner(PlannerConfig(technique=technique, **settings))
    pose, plans = world.start, []
    xy = [(pose.x_m, pose.y_m)]
    if known:
        paint(grid, world.walls, pose)
    while len(plans) < steps and np.hypot(*np.subtract(world.goal_m, xy[-1])) > 0.25:
        if not known:
            insert_scan(grid, world.walls, pose, rng, 0.015 if noisy else 0.0)
        plans.append(planner.plan(grid, pose, world.goal_m))
        if plans[-1].reason:
            break
        c = plans[-1].command
        shake = rng.standard_normal(3) * (0.02, 0.02, 5 * synthetic.DEG) if noisy else np.zeros(3)
        pose = pose @ Pose(c.dx_m + shake[0], c.dy_m + shake[1], c.dyaw_rad + shake[2])
        xy.append((pose.x_m, pose.y_m))
    reached = bool(np.hypot(*np.subtract(world.goal_m, xy[-1])) <= 0.25)
    return Flight(reached, plans[-1].reason, np.array(xy), min(true_clearance_m(world.walls, p) for p in xy), plans)
