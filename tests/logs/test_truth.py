"""Recorded ground truth: which topic, which message, and where the laser is on the body that was tracked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from mavnav.errors import TopicError
from mavnav.logs import open_log
from mavnav.pose import Pose
from support.log_files import (
    LASER,
    ODOM,
    PATH,
    PERIOD_NS,
    POSE,
    POSE_COVARIANCE,
    START_NS,
    TF,
    TRANSFORM,
    Message,
    drive,
    laser,
    write_bag1,
    write_mcap,
)

if TYPE_CHECKING:
    from pathlib import Path

BASE_T_LASER = Pose(0.2, 0.1, 0.5)
"""The mounting in ``drive``."""

SCANS = 10


def poses(topic: str, kind: str, child: str = "") -> list[Message]:
    """Return poses on a circle, one a scan; PoseStamped has no child."""
    more: dict[str, Any] = {"parent": "world", "child": child}
    return [
        Message(topic, kind, START_NS + k * PERIOD_NS, {"x": 0.1 * k, "y": 2.0, "yaw": 0.3 * k} | more)
        for k in range(SCANS)
    ]


def expected(body_T_laser: Pose) -> np.ndarray:
    return np.array([Pose(0.1 * k, 2.0, 0.3 * k) @ body_T_laser for k in range(SCANS)])


@pytest.mark.parametrize(
    ("kind", "child", "body_T_laser"),
    [
        (POSE, "", BASE_T_LASER),
        (ODOM, "base_link", BASE_T_LASER),
        (ODOM, "laser", Pose()),
        (TRANSFORM, "/laser", Pose()),
        (TRANSFORM, "vicon/robot/robot", BASE_T_LASER),
    ],
)
@pytest.mark.parametrize("write", [write_mcap, write_bag1])
def test_the_laser_is_where_it_is_mounted(tmp_path: Path, write, kind, child, body_T_laser) -> None:
    log = open_log(write(tmp_path / "a", [*drive(SCANS), *poses("/ground_truth", kind, child)]), truth="auto")
    assert log.truth is not None
    assert (log.truth.topic, log.truth.body_frame) == ("/ground_truth", child.lstrip("/") or None)
    np.testing.assert_allclose(log.truth.world_T_laser.xyyaw, expected(body_T_laser), atol=1e-12)
    assert log.odometry is not None
    assert log.odometry.topic == "/odom"


def test_an_extrinsic_replaces_the_transforms(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [*drive(SCANS), *poses("/gt", ODOM, "base_link")])
    log = open_log(path, truth="auto", extrinsic=Pose(1.0, 0.0, 0.0))
    assert log.truth is not None
    np.testing.assert_allclose(log.truth.world_T_laser.xyyaw, expected(Pose(1.0, 0.0, 0.0)), atol=1e-12)


def test_without_a_mounting_it_is_the_laser_s_own(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [*(laser(k) for k in range(SCANS)), *poses("/robot/mocap", POSE)])
    log = open_log(path, truth="auto")
    assert log.truth is not None
    np.testing.assert_allclose(log.truth.world_T_laser.xyyaw, expected(Pose()), atol=1e-12)
    assert any("taken as the laser's own" in warning for warning in log.warnings)


def test_a_truth_is_no_odometry(tmp_path: Path) -> None:
    scans = [message for message in drive(SCANS) if message.type == LASER]
    path = write_mcap(tmp_path / "a", [*scans, *poses("/base_pose_ground_truth", ODOM, "base_link")])
    assert open_log(path, truth="auto").odometry is None
    without = open_log(path)
    assert without.truth is None
    assert without.odometry is None
    assert any("--truth topic:/base_pose_ground_truth, or use it with --odom" in text for text in without.warnings)
    assert open_log(path, odom="/base_pose_ground_truth").odometry is not None


@pytest.mark.parametrize("name", ["/goal", "/slam_out_pose", "/target", "/weight/pose"])
def test_other_poses_are_taken_by_name_alone(tmp_path: Path, name: str) -> None:
    path = write_mcap(tmp_path / "a", [*drive(SCANS), *poses(name, POSE)])
    with pytest.raises(TopicError, match=rf"no topic is named like a ground truth; topics with poses: .*{name} "):
        open_log(path, truth="auto")
    named = open_log(path, truth=name).truth
    assert named is not None
    assert len(named.world_T_laser) == SCANS


def test_none_or_several_are_refused(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [*drive(SCANS), *poses("/gt", POSE), *poses("/vicon/robot/robot", TRANSFORM)])
    with pytest.raises(TopicError, match=r"several ground truth topics: /gt \(10\), /vicon/robot/robot \(10\)"):
        open_log(path, truth="auto")
    with pytest.raises(TopicError, match="no poses on topic '/gone'"):
        open_log(path, truth="/gone")
    with pytest.raises(TopicError, match="topics with poses: none;"):
        open_log(write_mcap(tmp_path / "b", [laser(k) for k in range(3)]), truth="auto")


def test_poses_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    lost = Message("/gt", POSE, START_NS, {"x": np.nan, "y": 0.0, "yaw": 0.0})
    with pytest.raises(TopicError, match="no topic is named"):
        open_log(write_mcap(tmp_path / "a", [*drive(SCANS), lost]), truth="auto")


@pytest.mark.parametrize(("kind", "child"), [(POSE, ""), (TRANSFORM, "base_link")])
def test_poses_are_odometry_if_they_are_asked_for(tmp_path: Path, kind: str, child: str) -> None:
    path = write_mcap(tmp_path / "a.mcap", [*drive(SCANS), *poses("/mocap/robot", kind, child)])
    log = open_log(path, odom="/mocap/robot")
    assert log.odometry is not None
    assert log.odometry.topic == "/mocap/robot"
    np.testing.assert_allclose(log.odometry.odom_T_laser.xyyaw, expected(BASE_T_LASER), atol=1e-12)
    usual = open_log(path)
    assert usual.odometry is not None
    assert usual.odometry.topic == "/odom"


@pytest.mark.parametrize("kind", [POSE_COVARIANCE, PATH])
def test_a_path_and_poses_with_covariances_are_read_where_they_are_named(tmp_path: Path, kind: str) -> None:
    messages = poses("/gt", POSE_COVARIANCE)
    if kind == PATH:  # sent again and again, each time longer, late after its poses
        stamped = poses("/gt", POSE)
        ends = [(3, 0.4), (SCANS, 30.0)]
        messages = [
            Message("/gt", PATH, START_NS, {"poses": stamped[:n]}, log_ns=START_NS + round(late_s * 1e9))
            for n, late_s in ends
        ]
    path = write_mcap(tmp_path / "a", [*drive(SCANS), *messages])
    truth = open_log(path, truth="/gt").truth
    assert truth is not None
    np.testing.assert_allclose(truth.world_T_laser.xyyaw, expected(BASE_T_LASER), atol=1e-12)
    with pytest.raises(TopicError):
        open_log(path, truth="auto")


def frames(parent: str, child: str, poses: list[Pose], period_ns: int = PERIOD_NS) -> list[Message]:
    """Return the transforms of one edge of /tf."""
    named = {"parent": parent, "child": child}
    return [
        Message("/tf", TF, START_NS + k * period_ns, named | dict(zip(("x", "y", "yaw"), pose, strict=True)))
        for k, pose in enumerate(poses)
    ]


@pytest.mark.parametrize(("wanted", "body"), [("tf:map,base_link", "base_link"), ("tf:/map", "laser")])
@pytest.mark.parametrize("write", [write_mcap, write_bag1])
def test_transforms_are_followed_through_moving_frames(tmp_path: Path, write, wanted, body) -> None:
    corrections = [Pose(0.01 * k, -0.02 * k, 0.03 * k) for k in range(3)]  # of every 5th scan
    driven = [Pose(0.1 * k, 0.0, 0.2 * k) for k in range(SCANS)]
    messages = [*frames("map", "odom", corrections, 5 * PERIOD_NS), *frames("odom", "base_link", driven)]
    truth = open_log(write(tmp_path / "a", [*drive(SCANS), *messages]), truth=wanted).truth
    assert truth is not None
    assert truth.body_frame == body
    wanted_poses = [
        Pose(0.002 * k, -0.004 * k, 0.006 * k) @ driven[k] @ BASE_T_LASER for k in range(SCANS)
    ]  # corrections are interpolated
    np.testing.assert_allclose(truth.world_T_laser.xyyaw, np.array(wanted_poses), atol=1e-12)


def test_frames_may_be_tied_upwards_and_by_constant_transforms_of_tf(tmp_path: Path) -> None:
    driven = [Pose(0.1 * k, 0.0, 0.2 * k) for k in range(SCANS)]
    inverse = frames("base_link", "map", [pose.inverse() for pose in driven])  # as of localization
    fixed = frames("world", "map", [Pose(1.0, 2.0, 0.5)] * 2)
    truth = open_log(write_mcap(tmp_path / "a", [*drive(SCANS), *inverse, *fixed]), truth="tf:world").truth
    assert truth is not None
    wanted = [Pose(1.0, 2.0, 0.5) @ pose @ BASE_T_LASER for pose in driven]
    np.testing.assert_allclose(truth.world_T_laser.xyyaw, np.array(wanted), atol=1e-12)


def test_frames_that_are_not_tied_are_refused_with_those_of_the_log(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [*drive(SCANS), *frames("map", "odom", [Pose(), Pose(1.0)])])
    with pytest.raises(TopicError, match="no transforms lead from 'map' to 'base_link'; frames of the log: base_link"):
        open_log(path, truth="tf:map,base_link")
