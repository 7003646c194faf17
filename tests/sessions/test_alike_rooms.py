"""Maps of rooms that are alike: what fits near the same frame may fit better elsewhere."""

from __future__ import annotations

import pytest

from mavnav.config.models import Config
from mavnav.mapping.occupancy_grid import Grid, GridBuilder, occupied_xy_m
from mavnav.pose import Pose, transform_points
from mavnav.scan import LaserSpec
from mavnav.sessions.map_alignment import align
from mavnav.slam.matching.prior_map import PriorMap
from support.marks import slow
from support.synthetic import DEG, along, corridor_with_rooms, record

WAY = [(1.0, 0.0), (2.6, 0.0), (2.6, 2.5), (2.6, 0.0), (12.6, 0.0), (12.6, 2.5), (12.6, 0.0), (23.0, 0.0)]


def drawn(shift_m: float) -> PriorMap:
    """Return the map of a corridor with rooms every 5 m, seen from the corridor and two rooms, in a shifted frame."""
    builder, way = GridBuilder(0.04), along(WAY, period_s=0.5)
    spec = LaserSpec(-180 * DEG, 1.0 * DEG, 360, 0.05, 12.0)
    for k, scan in enumerate(record(corridor_with_rooms(), way, spec, noise=0.0).scans):
        builder.insert(way[k], transform_points(way[k], scan.points()))
    grid = builder.by_rows()
    x_m, y_m = grid.origin_xy_m
    moved = Grid(grid.cell_m, (x_m + shift_m, y_m), grid.hits, grid.passes)
    return PriorMap(moved, occupied_xy_m(moved))


@pytest.mark.parametrize("shift_m", [0.0, slow(4.4), slow(5.0), slow(10.0)])
def test_a_map_in_another_frame_is_placed_where_it_fits_best(shift_m: float) -> None:
    """Shifted by about one room it was taken for the next one, where most places fit."""
    alignment, searched_all = align(drawn(0.0), drawn(shift_m), Config())
    assert searched_all
    assert alignment is not None
    assert max(alignment.a_T_b.gap(Pose(-shift_m))) < 0.02
