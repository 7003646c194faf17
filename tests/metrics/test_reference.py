"""Absolute trajectory error: what a rigid motion hides, and what it does not; the same as evo's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.ground_truth.references import References, compare_to
from mavnav.ground_truth.tables import read_tum
from mavnav.metrics.reference import absolute_error, position_errors, relative_error
from mavnav.pose import Pose, Trajectory, rigid_fit, transform_points
from support.synthetic import TOUR, along, drifting_odometry

coordinate = st.floats(-50, 50)


def path(seed: int, n: int = 40) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(0, 0.3, (n, 2)), axis=0)


@settings(max_examples=50)
@given(seed=st.integers(0, 999), x=coordinate, y=coordinate, yaw=st.floats(-3.1, 3.1))
def test_a_rigid_motion_is_no_error(seed: int, x: float, y: float, yaw: float) -> None:
    truth = path(seed)
    moved = transform_points(Pose(x, y, yaw), truth)
    found = rigid_fit(moved, truth) @ Pose(x, y, yaw)
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


def evo_of(trajectory):
    from evo.core.trajectory import PoseTrajectory3D

    x, y, yaw = trajectory.xyyaw.T
    zero = np.zeros_like(x)
    quaternions = np.column_stack((np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)))
    return PoseTrajectory3D(np.column_stack((x, y, zero)), quaternions, trajectory.stamps_ns * 1e-9)


def evo_errors(estimate, truth) -> dict[str, float]:
    """Let evo interpolate the truth at the estimate's times, align, and measure."""
    from evo.core import metrics

    inside = (estimate.stamps_ns >= truth.stamps_ns[0]) & (estimate.stamps_ns <= truth.stamps_ns[-1])
    estimate = Trajectory(estimate.stamps_ns[inside].copy(), estimate.xyyaw[inside].copy())
    reference, other = evo_of(truth).interpolate(estimate.stamps_ns * 1e-9), evo_of(estimate)
    relation, errors = metrics.PoseRelation, {}
    for name, kind in (
        ("translation_rmse_m", relation.translation_part),
        ("rotation_rmse_deg", relation.rotation_angle_deg),
        ("distance_rmse_m", relation.point_distance),
    ):
        rpe = metrics.RPE(kind, 1.0, metrics.Unit.meters)
        rpe.process_data((reference, other))
        errors[name] = rpe.get_statistic(metrics.StatisticsType.rmse)
    other.align(reference)
    ape = metrics.APE(relation.translation_part)
    ape.process_data((reference, other))
    return errors | {"rmse_m": ape.get_statistic(metrics.StatisticsType.rmse)}


@pytest.mark.filterwarnings("ignore")
def test_a_simulated_run_as_evo_measures_it() -> None:
    """The truth has other stamps than the estimate, which drifts."""
    truth = along(TOUR, period_s=0.07)
    estimate = drifting_odometry(along(TOUR, period_s=0.1))
    ours = compare_to(References(truth=truth), estimate, np.zeros((0, 2)))
    theirs = evo_errors(estimate, truth)
    assert ours.ate.rmse_m == pytest.approx(theirs.pop("rmse_m"), abs=1e-6)
    assert ours.rpe.pairs > 10
    assert {name: getattr(ours.rpe, name) for name in theirs} == pytest.approx(theirs, abs=1e-6)


@pytest.mark.parametrize("side", ["truth", "estimate"])
def test_no_stretch_of_relative_errors_spans_a_gap(side: str) -> None:
    truth = along(TOUR, period_s=0.1)
    estimate = drifting_odometry(truth)
    whole = compare_to(References(truth=truth), estimate, np.zeros((0, 2))).rpe
    elapsed_s = (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9
    kept = (elapsed_s < 0.2 * elapsed_s[-1]) | (elapsed_s > 0.8 * elapsed_s[-1])
    ends = {
        name: Trajectory(path.stamps_ns[kept], path.xyyaw[kept]) if name == side else path
        for name, path in (("truth", truth), ("estimate", estimate))
    }
    found = compare_to(References(truth=ends["truth"]), ends["estimate"], np.zeros((0, 2))).rpe
    assert 0.25 * whole.pairs < found.pairs < 0.5 * whole.pairs
    assert found.translation_rmse_m < 1.2 * whole.translation_rmse_m
    assert found.rotation_rmse_deg < 1.2 * whole.rotation_rmse_deg


def test_a_sparse_path_has_relative_errors() -> None:
    truth = along(TOUR, period_s=0.1)
    sparse = Trajectory(truth.stamps_ns[::15].copy(), truth.xyyaw[::15].copy())
    assert compare_to(References(truth=truth), sparse, np.zeros((0, 2))).rpe.pairs > 5


@pytest.mark.real_logs
@pytest.mark.filterwarnings("ignore")
def test_a_real_run_as_evo_measures_it(real_logs) -> None:
    """Wheel odometry against an overhead camera, which tells no headings."""
    folder = real_logs / "lego_robot4"
    truth = read_tum(folder / "groundtruth.tum")
    t, x, y, yaw = np.loadtxt(folder / "odometry.txt", usecols=range(4)).T
    estimate = Trajectory(np.round(t * 1e9).astype(np.int64), np.column_stack((x, y, yaw)))
    ours = compare_to(References(truth=truth), estimate, np.zeros((0, 2)))
    theirs = evo_errors(estimate, truth)
    assert ours.ate.rmse_m == pytest.approx(theirs["rmse_m"], abs=1e-6)
    assert ours.rpe.distance_rmse_m == pytest.approx(theirs["distance_rmse_m"], abs=1e-6)
    assert np.isnan(ours.rpe.translation_rmse_m)


@pytest.mark.parametrize(
    ("at", "turn", "headed"), [(0.0, 0.0, False), (0.0, 2e-9, False), (np.pi, 2e-9, False), (0.0, 1e-3, True)]
)
def test_a_truth_whose_heading_is_only_rounded_has_none(at: float, turn: float, headed: bool) -> None:
    truth = np.column_stack((path(4), at + turn * (np.arange(40) % 2)))
    truth[:, 2] = (truth[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    estimate, stamps_ns = (
        np.column_stack((truth[:, :2], np.linspace(0.0, 2.0, 40))),
        np.arange(40, dtype=np.int64) * 10**8,
    )
    found = relative_error(Trajectory(stamps_ns, estimate), Trajectory(stamps_ns, truth))
    assert np.isfinite([found.translation_rmse_m, found.rotation_rmse_deg]).all() == headed
    assert found.distance_rmse_m == pytest.approx(0.0, abs=1e-9)


def test_the_error_of_every_pose_is_nan_where_the_truth_is_not_known() -> None:
    xyyaw = np.column_stack((path(2), np.zeros(40)))
    stamps_ns = np.arange(40, dtype=np.int64) * 10**8
    estimate, truth = Trajectory(stamps_ns, xyyaw + np.array([3.0, 4.0, 0.0])), Trajectory(stamps_ns[:30], xyyaw[:30])
    found = position_errors(estimate, truth, aligned=False)
    np.testing.assert_allclose(found[:30], 5.0)
    assert np.isnan(found[30:]).all()
    np.testing.assert_allclose(position_errors(estimate, truth, aligned=True)[:30], 0.0, atol=1e-9)
    nothing = position_errors(estimate, Trajectory(stamps_ns[:0], xyyaw[:0]), aligned=True)
    assert np.isnan(nothing).all()
