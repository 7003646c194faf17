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
    PERIOD_NS,
    POSE,
    START_NS,
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
    with pytest.raises(TopicError, match="no ground truth on topic '/gone'"):
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
