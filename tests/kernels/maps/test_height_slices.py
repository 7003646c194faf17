"""Counting hits and crossings in slices by height, against a slow twin."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.kernels.maps.height_slices import add_to_slices
from support import naive

LATTICE, LEVELS_M, SHAPE = np.array([-1.0, -0.5, 0.05]), np.array([0.15, 0.3]), (4, 40, 80)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_beams_are_counted_where_they_cross_a_slice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = (-0.9, -0.4, 0.0), (2.9, 1.4, 1.6)
    points, laser = rng.uniform(low, high, (20, 3)), rng.uniform(low, high)
    fast = np.zeros((2, *SHAPE), np.uint16)
    add_to_slices(points, laser, LATTICE, LEVELS_M, *fast)
    slow = np.zeros((2, *SHAPE), np.int64)
    naive.add_to_slices(points, laser, LATTICE, LEVELS_M, *slow)
    np.testing.assert_array_equal(fast, slow)


def test_a_beam_over_a_table_does_not_free_what_is_below() -> None:
    hits, passes = np.zeros((2, *SHAPE), np.uint16)
    laser, wall = np.array([-0.88, 0.0, 1.0]), np.array([[2.875, 0.0, 0.2]])
    add_to_slices(wall, laser, LATTICE, LEVELS_M, hits, passes)
    across = [np.flatnonzero(layer[10]) for layer in passes]
    assert hits[0, 10, 77] == hits.sum() == 1
    assert [cols[0] for cols in across[:3]] == [54, 25, 2]
    assert across[0][-1] == 76
    assert not passes[3].any()


def test_beams_beyond_the_map_are_left_out() -> None:
    hits, passes = np.zeros((2, *SHAPE), np.uint16)
    add_to_slices(np.array([[9.0, 0.0, 0.5]]), np.array([0.0, 0.0, 0.5]), LATTICE, LEVELS_M, hits, passes)
    add_to_slices(np.array([[0.0, 0.0, 0.5]]), np.array([9.0, 0.0, 0.5]), LATTICE, LEVELS_M, hits, passes)
    assert not hits.any()
    assert not passes.any()
