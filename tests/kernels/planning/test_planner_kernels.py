"""Repulsion, clearance and wavefront against their twins."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.kernels.planning import potential, wavefront
from mavnav.mapping.tiled_arrays import in_strips
from support import naive_planner as naive

LATTICE = np.array([-1.0, -0.5, 0.05])
SEEDS = st.integers(0, 2**32 - 1)
few = settings(max_examples=30)


def stored(hits: np.ndarray, passes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return in_strips(hits.astype(np.uint16)), passes.astype(np.uint16)


@few
@given(seed=SEEDS, min_hits=st.integers(1, 6), min_share=st.sampled_from([0.0, 0.1, 0.5]))
def test_occupied_is_its_twin(seed: int, min_hits: int, min_share: float) -> None:
    rng = np.random.default_rng(seed)
    hits = np.where(rng.random((20, 31)) < 0.15, rng.integers(1, 5, (20, 31)), 0).astype(np.int32)
    passes = rng.integers(0, 30, hits.shape).astype(np.int32)
    fast = potential.wall_centres(*stored(hits, passes), LATTICE, min_hits, min_share)
    np.testing.assert_allclose(fast, naive.occupied(hits, passes, LATTICE, min_hits, min_share), atol=1e-12)


def test_a_stray_hit_and_a_cell_that_most_beams_passed_are_no_wall() -> None:
    hits, passes = np.zeros((2, 20, 20), np.int32)
    hits[3, 3] = 1  # a stray
    hits[10, 10:12] = 1  # two side by side
    hits[16, 16], passes[16, 16] = 3, 100  # someone who walked by
    walls = potential.wall_centres(*stored(hits, passes), np.array([0.0, 0.0, 1.0]), 2, 0.1)
    np.testing.assert_array_equal(walls, [(10.5, 10.5), (11.5, 10.5)])


@few
@given(seed=SEEDS)
def test_repulsion_and_clearance_are_their_twins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    walls, points = rng.uniform(-1, 1, (40, 2)), rng.uniform(-1, 1, (9, 2))
    walls[0] = points[0]  # a vehicle on a wall is pushed by the others alone
    for point in points:
        np.testing.assert_allclose(
            potential.repulsion(walls, point, 0.6, 0.05), naive.repulsion(walls, point, 0.6, 0.05), rtol=1e-9, atol=1e-9
        )
    np.testing.assert_allclose(potential.clearance(walls, points), naive.clearance(walls, points), atol=1e-12)
    assert np.isinf(potential.clearance(walls[:0], points)).all()


def test_repulsion_of_a_wall_does_not_depend_on_the_size_of_the_cells() -> None:
    pushes = []
    for cell in (0.01, 0.02):
        x = np.arange(-1, 1, cell) + cell / 2
        pushes.append(potential.repulsion(np.column_stack((x, 0 * x)), np.array([0.0, 0.3]), 0.6, cell)[1])
    np.testing.assert_allclose(pushes[0], pushes[1], rtol=0.01)
    assert pushes[0] > 0


@few
@given(seed=SEEDS, reach=st.integers(1, 12))
def test_squared_clearance_is_its_twin(seed: int, reach: int) -> None:
    walls = np.random.default_rng(seed).random((14, 9)) < 0.03
    np.testing.assert_array_equal(wavefront.squared_clearance(walls, reach), naive.squared_clearance(walls, reach))


def weights_and_goals(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    weights = np.where(rng.random((15, 22)) < 0.3, 0, rng.integers(1, 50, (15, 22))).astype(np.int32)
    goals = rng.integers(0, weights.shape, (rng.integers(1, 4), 2)).astype(np.int32)
    weights[tuple(goals.T)] = 1
    return weights, goals


@few
@given(seed=SEEDS)
def test_wave_is_its_twin(seed: int) -> None:
    weights, goals = weights_and_goals(seed)
    slow = np.full(weights.shape, wavefront.UNREACHED)
    for cell, cost in naive.wave(weights, goals).items():
        slow[cell] = cost
    for row, col in np.random.default_rng(seed).integers(0, weights.shape, (5, 2)):
        fast = wavefront.wave(weights, goals, row, col)
        final = slow <= slow[row, col]
        np.testing.assert_array_equal(fast[final], slow[final])
        assert (fast[~final] >= slow[~final]).all()


@few
@given(seed=SEEDS, steps=st.integers(0, 40))
def test_downhill_is_its_twin_and_ends_at_a_goal(seed: int, steps: int) -> None:
    weights, goals = weights_and_goals(seed)
    row, col = (int(k) for k in np.random.default_rng(seed + 1).integers(0, weights.shape))
    cost = wavefront.wave(weights, goals, row, col)
    way = wavefront.downhill(cost, weights, row, col, steps)
    np.testing.assert_array_equal(way, naive.downhill(cost, weights, row, col, steps))
    if len(way) < steps + 1 and cost[row, col] < wavefront.UNREACHED:
        assert cost[tuple(way[-1])] == 0
