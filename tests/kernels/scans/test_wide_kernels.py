"""The kernels of the wide search against their twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.kernels.maps.conflicts import conflicts
from mavnav.kernels.maps.cost_floors import cost_floors
from mavnav.kernels.maps.free_cells import free_positions
from mavnav.kernels.maps.layout import LEVELS
from mavnav.kernels.scans.correlative_search import BLOCK, pose_costs, separate_minima
from mavnav.kernels.scans.lowest_poses import lowest_poses
from mavnav.mapping.line_map import LineMap
from mavnav.mapping.tiled_arrays import in_strips
from mavnav.pose import Pose, transform_points
from support import naive

LATTICE = np.array([-0.3, 0.1, 0.02])
CORNER = np.array([0.0, 0.0, 0.02])


def counted(points: np.ndarray, laser: Pose, lattice: np.ndarray, hits: np.ndarray, passes: np.ndarray) -> int:
    """Count conflicts of points of the map frame, with a line map of the cells that were hit."""
    line_map = LineMap(lattice[2], 0.06, 0.01)
    line_map.insert((np.argwhere(hits)[:, ::-1] + 0.5) * lattice[2] + lattice[:2])
    seen = transform_points(laser.inverse(), points)
    counts = in_strips(hits.astype(np.uint16)), passes.astype(np.uint16)
    return conflicts(seen, laser.as_array(), lattice, *counts, line_map.nearest, line_map.geometry)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_conflicts_are_the_twins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hits = np.where(rng.random((60, 80)) < rng.choice((0.001, 0.01)), rng.integers(1, 9, (60, 80)), 0).astype(np.int32)
    passes = np.where(hits > 0, rng.integers(0, 9, hits.shape), rng.integers(0, 6, hits.shape)).astype(np.int32)
    points = rng.uniform((-0.6, -0.2), (1.6, 1.6), (40, 2))
    x, y, yaw = rng.uniform((-0.2, 0.2, -3), (1.2, 1.2, 3))
    expected = naive.conflicts(points, (x, y), LATTICE, hits, passes)
    assert counted(points, Pose(x, y, yaw), LATTICE, hits, passes) == expected


@pytest.mark.parametrize(("passes", "hits", "expected"), [(2, 0, 0), (3, 0, 1), (3, 1, 0)])
def test_a_point_in_the_open_is_a_conflict(passes: int, hits: int, expected: int) -> None:
    grid = np.zeros((40, 40), np.int32)
    near = grid.copy()
    near[20, 27] = hits
    at = np.array([[20.5, 20.5]]) * 0.02
    assert counted(at, Pose(0.3, 0.41), CORNER, near, grid + passes) == expected


@pytest.mark.parametrize(("hits", "passes", "expected"), [(4, 0, 1), (3, 0, 0), (4, 5, 0)])
def test_a_beam_through_a_wall_is_a_conflict(hits: int, passes: int, expected: int) -> None:
    grid = np.zeros((5, 80), np.int32)
    wall, crossed = grid.copy(), grid.copy()
    wall[2, 30], crossed[2, 30] = hits, passes
    ends = np.array([[60.5, 2.5], [38.5, 2.5], [29.5, 2.5]]) * 0.02  # well behind it, just behind it, in front of it
    assert counted(ends, Pose(0.1, 0.05), CORNER, wall, crossed) == expected


def test_a_point_on_the_laser_is_no_beam() -> None:
    grid = np.zeros((5, 5), np.int32)
    assert counted(np.full((1, 2), 0.05), Pose(0.05, 0.05), CORNER, grid, grid) == 0


def test_pose_costs_are_their_twin() -> None:
    rng = np.random.default_rng(3)
    line_map = LineMap(0.02, 0.06, 0.01)
    line_map.insert(np.column_stack((rng.uniform(0, 1, 60), rng.normal(0.5, 0.01, 60))))
    origin = np.array(line_map.origin_cells)[::-1]
    lines = {
        tuple(line_map.cells[k] + origin): (line_map.lines[k, :2], line_map.lines[k, [2, 3, 3, 4]].reshape(2, 2))
        for k in range(1, line_map.count)
    }
    points = rng.uniform(-0.5, 0.5, (4, 2))
    xy, yaws = rng.uniform(0, 1, (5, 2)), np.array([-3.0, 0.0, 0.4])
    fast = pose_costs(points, xy, yaws, 0.15, line_map.nearest, line_map.lines, line_map.geometry)
    slow = naive.pose_costs(points, xy, yaws, lines, 0.02, 0.15)
    clear = [(q, p) for q in range(3) for p in range(5) if slow[q][p] is not None]
    assert len(clear) > 8
    for q, p in clear:
        assert fast[q, p] == pytest.approx(slow[q][p], abs=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_separate_minima_are_their_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy, yaws = 0.1 * rng.integers(-6, 7, (40, 2)).astype(float), rng.uniform(-3, 3) + np.radians(4) * np.arange(-30, 31)
    costs, most = np.round(rng.uniform(0, 0.02, (len(yaws), len(xy))), 4), int(rng.integers(1, 9))
    costs[rng.random(costs.shape) < 0.1] = np.inf
    separate = np.array((0.25, np.radians(12)))
    expected = naive.separate_minima(costs, xy, yaws, separate, most)
    assert separate_minima(costs.copy(), xy, yaws, separate, most).tolist() == expected
    assert len(expected) == most


def test_without_finite_costs_there_is_no_minimum() -> None:
    none = separate_minima(np.full((3, 2), np.inf), np.zeros((2, 2)), np.zeros(3), np.ones(2), 5)
    assert none.shape == (0, 3)
    one = separate_minima(np.ones((3, 2)), np.zeros((2, 2)), np.zeros(3), np.ones(2), 5)
    assert one.tolist() == [[1.0, 0.0, 0.0]]


def test_a_position_costs_the_same_among_many() -> None:
    rng = np.random.default_rng(5)
    line_map = LineMap(0.02, 0.06, 0.01)
    line_map.insert(np.column_stack((rng.uniform(0, 1, 60), rng.normal(0.5, 0.01, 60))))
    told = 0.15, line_map.nearest, line_map.lines, line_map.geometry
    points, yaws = rng.uniform(-0.5, 0.5, (30, 2)), np.array([-3.0, 0.4])
    xy = rng.uniform(-3, 4, (2 * BLOCK + 7, 2))  # the map covers a part of it
    costs = pose_costs(points, xy, yaws, *told)
    alone = np.hstack([pose_costs(points, xy[p : p + 1], yaws, *told) for p in range(len(xy))])
    assert np.array_equal(costs, alone)
    outside = (np.abs(xy) > 2.5).any(axis=1)
    assert 0 < outside.sum() < len(xy)
    np.testing.assert_allclose(costs[:, outside], 0.15**2, rtol=1e-12)


def scattered(seed: int) -> LineMap:
    """Return a map of a few short walls."""
    rng = np.random.default_rng(seed)
    line_map = LineMap(0.02, 0.06, 0.01)
    for _ in range(4):
        a, b = rng.uniform(0, 1.5, (2, 2))
        line_map.insert(a + np.linspace(0, 1, 40)[:, None] * (b - a) + rng.normal(0, 0.005, (40, 2)))
    return line_map


@pytest.mark.parametrize("seed", range(3))
def test_cost_floors_are_their_twin_and_bound_every_point(seed: int) -> None:
    line_map, rng, step = scattered(seed), np.random.default_rng(seed), 5
    box = np.array([*np.floor(-np.array(line_map.origin_cells[::-1]) + rng.integers(-5, 9, 2)), 70, 61], np.int64)
    told = line_map.nearest, line_map.lines, line_map.geometry
    floors, planes = cost_floors(box, step, 0.15, *told)

    def line(row: int, col: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float] | None:
        slot = line_map.nearest[row, col] // 128
        foot, metric = line_map.lines[slot, :2], line_map.lines[slot, [2, 3, 3, 4]].reshape(2, 2)
        middle = np.array(line_map.origin_xy_m) + (np.array([col, row]) + 0.5) * 0.02
        return (foot, metric, middle, 0.01 * 2**0.5) if slot else None

    expected = naive.cost_floors(line, box, step, 0.15, LEVELS)
    assert np.abs(floors.astype(int) - expected).max() <= 1  # 255 times a square may round to either side
    apart = step << (LEVELS - 1)
    for row, col in rng.integers(0, (70, 61), (200, 2)):
        assert planes[row % apart * apart + col % apart, row // apart, col // apart] == floors[-1, row, col]
        x, y = np.array(line_map.origin_xy_m) + (box[[1, 0]] + (col, row) + rng.uniform(0.01, 0.99, 2)) * 0.02
        cost = pose_costs(np.zeros((1, 2)), np.array([[x, y]]), np.zeros(1), 0.15, *told)[0, 0]
        assert floors[0, row, col] * 0.15**2 / 255 <= cost + 1e-15


@pytest.mark.parametrize(("seed", "n_points"), [(0, 40), (1, 40), (2, 40), (3, 300)])
def test_lowest_poses_are_their_twin(seed: int, n_points: int) -> None:
    line_map, rng, separate = scattered(seed), np.random.default_rng(seed), np.array((0.25, 0.25))
    rows, cols = np.nonzero(rng.random((19, 23)) < 0.8)
    xy = np.column_stack((cols, rows)) * 0.1 + rng.uniform(-0.3, 0.1, 2)
    points, yaws = rng.uniform(-0.7, 0.7, (n_points, 2)), rng.uniform(-3, 3) + 0.1 * np.arange(12)
    floors = line_map.cost_floors(0.15, 5, (-2.0, -2.0, 4.0, 4.0))
    told = line_map.nearest, line_map.lines, line_map.geometry
    credit = np.array([10**6])
    args = 9, 5, floors.corner, floors.levels, floors.planes, *told, credit
    found = lowest_poses(points, xy, yaws, 0.15, separate, np.inf, *args)
    costs = pose_costs(points, xy, yaws, 0.15, *told)
    assert found.tolist() == [list(row) for row in naive.lowest_poses(costs, xy, yaws, separate, 9)]
    some = lowest_poses(points, xy, yaws, 0.15, separate, float(found[4, 0]), *args)
    assert some.tolist() == found[:5].tolist()
    few = lowest_poses(points, xy[:1], yaws[:1], 0.15, separate, np.inf, *args)
    assert few.tolist() == [[costs[0, 0], 0.0, 0.0]]
    needed = 10**6 - credit[0]
    credit[0] = (needed := needed // 3)
    first = lowest_poses(points, xy, yaws, 0.15, separate, np.inf, *args)
    assert (credit[0], len(first) < 9, first.tolist()) == (0, True, found[: len(first)].tolist())


def test_free_positions_are_the_twins() -> None:
    rng = np.random.default_rng(0)
    hits, passes = (rng.integers(0, 3, (30, 150)).astype(np.uint16) * (rng.random((30, 150)) < 0.1) for _ in range(2))
    rows, cols = np.arange(30) // 5, np.sort(rng.integers(0, 40, 150))
    found = free_positions(in_strips(hits), passes, rows, cols)
    assert 20 < found.sum() < found.size
    assert np.array_equal(found, naive.free_positions(hits, passes, rows, cols))
