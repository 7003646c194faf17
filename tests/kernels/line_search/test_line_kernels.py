"""Points, line map and line search against their twins."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.kernels.line_search import search as line_search
from mavnav.kernels.line_search.search import HOPELESS
from mavnav.kernels.maps.layout import FAR, NEAR, REACH_CELLS
from mavnav.kernels.scans.points import extent, place_points, scan_points
from mavnav.mapping import line_map as line_map_module
from mavnav.mapping.line_map import LineMap
from mavnav.pose import Pose, transform_points
from mavnav.scan import LaserSpec
from support import kernel_parts, naive
from support.marks import slow
from support.matches import voxel_means
from support.synthetic import URG_04LX, furnished_rooms, room, scan_at

if TYPE_CHECKING:
    from collections.abc import Callable

    Held = Callable[[tuple, tuple], np.ndarray]
    Terms = tuple[Callable[[float, float, float], float], np.ndarray, float, Held]

ANGLES = URG_04LX.angles_rad
DIRECTIONS = np.column_stack((np.cos(ANGLES), np.sin(ANGLES)))


def wall_points(rng: np.random.Generator, n: int = 60) -> np.ndarray:
    along = rng.uniform(-0.3, 0.5, n)
    return np.column_stack((along, 0.3 * along + 0.1)) + rng.normal(0, 0.012, (n, 2))


def cleaned(
    ranges: np.ndarray,
    twist: np.ndarray,
    increment_s: float,
    near_m: float,
    far_m: float,
    directions: np.ndarray = DIRECTIONS,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the end points of a scan and their means in voxels of 30 mm."""
    ends, means = np.empty((2, len(ranges), 2))
    n, m = scan_points(ranges, directions, twist, increment_s, np.array([near_m, far_m, 0.03]), ends, means)
    return ends[:n], means[:m]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), every=st.sampled_from((1, 4, 20)))
def test_scan_points_are_their_twin(seed: int, every: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = scan_at(furnished_rooms(), Pose(3.0, 2.2, 1.0), noise=0.03, rng=rng).ranges_m[::every].copy()
    ranges[rng.random(len(ranges)) < 0.1] = np.nan
    args, directions = (rng.uniform(-1, 1, 3), 1e-4, 0.5, 4.0), np.ascontiguousarray(DIRECTIONS[::every])
    ends, means = cleaned(ranges, *args, directions)
    np.testing.assert_allclose(ends, naive.scan_points(ranges, directions, *args), atol=1e-12)
    np.testing.assert_array_equal(means, voxel_means(ends, 0.03))


@pytest.mark.parametrize("beams", [36, 60, 90, 360])
def test_walls_that_few_beams_meet_are_no_mixed_pixels(beams: int) -> None:
    spec = LaserSpec(0.0, 2.0 * np.pi / beams, beams, 0.05, 20.0)
    ranges = scan_at(room(4.0, 3.0), Pose(1.4, 1.2, 0.3), spec).ranges_m
    points, _ = cleaned(ranges, np.zeros(3), 0.0, 0.1, 20.0, spec.directions)
    assert len(points) >= 0.98 * beams


def test_deskewing_undoes_a_turn_during_the_sweep() -> None:
    """A laser that turns at 2 rad/s sees each beam from a later heading; de-skewed, the walls are where they are."""
    at, rate = Pose(3.0, 2.2, 1.0), 2.0
    late = URG_04LX.time_increment_s * (np.arange(URG_04LX.beams) - (URG_04LX.beams - 1) / 2)
    skewed = np.array(
        [
            scan_at(furnished_rooms(), Pose(at.x_m, at.y_m, at.yaw_rad + rate * t)).ranges_m[i]
            for i, t in enumerate(late)
        ]
    )
    points, _ = cleaned(skewed, np.array([0.0, 0.0, rate]), URG_04LX.time_increment_s, 0.1, 5.0)
    still = scan_at(furnished_rooms(), at).points()
    gap = np.linalg.norm(points[:, None] - still[None], axis=2).min(axis=1)
    raw, _ = cleaned(skewed, np.zeros(3), 0.0, 0.1, 5.0)
    assert np.median(gap) < 0.01
    assert np.median(np.linalg.norm(raw[:, None] - still[None], axis=2).min(axis=1)) > 2 * np.median(gap)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_voxel_means_are_their_twin(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-0.3, 0.3, (80, 2))
    fast, slow = voxel_means(points, 0.05), naive.voxel_means(points, 0.05)
    np.testing.assert_allclose(fast[np.lexsort(fast.T)], slow[np.lexsort(slow.T)], atol=1e-12)
    np.testing.assert_array_equal(fast, voxel_means(points, 0.05))


def test_any_prefix_of_the_voxel_means_is_spread_over_the_scan() -> None:
    means = voxel_means(scan_at(furnished_rooms(), Pose(3.0, 2.2, 1.0)).points(), 0.03)
    some = means[: len(means) // 3]
    assert np.linalg.norm(some.mean(axis=0) - means.mean(axis=0)) < 0.2
    assert np.allclose(some.std(axis=0), means.std(axis=0), rtol=0.15)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_lines_grown_scan_by_scan_are_those_of_all_points_at_once(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = wall_points(rng)
    grown = LineMap(0.02, 0.06, 0.01)
    for part in np.array_split(points, 5):
        grown.insert(part)
    assert_lines(grown, naive.insert_points(points, 0.02, 0.06, 0.01))


def assert_lines(grown: LineMap, expected: dict) -> None:
    assert grown.count - 1 == len(expected)
    col0, row0 = grown.origin_cells
    for slot in range(1, grown.count):
        row, col = grown.cells[slot] + (row0, col0)
        foot, a, rests_on = expected[row, col]
        assert grown.nearest[tuple(grown.cells[slot])] // NEAR == slot
        np.testing.assert_allclose(grown.lines[slot, :2], foot, atol=1e-9)
        assert grown.lines[slot, 5] == pytest.approx(rests_on)
        np.testing.assert_allclose(grown.lines[slot, 2:5], (a[0, 0], a[0, 1], a[1, 1]), atol=1e-6)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.sampled_from((0.1, 0.3, 1.0)))
def test_points_wait_until_they_are_a_share_of_those_before(seed: int, share: float) -> None:
    points = wall_points(np.random.default_rng(seed))
    scans = [*(points[k::4] for k in range(4)), points[:9], points[3:6], points[4:5]]
    grown = LineMap(0.02, 0.06, 0.01, waiting_share=share)
    for scan in scans:
        grown.insert(scan)
    assert_lines(grown, naive.insert_points(naive.line_points(scans, 0.02, share), 0.02, 0.06, 0.01))
    grown.remove(np.array([(99.0, 99.0)]))
    assert_lines(grown, naive.insert_points(np.concatenate(scans), 0.02, 0.06, 0.01))


def test_where_too_many_points_would_wait_none_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_map_module, "MOST_WAITING", 8)
    points = wall_points(np.random.default_rng(3))
    grown = LineMap(0.02, 0.06, 0.01, waiting_share=2.0)
    for scan in (points, points):
        grown.insert(scan)
    assert 0 < grown.waiting[0, 0] <= 8
    grown.remove(np.array([(99.0, 99.0)]))
    assert_lines(grown, naive.insert_points(np.concatenate((points, points)), 0.02, 0.06, 0.01))


def test_nearest_is_the_nearest_occupied_cell_within_reach() -> None:
    grown = LineMap(0.02, 0.06, 0.01)
    grown.insert(wall_points(np.random.default_rng(5), 12))
    occupied = grown.cells[1 : grown.count].astype(int)
    rows, cols = np.indices(grown.nearest.shape)
    d2 = (rows[..., None] - occupied[:, 0]) ** 2 + (cols[..., None] - occupied[:, 1]) ** 2
    within = d2.min(axis=-1) <= REACH_CELLS**2
    np.testing.assert_array_equal(grown.nearest > 0, within)
    slot, closeness = np.divmod(grown.nearest.astype(int), NEAR)
    chosen = np.take_along_axis(d2, np.maximum(slot - 1, 0)[..., None], axis=-1)[..., 0]
    np.testing.assert_array_equal(chosen[within], d2.min(axis=-1)[within])
    np.testing.assert_array_equal(closeness, np.maximum(FAR + 1 - d2.min(axis=-1), 0))


def test_an_entry_of_nearest_has_room_for_how_near() -> None:
    assert FAR + 1 < NEAR
    assert NEAR & (NEAR - 1) == 0


@given(shift=st.tuples(st.integers(-900, 900), st.integers(-900, 900)))
@settings(max_examples=20, deadline=None)
def test_map_grows_any_way_and_forgets_nothing(shift: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    first = wall_points(rng)
    grown = LineMap(0.02, 0.06, 0.01)
    grown.insert(first)
    before = grown.lines[: grown.count, :5].copy(), grown.cells[1 : grown.count] + np.array(grown.origin_cells)[::-1]
    grown.insert(first[:5] + np.array(shift) * 0.05 + 100.0)
    n = len(before[0])
    np.testing.assert_array_equal(grown.lines[:n, :5], before[0])
    np.testing.assert_array_equal(grown.cells[1:n] + np.array(grown.origin_cells)[::-1], before[1])


def test_without_some_cells_the_lines_are_those_of_the_other_points() -> None:
    rng = np.random.default_rng(1)
    wall, strays = wall_points(rng), rng.uniform((-0.2, 0.4), (0.4, 0.9), (20, 2))
    line_map = LineMap(0.02, 0.06, 0.01)
    line_map.insert(np.vstack((wall, strays)))
    line_map.remove(np.vstack((strays, [(0.1, 0.8), (99.0, 99.0)])))
    expected = naive.insert_points(wall, 0.02, 0.06, 0.01)
    assert line_map.count - 1 == len(expected)
    for slot, cell in enumerate(line_map.cells[1 : line_map.count], start=1):
        foot, a, _ = expected[tuple(cell + np.array(line_map.origin_cells)[::-1])]
        assert line_map.nearest[tuple(cell)] // NEAR == slot
        np.testing.assert_allclose(line_map.lines[slot, :2], foot, atol=1e-9)
        np.testing.assert_allclose(line_map.lines[slot, 2:5], (a[0, 0], a[0, 1], a[1, 1]), atol=1e-6)
    assert np.count_nonzero(line_map.nearest % NEAR > FAR) == len(expected)


def arrays(line_map: LineMap) -> tuple[np.ndarray, ...]:
    return line_map.nearest, line_map.lines, line_map.geometry


def furnished_map() -> tuple[LineMap, np.ndarray]:
    here = Pose(3.0, 2.2, 1.0)
    line_map = LineMap(0.02, 0.06, 0.01)
    rng = np.random.default_rng(0)
    for _ in range(3):
        scan = scan_at(furnished_rooms(), here, noise=0.01, rng=rng)
        line_map.insert(transform_points(here, scan.points()))
    seen = scan_at(furnished_rooms(), here, noise=0.01, rng=rng).points()
    return line_map, voxel_means(seen[::12], 0.03)


def test_extent_is_its_twin() -> None:
    points = np.random.default_rng(4).normal(0, 5, (50, 2))
    assert extent(points) == naive.extent(points)
    assert extent(points[:1]) == naive.extent(points[:1])


def test_placed_points_are_their_twins_and_told_their_extent() -> None:
    points, pose, out = np.random.default_rng(4).normal(0, 5, (50, 2)), Pose(1.0, -2.0, 0.7), np.empty((50, 2))
    extent_m = place_points(points, pose.as_array(), out)
    np.testing.assert_allclose(out, transform_points(pose, points), rtol=1e-14, atol=1e-14)
    assert extent_m == naive.extent(out)


def test_cost_is_its_twin() -> None:
    line_map, points = furnished_map()
    origin = np.array(line_map.origin_cells)[::-1]
    lines = {
        tuple(line_map.cells[k] + origin): (
            line_map.lines[k, :2],
            np.array([line_map.lines[k, 2:4], line_map.lines[k, 3:5]]),
        )
        for k in range(1, line_map.count)
    }
    for pose in ([3.0, 2.2, 1.0], [3.04, 2.17, 1.02], [2.8, 2.4, 0.8]):
        slow = naive.line_costs(points, pose, lines, 0.02, 0.15)
        keep = [k for k, cost in enumerate(slow) if cost is not None]
        fast = cost_of(points[keep], line_map)(*pose)
        assert fast == pytest.approx(sum(slow[k] for k in keep), rel=1e-9)


def cost_of(points: np.ndarray, line_map: LineMap) -> Callable[[float, float, float], float]:
    """Return the cost sum of the points at a pose."""

    def cost(x: float, y: float, yaw: float) -> float:
        placed = np.ascontiguousarray(transform_points(Pose(x, y, yaw), points).T)
        return kernel_parts.cost_sum(*placed, 0.0, 0.0, 0.15**2, *arrays(line_map))

    return cost


FEW = 90  # points of the search until those on known ground are selected


@pytest.mark.parametrize(
    ("overlap_m", "known_points", "hold_m"),
    [
        (0.0, 0.0, 0.0),
        (0.02, 0.0, 0.05),
        (0.1, 6.0, 0.05),
        slow(0.0, 0.0, 0.05),
        slow(0.02, 0.0, 0.0),
        slow(0.1, 6.0, 0.0),
    ],
)
@pytest.mark.parametrize(("grid", "prior"), [((7, 4, 5, 2), 0.0), ((6, 5, 5, 0), 0.0), ((6, 5, 5, 0), 0.5)])
def test_search_is_its_twin(
    grid: tuple[int, ...], prior: float, overlap_m: float, known_points: float, hold_m: float
) -> None:
    line_map, points = furnished_map()
    points = np.concatenate((points, np.random.default_rng(5).uniform(-3, 3, (8, 2))))
    assert_is_its_twin(line_map, points, grid, [prior, hold_m, 0.02, overlap_m, known_points, 0.0])


@pytest.mark.parametrize("sparse", [False, True])
def test_levels_of_sparse_scans_hold_no_lines_within_a_cell(sparse: bool) -> None:
    line_map, points = furnished_map()
    assert_is_its_twin(line_map, points, (6, 5, 5, 0), [0.0, 0.05, 0.02, 0.1, 6.0, len(points) + sparse])


@pytest.mark.parametrize("hold_m", [0.0, 0.2])
def test_a_search_where_nothing_fits_ends_after_the_first_grids(hold_m: float) -> None:
    line_map, points = furnished_map()
    rest, nowhere = [0.0, hold_m, 0.02, 0.1, 6.0, 0.0], (6.5, 5.2, 0.3)
    converged = assert_is_its_twin(line_map, points, (6, 5, 5, 0), rest, nowhere)
    assert converged == (hold_m > 0)  # fixed correspondences, as in a final pass


def assert_is_its_twin(
    line_map: LineMap,
    points: np.ndarray,
    grid: tuple[int, ...],
    rest: list[float],
    near: tuple[float, float, float] = (3.06, 2.12, 1.1),
) -> bool:
    """Compare a search with its twin; return whether it converged."""
    prior, _, _, overlap_m, known_points, sparse_points = rest
    start, middle, dense = np.array(near), points.mean(axis=0), len(points) >= sparse_points
    limits = np.array([0.15, 0.12, 0.004, 0.004, 0.15, FEW, 2, *rest])
    limits[10] = line_map.closeness_at(overlap_m) if overlap_m else 0.0
    found = line_search.search(points, start, np.array([*grid, 1.0]), limits, *arrays(line_map))

    def terms(deciding: np.ndarray, pivot: np.ndarray) -> Terms:
        def fixed(at: tuple, motion: tuple) -> np.ndarray:
            return naive.fixed_cost(deciding - pivot, at, motion, line_map, 0.15)

        return cost_of(deciding, line_map), pivot, prior * len(deciding), fixed

    def on_known(*pose: float) -> Terms:
        deciding = naive.on_mapped_area(points, pose, line_map, overlap_m, known_points)
        return terms(deciding, deciding.mean(axis=0))

    few, whole = terms(points[:FEW], middle), terms(points, middle)

    def hopeless(used: Terms, pose: tuple) -> bool:
        return used[0](*pose) > HOPELESS * 0.15**2 * len(points[: FEW if used is few else None])

    slow = naive.coarse_to_fine(whole, start, grid, limits, dense, few, on_known if overlap_m else None, hopeless)
    np.testing.assert_allclose(found[:3], slow, atol=1e-9)
    assert found[3] == pytest.approx(cost_of(points, line_map)(*found[:3]) / len(points), rel=1e-9)
    return bool(found[7])


@pytest.mark.parametrize(("overlap_m", "known_points"), [(0.0, 0.0), (0.02, 0.0), (0.1, 0.0), (0.1, 6.0), (0.1, 1e9)])
@pytest.mark.parametrize("pose", [(3.0, 2.2, 1.0), (3.04, 2.17, 1.02), (8.0, 2.0, 0.0)])
def test_drawn_points_are_their_twin(pose: tuple[float, float, float], overlap_m: float, known_points: float) -> None:
    line_map, points = furnished_map()
    placed = transform_points(Pose(*pose), points.mean(axis=0)[None])[0]
    centred = np.ascontiguousarray((points - points.mean(axis=0)).T)
    at = np.array([*placed, pose[2], *placed])
    closeness = line_map.closeness_at(overlap_m)
    fast = kernel_parts.on_mapped_area(centred, at, closeness, known_points, *arrays(line_map))
    slow = naive.on_mapped_area(points, pose, line_map, overlap_m, known_points)
    np.testing.assert_allclose(fast.T + points.mean(axis=0), slow, atol=1e-9)


def test_search_finds_the_pose_and_counts_its_work() -> None:
    line_map, points = furnished_map()
    x, y, yaw, cost, inliers, evaluations, grids, converged = line_search.search(
        points, np.array([3.2, 2.0, 1.2]), np.array([20.0, 10, 10, 3, 1]),
        np.array([0.35, 0.35, 0.001, math.radians(0.02), 0.15, 120, 2, 0, 0.0, 0.02, 61.0, 0.0, 0.0]),
        *arrays(line_map),
    )  # fmt: skip
    assert math.hypot(x - 3.0, y - 2.2) < 0.01
    assert abs(yaw - 1.0) < 0.005
    assert inliers > 0.95
    assert cost <= cost_of(points, line_map)(3.0, 2.2, 1.0) / len(points)
    assert converged
    azimuth_grids = (100 * grids - evaluations) / 80  # each grid has 20 or 100 points
    assert azimuth_grids == int(azimuth_grids)
    assert 0.4 * grids <= azimuth_grids <= 0.6 * grids


def test_points_off_the_map_cost_the_truncation() -> None:
    line_map, points = furnished_map()
    found = line_search.search(
        points, np.array([-500.0, 800.0, 0.0]), np.array([4.0, 3, 3, 1, 1]),
        np.array([0.1, 0.1, 0.05, 0.05, 0.15, 120, 1, 0, 0.0, 0.02, 61.0, 0.0, 0.0]), *arrays(line_map),
    )  # fmt: skip
    assert found[3] == pytest.approx(0.15**2)
    assert found[4] == 0.0
