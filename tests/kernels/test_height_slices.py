"""Counting hits and crossings in slices by height, against a slow twin."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.kernels.height_slices import add_to_slices

LATTICE, LEVELS_M, SHAPE = np.array([-1.0, -0.5, 0.05]), np.array([0.15, 0.3]), (4, 40, 80)


def twin(points: np.ndarray, laser: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut each beam where it enters a cell or a slice, and count the middle of each piece."""
    corner, edge = np.array([*LATTICE[:2], LEVELS_M[0]]), np.array([0.05, 0.05, LEVELS_M[1]])
    hits, passes = np.zeros((2, *SHAPE), np.int64)
    for point in points:
        a, b = (laser - corner) / edge, (point - corner) / edge
        cuts = [0.0, 1.0]
        for start, end in zip(a, b, strict=True):
            between = np.arange(np.ceil(min(start, end)), np.floor(max(start, end)) + 1)
            cuts += ((between - start) / (end - start)).tolist()
        cuts = sorted(cuts)
        for t in (np.array(cuts[:-1]) + cuts[1:]) / 2:
            col, row, layer = np.floor(a + t * (b - a)).astype(int)
            if 0 <= layer < SHAPE[0]:
                passes[layer, row, col] += 1
        col, row, layer = np.floor(b).astype(int)
        if 0 <= layer < SHAPE[0]:
            passes[layer, row, col] -= 1
            hits[layer, row, col] += 1
    return hits, passes


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_beams_are_counted_where_they_cross_a_slice(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = (-0.9, -0.4, 0.0), (2.9, 1.4, 1.6)
    points, laser = rng.uniform(low, high, (20, 3)), rng.uniform(low, high)
    fast = np.zeros((2, *SHAPE), np.uint16)
    add_to_slices(points, laser, LATTICE, LEVELS_M, *fast)
    np.testing.assert_array_equal(fast, twin(points, laser))


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
