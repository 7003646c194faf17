"""The kernels of the metrics do what their slow twins do."""

from __future__ import annotations

import naive_metrics as naive
import numpy as np
import pytest
from synthetic import LDS_01, URG_04LX, furnished_rooms, scan_at

from mavnav.kernels.overlap import scan_distances
from mavnav.kernels.profiles import wall_profiles
from mavnav.pose import Pose


def test_profiles_across_walls() -> None:
    rng = np.random.default_rng(0)
    counts = rng.integers(0, 5, (40, 50)).astype(np.int32)
    stations = np.column_stack((rng.uniform(-3, 53, 20), rng.uniform(-3, 43, 20), rng.uniform(-4, 4, 20)))
    np.testing.assert_allclose(
        wall_profiles(counts, stations, 5, 12), naive.wall_profiles(counts, stations, 5, 12), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("spec", [URG_04LX, LDS_01], ids=["240 degrees", "full turn"])
@pytest.mark.parametrize("every", [1, 5])
def test_distances_between_scans(spec, every) -> None:
    rng = np.random.default_rng(1)
    poses = np.column_stack((rng.uniform(0.8, 2.5, 8), rng.uniform(0.6, 1.5, 8), rng.uniform(-9, 9, 8)))
    walls = furnished_rooms()
    ranges = np.array([scan_at(walls, Pose(*p), spec, noise=0.02, rng=rng).ranges_m for p in poses])
    ranges[rng.random(ranges.shape) < 0.05] = np.nan
    poses += rng.normal(0, 0.03, poses.shape)
    pairs = np.array([(i, j) for i in range(8) for j in range(8)])
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
