"""Predictions: constant velocity in whole periods, odometry where it covers the time."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from mavnav.pose import Pose, Rotation, Trajectory
from mavnav.slam.matching.motion_model import Motion

MS = 1_000_000
STEP = Pose(0.1, 0.02, 0.05)


def after_two_steps(odometry: Trajectory | None = None) -> Motion:
    motion = Motion(0.1, odometry and partial(odometry.at, max_gap_ns=500 * MS)).started_at(Pose(), 0)
    motion = motion.moved_to(STEP, 100 * MS)
    return motion.moved_to(STEP @ STEP, 200 * MS)


def close(a: Pose, b: Pose, tolerance: float = 1e-9) -> bool:
    return bool(np.allclose(a.between(b).as_array(), 0.0, atol=tolerance))


def test_constant_velocity_goes_on() -> None:
    motion = Motion(0.1).started_at(Pose(), 0)
    pose = Pose()
    for k in range(1, 9):
        pose = pose @ STEP
        motion = motion.moved_to(pose, k * 100 * MS)
    assert close(motion.predict(900 * MS), pose @ STEP, 1e-4)


def test_jitter_of_reception_times_is_not_speed() -> None:
    assert after_two_steps().elapsed_s(205 * MS) == 0.1
    assert after_two_steps().elapsed_s(270 * MS) == 0.1
    assert after_two_steps().elapsed_s(420 * MS) == 0.2


def test_velocity_is_trusted_for_a_while_only() -> None:
    motion = after_two_steps()
    assert close(motion.predict(10_000 * MS), motion.predict(1_400 * MS))


def test_after_a_long_gap_the_old_velocity_is_forgotten() -> None:
    motion = after_two_steps()
    rested = motion.moved_to(motion.map_T_laser, 2_000 * MS)
    assert np.allclose(rested.twist, 0.0)
    assert not np.allclose(motion.moved_to(motion.map_T_laser, 300 * MS).twist, 0.0)


def test_a_motion_backwards_comes_from_a_pose_that_is_not_too_long_ago() -> None:
    here = Motion(0.1).started_at(Pose(0.2), 1400 * MS)
    assert close(here.coming_from(Pose(), 1200 * MS).predict(1300 * MS), Pose(0.1))
    assert here.coming_from(Pose(), 100 * MS) == here


def test_odometry_moves_the_last_pose() -> None:
    stamps = np.arange(5) * 100 * MS
    odometry = Trajectory.of(stamps.tolist(), [Pose(5.0 + 0.3 * k, 1.0, 0.0) for k in range(5)])
    motion = after_two_steps(odometry)
    assert close(motion.predict(300 * MS), motion.map_T_laser @ Pose(0.3, 0.0, 0.0))
    assert close(motion.predict(250 * MS), motion.map_T_laser @ Pose(0.15, 0.0, 0.0))
    assert np.allclose(motion.twist_at(300 * MS), (3.0, 0.0, 0.0))
    assert np.allclose(motion.twist_at(100 * MS), (3.0, 0.0, 0.0))  # a scan that is matched backwards


@pytest.mark.parametrize("stamp_ms", [600, 5_000])
def test_without_odometry_at_the_time_velocity_takes_over(stamp_ms: int) -> None:
    odometry = Trajectory.of([0, 100 * MS, 400 * MS], [Pose()] * 3)
    motion = after_two_steps(odometry)
    assert motion.by_odometry(stamp_ms * MS) is None
    assert close(motion.predict(stamp_ms * MS), motion.by_velocity(stamp_ms * MS))
    gap = Trajectory.of([0, 100 * MS, 900 * MS], [Pose()] * 3)
    assert after_two_steps(gap).by_odometry(300 * MS) is None


# ---- odometry that contradicts the scans ---------------------------------------------------------------------------


def swaying(sign: float, steps: int = 30) -> tuple[Motion, Pose]:
    """Return the motion after steps of changing turns, with a sensor that measured them, and the next pose."""
    stamps_ns = np.arange(-1, 400, dtype=np.int64) * 10 * MS
    yaws_rad = np.sin(stamps_ns * 4e-9)
    motion = Motion(0.1, rotation=Rotation(stamps_ns, sign * yaws_rad, np.zeros(len(stamps_ns))))
    motion = motion.started_at(Pose(), 0)
    poses = [Pose(0.0, 0.0, float(np.sin(0.4 * k))) for k in range(steps + 1)]
    for k in range(1, steps):
        motion = motion.moved_to(poses[k], k * 100 * MS)
    return motion, poses[steps]


def test_a_measured_yaw_rate_that_fits_predicts_the_turn() -> None:
    motion, there = swaying(1.0)
    assert motion.yaw_rate_fit.fits
    assert close(motion.predict(3000 * MS), there, 1e-3)
    turn_rad = motion.map_T_laser.between(there).yaw_rad
    assert motion.twist_at(3000 * MS)[2] == pytest.approx(turn_rad / 0.1, abs=0.02)
    assert not swaying(1.0, 8)[0].yaw_rate_fit.fits


def test_a_measured_yaw_rate_of_the_wrong_sign_is_not_used() -> None:
    motion, _ = swaying(-1.0)
    assert not motion.yaw_rate_fit.fits
    assert motion.predict(3000 * MS) == motion._replace(rotation=None).predict(3000 * MS)
