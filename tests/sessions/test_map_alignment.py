"""Maps whose places fit each other only together, as with coarse cells and thick walls."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from mavnav.config.models import Config
from mavnav.mapping.occupancy_grid import Grid, GridBuilder, occupied_xy_m
from mavnav.pose import Pose, transform_points
from mavnav.scan import LaserSpec
from mavnav.sessions import map_alignment
from mavnav.slam.matching import relocalization
from mavnav.slam.matching.prior_map import PriorMap, prior_map_of
from support.marks import slow
from support.synthetic import DEG, TOUR, Segments, along, furnished_rooms, record, room

LASER = LaserSpec(-135 * DEG, 1.5 * DEG, 181, 0.05, 8.0)
A_T_B = Pose(1.0, -2.0, 0.5)


def drawn(walls: Segments, cell_m: float) -> Grid:
    grid, way = GridBuilder(cell_m), along(TOUR, period_s=0.5)
    for k, scan in enumerate(record(walls, way, LASER, noise=0.0).scans):
        grid.insert(way[k], transform_points(way[k], scan.points()))
    return grid.by_rows()


@cache
def thick() -> PriorMap:
    grid = drawn(furnished_rooms(), 0.1)
    walls = binary_dilation(grid.hits > 0, np.ones((3, 3)))
    return prior_map_of(Grid(0.1, grid.origin_xy_m, walls, np.where(walls, 0, grid.passes > 0)), A_T_B)


@cache
def fine() -> PriorMap:
    grid = drawn(furnished_rooms(), 0.02)
    return PriorMap(grid, occupied_xy_m(grid))


@pytest.fixture(autouse=True)
def no_place_fits_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_alignment, "consensus", lambda pairs: None)


@pytest.mark.parametrize("swapped", [False, slow(True)])
def test_a_fine_map_is_placed_in_a_coarse_one_whichever_comes_first(swapped: bool) -> None:
    maps = (fine(), thick()) if swapped else (thick(), fine())
    alignment, searched_all = map_alignment.align(*maps, Config())
    assert alignment is not None
    assert searched_all
    a_T_b = alignment.a_T_b.inverse() if swapped else alignment.a_T_b
    middle = Pose(*fine().walls_xy_m.mean(axis=0).tolist())
    off_m, off_rad = (a_T_b @ middle).gap(A_T_B @ middle)
    assert off_m < 0.2  # within a wall of three cells all places fit
    assert off_rad < 3 * DEG


@pytest.mark.slow
def test_maps_of_different_buildings_have_no_place_in_each_other() -> None:
    grid = drawn(room(9.0, 6.5), 0.02)
    assert map_alignment.align(thick(), PriorMap(grid, occupied_xy_m(grid)), Config()) == (None, True)


def test_scans_of_a_hall_are_taken_all_over_it_whatever_its_size() -> None:
    for side in (300, 2500):  # from 2048 on not every cell is a possible place
        free, grid = np.ones((side, side), np.bool_), Grid(0.05)
        places_m = map_alignment.viewpoints(grid, free)
        assert len(places_m) == map_alignment.VIEWPOINTS
        assert np.abs(places_m - 0.025 * side).max() < 0.025 * side - map_alignment.CLEARANCE_M + 0.05
        assert np.ptp(places_m, axis=0).min() > 0.8 * 0.05 * side


def test_a_map_that_fits_nearly_everywhere_is_not_searched_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dots all over a hall: every place is about as good, and the search of 100 000 of them took minutes."""
    monkeypatch.setattr(relocalization, "MOST_SQUARES", 20_000)
    rng = np.random.default_rng(0)
    dots = rng.random((2, 400, 400)) < 0.01
    for row, col in rng.integers(40, 360, (8, 2)):
        dots[:, row - 30 : row + 30, col - 30 : col + 30] = False
    grids = [Grid(0.02, (0.0, 0.0), 9 * d.astype(np.uint16), np.full(d.shape, 9, np.uint16)) for d in dots]
    assert map_alignment.align(*(PriorMap(g, occupied_xy_m(g)) for g in grids), Config()) == (None, False)
