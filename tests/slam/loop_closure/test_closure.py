"""Weak closures: compared, corrected and weighted only in what they constrain."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose, transform_points
from mavnav.slam.loop_closure.closure import LEAST_GROWTH, SIGMA_M, KeyClosure, agree, agreeing_closures, points_around
from mavnav.slam.loop_closure.key_frames import KeyFrame, KeyFrameMap
from mavnav.slam.matching.relocalization import unobservable_direction
from mavnav.slam.matching.scan_matching import first_match
from support.synthetic import DEG, LDS_01, Segments, polyline, scan_at

ROOM = np.array((0.6, 0.1, 0.4, 0.2, -0.3, 2.0))
"""Information about a pose, a share of a point: xx, xy, yy, x yaw, y yaw, yaw yaw."""

KEYS = [KeyFrame(k, path_m, np.zeros((0, 2)), Pose()) for k, path_m in enumerate((0.0, 30.0))]


def closure(x_m: float, y_m: float, yaw_rad: float = 0.0, weak_rad: float | None = None) -> KeyClosure:
    """Return a closure of two key frames that were tracked at the origin."""
    return KeyClosure(0, 1, Pose(x_m, y_m, yaw_rad), first_match(100), ROOM, weak_rad)


def test_closures_are_compared_only_in_what_both_constrain() -> None:
    full, along_x = closure(0.0, 0.0), closure(1.5, 0.0, weak_rad=0.0)
    assert agree(full, closure(1.5, 0.0), KEYS) is False
    assert agree(full, along_x, KEYS) is True
    assert agree(along_x, full, KEYS) is True
    assert agree(along_x, closure(-1.5, 0.1, weak_rad=0.0), KEYS) is True
    assert agree(along_x, closure(-1.5, 0.4, weak_rad=0.0), KEYS) is False
    assert agree(along_x, closure(1.5, 0.0, 5 * DEG, weak_rad=0.0), KEYS) is False
    assert agree(along_x, closure(1.5, 0.0, weak_rad=pi / 2), KEYS) is None


def test_weak_closures_are_checked_against_accepted_ones() -> None:
    right, wrong = closure(1.0, 0.0, weak_rad=0.0), closure(1.0, 0.5, weak_rad=0.0)
    assert agreeing_closures([right, wrong], KEYS, [closure(0.0, 0.0)] * 2) == [right]


def test_a_weak_correction_leaves_out_the_weak_direction() -> None:
    correction = closure(1.0, 0.5, 0.1, weak_rad=0.0).correction(KEYS)
    np.testing.assert_allclose(correction, (0.0, 0.5, 0.1), atol=1e-12)
    assert closure(1.0, 0.5).correction(KEYS) == Pose(1.0, 0.5, 0.0)


@pytest.mark.parametrize("weak_rad", [0.0, 0.7, -2.0])
def test_the_information_is_zero_along_the_weak_direction(weak_rad: float) -> None:
    root = closure(0.0, 0.0, weak_rad=weak_rad).sqrt_information
    along = np.array((np.cos(weak_rad), np.sin(weak_rad), 0.0))
    np.testing.assert_allclose(root @ along, 0.0, atol=1e-6 / SIGMA_M)
    # Across it, and in yaw, the covariance is that of the full measurement.
    turn = np.array([along, np.cross((0.0, 0.0, 1.0), along), (0.0, 0.0, 1.0)])
    full, weak = (turn @ (r.T @ r) @ turn.T for r in (closure(0.0, 0.0).sqrt_information, root))
    np.testing.assert_allclose(np.linalg.inv(weak[1:, 1:]), np.linalg.inv(full)[1:, 1:])


def test_a_direction_that_half_of_the_points_show_has_the_usual_deviation() -> None:
    root = replace(closure(0.0, 0.0), information=np.array((0.5, 0.0, 0.02, 0.0, 0.0, 1.0))).sqrt_information
    deviations = np.sqrt(np.diag(np.linalg.inv(root.T @ root)))
    np.testing.assert_allclose(deviations, (SIGMA_M, 5 * SIGMA_M, SIGMA_M / np.sqrt(2)))


def test_points_of_the_path_around_lie_where_the_key_frame_sees_them() -> None:
    rng = np.random.default_rng(1)
    poses = [Pose(0.4 * k, 0.1 * k, 0.2 * k) for k in range(12)]
    walls_m = rng.uniform(-5.0, 5.0, (50, 2))
    keys = [KeyFrame(k, 0.4 * k, transform_points(pose.inverse(), walls_m), pose) for k, pose in enumerate(poses)]
    around = points_around(keys, 6)
    assert 2 * len(walls_m) <= len(around) <= 3 * len(walls_m)
    off_m = np.hypot(*(transform_points(poses[6], around)[:, None] - walls_m).transpose(2, 0, 1)).min(axis=1)
    np.testing.assert_allclose(off_m, 0.0, atol=1e-9)
    alone = points_around([keys[6]], 0)
    np.testing.assert_array_equal(alone, keys[6].points)


@pytest.mark.parametrize("yaw_rad", [0.0, 0.4, -1.1])
def test_the_least_observable_direction_is_along_the_corridor(yaw_rad: float) -> None:
    corridor = np.vstack([polyline((-9, y), (9, y)) for y in (-0.8, 0.7)])
    along_rad = direction(corridor, yaw_rad)
    assert along_rad is not None
    assert abs(np.sin(along_rad)) < np.sin(1 * DEG)
    assert direction(np.vstack((corridor, polyline((2, -0.8), (2, 0.7)))), yaw_rad) is None


def direction(walls: Segments, yaw_rad: float) -> float | None:
    """Return the least observable direction of a scan at the origin, on a map of scans along the x axis."""
    config, part, rng = Config(), KeyFrameMap(Config()), np.random.default_rng(0)
    poses = [Pose(0.2 * k, 0.0, yaw_rad) for k in range(-5, 6)]
    points = [scan_at(walls, pose, LDS_01, noise=0.005, rng=rng).points() for pose in poses]
    part.grow([KeyFrame(k, 0.0, *seen) for k, seen in enumerate(zip(points, poses, strict=True))], len(poses))
    return unobservable_direction(points[5], poses[5], part.lines, LEAST_GROWTH, config)
