"""What did not stay: the kernels against their twins, and what they are for."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.kernels.maps.dynamic_cells import dynamic_cells
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.mapping.tiled_arrays import in_strips
from mavnav.pose import Pose
from support import naive


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_dynamic_cells_are_the_twins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hits = np.where(rng.random((50, 60)) < 0.02, rng.integers(1, 9, (50, 60)), 0).astype(np.int32)
    passes = rng.integers(0, 80, hits.shape).astype(np.int32)
    shielded = np.minimum(passes, rng.integers(0, 20, hits.shape)).astype(np.int32)
    slow = naive.dynamic_cells(hits, passes, shielded)
    ended, passed = (counts.astype(np.uint16) for counts in (hits, passes))
    fast = dynamic_cells(in_strips(ended), passed, in_strips(shielded.astype(np.int16)))
    np.testing.assert_array_equal(fast, np.argwhere(slow))


def wall(y_m: float) -> np.ndarray:
    return np.column_stack((np.linspace(-0.5, 0.5, 60), np.full(60, y_m)))


def test_who_walks_by_is_cleared_and_what_stands_is_kept() -> None:
    grid, person, post = GridBuilder(0.02), np.array([(0.005, 1.005)]), np.array([(0.305, 1.005)])
    grid.insert(Pose(), person)
    for _ in range(10):
        grid.insert(Pose(), np.vstack((wall(2.005), post)))
    np.testing.assert_allclose(grid.remove_dynamic_cells(), [(0.01, 1.01)])
    assert grid.hits.sum() == 10 * 61
    assert not len(grid.remove_dynamic_cells())


def test_beams_beside_a_thin_post_do_not_speak_against_it() -> None:
    """Its fuzzy edge is hit now and then; in the same scans beams go past it."""
    grid, rng = GridBuilder(0.02), np.random.default_rng(0)
    for _ in range(40):
        post = rng.normal((0.0, 1.0), 0.02, (6, 2))
        grid.insert(Pose(), np.vstack((wall(2.005), post)))
    before = grid.hits.copy()
    assert not len(grid.remove_dynamic_cells())
    np.testing.assert_array_equal(grid.hits, before)
