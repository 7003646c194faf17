"""True maps in other frames than the map that they are compared with."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.ground_truth.map_file import MapFile
from mavnav.ground_truth.references import References, compare_to, of_map
from mavnav.mapping.occupancy_grid import Grid, GridBuilder, occupied_xy_m
from mavnav.pipelines.maps import with_true_map_placed
from mavnav.pose import Pose, transform_points
from mavnav.scan import LaserSpec
from support.synthetic import DEG, TOUR, along, furnished_rooms, record, room

LASER = LaserSpec(-135 * DEG, 1.5 * DEG, 181, 0.05, 8.0)


@cache
def drawn(walls: tuple[tuple[float, ...], ...]) -> Grid:
    grid, way = GridBuilder(0.02), along(TOUR, period_s=0.5)
    for k, scan in enumerate(record(np.array(walls), way, LASER, noise=0.0).scans):
        grid.insert(way[k], transform_points(way[k], scan.points()))
    return grid.by_rows()


def true_map(grid: Grid, world_T_map: Pose) -> References:
    """Return a drawn map as a true one, in the frame of a world."""
    file = MapFile(Grid(grid.cell_m, (0.0, 0.0), grid.hits > 0, grid.passes > 0), world_T_map @ Pose(*grid.origin_xy_m))
    return References(true_map=of_map(file, Pose(), "same frame"), map_file=file)


ROOMS, WORLD_T_MAP = tuple(map(tuple, furnished_rooms().tolist())), Pose(3.0, -2.0, 1.2)


def test_a_true_map_of_another_frame_is_placed_where_the_map_shows_it() -> None:
    grid = drawn(ROOMS)
    placed = with_true_map_placed(true_map(grid, WORLD_T_MAP), grid, Config())
    distance = compare_to(placed, None, occupied_xy_m(grid)).map_distance
    assert distance.p95_mm < 5.0
    assert distance.covered_share == 1.0
    there = WORLD_T_MAP.inverse()
    assert distance.alignment == f"found at {there.x_m:.2f} m, {there.y_m:.2f} m, {there.yaw_rad / DEG:.1f} deg"


def test_a_map_from_a_file_is_turned_before_a_true_map_is_placed_in_it() -> None:
    grid, map_T_grid = drawn(ROOMS), Pose(1.0, 2.0, -0.7)
    placed = with_true_map_placed(true_map(grid, Pose()), grid, Config(), map_T_grid)
    walls = transform_points(map_T_grid, occupied_xy_m(grid))
    assert compare_to(placed, None, walls).map_distance.p95_mm < 25.0  # resampled to other cells


def test_an_error_of_the_map_in_the_same_frame_stays_in_the_distance() -> None:
    grid = drawn(ROOMS)
    references = true_map(grid, Pose(0.06, 0.0, 0.0))
    assert with_true_map_placed(references, grid, Config()) is references


@pytest.mark.slow
def test_the_true_map_of_another_building_has_no_clear_place() -> None:
    grid, other = drawn(ROOMS), drawn(tuple(map(tuple, room(9.0, 6.5).tolist())))
    placed = with_true_map_placed(true_map(other, WORLD_T_MAP), grid, Config())
    assert placed.true_map.alignment == "same frame, no clear place"
    assert np.array_equal(placed.true_map.xy_m, true_map(other, WORLD_T_MAP).true_map.xy_m)
