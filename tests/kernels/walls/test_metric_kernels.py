"""The kernels of the metrics do what their slow twins do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from mavnav.kernels.maps.regions import region_sizes
from mavnav.kernels.walls.overlap import scan_distances
from mavnav.kernels.walls.profiles import wall_profiles
from mavnav.kernels.walls.smoothing import smooth_image
from mavnav.kernels.walls.straight_beams import straight_beams
from mavnav.metrics.map_quality import gaussian, highest
from mavnav.metrics.walls import link
from mavnav.pose import Pose
from support import naive_metrics as naive
from support.synthetic import LDS_01, URG_04LX, furnished_rooms, scan_at


def test_profiles_across_walls() -> None:
    rng = np.random.default_rng(0)
    hits, passes = rng.integers(0, 5, (2, 40, 50)).astype(np.uint16)
    stations = np.column_stack((rng.uniform(-3, 53, 20), rng.uniform(-3, 43, 20), rng.uniform(-4, 4, 20)))
    for counts in (hits, passes):
        found = wall_profiles(counts, stations, 5, 12)
        np.testing.assert_allclose(found, naive.wall_profiles(counts, stations, 5, 12), rtol=0, atol=1e-12)


@pytest.mark.parametrize("spec", [URG_04LX, LDS_01], ids=["240 degrees", "full turn"])
@pytest.mark.parametrize("every", [1, 5])
def test_distances_between_scans(spec, every) -> None:
    rng = np.random.default_rng(1)
    poses = np.column_stack((rng.uniform(0.8, 2.5, 4), rng.uniform(0.6, 1.5, 4), rng.uniform(-9, 9, 4)))
    walls = furnished_rooms()
    ranges = np.array([scan_at(walls, Pose(*p), spec, noise=0.02, rng=rng).ranges_m for p in poses])
    ranges[rng.random(ranges.shape) < 0.05] = np.nan
    poses += rng.normal(0, 0.03, poses.shape)
    pairs = np.array([(i, j) for i in range(4) for j in range(4)])
    directions = np.column_stack((np.cos(spec.angles_rad), np.sin(spec.angles_rad)))
    beams = np.array([spec.angle_min_rad, spec.angle_step_rad, 0.1, 4.0])
    arguments = ranges, poses, pairs, directions, beams, 0.15, every
    found, expected = scan_distances(*arguments), naive.scan_distances(*arguments)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert found[:, 0].min() > 0


def test_a_laser_that_counts_clockwise() -> None:
    spec = URG_04LX
    ranges = np.array([scan_at(furnished_rooms(), Pose(x, 1.0, 0.3), spec).ranges_m for x in (1.0, 1.2)])[
        :, ::-1
    ].copy()
    angles = spec.angles_rad[::-1]
    arguments = (
        ranges, np.array([(1.0, 1.0, 0.3), (1.2, 1.0, 0.3)]), np.array([(0, 1)]),
        np.column_stack((np.cos(angles), np.sin(angles))),
        np.array([angles[0], -spec.angle_step_rad, 0.1, 4.0]), 0.15, 3,
    )  # fmt: skip
    np.testing.assert_allclose(scan_distances(*arguments), naive.scan_distances(*arguments), atol=1e-9)


@pytest.mark.parametrize("diagonal", [False, True])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 0.6, 0.8, 1.0])
def test_sizes_of_regions(share, diagonal) -> None:
    masks = [np.random.default_rng(seed).random(shape) < share for seed, shape in enumerate([(40, 60), (1, 9), (9, 1)])]
    for mask in masks:
        np.testing.assert_array_equal(region_sizes(mask, diagonal), naive.region_sizes(mask, diagonal))


@pytest.mark.parametrize("shape", [(60, 40), (3, 50), (50, 2)])
def test_smoothing_and_slopes(shape) -> None:
    image = np.random.default_rng(2).random(shape).astype(np.float32)
    wide, steep = gaussian(3.75), gaussian(1.5)
    slope = np.arange(len(steep)) * steep
    for arguments in ((wide, wide, 1.0, 1.0), (slope, steep, -1.0, 1.0), (steep, slope, 1.0, -1.0)):
        np.testing.assert_array_equal(smooth_image(image, *arguments), naive.smoothed(image, *arguments))
    np.testing.assert_allclose(
        smooth_image(image, wide, wide, 1.0, 1.0), ndimage.gaussian_filter(image, 3.75), atol=1e-6
    )


@pytest.mark.parametrize("reach", [1, 2, 7])
def test_highest_within_reach(reach) -> None:
    image = np.random.default_rng(3).random((30, 20)).astype(np.float32)
    np.testing.assert_array_equal(highest(image, reach), ndimage.maximum_filter(image, 2 * reach + 1))


@pytest.mark.parametrize("n", [1, 2, 300])
def test_groups_of_linked_points(n) -> None:
    rng = np.random.default_rng(4)
    xy_m, angles = rng.uniform(-1.0, 1.0, (n, 2)), rng.uniform(-4.0, 4.0, n)
    found = link(xy_m, angles, reach_m=0.2, across_m=0.1, turn_rad=0.5)
    directions = np.column_stack((np.cos(angles), np.sin(angles)))
    np.testing.assert_array_equal(found, naive.link_groups(xy_m, directions, 0.2, 0.1, np.sin(0.5)))
    assert n < 3 or 1 < found.max() < n - 1


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_straight_walls_in_a_scan(noise) -> None:
    rng = np.random.default_rng(2)
    for pose in (Pose(0.9, 0.8, 0.3), Pose(4.6, 3.4, 1.2), Pose(2.9, 3.2, -2.0)):
        scan = scan_at(furnished_rooms(), pose, noise=noise, rng=rng)
        ends = scan.ranges_m[:, None] * scan.spec.directions
        ends[rng.random(len(ends)) < 0.05] = np.nan
        given = ends, 0.02, np.array((0.25, 0.5, 1.0)), 0.7, 0.1, 6
        found, expected = straight_beams(*given), naive.straight_beams(*given)
        assert np.isfinite(found).sum() > 20
        np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
        apart = np.sin(found - expected)[np.isfinite(found)]  # modulo half a turn
        np.testing.assert_allclose(apart, 0.0, atol=1e-6)
