"""Conversion of messages of CARMEN logs to ROS 2 messages (CDR)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mavnav.logs.messages import ros
from mavnav.logs.messages.carmen import pose_decoder, scan_decoder
from mavnav.logs.messages.definitions import ODOMETRY, SCAN, TRANSFORM
from mavnav.logs.transforms import planar_pose
from mavnav.pose import Pose
from mavnav.scan import LaserSpec, Scan

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavnav.logs.messages.records import LaserMessage, TransformMessage
    from mavnav.logs.records import Channel


def carmen_to_cdr(channel: Channel) -> Callable[[bytes], bytes]:
    """Return the function that converts a line of a channel to a message of its type; it raises DecodeError."""
    if channel.type == SCAN:
        scan = scan_decoder(channel)
        return lambda line: ros.cdr(_scan(scan(line)))
    poses, build = pose_decoder(channel), _BUILDERS.get(channel.type, _transforms)
    return lambda line: ros.cdr(build(poses(line)))


def _scan(laser: LaserMessage) -> Any:  # noqa: ANN401  rosbags' types are made at run time
    limits, times = (laser.range_min_m, laser.range_max_m), (laser.time_increment_s, laser.scan_time_s)
    spec = LaserSpec(laser.angle_min_rad, laser.angle_step_rad, len(laser.ranges_m), *limits, *times)
    return ros.laser_scan(Scan(laser.stamp_ns, laser.ranges_m, spec), laser.frame_id)


def _odometry(poses: list[TransformMessage]) -> Any:  # noqa: ANN401
    return ros.odometry(*_edge(poses[0]))


def _transforms(poses: list[TransformMessage]) -> Any:  # noqa: ANN401
    return ros.transform(*_edge(poses[0]))


def _one_transform(poses: list[TransformMessage]) -> Any:  # noqa: ANN401
    return _transforms(poses).transforms[0]


def _edge(message: TransformMessage) -> tuple[int, str, str, Pose]:
    return message.stamp_ns, message.parent, message.child, planar_pose(message) or Pose()


_BUILDERS: dict[str, Callable[[list[TransformMessage]], Any]] = {ODOMETRY: _odometry, TRANSFORM: _one_transform}
