"""Closures: which agree, how they are weighed, and what they are measured by."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from mavnav.pose import Pose, transform_points
from mavnav.slam.loop_closure.closure import SIGMA_M, KeyClosure, agree, agreeing_closures, points_around
from mavnav.slam.loop_closure.key_frames import KeyFrame
from mavnav.slam.matching.scan_matching import first_match
from support.synthetic import DEG

ROOM = np.array((0.6, 0.1, 0.4, 0.2, -0.3, 2.0))
"""Information about a pose, a share of a point: xx, xy, yy, x yaw, y yaw, yaw yaw."""

KEYS = [KeyFrame(k, path_m, np.zeros((0, 2)), Pose()) for k, path_m in enumerate((0.0, 30.0, 60.0))]


def closure(x_m: float, y_m: float, yaw_rad: float = 0.0) -> KeyClosure:
    """Return a closure of two key frames that were tracked at the origin."""
    return KeyClosure(0, 1, Pose(x_m, y_m, yaw_rad), first_match(100), ROOM)


def test_closures_agree_where_they_lead_to_about_the_same_place() -> None:
    assert agree(closure(0.0, 0.0), closure(0.1, 0.0), KEYS) is True
    assert agree(closure(0.0, 0.0), closure(1.5, 0.0), KEYS) is False
    assert agree(closure(0.0, 0.0), closure(0.0, 0.0, 5 * DEG), KEYS) is False
    assert agree(closure(0.0, 0.0), replace(closure(0.0, 0.0), end=2), KEYS) is None


def test_a_closure_that_more_contradict_than_confirm_is_left_out() -> None:
    right = [closure(0.0, 0.0), closure(0.05, 0.0), closure(0.0, 0.05)]
    assert agreeing_closures([closure(1.0, 0.5), *right], KEYS) == right


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
