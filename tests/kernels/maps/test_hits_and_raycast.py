"""Counting hits and passes, and the virtual scan, against their twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.kernels.maps import hits, raycast
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.mapping.tiled_arrays import blank_strips, in_strips, plain
from mavnav.pose import Pose
from support import naive

LATTICE = np.array([-1.0, -0.5, 0.05])


def blanks() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return blank_strips((40, 128), np.uint16), np.zeros((40, 80), np.uint16), blank_strips((40, 128), np.int16)


def by_rows(counts: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
    hits, passes, shielded = counts
    return np.array([plain(hits)[:, :80], passes, plain(shielded)[:, :80]])


def directions(n: int = 90) -> np.ndarray:
    angle = np.linspace(-np.pi, np.pi, n, endpoint=False) + 0.01
    return np.column_stack((np.cos(angle), np.sin(angle)))


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), room=st.booleans())
def test_add_scan_is_its_twin(seed: int, room: bool) -> None:
    rng = np.random.default_rng(seed)
    points, laser = rng.uniform((-0.9, -0.4), (2.9, 1.4), (20, 2)), rng.uniform(0, 1, 2)
    fast, slow = blanks(), np.zeros((3, 40, 80), np.int32)
    hits.add_scan(points, laser, LATTICE, *fast, room)
    naive.add_scan(points, laser, LATTICE, *slow)
    np.testing.assert_array_equal(by_rows(fast), slow)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_show_ends_is_its_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = np.where(rng.random(90) < 0.1, np.nan, rng.uniform(0.1, 3.0, 90))
    walls = rng.choice(np.array([-1, 0, 100], np.int8), (40, 80))
    pose = rng.uniform((-0.9, -0.4, -3), (2.9, 1.4, 3))
    fast, slow = np.full((2, 40, 80), -1, np.int8)
    count = hits.show_ends(ranges, directions(), pose, LATTICE, walls, fast)
    assert count == naive.show_ends(ranges, directions(), pose, LATTICE, walls, slow)
    np.testing.assert_array_equal(fast, slow)


def test_beams_along_the_axes_and_through_corners_end_where_they_end() -> None:
    counts = blanks()
    ends = np.array([(0.025, 0.525), (0.525, 0.025), (-0.475, 0.025), (0.025, -0.475), (0.525, 0.525), (0.025, 0.025)])
    hits.add_scan(ends, np.array([0.025, 0.025]), LATTICE, *counts, True)
    fast = by_rows(counts)
    for x, y in ends:
        assert fast[0][naive.cell_of((x + 1.0, y + 0.5), 0.05)] == 1
    assert fast[0].sum() == len(ends)
    assert fast[1].sum() == 10 * 4 + 20


def test_counts_that_have_ended_stay() -> None:
    counts = blanks()
    for full, most in zip(counts, (hits.MOST, hits.MOST, hits.MOST_SHIELDED), strict=True):
        full[:] = most - 2
    ends = np.array([(0.525, 0.025 + 0.01 * k) for k in range(20)] * 3)
    for _ in range(2):
        hits.add_scan(ends, np.array([0.025, 0.025]), LATTICE, *counts, False)
        assert [full.max() for full in counts] == [hits.MOST, hits.MOST, hits.MOST_SHIELDED]
        assert all(full.min() >= most - 2 for full, most in zip(counts, (65535, 65535, 32767), strict=True))


@pytest.mark.parametrize("moving", [False, True])
def test_crossings_never_exceed_what_two_bytes_hold(moving: bool) -> None:
    """A laser at rest fills its cell; one that moves leaves room, which is found anew after every 65535 beams."""
    grid, known = GridBuilder(0.05), 0
    ends = np.array([(1.0, 0.01 * k) for k in range(-500, 500)])
    for k in range(150):
        x = 0.05 * k if moving else 0.0
        grid.insert(Pose(x), ends + np.array([x, 0.0]))
        known += grid._room >= 0
    assert (grid.passes.max() == hits.MOST) == (not moving)
    assert known == 150 if moving else 40 < known < 60


@settings(max_examples=300, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), earlier=st.sampled_from([0, 1, 5, 65534, 65535]))
def test_beams_that_end_at_corners_take_no_crossing_away(seed: int, earlier: int) -> None:
    """Beside a corner a beam may count a neighbor instead of its last cell, which must not lose a count for it."""
    rng, counts = np.random.default_rng(seed), blanks()
    counts[1][:] = earlier
    before = by_rows(counts).astype(int)
    ends = np.column_stack((rng.integers(1, 79, 6), rng.integers(1, 39, 6))).astype(float)
    for _ in range(3):
        laser = rng.integers((4, 4), (300, 150)) * 0.25
        hits.add_scan(ends, laser, np.array((0.0, 0.0, 1.0)), *counts, earlier < 60000)
    grown = by_rows(counts).astype(int) - before
    assert grown.min() >= 0
    assert grown[1:].max() <= 2 * 3 * len(ends)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), gap=st.integers(0, 3), middle=st.booleans())
def test_virtual_scan_is_its_twin(seed: int, gap: int, middle: bool) -> None:
    rng = np.random.default_rng(seed)
    counts = np.where(rng.random((40, 80)) < rng.choice((0.06, 0.3)), rng.integers(1, 5, (40, 80)), 0).astype(np.int32)
    pose = rng.uniform((-0.9, -0.4, -3), (2.9, 1.4, 3))
    fast = raycast.virtual_scan(in_strips(counts.astype(np.uint16)), LATTICE, pose, directions(), 1.7, gap, middle)
    slow = naive.virtual_scan(counts, LATTICE, pose, directions(), 1.7, gap, middle)
    # The last cell within reach is a matter of rounding; nothing else is.
    edge = np.isnan(fast) != np.isnan(slow)
    assert edge.sum() <= 1
    np.testing.assert_allclose(fast[~edge], slow[~edge], rtol=1e-12)


def test_thick_wall_counts_as_its_cell_of_most_hits() -> None:
    grid = GridBuilder(0.05)
    for x, times in ((1.025, 1), (1.075, 5), (1.125, 5), (1.225, 9)):
        for _ in range(times):
            grid.insert(Pose(), np.array([(x, 0.025)]))
    ahead = np.array([(1.0, 0.0)])
    here = Pose(0.025, 0.025)
    assert grid.virtual_scan(here, ahead, 5.0, 0)[0] == pytest.approx(1.05)  # nearest of two equals
    assert grid.virtual_scan(here, ahead, 5.0, 1)[0] == pytest.approx(1.2)  # over one empty cell
    assert grid.virtual_scan(here, ahead, 5.0, 0, middle=True)[0] == pytest.approx(1.05)
    for _ in range(4):
        grid.insert(Pose(), np.array([(1.025, 0.025)]))
    assert grid.virtual_scan(here, ahead, 5.0, 0)[0] == pytest.approx(1.0)
    assert grid.virtual_scan(here, ahead, 5.0, 0, middle=True)[0] == pytest.approx(1.05)  # of three equals
    assert np.isnan(grid.virtual_scan(here, ahead, 0.9, 0)[0])
    assert np.isnan(grid.virtual_scan(here, -ahead, 5.0, 0)[0])


@given(st.lists(st.tuples(st.integers(-40_000, 40_000), st.integers(-40_000, 40_000)), min_size=1, max_size=8))
@settings(max_examples=50, deadline=None)
def test_grid_grows_without_losing_a_hit(points_mm: list[tuple[int, int]]) -> None:
    grid = GridBuilder(0.1)
    points = [(x / 1000 + 0.0005, y / 1000 + 0.0005) for x, y in points_mm]
    for x, y in points:
        grid.insert(Pose(), np.array([(x, y)]))
    col, row = np.round(np.array(grid.origin_xy_m) / 0.1).astype(int)
    for x, y in points:
        r, c = naive.cell_of((x, y), 0.1)
        assert plain(grid.hits)[r - row, c - col] >= 1
    assert grid.hits.sum() == len(points)
