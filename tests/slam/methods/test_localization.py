"""Localise-only: the laser is found in a given map and followed there, or said to be lost; the map stays as it is."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec.structs import replace
from scipy.spatial import cKDTree

from mavnav.config.models import Config
from mavnav.mapping.occupancy_grid import OCCUPIED, Grid, GridBuilder, occupancy
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.scan import LaserSpec
from mavnav.slam import pipeline
from mavnav.slam.findings import TrackedAgain
from mavnav.slam.matching.prior_map import PriorMap, prior_map_of
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.methods.localization import Localizer
from mavnav.slam.pipeline import run_slam
from mavnav.slam.recovery.own_map import OWN_MAP
from mavnav.slam.result import SlamResult
from support.synthetic import DEG, TOUR, Recording, Segments, along, box, furnished_rooms, polyline, record, room

LASER = LaserSpec(-135 * DEG, 0.75 * DEG, 361, 0.05, 8.0)
CELL_M = 0.05  # as other tools' maps


def drawn(walls: Segments, way: Trajectory) -> Grid:
    """Draw a map in the world's frame."""
    grid = GridBuilder(CELL_M)
    for k, scan in enumerate(record(walls, way, LASER, noise=0.0).scans):
        grid.insert(way[k], transform_points(way[k], scan.points()))
    return grid.by_rows()


@cache
def rooms_grid() -> Grid:
    return drawn(furnished_rooms(), along(TOUR, period_s=0.5))


@cache
def visit() -> Recording:
    """Return a walk through the rooms that begins in their middle."""
    way = along([(5.2, 2.2), (4.65, 3.4), (4.65, 5.2), (5.9, 5.2)], period_s=0.25)
    return record(furnished_rooms(), way, LASER, noise=0.01)


def localised(recording: Recording, known: PriorMap) -> SlamResult:
    return run_slam(lambda: recording.scans, Config(), 0.25, prior_map=known)


def off_m(outcome: SlamResult, truth: Trajectory) -> np.ndarray:
    rows = np.searchsorted(truth.stamps_ns, outcome.trajectory.stamps_ns)
    error: np.ndarray = np.hypot(*(outcome.trajectory.xyyaw - truth.xyyaw[rows])[:, :2].T)
    return error


def test_the_laser_is_found_and_followed_in_the_frame_of_the_map() -> None:
    outcome = localised(visit(), prior_map_of(rooms_grid(), Pose()))
    assert not outcome.lost
    assert len(outcome.trajectory) == len(visit().scans)
    assert off_m(outcome, visit().world_T_laser).max() < 0.03


def test_a_map_that_lies_turned_and_shifted_gives_turned_and_shifted_poses() -> None:
    map_T_grid = Pose(-3.0, 7.0, 0.7)
    outcome = localised(visit(), prior_map_of(rooms_grid(), map_T_grid))
    assert len(outcome.trajectory) == len(visit().scans)
    assert off_m(outcome, visit().world_T_laser.seen_from(map_T_grid)).max() < 0.04


def test_the_map_stays_as_it_is() -> None:
    known = prior_map_of(rooms_grid(), Pose())
    method = Localizer(Config(), known)
    lines, hits = method.lines.moments.copy(), known.grid.hits.copy()
    method.insert(visit().scans[0], visit().world_T_laser[0], pipeline.Motion(0.25))
    np.testing.assert_array_equal(method.lines.moments, lines)
    np.testing.assert_array_equal(known.grid.hits, hits)
    assert method.grid.hits.sum() > 0.9 * len(visit().scans[0].ranges_m)


def twin_rooms() -> Segments:
    """Return two identical furnished rooms beside each other."""
    one = np.vstack((room(3.0, 2.5), box(0.6, 0.5, 0.6, 0.5), box(2.3, 2.0, 0.4, 0.3)))
    return np.vstack((one, one + np.array([6.0, 0.0, 6.0, 0.0])))


@cache
def twins() -> tuple[PriorMap, Recording]:
    ways = [along([(x + 1.5, 1.0), (x + 1.8, 1.7), (x + 1.2, 1.2)], period_s=0.25) for x in (0.0, 6.0)]
    both = Trajectory.of(list(range(sum(map(len, ways)))), [way[k] for way in ways for k in range(len(way))])
    return prior_map_of(drawn(twin_rooms(), both), Pose()), record(twin_rooms(), ways[1], LASER, noise=0.005)


def test_in_one_of_two_identical_rooms_nothing_is_believed() -> None:
    known, inside = twins()
    outcome = localised(inside, known)
    assert outcome.lost_for_good
    assert len(outcome.trajectory) == 0


@pytest.mark.parametrize("room_number", [0, 1])
def test_a_start_pose_tells_identical_rooms_apart(room_number: int) -> None:
    known, inside = twins()
    first = inside.world_T_laser[0]
    start = Pose(first.x_m - 6.0 * (1 - room_number) + 0.3, first.y_m - 0.2, first.yaw_rad + 0.2)
    outcome = localised(inside, replace(known, start=start))
    assert len(outcome.trajectory) == len(inside.scans)
    assert outcome.trajectory[0].x_m == pytest.approx(first.x_m - 6.0 * (1 - room_number), abs=0.03)


def test_a_start_pose_that_is_wrong_does_not_lead_astray() -> None:
    outcome = localised(visit(), replace(prior_map_of(rooms_grid(), Pose()), start=Pose(1.0, 1.0, 3.0)))
    assert off_m(outcome, visit().world_T_laser).max() < 0.03


def test_in_a_map_without_a_free_cell_the_laser_is_lost() -> None:
    wall = np.full((2, 2), 5, np.uint16)
    outcome = localised(visit(), prior_map_of(Grid(CELL_M, (0.0, 0.0), wall, wall * 0), Pose()))
    assert outcome.lost_for_good


def test_a_laser_that_is_somewhere_else_is_lost() -> None:
    elsewhere = polyline((0, 0), (2.2, 0), (3.1, 1.4), (1.2, 2.6), (-0.4, 1.6), closed=True)
    recording = record(elsewhere, along([(0.8, 0.8), (1.6, 1.4)], period_s=0.25), LASER, noise=0.005)
    outcome = localised(recording, prior_map_of(rooms_grid(), Pose()))
    assert outcome.lost_for_good
    assert len(outcome.trajectory) == 0


@given(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), st.floats(-3.2, 3.2))
@example(0.0, 0.65, 0.0)  # middles on the edges of old cells
def test_a_grid_is_brought_to_its_map_frame(x_m: float, y_m: float, yaw_rad: float) -> None:
    rng = np.random.default_rng(0)
    hits = (rng.random((7, 11)) < 0.3).astype(np.int32)
    grid = Grid(0.1, (0.0, 0.0), hits, 1 - hits)
    map_T_grid = Pose(x_m, y_m, yaw_rad)
    known = prior_map_of(grid, map_T_grid)
    rows, cols = np.nonzero(hits)
    middles = transform_points(map_T_grid, (np.column_stack((cols, rows)) + 0.5) * 0.1)
    np.testing.assert_allclose(known.walls_xy_m, middles)
    at_rows, at_cols = np.nonzero(occupancy(known.grid) == OCCUPIED)
    back = (np.column_stack((at_cols, at_rows)) + 0.5) * 0.1 + np.array(known.grid.origin_xy_m)
    near = np.floor(transform_points(map_T_grid.inverse(), back) / 0.1 + 1e-9).astype(int)
    assert hits[near[:, 1].clip(0, 6), near[:, 0].clip(0, 10)].all()
    seen = np.count_nonzero(known.grid.hits + known.grid.passes)
    assert seen == pytest.approx(hits.size, rel=0.25)


@pytest.mark.slow
def test_a_laser_lost_in_the_map_is_mapped_by_itself_and_placed_as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """The map of another tool fits no single scan well; here, none is accepted."""
    monkeypatch.setattr(Localizer, "first", lambda self, scan: no_match(Pose(), len(self.match_points(scan))))
    known = prior_map_of(rooms_grid(), Pose())
    outcome = localised(visit(), known)
    assert len(outcome.trajectory) == len(visit().scans)
    assert TrackedAgain(OWN_MAP, kept=True) in outcome.attempts
    assert any("placed in the given one as a whole" in text for text in outcome.warnings)
    assert off_m(outcome, visit().world_T_laser).max() < 0.06
    hit = np.argwhere(outcome.grid.hits > 3)[:, ::-1] * outcome.grid.cell_m + np.array(outcome.grid.origin_xy_m)
    assert np.median(cKDTree(known.walls_xy_m).query(hit)[0]) < CELL_M


@pytest.mark.slow
def test_a_laser_lost_in_the_map_of_another_building_stays_lost() -> None:
    way = along([(1.0, 1.0), (8.0, 1.2), (8.2, 2.0)], period_s=0.25)
    other = record(room(9.5, 2.6), way, LASER, noise=0.01)
    outcome = localised(other, prior_map_of(rooms_grid(), Pose()))
    assert outcome.lost_for_good
    assert not any(attempt.kept for attempt in outcome.attempts)
