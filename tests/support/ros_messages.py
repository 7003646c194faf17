"""Messages built field by field by rosbags, the slow twin of ``mavnav.logs.messages.cdr``."""

from __future__ import annotations

from math import cos, sin
from typing import Any

import numpy as np

from mavnav.logs.messages.definitions import ODOMETRY, POSE, SCAN, TF
from mavnav.logs.messages.ros import types_ros2
from mavnav.pose import Pose
from mavnav.scan import Attitude, Scan


def _new(msgtype: str, *fields: object) -> Any:
    return types_ros2().types[msgtype](*fields)


def _time(stamp_ns: int) -> Any:
    return _new("builtin_interfaces/msg/Time", *divmod(stamp_ns, 1_000_000_000))


def _header(stamp_ns: int, frame: str) -> Any:
    return _new("std_msgs/msg/Header", _time(stamp_ns), frame)


def _turn(yaw_rad: float) -> Any:
    return _new("geometry_msgs/msg/Quaternion", 0.0, 0.0, sin(yaw_rad / 2.0), cos(yaw_rad / 2.0))


def _pose(pose: Pose) -> Any:
    point = _new("geometry_msgs/msg/Point", pose.x_m, pose.y_m, 0.0)
    return _new("geometry_msgs/msg/Pose", point, _turn(pose.yaw_rad))


def transform(stamp_ns: int, parent: str, child: str, parent_T_child: Pose) -> Any:
    """Return a TFMessage of one transform."""
    shift = _new("geometry_msgs/msg/Vector3", parent_T_child.x_m, parent_T_child.y_m, 0.0)
    body = _new("geometry_msgs/msg/Transform", shift, _turn(parent_T_child.yaw_rad))
    return _new(TF, [_new("geometry_msgs/msg/TransformStamped", _header(stamp_ns, parent), child, body)])


def pose_stamped(stamp_ns: int, frame: str, pose: Pose) -> Any:
    """Return a PoseStamped."""
    return _new(POSE, _header(stamp_ns, frame), _pose(pose))


def attitude(stamp_ns: int, frame: str, attitude: Attitude) -> Any:
    """Return a PoseStamped of roll, pitch and height: the orientation ``Ry(pitch) Rx(roll)``, x = y = 0."""
    (a, c), (b, d) = ((sin(angle / 2.0), cos(angle / 2.0)) for angle in attitude[:2])
    turn = _new("geometry_msgs/msg/Quaternion", a * d, c * b, -a * b, c * d)
    point = _new("geometry_msgs/msg/Point", 0.0, 0.0, attitude.height_m)
    return _new(POSE, _header(stamp_ns, frame), _new("geometry_msgs/msg/Pose", point, turn))


def odometry(stamp_ns: int, parent: str, child: str, parent_T_child: Pose) -> Any:
    """Return an Odometry; velocities and covariances are zero, which means unknown."""
    still = _new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    pose = _new("geometry_msgs/msg/PoseWithCovariance", _pose(parent_T_child), np.zeros(36))
    twist = _new("geometry_msgs/msg/TwistWithCovariance", _new("geometry_msgs/msg/Twist", still, still), np.zeros(36))
    return _new(ODOMETRY, _header(stamp_ns, parent), child, pose, twist)


def laser_scan(scan: Scan, frame: str, no_return_m: float = np.nan) -> Any:
    """Return a LaserScan with ``no_return_m`` where there is no valid return; no intensities."""
    spec = scan.spec
    last = spec.angle_min_rad + spec.angle_step_rad * max(spec.beams - 1, 0)
    angles, times = (spec.angle_min_rad, last, spec.angle_step_rad), (spec.time_increment_s, spec.scan_time_s)
    limits = (spec.range_min_m, spec.range_max_m)
    ranges = np.where(np.isnan(scan.ranges_m), no_return_m, scan.ranges_m).astype(np.float32)
    return _new(SCAN, _header(scan.stamp_ns, frame), *angles, *times, *limits, ranges, np.empty(0, np.float32))
