"""The kernels that compare pairs of scans do what their slow twins do."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.kernels.walls.scan_pairs import best_alignments, wall_gaps, wall_normals
from mavnav.pose import Pose
from support import naive_metrics as naive
from support.synthetic import DEG, LDS_01, URG_04LX, furnished_rooms, room, scan_at

LIMITS_M = np.array([0.1, 4.0])


def scans_of(spec, poses: np.ndarray, noise: float = 0.01) -> np.ndarray:
    rng = np.random.default_rng(1)
    ranges = np.array([scan_at(furnished_rooms(), Pose(*p), spec, noise=noise, rng=rng).ranges_m for p in poses])
    ranges[rng.random(ranges.shape) < 0.05] = np.nan
    return ranges


@pytest.fixture
def poses() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.column_stack((rng.uniform(0.8, 2.5, 4), rng.uniform(0.6, 1.5, 4), rng.uniform(-9, 9, 4)))


@pytest.mark.parametrize("spec", [URG_04LX, LDS_01], ids=["240 degrees", "full turn"])
def test_normals_of_walls(spec, poses) -> None:
    ranges = scans_of(spec, poses)
    found, expected = (f(ranges, spec.directions, LIMITS_M) for f in (wall_normals, naive.wall_normals))
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert 0.4 < np.isfinite(found).mean() < 0.95


@pytest.mark.parametrize("every", [1, 6])
@pytest.mark.parametrize("spec", [URG_04LX, LDS_01], ids=["240 degrees", "full turn"])
def test_gaps_behind_walls(spec, every, poses) -> None:
    ranges = scans_of(spec, poses)
    normals = wall_normals(ranges, spec.directions, LIMITS_M)
    pairs = np.array(list(pairwise([0, 1, 2, 3, 0, 2])))
    motions = np.array([Pose(*poses[b]).between(Pose(*poses[a])).as_array() for a, b in pairs])
    motions[::2] += 0.3, -0.2, 0.05
    beams = np.array([spec.angle_min_rad, spec.angle_step_rad, *LIMITS_M])
    arguments = ranges, normals, pairs, motions, spec.directions, beams, every
    found = wall_gaps(*arguments)
    np.testing.assert_allclose(found, naive.wall_gaps(*arguments), atol=1e-9)
    assert all(np.count_nonzero(some) for some in (found < 0, found == 0, found > 0, np.isinf(found)))


def test_the_best_alignment_is_the_true_pose(poses) -> None:
    poses[:, 2] = 0.3 + 0.2 * np.arange(4)
    ranges = scans_of(LDS_01, poses, noise=0.005)
    pairs = np.array([(0, 1), (1, 2), (3, 2)])
    true = np.array([Pose(*poses[b]).between(Pose(*poses[a])).as_array() for a, b in pairs])
    given = true + np.array([(0.63, 0.2, 0.05), (-0.4, 0.9, -0.06), (0.0, 0.0, 0.0)])
    found = best_alignments(ranges, pairs, given, LDS_01.directions, LIMITS_M, 12)
    np.testing.assert_allclose(found, true, atol=0.04)
    np.testing.assert_allclose(
        best_alignments(ranges, pairs, given, LDS_01.directions, LIMITS_M, 0)[2], true[2], atol=0.04
    )


def test_the_search_tries_what_its_twin_tries(poses) -> None:
    spec = replace(LDS_01, beams=180, angle_step_rad=2 * DEG)
    ranges, pairs = scans_of(spec, poses), np.array([(0, 1), (2, 3)])
    given = np.array([Pose(*poses[b]).between(Pose(*poses[a])).as_array() for a, b in pairs])
    given += 0.06, -0.04, 0.03
    arguments = ranges, pairs, given, spec.directions, LIMITS_M, 1
    np.testing.assert_allclose(best_alignments(*arguments), naive.best_alignments(*arguments), atol=1e-9)


def test_an_empty_scan_has_neither_walls_nor_a_better_pose() -> None:
    ranges = np.full((2, LDS_01.beams), np.nan)
    ranges[0] = scan_at(room(), Pose(2.0, 2.0, 0.0), LDS_01).ranges_m
    given, pairs = np.array([(0.1, 0.2, 0.3)]), np.array([(0, 1)])
    np.testing.assert_allclose(best_alignments(ranges, pairs, given, LDS_01.directions, LIMITS_M, 2), given, atol=1e-12)
    assert np.isnan(wall_normals(ranges, LDS_01.directions, LIMITS_M)[1]).all()
