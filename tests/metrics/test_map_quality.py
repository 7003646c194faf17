"""The profile reacts to what makes a map worse, and is not to be gamed."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace
from scipy import ndimage

from mavnav.mapping.occupancy_grid import Grid, GridBuilder
from mavnav.metrics.journey import Journey
from mavnav.metrics.map_quality import MapQuality, measure_map
from mavnav.metrics.walls import summary, wall_sections
from mavnav.pose import Pose, Trajectory, transform_points
from support.marks import slow
from support.synthetic import TOUR, along, furnished_rooms, record


def mapped(recording, poses: Trajectory, every: int = 1) -> Grid:
    tally = GridBuilder(0.02)
    for k in range(0, len(poses), every):
        tally.insert(poses[k], transform_points(poses[k], recording.scans[k].points()))
    return tally.by_rows()


@pytest.fixture(scope="module")
def tour():
    return record(furnished_rooms(), along(TOUR + TOUR[1:], period_s=0.5), noise=0.005)


@pytest.fixture(scope="module")
def journey(tour) -> Journey:
    return Journey(tour.map_T_laser, lambda: iter(tour.scans), 1.0)


@pytest.fixture(scope="module")
def grid(tour) -> Grid:
    return mapped(tour, tour.map_T_laser)


@pytest.fixture(scope="module")
def good(grid, journey) -> MapQuality:
    return measure_map(grid, journey).quality


def changed(grid: Grid, change) -> Grid:
    return Grid(grid.cell_m, grid.origin_xy_m, change(grid.hits).astype(np.int32), change(grid.passes).astype(np.int32))


def test_a_good_map_is_meaningful(good) -> None:
    assert (good.profile, good.meaningful, good.why) == ("map-quality/2", True, ())
    assert good.ghost_walls.count == 0
    assert good.support.wall_m > 15
    assert good.support.mapped_share == 1.0
    assert good.support.explained_share > 0.95
    assert good.revisits.nn_l_mm < 20
    assert 4 <= len(good.walls) <= 40


def test_the_same_map_gives_the_same_numbers(grid, journey, good) -> None:
    assert repr(measure_map(grid, journey).quality) == repr(good)


def test_half_of_the_scans_dropped(tour, journey) -> None:
    half = measure_map(mapped(tour, tour.map_T_laser, every=2), replace(journey, mapped_share=0.5)).quality
    assert not half.meaningful
    assert "50 % of the scans" in half.why[0]


@pytest.mark.parametrize("sigma_cells", [1.0, 2.0, 4.0])
def test_a_blurred_map(grid, journey, good, sigma_cells: float) -> None:
    def blur(counts):
        return np.rint(8 * ndimage.gaussian_filter(counts.astype(float), sigma_cells))

    blurred = changed(grid, blur)
    found = measure_map(blurred, journey).quality
    thicker = (
        summary(wall_sections(blurred.hits, 0.02, 1), 0.02).p95_cells
        > summary(wall_sections(grid.hits, 0.02, 1), 0.02).p95_cells
    )
    less_wall = found.support.wall_m < 0.8 * good.support.wall_m
    assert thicker or less_wall
    assert less_wall or found.crispness.occupied_cells_per_m > 1.1 * good.crispness.occupied_cells_per_m


@pytest.mark.parametrize(("kept", "meaningful"), [(0.75, True), (0.25, False)])
def test_a_cut_map(grid, journey, good, kept: float, meaningful: bool) -> None:
    found = measure_map(
        changed(grid, lambda c: np.where(np.arange(c.shape[1]) < kept * c.shape[1], c, 0)), journey
    ).quality
    assert found.support.wall_m < 0.9 * good.support.wall_m
    assert found.support.explained_share < good.support.explained_share - 0.1
    assert found.meaningful == meaningful


def test_only_the_thin_walls_left(grid, journey, good) -> None:
    """Cells with few hits wiped out: thin walls, but the scans say that something is missing."""
    least = np.quantile(grid.hits[grid.hits > 0], 0.9)
    found = measure_map(changed(grid, lambda c: np.where(grid.hits >= least, c, 0)), journey).quality
    assert found.support.explained_share < good.support.explained_share - 0.1


def test_a_laser_that_tilts(grid, journey) -> None:
    found = measure_map(grid, replace(journey, planar=False)).quality
    assert not found.meaningful
    assert found.why == ("the laser did not move in a plane",)


def test_a_lost_track(grid, journey) -> None:
    found = measure_map(grid, replace(journey, lost_for_good=True)).quality
    assert (found.meaningful, found.why) == (False, ("the track was lost for good",))


@pytest.mark.parametrize("shape", [(0, 0), (64, 64)])
def test_a_map_of_nothing(shape, journey) -> None:
    nothing = Grid(0.02, (0.0, 0.0), np.zeros(shape, np.int32), np.zeros(shape, np.int32))
    found = measure_map(nothing, replace(journey, map_T_laser=Trajectory.of([], []), mapped_share=0.0)).quality
    assert not found.meaningful
    assert found.support.wall_m == 0
    assert np.isnan(found.crispness.occupied_cells_per_m)
    assert np.isnan(found.occupied_share)
    assert found.revisits.pairs == 0
    assert np.isnan(found.revisits.nn_l_mm)


def test_without_scans_what_only_they_tell_is_unknown(grid) -> None:
    found = measure_map(grid).quality
    assert found.meaningful
    assert found.revisits is None
    assert np.isnan(found.support.mapped_share)
    assert np.isnan(found.support.explained_share)


def drifting(poses: Trajectory, mm_a_scan: float) -> Trajectory:
    shift = np.column_stack((np.arange(len(poses)) * mm_a_scan * 1e-3, np.zeros((len(poses), 2))))
    return Trajectory(poses.stamps_ns.copy(), poses.xyyaw + shift)


def test_drift_shows_in_revisits_and_hardly_between_neighbours(tour, good) -> None:
    poses = drifting(tour.map_T_laser, 1.0)
    worse = measure_map(mapped(tour, poses), Journey(poses, lambda: iter(tour.scans), 1.0)).quality.revisits
    assert worse.nn_l_mm > 1.5 * good.revisits.nn_l_mm
    assert worse.nn_s_mm < 1.3 * good.revisits.nn_s_mm


def test_a_jump_of_the_poses_leaves_ghosts(tour) -> None:
    """From the middle of the log on, everything is mapped 120 mm beside: the walls seen again are there twice."""
    poses = tour.map_T_laser
    late = np.arange(len(poses)) >= len(poses) // 2
    jumped = Trajectory(poses.stamps_ns.copy(), poses.xyyaw + late[:, None] * np.array([0.12, 0.12, 0.0]))
    found = measure_map(mapped(tour, jumped), Journey(jumped, lambda: iter(tour.scans), 1.0)).quality
    assert found.ghost_walls.count >= 2
    assert found.ghost_walls.length_m > 2.0
    assert found.ghost_walls.worst_offset_mm == pytest.approx(120, abs=50)


@pytest.mark.parametrize("changed_scans", [slice(0, 1), *(slow(s) for s in (slice(0, None, 2), slice(0, 90)))])
def test_scans_of_another_geometry_are_compared_as_well(tour, good, changed_scans) -> None:
    """Scans with every other beam, from one of the first three on, are as good as the others, and show a jump."""
    scans = list(tour.scans)
    for k in range(len(scans))[changed_scans]:
        spec, ranges_m, first = scans[k].spec, scans[k].ranges_m[k % 3 :: 2].copy(), scans[k].spec.angles_rad[k % 3]
        coarser = replace(spec, beams=len(ranges_m), angle_min_rad=first, angle_step_rad=2 * spec.angle_step_rad)
        scans[k] = replace(scans[k], spec=coarser, ranges_m=ranges_m)
    poses = tour.map_T_laser
    found = measure_map(mapped(tour, poses), Journey(poses, lambda: iter(scans), 1.0)).quality
    assert found.ghost_walls.count == 0
    assert found.support.explained_share == pytest.approx(good.support.explained_share, abs=0.01)
    assert found.revisits.pairs > 0.9 * good.revisits.pairs
    assert found.revisits.nn_l_mm == pytest.approx(good.revisits.nn_l_mm, rel=0.5)
    late = np.arange(len(poses)) >= len(poses) // 2
    jumped = Trajectory(poses.stamps_ns.copy(), poses.xyyaw + late[:, None] * np.array([0.12, 0.12, 0.0]))
    ghosts = measure_map(mapped(tour, jumped), Journey(jumped, lambda: iter(scans), 1.0)).quality.ghost_walls
    assert ghosts.count >= 2
    assert ghosts.worst_offset_mm == pytest.approx(120, abs=50)


def test_the_start_does_not_matter(tour, good) -> None:
    """A map seen from another frame, turned by 30 degrees, is as good."""
    other = tour.map_T_laser.seen_from(Pose(0.31, -0.17, np.radians(30)))
    found = measure_map(mapped(tour, other), Journey(other, lambda: iter(tour.scans), 1.0)).quality
    assert found.ghost_walls.count == 0
    assert found.support.wall_m == pytest.approx(good.support.wall_m, rel=0.15)
    assert found.revisits.nn_l_mm == pytest.approx(good.revisits.nn_l_mm, rel=1e-6)
    assert found.crispness.occupied_cells_per_m == pytest.approx(good.crispness.occupied_cells_per_m, rel=0.25)
