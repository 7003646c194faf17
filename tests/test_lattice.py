"""Lattices grow by what is seen, and keep what they hold."""

from __future__ import annotations

import resource

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavnav import lattice
from mavnav.lattice import SMALL_BYTES, blank, covering, moved, pooled

cells = st.tuples(st.integers(-500, 500), st.integers(-500, 500))


@given(low=cells, size=st.tuples(st.integers(0, 300), st.integers(0, 300)), origin=cells, block=st.integers(1, 64))
def test_a_lattice_covers_what_is_asked_and_what_it_covered(
    low: tuple[int, int], size: tuple[int, int], origin: tuple[int, int], block: int
) -> None:
    present, high = (70, 130), (low[0] + size[0], low[1] + size[1])
    grown = covering(low, high, present, origin, block)
    (col, row), (rows, cols) = grown or (origin, present)
    assert col <= min(low[0], origin[0])
    assert row <= min(low[1], origin[1])
    assert col + cols >= max(high[0] + 1, origin[0] + present[1])
    assert row + rows >= max(high[1] + 1, origin[1] + present[0])


def test_what_lies_within_needs_no_growth_and_growth_reaches_farther_on_its_own_side_only() -> None:
    assert covering((1, 1), (98, 98), (100, 100), (0, 0), 1) is None
    assert covering((1, 1), (100, 98), (100, 100), (0, 0), 1) == ((0, 0), (100, 100 + 1 + 12))


@given(seed=st.integers(0, 2**32 - 1), row=st.integers(0, 90), col=st.integers(0, 90))
def test_contents_move_with_the_array(seed: int, row: int, col: int) -> None:
    rng = np.random.default_rng(seed)
    array = np.where(rng.random((130, 70)) < 0.01, 7, 0).astype(np.int32)
    out = moved(array, (250, 200), row, col)
    np.testing.assert_array_equal(out[row : row + 130, col : col + 70], array)
    assert out.sum() == array.sum()


def test_blank_cells_take_no_memory() -> None:
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    array = blank((20_000, 20_000), np.int32)
    array[5_000:5_100, 3_000:3_100] = 1
    larger = moved(array, (22_000, 22_000), 1_000, 1_000)
    assert larger[6_000:6_100, 4_000:4_100].all()
    assert larger.nbytes > 100 * SMALL_BYTES
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 100_000


def test_pooling_keeps_the_largest_and_fills_up() -> None:
    small = pooled(np.array([[-1, -1, 0], [-1, 100, -1], [-1, -1, -1]], np.int8), 2, fill=-1)
    np.testing.assert_array_equal(small, [[100, 0], [-1, -1]])


@pytest.mark.parametrize("rows", [1, 63, 64, 65, 300])
@pytest.mark.parametrize("margin", [0, 5, 100])
def test_bands_are_all_rows_once_each_with_its_neighbours(
    rows: int, margin: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lattice, "BAND_CELLS", 70 * 10)
    values, done = np.arange(rows), []
    for around, inside, band in lattice.bands((rows, 10), margin):
        np.testing.assert_array_equal(values[around][inside], values[band])
        assert around.start == max(band.start - margin, 0)
        assert around.stop == min(band.stop + margin, rows)
        done += values[band].tolist()
    assert done == values.tolist()
