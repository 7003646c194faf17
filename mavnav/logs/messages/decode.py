"""Decoders of messages, selected by encoding and type.

ROS messages are decoded by the standard definitions; the schema text in the log, ros2msg or ros2idl, is not used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mavnav.logs.formats.decompress import DecompressError, unpack_message
from mavnav.logs.messages import carmen
from mavnav.logs.messages.definitions import FOXGLOVE_SCAN, IMU, ODOMETRY, POSE, SCAN, TF, TF_ROS1, TRANSFORM
from mavnav.logs.messages.fast_cdr import imu_message, imu_of, laser_of, odometry_of, pose_of, transforms_of
from mavnav.logs.messages.other_scans import other_scan, suffix_of
from mavnav.logs.messages.records import DecodeError, ImuMessage, LaserMessage, TransformMessage

if TYPE_CHECKING:
    from collections.abc import Callable

    from mavnav.logs.records import Channel

LASER_TYPES = frozenset({SCAN, FOXGLOVE_SCAN})
ROS_ENCODINGS = ("cdr", "ros1")


def decoder(channel: Channel, *, poses: bool = False, topic: str | None = None) -> Callable[[bytes], Any] | None:
    """Return the function that decodes a channel's messages; None for types that mavnav does not use.

    The function returns a LaserMessage, an ImuMessage, or a list of TransformMessage for odometry and transforms, and
    raises DecodeError. With ``poses``, single poses and transforms are decoded too. A requested ``topic`` adds scans in
    messages of other types.
    """
    kind, part = (channel.encoding, channel.type), suffix_of(channel, topic)
    if part is not None and channel.encoding in ROS_ENCODINGS:
        return _unpack_first(_other_scans(channel, part))
    make = DECODERS.get(kind) or (POSE_DECODERS.get(kind) if poses else None)
    return None if make is None else _unpack_first(make(channel))


def _unpack_first(decode: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
    def decode_unpacked(data: bytes) -> Any:  # noqa: ANN401
        try:
            return decode(unpack_message(data))
        except DecompressError as error:
            raise DecodeError(str(error)) from error

    return decode_unpacked


def _other_scans(channel: Channel, part: str) -> Callable[[bytes], LaserMessage]:
    state: dict[str, Any] = {}

    def decode(data: bytes) -> LaserMessage:
        return other_scan(_deserialize(data, channel.encoding, channel.type), channel.type, part, state)

    return decode


def scan_topics(topic: str) -> list[str]:
    """Split the names of topics whose scans are merged, joined by commas; no ROS name contains a comma."""
    return [name for name in topic.split(",") if name]


def scan_topic(channel: Channel, topic: str | None) -> str | None:
    """Return the requested topic whose scans a channel contains, None if there is none.

    If ``topic`` is None, any channel with LaserScans is accepted.
    """
    if topic is None:
        return channel.topic if is_laser(channel) else None
    other = channel.encoding in ROS_ENCODINGS
    names = (
        name
        for name in scan_topics(topic)
        if (is_laser(channel) and name == channel.topic) or (other and suffix_of(channel, name) is not None)
    )
    return next(names, None)


def is_laser(channel: Channel) -> bool:
    """Return whether a channel contains scans that can be decoded."""
    return channel.type in LASER_TYPES and (channel.encoding, channel.type) in DECODERS


def _deserialize(data: bytes, encoding: str, type_name: str) -> Any:  # noqa: ANN401
    """Decode a message by its standard definition; raises DecodeError."""
    from rosbags.serde import SerdeError  # noqa: PLC0415

    from mavnav.logs.messages import ros  # noqa: PLC0415  its type stores take about 0.1 s to load

    try:
        if encoding == "cdr":
            return ros.types_ros2().deserialize_cdr(data, type_name)
        return ros.types_ros1().deserialize_ros1(data, type_name)
    except (SerdeError, ValueError, IndexError) as error:
        raise DecodeError(str(error)) from error


def _ros(
    by_layout: Callable[[bytes, str], Any], convert: Callable[[Any], Any], type_name: str
) -> Callable[[Channel], Callable[[bytes], Any]]:
    def make(channel: Channel) -> Callable[[bytes], Any]:
        def decode(data: bytes) -> Any:  # noqa: ANN401
            messages = by_layout(data, channel.encoding)
            return convert(_deserialize(data, channel.encoding, type_name)) if messages is None else messages

        return decode

    return make


def _stamp_ns(stamp: Any) -> int:  # noqa: ANN401  (rosbags generates its classes)
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _laser(message: Any) -> LaserMessage:  # noqa: ANN401
    return LaserMessage(
        _stamp_ns(message.header.stamp),
        message.header.frame_id,
        message.angle_min,
        message.angle_increment,
        message.angle_max,
        message.range_min,
        message.range_max,
        message.time_increment,
        message.scan_time,
        message.ranges,
    )


def _odometry(message: Any) -> list[TransformMessage]:  # noqa: ANN401
    p, q = message.pose.pose.position, message.pose.pose.orientation
    header = message.header
    stamp_ns = _stamp_ns(header.stamp)
    return [TransformMessage(stamp_ns, header.frame_id, message.child_frame_id, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))]


def _imu(message: Any) -> ImuMessage:  # noqa: ANN401
    q, w, a = message.orientation, message.angular_velocity, message.linear_acceleration
    covariance = [0.0] * 9
    values = (q.x, q.y, q.z, q.w, *message.orientation_covariance, w.x, w.y, w.z, *covariance, a.x, a.y, a.z)
    return imu_message(_stamp_ns(message.header.stamp), message.header.frame_id, values)


def _transforms(message: Any) -> list[TransformMessage]:  # noqa: ANN401
    return [_transform(stamped) for stamped in message.transforms]


def _transform(stamped: Any) -> TransformMessage:  # noqa: ANN401
    t, q = stamped.transform.translation, stamped.transform.rotation
    return TransformMessage(
        _stamp_ns(stamped.header.stamp),
        stamped.header.frame_id,
        stamped.child_frame_id,
        (t.x, t.y, t.z),
        (q.x, q.y, q.z, q.w),
    )


def _pose(message: Any) -> list[TransformMessage]:  # noqa: ANN401
    p, q = message.pose.position, message.pose.orientation
    header = message.header
    return [TransformMessage(_stamp_ns(header.stamp), header.frame_id, "", (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))]


def _one_transform(message: Any) -> list[TransformMessage]:  # noqa: ANN401
    return [_transform(message)]


def _no_layout(_data: bytes, _encoding: str) -> None:
    """Return None, so that the message is decoded by its definition."""


def _foxglove_json(channel: Channel) -> Callable[[bytes], LaserMessage]:
    from mavnav.logs.messages.foxglove import json_decoder  # noqa: PLC0415

    return json_decoder(channel)


def _foxglove_protobuf(channel: Channel) -> Callable[[bytes], LaserMessage]:
    from mavnav.logs.messages.foxglove import protobuf_decoder  # noqa: PLC0415

    return protobuf_decoder(channel)


_ROS_KINDS: dict[str, Callable[[Channel], Callable[[bytes], Any]]] = {
    SCAN: _ros(laser_of, _laser, SCAN),
    ODOMETRY: _ros(odometry_of, _odometry, ODOMETRY),
    IMU: _ros(imu_of, _imu, IMU),
    **dict.fromkeys((TF, TF_ROS1), _ros(transforms_of, _transforms, TF)),
}
DECODERS: dict[tuple[str, str], Callable[[Channel], Callable[[bytes], Any]]] = {
    ("json", FOXGLOVE_SCAN): _foxglove_json,
    ("protobuf", FOXGLOVE_SCAN): _foxglove_protobuf,
    **{(encoding, name): make for name, make in _ROS_KINDS.items() for encoding in ROS_ENCODINGS},
    (carmen.ENCODING, SCAN): carmen.scan_decoder,
    (carmen.ENCODING, ODOMETRY): carmen.pose_decoder,
    (carmen.ENCODING, TF): carmen.pose_decoder,
}
POSE_DECODERS: dict[tuple[str, str], Callable[[Channel], Callable[[bytes], Any]]] = {
    (encoding, name): _ros(by_layout, convert, name)
    for name, by_layout, convert in ((POSE, pose_of, _pose), (TRANSFORM, _no_layout, _one_transform))
    for encoding in ROS_ENCODINGS
} | {(carmen.ENCODING, TRANSFORM): carmen.pose_decoder}
