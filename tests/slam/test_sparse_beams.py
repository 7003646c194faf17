"""A track does not depend on the spacing of the beams: walls are lines between points, not the points."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory, rigid_fit, transform_points
from mavnav.scan import LaserSpec
from mavnav.slam.pipeline import run_slam
from support.marks import slow
from support.synthetic import box, room, scan_at

PERIOD_S = 0.1
HALL = np.vstack((room(24.0, 14.0), box(8.0, 4.0, 3.0, 1.0), box(16.0, 9.5, 2.0, 1.5, 0.3)))
PATH = [Pose(3.0 + 0.05 * k, 7.0 + np.sin(0.05 * k), 0.4 * np.cos(0.05 * k)) for k in range(110)]
"""A drive of 5.5 m at 0.5 m/s and more."""


def worst_error_m(beams: int, *, with_odometry: bool) -> float:
    """Return the largest error of a track by few beams, after the best rigid motion."""
    spec, rng = LaserSpec(-np.pi, 2 * np.pi / beams, beams, 0.05, 30.0), np.random.default_rng(beams)
    stamps_ns = [round(k * PERIOD_S * 1e9) for k in range(len(PATH))]
    scans = [
        scan_at(HALL, pose, spec, stamp_ns=stamp_ns, noise=0.01, rng=rng)
        for pose, stamp_ns in zip(PATH, stamps_ns, strict=True)
    ]
    odometry = Trajectory.of(stamps_ns, PATH) if with_odometry else None
    path = run_slam(lambda: scans, Config(), PERIOD_S, odometry).trajectory
    assert len(path) == len(PATH)
    truth = np.array([(pose.x_m, pose.y_m) for pose in PATH])
    placed = transform_points(rigid_fit(path.xyyaw[:, :2], truth), path.xyyaw[:, :2])
    return float(np.hypot(*(placed - truth).T).max())


@pytest.mark.parametrize(
    ("beams", "with_odometry"),
    [(48, False), (360, False), *(slow(*case) for case in [(48, True), (72, False), (72, True), (360, True)])],
)
def test_few_beams_are_tracked_like_many(beams: int, *, with_odometry: bool) -> None:
    assert worst_error_m(beams, with_odometry=with_odometry) < 0.1
