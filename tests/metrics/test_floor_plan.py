"""The floor plan of maps of simulated worlds, against their true walls."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mavnav.mapping.occupancy_grid import Grid, GridBuilder
from mavnav.metrics.floor_plan import FloorPlan, floor_plan, turn_to_walls
from mavnav.pose import Pose, transform_points
from mavnav.simulation.world.geometry import World
from mavnav.simulation.world.scenario_file import load_scenario

NOISE_M = 0.01
PLACES = {
    "doorway": [
        (0.6, 0.6),
        (3.2, 0.6),
        (3.4, 3.5),
        (1.8, 4.4),
        (0.4, 3.2),
        (4.6, 3.5),
        (4.7, 0.6),
        (7.4, 2.5),
        (6.4, 4.4),
    ],
    "complex": [
        (0.7, 0.7),
        (3.2, 0.7),
        (3.2, 2.6),
        (2.2, 4.2),
        (0.5, 4.3),
        (1.8, 2.4),
        (5.0, 2.2),
        (5.2, 4.2),
        (5.2, 0.8),
    ],
}
"""Where the laser stood in the world of a scenario, m."""

SIZES_M = {"doorway": (8.0, 5.0), "complex": (6.0, 5.0)}

FOUND = {"doorway": 0.93, "complex": 0.88}
"""Share of the walls that a plan has (measured 0.94 to 0.96, 0.89 to 0.93).

Not the far face of a wall of 0.1 m, nor the short sides of furniture.
"""


@cache
def mapped(name: str, yaw_rad: float, cell_m: float = 0.02) -> tuple[World, Grid, Pose]:
    """Return the world of a scenario, a map of it by known poses, and where the world is in the map frame."""
    world, rng, grid = load_scenario(name).world, np.random.default_rng(4), GridBuilder(cell_m)
    map_T_world, bearings_rad = Pose(0.4, -0.3, yaw_rad), np.linspace(-np.pi, np.pi, 1440, endpoint=False)
    for x_m, y_m in PLACES[name]:
        ranges_m, _ = world.cast((x_m, y_m), bearings_rad)
        ranges_m = ranges_m + NOISE_M * rng.standard_normal(len(bearings_rad))
        xy_m = np.array((x_m, y_m)) + ranges_m[:, None] * np.column_stack((np.cos(bearings_rad), np.sin(bearings_rad)))
        at = map_T_world @ Pose(x_m, y_m, 0.0)
        grid.insert(at, transform_points(map_T_world, xy_m))
    return world, grid.by_rows(), map_T_world


def in_plan(world: World, map_T_world: Pose, plan: FloorPlan) -> np.ndarray:
    """Return the true walls (n, 4) in the frame of the plan."""
    ends = world.segments.reshape(-1, 2)
    return transform_points(plan.plan_T_map @ map_T_world, ends).reshape(-1, 4)


def along(line: np.ndarray) -> np.ndarray:
    """Return points (n, 2) every 20 mm along a line."""
    count = max(int(np.hypot(*(line[2:] - line[:2])) / 0.02), 2)
    return line[:2] + np.linspace(0.0, 1.0, count)[:, None] * (line[2:] - line[:2])


def distances(xy_m: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Return the distance (n,) of each point from the nearest of some lines."""
    step = lines[:, 2:] - lines[:, :2]
    share = np.clip(((xy_m[:, None] - lines[:, :2]) * step).sum(axis=2) / (step**2).sum(axis=1), 0.0, 1.0)
    return np.hypot(*(xy_m[:, None] - lines[:, :2] - share[:, :, None] * step).T).T.min(axis=1)


def lengths(lines: np.ndarray) -> np.ndarray:
    return np.hypot(*(lines[:, 2:] - lines[:, :2]).T)


@pytest.mark.parametrize("name", PLACES)
@pytest.mark.parametrize("yaw_rad", [0.0, 0.5, -2.0])
def test_walls_lie_where_the_true_walls_are(name: str, yaw_rad: float) -> None:
    world, grid, map_T_world = mapped(name, yaw_rad)
    plan = floor_plan(grid, Pose())
    true = in_plan(world, map_T_world, plan)
    seen = np.concatenate([along(line) for line in true if lengths(line[None])[0] >= 0.5])
    drawn = np.concatenate([along(line) for line in plan.walls])
    hits = transform_points(
        plan.plan_T_map, np.argwhere(grid.hits > 0)[:, ::-1] * grid.cell_m + grid.origin_xy_m + 0.01
    )
    seen = seen[np.array([np.abs(hits - point).max(axis=1).min() < 0.05 for point in seen])]
    assert len(seen) > 1000
    assert (distances(seen, plan.walls) < 0.05).mean() > FOUND[name]
    assert (distances(drawn, true) < 0.03).mean() > 0.98
    assert np.median(distances(drawn, true)) < 0.006
    turn = (plan.plan_T_map @ map_T_world).yaw_rad
    assert abs((turn + np.pi / 4) % (np.pi / 2) - np.pi / 4) < np.radians(0.1)
    straight = np.abs(plan.walls[:, 2:] - plan.walls[:, :2]).min(axis=1) < 1e-9
    assert lengths(plan.walls[straight]).sum() > 0.7 * lengths(plan.walls).sum()
    size_m = np.ptp(plan.walls.reshape(-1, 2), axis=0)
    assert size_m == pytest.approx(SIZES_M[name], abs=0.02)


@pytest.mark.parametrize("yaw_rad", [0.0, 0.5])
def test_the_door_of_a_scenario_is_a_gap_of_its_width(yaw_rad: float) -> None:
    _, grid, map_T_world = mapped("doorway", yaw_rad)
    plan = floor_plan(grid, Pose())
    assert lengths(plan.openings) == pytest.approx([0.8], abs=0.04)
    middle = transform_points(plan.plan_T_map @ map_T_world, np.array([[4.0, 3.5]]))[0]
    door = plan.openings[0].reshape(2, 2).mean(axis=0)
    assert np.hypot(*(door - middle)) < 0.09  # it is that of one face of a wall of 0.12 m
    assert distances(middle[None], plan.walls)[0] > 0.35


def test_a_picture_that_is_turned_gives_the_plan_of_the_map_frame() -> None:
    _, grid, _ = mapped("doorway", 0.0)
    still, turned = floor_plan(grid, Pose()), floor_plan(grid, Pose(3.0, -1.0, 0.3))
    moved = Pose(3.0, -1.0, 0.3)
    ends = transform_points(turned.plan_T_map @ moved @ still.plan_T_map.inverse(), still.walls.reshape(-1, 2))
    assert np.allclose(ends.reshape(-1, 4), turned.walls, atol=1e-9)


@pytest.mark.parametrize("yaw_rad", [0.0, 0.5, -2.0])
def test_the_same_map_in_larger_cells_gives_the_same_rooms(yaw_rad: float) -> None:
    _, grid, _ = mapped("doorway", yaw_rad, cell_m=0.05)
    plan = floor_plan(grid, Pose())
    assert np.ptp(plan.walls.reshape(-1, 2), axis=0) == pytest.approx([8.0, 5.0], abs=0.02)
    assert lengths(plan.openings) == pytest.approx([0.8], abs=0.1)  # less by up to a cell at each side


@pytest.mark.parametrize(
    ("yaw_rad", "turn_rad"), [(0.0, 0.0), (0.5, -0.5), (-2.0, 2.0 - np.pi / 2), (1.0, np.pi / 2 - 1.0)]
)
def test_walls_are_brought_along_the_axes_by_the_smaller_turn(yaw_rad: float, turn_rad: float) -> None:
    _, grid, _ = mapped("doorway", yaw_rad)
    assert turn_to_walls(grid) == pytest.approx((0.0, 0.0, turn_rad), abs=np.radians(0.1))


def test_a_map_without_walls_has_a_plan_without_walls() -> None:
    empty = Grid(0.02, (0.0, 0.0), np.zeros((9, 9), np.uint16), np.ones((9, 9), np.uint16))
    plan = floor_plan(empty, Pose())
    assert (len(plan.walls), len(plan.openings)) == (0, 0)
    assert turn_to_walls(empty) is None
