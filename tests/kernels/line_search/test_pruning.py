"""A pruned grid has the minimum of the exhaustive one: the same index and the same cost, bit for bit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mavnav.kernels.line_search import search as line_search
from mavnav.kernels.line_search.cost import ROUNDING_M2
from mavnav.pose import Pose, transform_points
from support import kernel_parts, naive
from support.matches import GRIDS, Problem, differences, random_problem

HALF_WINDOWS_M = (0.35, 0.12, 0.05, 0.02, 0.008, 0.001)
HALF_WINDOWS_RAD = (0.35, 0.05, 0.005, 0.0005)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    grid=st.sampled_from(GRIDS),
    half_m=st.sampled_from(HALF_WINDOWS_M),
    half_rad=st.sampled_from(HALF_WINDOWS_RAD),
    prior=st.sampled_from((0.0, 0.01)),
)
@example(seed=0, grid=40, half_m=0.35, half_rad=0.35, prior=0.0)
@example(seed=1, grid=40, half_m=0.02, half_rad=0.005, prior=0.01)
def test_every_grid_has_the_same_minimum(seed: int, grid: int, half_m: float, half_rad: float, prior: float) -> None:
    problem = random_problem(seed)
    assert differences(problem, grid, half_m, half_rad, prior) == []


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), grid=st.sampled_from(GRIDS))
def test_whole_searches_are_identical(seed: int, grid: int) -> None:
    problem = random_problem(seed)
    limits = np.array([0.35, 0.35, 0.001, 0.0004, 0.15, 120, 2, 0.01, 0.051, 0.02, 61.0, 6.0, 0.0])
    pruned, exhaustive = (
        line_search.search(
            problem.points, problem.start, np.array([2.0 * grid, grid, grid, 3, prune]), limits, *problem.lines
        )
        for prune in (1.0, 0.0)
    )
    np.testing.assert_array_equal(pruned, exhaustive)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), half_m=st.sampled_from(HALF_WINDOWS_M[2:]), grid=st.sampled_from((2, 5, 13)))
def test_sums_by_cells_are_the_sums_by_points(seed: int, half_m: float, grid: int) -> None:
    """The polynomials stand for every candidate of the plane, well within the rounding that pruning allows for."""
    problem = random_problem(seed)
    at, window = problem.grid(half_m, 0.1, 0.0, pruned=True)
    x, y = problem.turned(at)
    sums = np.zeros((grid, grid))
    kernel_parts.shift_sums(problem.centred, at, window, sums, *problem.lines)
    offsets = -half_m + np.arange(grid) * (2 * half_m / (grid - 1))
    slow = [[problem.cost(x, y, at[:2] + np.array((right, up))) for right in offsets] for up in offsets]
    np.testing.assert_allclose(sums, slow, atol=0.01 * ROUNDING_M2)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), half_rad=st.sampled_from(HALF_WINDOWS_RAD), azimuths=st.sampled_from((2, 7, 20)))
def test_sums_over_turns_are_the_sums_by_points(seed: int, half_rad: float, azimuths: int) -> None:
    problem = random_problem(seed)
    at, window = problem.grid(0.05, half_rad, 0.0, pruned=True)
    turns = np.linspace(-half_rad, half_rad, azimuths)
    sums = np.zeros(azimuths)
    kernel_parts.turn_sums(problem.centred, at, window, sums, *problem.lines)
    slow = []
    for turn in turns:
        x, y = problem.turned(at + np.array([0, 0, turn, 0, 0]))
        slow.append(problem.cost(x, y, at[:2]))
    np.testing.assert_allclose(sums, slow, atol=0.01 * ROUNDING_M2)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), prior=st.sampled_from((0.0, 0.01)))
def test_the_form_is_the_sum_by_points(seed: int, prior: float) -> None:
    """Each point keeps the line of the middle, or stays truncated, however the scan is moved."""
    problem = random_problem(seed)
    at, window = problem.grid(0.05, 0.1, prior, pruned=True)
    form = np.zeros((5, 5))
    kernel_parts.quadratic_form(problem.centred, at, window, form, np.empty(0, np.int64), *problem.lines)
    rng = np.random.default_rng(seed)
    for turn, right, up in rng.uniform(-1, 1, (5, 3)) * (0.1, 0.05, 0.05):
        motion = np.array((1.0, math.cos(turn) - 1.0, math.sin(turn), right, up))
        value = motion @ (form + np.triu(form, 1).T) @ motion
        slow = naive.fixed_cost(problem.centred.T, at[:3], (right, up, turn), problem.line_map, 0.15)
        far2 = ((at[:2] - at[3:] + np.array((right, up))) ** 2).sum()
        assert value == pytest.approx(slow + prior * len(problem.points) * far2, abs=ROUNDING_M2)


@pytest.mark.parametrize("fixed", [True, False])
@pytest.mark.parametrize("pruned", [True, False])
def test_ties_go_to_the_lowest_index(*, pruned: bool, fixed: bool) -> None:
    """Far from the map every candidate costs the same."""
    problem = random_problem(0)
    far = Problem(problem.line_map, problem.points, problem.start + np.array([500.0, 0, 0]))
    x, y, yaw, *_ = far.search_once(5, 0.1, 0.1, 0.0, fixed=fixed, pruned=pruned, rounds=1)
    assert yaw == far.start[2] - 0.1
    middle = far.points.mean(axis=0)[None]
    moved = transform_points(Pose(x, y, yaw), middle) - transform_points(Pose(*far.start), middle)
    np.testing.assert_allclose(moved, [[-0.1, -0.1]], atol=1e-9)
