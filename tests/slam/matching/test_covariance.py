"""Covariances of poses, from the Hessian of the matching."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.slam.matching.observability import covariances_of
from mavnav.slam.matching.scan_matching import first_match
from mavnav.slam.matching.steps import Step, Steps

SIGMA_M = 0.01


def steps(n: int) -> Steps:
    match = first_match(100)._replace(cost_m2=SIGMA_M**2)
    return Steps(Step(k, k, match, tracked=True) for k in range(n))


def jacobian_of(normals_rad: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return how the distances of points from walls of these normals change with x, y and yaw."""
    nx, ny = np.cos(normals_rad), np.sin(normals_rad)
    return np.column_stack((nx, ny, ny * points[:, 0] - nx * points[:, 1]))


def packed(matrix: np.ndarray) -> np.ndarray:
    return matrix[(0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)]


def test_the_covariance_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-3, 3, (200, 2))
    normals = rng.choice([0.0, np.pi / 2], 200)
    jacobian = jacobian_of(normals, points)
    found = covariances_of(steps(2), packed(jacobian.T @ jacobian)[None])
    fits = [np.linalg.lstsq(jacobian, rng.normal(0, SIGMA_M, 200), rcond=None)[0] for _ in range(2000)]
    sampled = packed(np.cov(np.array(fits).T))
    np.testing.assert_allclose(found[0], sampled, atol=0.1 * sampled.max())
    assert found[0, 0] == pytest.approx(sampled[0], rel=0.1)
    assert found[0, 5] == pytest.approx(sampled[5], rel=0.1)
    assert np.isnan(found[1]).all()


def test_a_plain_corridor_has_no_covariance() -> None:
    points = np.column_stack((np.linspace(-3, 3, 50), np.full(50, 1.0)))
    jacobian = jacobian_of(np.full(50, np.pi / 2), points)
    assert np.isnan(covariances_of(steps(1), packed(jacobian.T @ jacobian)[None])).all()


def test_a_pose_without_points_has_no_covariance() -> None:
    assert np.isnan(covariances_of(steps(1), np.zeros((1, 6)))).all()
