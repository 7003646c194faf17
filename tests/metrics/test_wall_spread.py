"""The spread of hits across walls: known by construction, and the same however long one looks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import ndimage

from mavnav.config.models import Config
from mavnav.mapping.occupancy_grid import Grid, GridBuilder
from mavnav.metrics.journey import Journey, placed_scans
from mavnav.metrics.map_quality import LEAST_MEASURED_SHARE
from mavnav.metrics.wall_spread import WallCuts, WallSpread, cut_walls, wall_spread
from mavnav.pose import Pose, Trajectory, transform_points
from mavnav.scan import Scan
from mavnav.slam.pipeline import run_slam
from support.marks import slow
from support.synthetic import TOUR, URG_04LX, along, box, cast, furnished_rooms, polyline, record, room, scan_at
from support.walls import planted_wall, walking_people

CELL_M = 0.02


def cuts_of(grid: Grid, scans: list[Scan], poses: Trajectory) -> WallCuts:
    placed = placed_scans(Journey(poses, lambda: iter(scans), 1.0), np.arange(len(poses)))
    return cut_walls(grid, placed, len(poses))


def spread_of(grid: Grid, scans: list[Scan], poses: Trajectory) -> WallSpread:
    return wall_spread(cuts_of(grid, scans, poses), grid.cell_m)


def mapped(scans: list[Scan], poses: Trajectory) -> Grid:
    builder = GridBuilder(CELL_M)
    for pose, scan in zip(poses, scans, strict=True):
        builder.insert(pose, transform_points(pose, scan.points()))
    return builder.by_rows()


def moved(poses: Trajectory, by_xy_m) -> Trajectory:
    return Trajectory(poses.stamps_ns.copy(), poses.xyyaw + np.column_stack((by_xy_m, np.zeros(len(poses)))))


@pytest.fixture(scope="module")
def tour():
    recording = record(furnished_rooms(), along(TOUR + TOUR[1:], period_s=0.3), noise=0.005)
    return recording.scans, recording.map_T_laser


@pytest.fixture(scope="module")
def sharp(tour) -> WallSpread:
    scans, poses = tour
    return spread_of(mapped(scans, poses), scans, poses)


ANGLES_RAD = np.linspace(0.0, np.pi, 40, endpoint=False)


@pytest.mark.parametrize("thickness_mm", [1, 20, 60, 100, 200, 300, 400])
def test_solid_walls_at_forty_angles(thickness_mm: float) -> None:
    """95 % of the wall's thickness, and as much as the cells add: a thin wall takes one or two of them."""
    across_m = np.random.default_rng(1).uniform(-0.5, 0.5, 40_000) * thickness_mm * 1e-3
    found = np.array([planted_wall(a, across_m).median_mm for a in ANGLES_RAD])
    bias_mm = found - 0.95 * thickness_mm
    assert bias_mm.min() > -5.0
    assert bias_mm.max() < (2 * 20.0 if thickness_mm < 20 else 25.0)
    assert found.std() < 2.5


@pytest.mark.parametrize("sigma_mm", [10, 20, 40, 80])
def test_noisy_walls_at_forty_angles(sigma_mm: float) -> None:
    """Of a normal distribution 95 % of what is over a fifth of the peak lies within 3.15 standard deviations."""
    across_m = np.random.default_rng(1).normal(0.0, sigma_mm * 1e-3, 40_000)
    found = np.array([planted_wall(a, across_m).median_mm for a in ANGLES_RAD])
    assert np.median(found) == pytest.approx(3.15 * np.hypot(sigma_mm, 13.0), rel=0.15)
    assert found.std() < 2.5


@pytest.mark.parametrize("people", [slow(0), 2])
def test_a_laser_at_rest_reads_the_same_however_long_it_looks(people: int) -> None:
    rng, at = np.random.default_rng(people), Pose(2.9, 1.0, 1.2)
    walls = np.vstack((room(), box(1.9, 2.0, 0.7, 0.5, 0.3), box(4.2, 1.9, 0.4, 0.6, -0.2)))
    bearings = URG_04LX.angles_rad + at.yaw_rad
    scans = [
        Scan(k * 200_000_000, cast(np.vstack((walls, outline)), (at.x_m, at.y_m), bearings) * fuzz, URG_04LX)
        for k, outline in enumerate(walking_people(rng, people, 200))
        for fuzz in [1.0 + 0.01 * rng.standard_normal(URG_04LX.beams)]
    ]
    found = {}
    for seconds in (10, 40):
        some = scans[: seconds * 5]
        outcome = run_slam(lambda some=some: iter(some), Config(), 0.2)
        found[seconds] = spread_of(outcome.grid, some, outcome.trajectory)
    assert found[10].median_mm == pytest.approx(found[40].median_mm, rel=0.1)
    assert found[10].p95_mm == pytest.approx(found[40].p95_mm, rel=0.1)


def test_more_passes_read_the_same(tour, sharp) -> None:
    """The same walls with ten times the hits, and with a third of them."""
    scans, poses = tour
    grid = mapped(scans, poses)
    fewer = np.random.default_rng(0).binomial(grid.hits.astype(np.int64), 1 / 3)
    for hits in (10 * grid.hits.astype(np.int64), fewer):
        found = spread_of(Grid(CELL_M, grid.origin_xy_m, hits, grid.passes), scans, poses)
        assert found.median_mm == pytest.approx(sharp.median_mm, rel=0.05)
        assert found.p95_mm == pytest.approx(sharp.p95_mm, rel=0.1)


@pytest.mark.slow
def test_noise_of_the_poses_makes_walls_thicker(tour, sharp) -> None:
    scans, poses = tour
    noise = np.random.default_rng(1).standard_normal((len(poses), 2))
    found = [sharp]
    for sigma_m in (0.005, 0.01, 0.02, 0.04):
        wrong = moved(poses, sigma_m * noise)
        found.append(spread_of(mapped(scans, wrong), scans, wrong))
    assert all(b.median_mm > a.median_mm and b.p95_mm > a.p95_mm for a, b in pairwise(found))
    assert found[-1].median_mm > 2.5 * sharp.median_mm


def test_smeared_walls_are_measured_up_to_half_a_metre(tour, sharp) -> None:
    scans, poses = tour
    smear = np.random.default_rng(1).uniform(-0.5, 0.5, (len(poses), 2))
    found = [sharp]
    for wide_m in (0.05, 0.2, 0.5):
        wrong = moved(poses, wide_m * smear)
        found.append(spread_of(mapped(scans, wrong), scans, wrong))
        assert found[-1].median_mm == pytest.approx(0.95 * wide_m * 1e3, abs=0.05 * wide_m * 1e3 + 25)
    assert all(b.median_mm > a.median_mm and b.p95_mm > a.p95_mm for a, b in pairwise(found))
    assert all(one.measured_share > 0.5 for one in found)


def test_a_map_half_sharp_and_half_smeared_is_worse_than_the_sharp_one(tour, sharp) -> None:
    scans, poses = tour
    late = np.arange(len(poses)) >= len(poses) // 2
    wrong = moved(poses, 0.3 * np.random.default_rng(1).uniform(-0.5, 0.5, (len(poses), 2)) * late[:, None])
    found = spread_of(mapped(scans, wrong), scans, wrong)
    assert found.p95_mm > 2.0 * sharp.p95_mm
    assert found.median_mm > sharp.median_mm


@pytest.mark.slow
def test_what_cannot_be_measured_lowers_the_share(tour, sharp) -> None:
    scans, poses = tour
    assert sharp.measured_share > 0.98
    apart = moved(poses, np.random.default_rng(1).uniform(-0.75, 0.75, (len(poses), 2)))
    assert spread_of(mapped(scans, apart), scans, apart).measured_share < LEAST_MEASURED_SHARE
    grid = mapped(scans, poses)
    cut = np.where(np.arange(grid.hits.shape[1]) < grid.hits.shape[1] // 2, grid.hits, 0)
    found = spread_of(Grid(CELL_M, grid.origin_xy_m, cut, grid.passes), scans, poses)
    assert found.measured_share < 0.7
    least = np.quantile(grid.hits[grid.hits > 0], 0.9)
    bright = np.where(grid.hits >= least, grid.hits, 0)
    assert spread_of(Grid(CELL_M, grid.origin_xy_m, bright, grid.passes), scans, poses).measured_share < 0.9


@pytest.mark.parametrize("sigma_cells", [1.0, 2.0, 4.0])
def test_a_blurred_map_is_thicker(tour, sharp, sigma_cells: float) -> None:
    scans, poses = tour
    grid = mapped(scans, poses)
    hits = np.rint(8 * ndimage.gaussian_filter(grid.hits.astype(float), sigma_cells)).astype(np.int64)
    found = spread_of(Grid(CELL_M, grid.origin_xy_m, hits, grid.passes), scans, poses)
    assert found.median_mm > sharp.median_mm + 10.0 * sigma_cells


def test_the_start_does_not_matter(tour, sharp) -> None:
    scans, poses = tour
    other = poses.seen_from(Pose(0.31, -0.17, np.radians(30)))
    found = spread_of(mapped(scans, other), scans, other)
    assert found.median_mm == pytest.approx(sharp.median_mm, abs=0.3 * 20)  # the cells lie otherwise
    assert found.p95_mm == pytest.approx(sharp.p95_mm, abs=0.5 * 20)
    assert found.length_m == pytest.approx(sharp.length_m, rel=0.1)


def test_both_faces_of_a_thin_wall_are_two_walls() -> None:
    """A partition of 150 mm, seen from both sides."""
    rng = np.random.default_rng(0)
    walls = np.vstack((room(6.0, 4.0), polyline((0.0, 1.95), (5.0, 1.95), (5.0, 2.1), (0.0, 2.1))))
    path = along([(0.5, 1.0), (5.5, 1.0), (5.5, 3.0), (0.5, 3.0)], period_s=0.2)
    scans = [
        scan_at(walls, path[k], noise=0.005, rng=rng, stamp_ns=int(stamp)) for k, stamp in enumerate(path.stamps_ns)
    ]
    cuts = cuts_of(mapped(scans, path), scans, path)
    at_partition = (np.abs(cuts.xy_m[:, 1] - 2.025) < 0.15) & (np.abs(cuts.xy_m[:, 0] - 2.5) < 1.5)
    assert at_partition.sum() > 30
    assert np.median(cuts.width_m[at_partition]) < 0.06


@pytest.mark.parametrize("shape", [(0, 0), (64, 64)])
def test_a_map_of_nothing_has_no_spread(shape) -> None:
    nothing = Grid(CELL_M, (0.0, 0.0), np.zeros(shape, np.int64), np.zeros(shape, np.int64))
    found = wall_spread(cut_walls(nothing, None, 0), CELL_M)
    assert np.isnan(found.median_mm)
    assert found.length_m == 0.0
    assert np.isnan(found.measured_share)
