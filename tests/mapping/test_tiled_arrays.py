"""Lattices grow by what is seen, and keep what they hold."""

from __future__ import annotations

import resource
from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from mavnav.kernels.maps.layout import SHIFT, WIDE
from mavnav.mapping import tiled_arrays
from mavnav.mapping.tiled_arrays import (
    blank_strips,
    covered_extent,
    covering,
    enlarge,
    farther,
    in_strips,
    max_pool,
    plain,
    within,
)

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


@given(origin=cells, beyond=st.integers(0, 9), share=st.tuples(st.floats(-0.2, 1.2), st.floats(-0.2, 1.2)))
def test_the_covered_extent_needs_no_growth(origin: tuple[int, int], beyond: int, share: tuple[float, float]) -> None:
    cell_m, present = 0.05, (70, 130)
    covered_m = covered_extent((origin[0] * cell_m, origin[1] * cell_m), present, cell_m, beyond)
    x = covered_m[0] + share[0] * (covered_m[2] - covered_m[0])
    y = covered_m[1] + share[1] * (covered_m[3] - covered_m[1])
    inside = 0 <= min(share) <= max(share) <= 1
    assert within((x, y, x, y), covered_m) == inside or min(map(abs, (*share, share[0] - 1, share[1] - 1))) < 1e-9
    col, row = floor(x / cell_m), floor(y / cell_m)
    if within((x, y, x, y), covered_m):
        assert covering((col - beyond, row - beyond), (col + beyond, row + beyond), present, origin, 8) is None


def test_what_lies_within_needs_no_growth_and_growth_reaches_farther_on_its_own_side_only() -> None:
    assert covering((1, 1), (98, 98), (100, 100), (0, 0), 1) is None
    assert covering((1, 1), (100, 98), (100, 100), (0, 0), 1) == ((0, 0), (100, 100 + 1 + 12))


contents = st.integers(0, 2**32 - 1).map(
    lambda seed: np.where(np.random.default_rng(seed).random((130, 2 * WIDE)) < 0.01, 7, 0).astype(np.int32)
)


@given(array=contents, row=st.integers(0, 90), strip=st.integers(0, 2))
def test_contents_move_with_the_array(array: np.ndarray, row: int, strip: int) -> None:
    extent, col = (250, 4 * WIDE), strip * WIDE
    out = enlarge(array, extent, row, col)
    np.testing.assert_array_equal(out[row : row + 130, col : col + 2 * WIDE], array)
    assert out.sum() == array.sum()
    np.testing.assert_array_equal(plain(enlarge(in_strips(array), extent, row, col)), out)


@given(array=contents, cols=st.integers(1, 2 * WIDE))
def test_strips_hold_what_is_laid_in_them(array: np.ndarray, cols: int) -> None:
    strips = in_strips(array[:, :cols])
    assert strips.shape == (-(-cols // WIDE), 130, WIDE)
    for row, col in np.argwhere(array[:, :cols]):
        assert strips[col // WIDE, row, col % WIDE] == array[row, col]
    back = plain(strips)
    assert back.dtype == array.dtype
    np.testing.assert_array_equal(back[:, :cols], array[:, :cols])
    assert not back[:, cols:].any()


def test_a_strip_is_a_power_of_two_wide() -> None:
    assert 1 << SHIFT == WIDE


@pytest.mark.parametrize("strips", [False, True], ids=["plain", "strips"])
def test_blank_cells_take_no_memory(*, strips: bool) -> None:
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    extent, larger = (20_000, 320 * WIDE), (22_000, 350 * WIDE)
    array = blank_strips(extent, np.int32) if strips else np.zeros(extent, np.int32)
    array[(40, slice(5_000, 5_100)) if strips else (slice(5_000, 5_100), slice(40 * WIDE, 41 * WIDE))] = 1
    grown = enlarge(array, larger, 1_000, 10 * WIDE)
    assert grown[(50, slice(6_000, 6_100)) if strips else (slice(6_000, 6_100), slice(50 * WIDE, 51 * WIDE))].all()
    assert grown.nbytes > 400 << 20
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 100_000


def test_pooling_keeps_the_largest_and_fills_up() -> None:
    small = max_pool(np.array([[-1, -1, 0], [-1, 100, -1], [-1, -1, -1]], np.int8), 2, fill=-1)
    np.testing.assert_array_equal(small, [[100, 0], [-1, -1]])


@pytest.mark.parametrize("rows", [1, 63, 64, 65, 300])
@pytest.mark.parametrize("margin", [0, 5, 100])
def test_bands_are_all_rows_once_each_with_its_neighbours(
    rows: int, margin: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tiled_arrays, "BAND_CELLS", 70 * 10)
    values, done = np.arange(rows), []
    for around, inside, band in tiled_arrays.bands((rows, 10), margin):
        np.testing.assert_array_equal(values[around][inside], values[band])
        assert around.start == max(band.start - margin, 0)
        assert around.stop == min(band.stop + margin, rows)
        done += values[band].tolist()
    assert done == values.tolist()


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9, 0.99, 1.0])
@pytest.mark.parametrize("band_rows", [5, 64])
def test_cells_farther_than_a_distance_are_those_of_a_distance_transform(monkeypatch, share, band_rows) -> None:
    monkeypatch.setattr(tiled_arrays, "BAND_CELLS", 1)
    monkeypatch.setattr(tiled_arrays, "LEAST_ROWS", band_rows)
    rng = np.random.default_rng(int(100 * share))
    for cells_away in (0.3, 1.0, 2.0, 3.7, 5.0, 40.0):
        for outside in (False, True):
            cells = rng.random(rng.integers(1, 80, 2)) < share
            around = np.pad(cells, 100, constant_values=outside)
            away = distance_transform_edt(around) if not around.all() else np.full(around.shape, np.inf)
            expected = away[100:-100, 100:-100] * 0.05 > cells_away * 0.05
            assert np.array_equal(farther(cells, cells_away * 0.05, 0.05, outside=outside), expected)
