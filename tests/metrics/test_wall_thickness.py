"""Wall thickness: against a slow twin, and on walls whose thickness is known."""

from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mavnav.mapping import tiled_arrays
from mavnav.metrics import walls as module
from mavnav.metrics.walls import summary, wall_sections
from support.marks import slow

CELL_M = 0.02
ANGLES = range(0, 91, 3)


def wall_thickness(hits, cell_m, min_hits):
    return summary(wall_sections(hits, cell_m, min_hits), cell_m)


def naive(walls, hits, min_hits, cell_m=CELL_M):
    radius_m = max(module.RADIUS_M, module.RADIUS_CELLS * cell_m)
    rows = walls.naive(
        hits, cell_m, min_hits, radius_m=radius_m, min_cells=module.MIN_CELLS, min_length_m=module.MIN_LENGTH_M,
        max_ratio=module.MAX_RATIO, max_gap=module.MAX_GAP_CELLS,
    )  # fmt: skip
    return np.array(rows, float).reshape(-1, 5)[:, :4]


def table(hits, min_hits, cell_m=CELL_M):
    s = wall_sections(hits, cell_m, min_hits)
    rows = zip(s.row, s.col, s.thickness_cells, s.length_m, strict=True)
    return np.array(sorted(rows), float).reshape(-1, 4)


@pytest.mark.parametrize(
    ("angle_deg", "min_hits"),
    [
        *(FEW_SECTIONS := [(0, 1), (17, 2), (52, 5), (90, 2), (131, 1)]),
        *(slow(*case) for case in product([0, 17, 52, 90, 131], [1, 2, 5]) if case not in FEW_SECTIONS),
    ],
)
def test_sections_are_the_slow_twins(walls, angle_deg, min_hits):
    hits = walls.noisy(angle_deg, 1.5, returns=6000)
    hits = np.ascontiguousarray(hits[30:110, 40:120])
    hits[5:8, 10:60] += 2  # another wall, meeting the first or not
    expected = naive(walls, hits, min_hits)
    assert len(expected) > 10
    np.testing.assert_allclose(table(hits, min_hits), expected, atol=1e-9)


DIAGONAL = np.zeros((4, 5), np.int32)
DIAGONAL[[0, 1, 2, 3, 3, 3], [0, 2, 4, 1, 2, 3]] = 9, 2, 1, 1, 2, 9


# Cells of 0.1 m: small maps have sections too.
@given(
    arrays(np.int32, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=st.sampled_from([0, 0, 0, 1, 2, 9]))
)
@example(DIAGONAL)
@settings(max_examples=60)
def test_any_small_map_is_cut_as_the_slow_twin_cuts_it(walls, hits):
    got, expected = table(hits, 1, 0.1003), naive(walls, hits, 1, 0.1003)
    assert got.shape == expected.shape
    np.testing.assert_allclose(got, expected, atol=1e-9)


@pytest.mark.parametrize("angle_deg", ANGLES)
def test_a_wall_of_one_cell_reads_exactly_one_at_every_angle(walls, angle_deg):
    t = wall_thickness(walls.straight(angle_deg, 1), CELL_M, 1)
    assert (t.max_cells, t.p95_cells, t.median_cells) == (1.0, 1.0, 1.0)
    assert t.max_mm == pytest.approx(20.0)
    assert t.length_m == pytest.approx(2.8, abs=0.1)
    assert t.share > 0.97


@pytest.mark.parametrize("angle_deg", ANGLES)
@pytest.mark.parametrize("cell_m", [0.08, 0.1, 0.15, 0.25])
def test_a_wall_on_coarse_cells_is_measured_at_every_angle(walls, cell_m, angle_deg):
    t = wall_thickness(walls.straight(angle_deg, 1), cell_m, 1)
    assert (t.max_cells, t.median_cells) == (1.0, 1.0)
    assert t.length_m == pytest.approx(140 * cell_m, rel=0.05)


@pytest.mark.parametrize("cells", [2, 3, 5, 7])
def test_a_thick_wall_reads_its_thickness_at_every_angle(walls, cells):
    read = [wall_thickness(walls.straight(a, cells), CELL_M, 1) for a in ANGLES]
    assert all(abs(t.median_cells - cells) < 0.75 and t.max_cells < cells + 1.0 for t in read)
    assert np.mean([t.median_cells for t in read]) == pytest.approx(cells, abs=0.15)
    assert all(t.length_m == pytest.approx(2.8, abs=0.35) for t in read)


@pytest.mark.parametrize("angle_deg", [0, 20, 45, 70, 90])
def test_noise_thickens_a_wall_alike_at_every_angle(walls, angle_deg):
    upright = wall_thickness(walls.noisy(0, 1.5), CELL_M, 2)
    turned = wall_thickness(walls.noisy(angle_deg, 1.5, seed=1), CELL_M, 2)
    assert turned.median_cells == pytest.approx(upright.median_cells, abs=0.8)
    assert turned.p95_cells == pytest.approx(upright.p95_cells, abs=0.8)


def test_more_noise_reads_thicker_and_a_higher_threshold_thinner(walls):
    by_noise = [wall_thickness(walls.noisy(10, sigma), CELL_M, 2).p95_cells for sigma in (0.5, 1.0, 2.0)]
    by_hits = [wall_thickness(walls.noisy(10, 1.5), CELL_M, k).p95_cells for k in (1, 2, 5)]
    assert by_noise == sorted(by_noise)
    assert by_hits == sorted(by_hits, reverse=True)
    assert by_noise[0] < by_noise[-1]
    assert by_hits[-1] < by_hits[0]


@pytest.mark.parametrize("turn", ["mirror rows", "mirror columns", "transpose", "half turn"])
@pytest.mark.parametrize("angle_deg", [0, 8, 33, 60])
def test_a_mirrored_map_gives_the_same_numbers(walls, angle_deg, turn):
    hits = walls.noisy(angle_deg, 1.2)
    turned = {
        "mirror rows": hits[::-1], "mirror columns": hits[:, ::-1], "transpose": hits.T, "half turn": hits[::-1, ::-1],
    }[turn]  # fmt: skip
    here, there = wall_thickness(hits, CELL_M, 2), wall_thickness(turned, CELL_M, 2)
    assert (here.sections, here.share) == (there.sections, there.share)
    for name in ("max_cells", "p95_cells", "median_cells", "length_m"):
        assert getattr(here, name) == pytest.approx(getattr(there, name), abs=1e-9)


def test_a_corner_is_not_a_thick_wall():
    hits = np.zeros((120, 120), np.int32)
    hits[10:13, 10:100] = 4
    hits[10:100, 10:13] = 4
    sections = wall_sections(hits, CELL_M, 1)
    assert sections.thickness_cells.max() <= 3.0
    assert len(sections.row) > 100
    assert np.hypot(sections.row - 11, sections.col - 11).min() * CELL_M > 0.1


def test_clutter_has_no_walls():
    rng = np.random.default_rng(3)
    blobs = np.zeros((150, 150), np.int32)
    for corner in np.ndindex(5, 5):  # posts of 0.18 m, half a metre apart
        row, col = np.array(corner) * 26 + rng.integers(10, 18, 2)
        blobs[row - 4 : row + 5, col - 4 : col + 5] = 3
    assert wall_thickness(blobs, CELL_M, 1).share < 0.02


def test_a_wall_ruined_by_noise_reads_thick_or_is_missing_from_the_share(walls):
    """A measure that silently looked away from bad walls would praise them."""
    hits = walls.noisy(30, 3.0)
    assert wall_thickness(hits, CELL_M, 5).p95_cells > 9
    assert wall_thickness(hits, CELL_M, 1).share < 0.5


@pytest.mark.parametrize("cells", [3, 4, 8, 12, 20])
def test_a_ghost_some_cells_away_is_a_wall_of_its_own(cells):
    hits = np.zeros((60, 120), np.int32)
    hits[20, 10:110] = hits[20 + cells, 10:110] = 5
    t = wall_thickness(hits, CELL_M, 1)
    assert t.max_cells == 1.0
    assert t.length_m == pytest.approx(4.0)


def test_one_empty_cell_is_bridged_and_two_are_not():
    hits = np.zeros((60, 120), np.int32)
    hits[20, 10:110] = hits[22, 10:110] = 5
    assert wall_thickness(hits, CELL_M, 1).median_cells == 3.0
    hits[22] = 0
    hits[23, 10:110] = 5
    assert wall_thickness(hits, CELL_M, 1).median_cells == 1.0


def test_stray_cells_beside_a_wall_are_no_thin_walls():
    hits = np.zeros((60, 120), np.int32)
    hits[20:24, 10:110] = 10
    hits[28, 10:110:5] = 1
    t = wall_thickness(hits, CELL_M, 1)
    assert (t.median_cells, t.max_cells) == (4.0, 4.0)
    assert t.length_m == pytest.approx(2.0)


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (40, 40)])
def test_an_empty_map_has_no_thickness(shape):
    t = wall_thickness(np.zeros(shape, np.int32), CELL_M, 1)
    assert np.isnan([t.max_cells, t.p95_cells, t.median_mm]).all()
    assert (t.sections, t.length_m, t.share) == (0, 0.0, 0.0)


def test_a_short_piece_is_not_measured():
    hits = np.zeros((60, 60), np.int32)
    hits[30, 20:29] = 5  # 0.18 m
    assert wall_thickness(hits, CELL_M, 1).sections == 0


def test_a_large_map_weighs_hits_without_overflow():
    hits = np.zeros((60, 120), np.int32)
    hits[20:23, 10:110] = 2_000_000
    assert wall_thickness(hits, CELL_M, 5).median_cells == 3.0


def test_nothing_is_occupied_from_zero_hits_on():
    with pytest.raises(ValueError, match="from 1 hit on"):
        wall_thickness(np.ones((3, 3), np.int32), CELL_M, 0)


@given(
    arrays(np.uint16, st.tuples(st.integers(1, 60), st.integers(1, 30)), elements=st.sampled_from([0, 0, 0, 1, 2, 9])),
    st.sampled_from([0.05, 0.1]),
)
@settings(max_examples=60)
def test_bands_of_a_map_are_cut_as_the_whole_map(hits, cell_m):
    whole = wall_sections(hits, cell_m, 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tiled_arrays, "BAND_CELLS", 1)
        patch.setattr(tiled_arrays, "LEAST_ROWS", 5)
        banded = wall_sections(hits, cell_m, 1)
    for name in ("row", "col", "thickness_cells", "length_m", "direction_rad"):
        np.testing.assert_array_equal(getattr(banded, name), getattr(whole, name))
