"""Absolute trajectory error: what a rigid motion hides, and what it does not; the same as evo's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.metrics.trajectory_error import absolute_error, align
from mavnav.pose import Pose, transform_points

coordinate = st.floats(-50, 50)


def path(seed: int, n: int = 40) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(0, 0.3, (n, 2)), axis=0)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 999), x=coordinate, y=coordinate, yaw=st.floats(-3.1, 3.1))
def test_a_rigid_motion_is_no_error(seed: int, x: float, y: float, yaw: float) -> None:
    truth = path(seed)
    moved = transform_points(Pose(x, y, yaw), truth)
    found = align(moved, truth) @ Pose(x, y, yaw)
    assert np.allclose(found.as_array(), 0.0, atol=1e-8)
    assert absolute_error(moved, truth).max_m < 1e-8


def test_unaligned_errors_are_plain_distances() -> None:
    truth = path(1)
    error = absolute_error(truth + np.array([3.0, 4.0]), truth, aligned=False)
    assert (error.poses, error.rmse_m, error.median_m, error.max_m) == (40, *[pytest.approx(5.0)] * 3)


def test_without_poses_there_is_no_number() -> None:
    error = absolute_error(np.zeros((0, 2)), np.zeros((0, 2)))
    assert error.poses == 0
    assert np.isnan(error.rmse_m)


@pytest.mark.filterwarnings("ignore")
def test_it_is_what_evo_says() -> None:
    from evo.core import metrics
    from evo.core.trajectory import PosePath3D

    truth = path(2)
    estimate = transform_points(Pose(1.0, 2.0, 0.3), truth) + np.random.default_rng(3).normal(0, 0.05, truth.shape)

    def lifted(xy: np.ndarray) -> PosePath3D:
        zeros = np.zeros((len(xy), 1))
        return PosePath3D(np.hstack((xy, zeros)), np.tile([1.0, 0, 0, 0], (len(xy), 1)))

    reference, other = lifted(truth), lifted(estimate)
    other.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, other))
    ours = absolute_error(estimate, truth)
    assert ours.rmse_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), abs=1e-9)
    assert ours.max_m == pytest.approx(ape.get_statistic(metrics.StatisticsType.max), abs=1e-9)
