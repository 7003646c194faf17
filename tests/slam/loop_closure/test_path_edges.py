"""The path in the pose graph: where motion is measured, where it may have slipped, and what loops then correct."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.pose import Pose, Trajectory
from mavnav.slam.findings import Edge
from mavnav.slam.loop_closure.key_frames import KeyFrame
from mavnav.slam.loop_closure.pose_graph import (
    OBSERVABLE,
    PATH_SIGMA_M,
    PATH_SIGMA_RAD,
    WEAK,
    optimize,
    path_edges,
    weakest_translation,
)
from mavnav.units import DEG

PERIOD_NS, STEP_M, EVERY = 100_000_000, 0.08, 4
POINTS = np.zeros((50, 2))
TIGHT = np.diag((1 / PATH_SIGMA_M, 1 / PATH_SIGMA_M, 1 / PATH_SIGMA_RAD))


def plain_corridor(points: np.ndarray, pose: Pose) -> np.ndarray:
    """Return the information of points on walls along the x axis of the map."""
    del pose
    return len(points) * np.array([0.0, 0.0, 1.0, 0.0, 0.0, 4.0])


def furnished(points: np.ndarray, pose: Pose) -> np.ndarray:
    """Return the information of points on walls of all directions."""
    del pose
    return len(points) * np.array([0.5, 0.0, 0.5, 0.0, 0.0, 4.0])


def driven(steps_m: np.ndarray, yaw_rad: float = 0.0) -> tuple[Trajectory, list[KeyFrame]]:
    """Return a straight path by the lengths of its steps, and every fourth pose as a key frame."""
    x_m = np.concatenate(([0.0], steps_m.cumsum()))
    poses = [Pose(float(x), 0.0, yaw_rad) for x in x_m]
    path = Trajectory.of([k * PERIOD_NS for k in range(len(poses))], poses)
    return path, [KeyFrame(k, float(x_m[k]), POINTS, poses[k]) for k in range(0, len(poses), EVERY)]


def standing(first: int, last: int, n: int = 120) -> np.ndarray:
    """Return steps of a path that stands still from one to another."""
    steps_m = np.full(n, STEP_M)
    steps_m[first:last] = 0.0
    return steps_m


def sigmas_m(edge: Edge) -> tuple[float, float]:
    """Return the standard deviations of a motion along and across the x axis of its start."""
    covariance = np.linalg.inv(edge.sqrt_information.T @ edge.sqrt_information)
    return float(np.sqrt(covariance[0, 0])), float(np.sqrt(covariance[1, 1]))


def test_motion_that_the_walls_show_is_tight() -> None:
    for edge in path_edges(*driven(standing(40, 60)), furnished):
        np.testing.assert_allclose(np.abs(edge.sqrt_information), TIGHT, atol=1e-9)


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7])
def test_standing_still_in_a_plain_corridor_is_loose_along_it(yaw_rad: float) -> None:
    edges = path_edges(*driven(standing(40, 44), yaw_rad), plain_corridor)
    missing_m = EVERY * STEP_M
    along = [np.array((np.cos(yaw_rad), -np.sin(yaw_rad), 0.0)) for _ in edges]
    measured = [1 / np.linalg.norm(e.sqrt_information @ a) for e, a in zip(edges, along, strict=True)]
    assert measured[10] == pytest.approx(PATH_SIGMA_M + missing_m, rel=1e-6)
    np.testing.assert_allclose([*measured[:10], *measured[11:]], PATH_SIGMA_M, rtol=1e-6)
    across = np.array((np.sin(yaw_rad), np.cos(yaw_rad), 0.0))
    assert np.linalg.norm(edges[10].sqrt_information @ across) == pytest.approx(1 / PATH_SIGMA_M)


def test_a_jump_is_loose_in_all_directions_even_between_good_walls() -> None:
    steps_m = np.full(120, STEP_M)
    steps_m[42] = 1.5
    edges = path_edges(*driven(steps_m), furnished)
    assert sigmas_m(edges[10]) == pytest.approx((PATH_SIGMA_M + 1.42,) * 2, rel=1e-6)
    assert max(max(sigmas_m(edge)) for k, edge in enumerate(edges) if k != 10) == pytest.approx(PATH_SIGMA_M)


def test_a_vehicle_that_stops_has_not_jumped() -> None:
    steps_m = np.concatenate((np.full(60, STEP_M), np.zeros(60)))
    for edge in path_edges(*driven(steps_m), furnished):
        assert max(sigmas_m(edge)) == pytest.approx(PATH_SIGMA_M)


def test_the_weakest_translation_is_what_a_rotation_does_not_explain() -> None:
    """Points on one wall ahead: turning about them looks like moving along it."""
    xy_m = np.column_stack((np.full(100, 3.0), np.linspace(-1.0, 1.0, 100)))
    normals = np.column_stack((np.ones(100), np.zeros(100)))
    turning = normals[:, 1] * xy_m[:, 0] - normals[:, 0] * xy_m[:, 1]
    rows = np.column_stack((normals, turning))
    full = rows.T @ rows
    found = weakest_translation(full[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]], 100)
    assert found.information == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(np.abs(found.direction), (0.0, 1.0), atol=1e-9)
    assert WEAK < OBSERVABLE < weakest_translation(furnished(POINTS, Pose()), 50).information


def test_a_loop_corrects_the_path_where_it_slipped() -> None:
    """A laser that drives 12 m there and back is tracked as standing still for 0.96 m of the way there."""
    there, back = standing(60, 72, 152), np.full(152, -STEP_M)
    truth, _ = driven(np.concatenate((np.full(152, STEP_M), back)))
    path, keys = driven(np.concatenate((there, back)))
    closure = Edge(0, len(keys) - 1, Pose(), np.diag((30.0, 30.0, 1 / (0.5 * DEG))))
    off = {}
    for name, information_of in (("corridor", plain_corridor), ("furnished", furnished)):
        found = optimize([key.map_T_laser for key in keys], [*path_edges(path, keys, information_of), closure])
        off[name] = max(abs(pose.x_m - truth[key.row].x_m) for key, pose in zip(keys, found, strict=True))
    assert off["corridor"] < 0.1
    assert off["furnished"] > 0.3
