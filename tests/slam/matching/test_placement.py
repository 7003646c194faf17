"""Scans with poses of their own, placed together in a coarse map of thick walls."""

from __future__ import annotations

from functools import cache
from math import pi
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from mavnav.config.models import Config
from mavnav.mapping import tiled_arrays
from mavnav.mapping.occupancy_grid import Grid, GridBuilder, cell_centres
from mavnav.pose import Pose, transform_points
from mavnav.scan import LaserSpec
from mavnav.slam.matching.placement import place_together
from mavnav.slam.matching.prior_map import SURELY, PriorMap, prior_map_of
from mavnav.slam.matching.scan_matching import empty_line_map
from mavnav.slam.methods.acceptance import Acceptance
from mavnav.slam.methods.localization import Localizer
from support.synthetic import DEG, TOUR, Segments, along, furnished_rooms, moved, record, room

if TYPE_CHECKING:
    from mavnav.slam.matching.placement import PosedScan

LASER = LaserSpec(-135 * DEG, 1.5 * DEG, 181, 0.05, 8.0)
OWN = Pose(2.0, -1.5, 0.6)
"""The pose of the world in the scans' own frame."""


def thick_map(walls: Segments, cell_m: float) -> PriorMap:
    """Draw a map of coarse cells, with walls of three cells, as other tools' maps."""
    grid, way = GridBuilder(cell_m), along(TOUR, period_s=1.0)
    for k, scan in enumerate(record(walls, way, LASER, noise=0.0).scans):
        grid.insert(way[k], transform_points(way[k], scan.points()))
    thick = binary_dilation(grid.by_rows().hits > 0, np.ones((3, 3)))
    return prior_map_of(Grid(cell_m, grid.origin_xy_m, thick, np.where(thick, 0, grid.passes > 0)), Pose())


@cache
def rooms_map(cell_m: float) -> PriorMap:
    return thick_map(furnished_rooms(), cell_m)


def posed_scans(walls: Segments, way: list[tuple[float, float]]) -> list[PosedScan]:
    recording = record(walls, along(way, period_s=0.8), LASER, noise=0.01)
    method = Localizer(Config(), rooms_map(0.1))
    poses = (OWN @ recording.world_T_laser[k] for k in range(len(recording.scans)))
    return [(pose, method.match_points(scan)) for pose, scan in zip(poses, recording.scans, strict=True)]


def world_of(scans: list[PosedScan], known: PriorMap, start: Pose | None = None) -> Pose | None:
    """Return the pose of the world's frame in the map as the scans see it: none at the right place."""
    config = Config()
    lines = empty_line_map(config, known.grid.cell_m)
    lines.insert(known.walls_xy_m)
    match = place_together(scans, lines, GridBuilder.of(known.grid), config, start)
    return match.map_T_laser @ OWN if match and Acceptance(config.robust).is_good(match) else None


WAY = [(5.2, 2.2), (4.65, 3.4), (4.65, 5.2), (5.9, 5.2)]


@pytest.mark.parametrize("cell_m", [0.05, 0.1])
def test_scans_find_their_place_in_a_coarse_map(cell_m: float) -> None:
    world, middle = world_of(posed_scans(furnished_rooms(), WAY), rooms_map(cell_m)), Pose(*WAY[1])
    assert world is not None
    off = middle.between(world @ middle)
    assert off.distance_m < 2 * cell_m
    assert abs(off.yaw_rad) < 5 * DEG


def test_scans_of_another_building_have_no_place() -> None:
    other = moved(room(9.0, 3.0), Pose(0.0, 2.0, 0.0))
    assert world_of(posed_scans(other, [(1.0, 3.5), (7.5, 3.5)]), rooms_map(0.1)) is None


def test_a_place_that_exists_twice_is_none_but_by_the_start_pose() -> None:
    plain = room(8.0, 8.0)
    known = thick_map(plain, 0.1)
    scans = posed_scans(plain, [(2.0, 2.0), (5.0, 3.0)])
    assert world_of(scans, known) is None
    first = along([(2.0, 2.0), (5.0, 3.0)], period_s=0.8)[0]
    world = world_of(scans, known, Pose(first.x_m + 0.3, first.y_m, first.yaw_rad + 0.2))
    assert world is not None
    assert world.distance_m < 0.2


def test_the_heading_of_a_laser_at_rest_counts() -> None:
    scans = posed_scans(furnished_rooms(), WAY)[:1]
    pose, points = scans[0]
    world = world_of([(pose, points)] * 4, rooms_map(0.05))
    assert world is None or (world.distance_m < 0.2 and abs(world.yaw_rad) < 3 * DEG)
    assert world_of([], rooms_map(0.05)) is None


@pytest.mark.parametrize("pose", [Pose(), Pose(0.3, -1.2, 0.4), Pose(-3.0, 2.0, pi)])
def test_a_turned_map_copies_the_cell_at_each_centre(monkeypatch, pose) -> None:
    monkeypatch.setattr(tiled_arrays, "BAND_CELLS", 1)
    passes = np.random.default_rng(0).integers(0, 2, (150, 90))
    grid = prior_map_of(Grid(0.1, (0.0, 0.0), 1 - passes, passes), pose).grid
    row, col = np.indices(grid.hits.shape).reshape(2, -1)
    at = np.floor(transform_points(pose.inverse(), cell_centres(grid, row, col)) / 0.1 + 1e-9).astype(int)
    for (x, y), hits, crossed in zip(at.tolist(), grid.hits.ravel(), grid.passes.ravel(), strict=True):
        seen = SURELY * int(passes[y, x]) if 0 <= x < 90 and 0 <= y < 150 else None
        assert (hits, crossed) == ((0, 0) if seen is None else (SURELY - seen, seen))
