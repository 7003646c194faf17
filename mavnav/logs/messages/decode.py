"""Decoders of messages, selected by encoding and type.

ROS messages are decoded by the standard definitions; the schema text in the log, ros2msg or ros2idl, is not used.
Messages that are no scans wait here until they are decoded together, in columns.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.logs.formats import carmen
from mavnav.logs.formats.decompress import DecompressError, unpack_message
from mavnav.logs.messages import definitions, fast_cdr
from mavnav.logs.messages.columns import columns_of, read_blocks
from mavnav.logs.messages.other_scans import other_scan, suffix_of
from mavnav.logs.messages.records import DecodeError, LaserMessage
from mavnav.logs.namespaces import topic_and_frame
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel
from mavnav.logs.stamps import storable

LASER_TYPES = frozenset({definitions.SCAN, definitions.FOXGLOVE_SCAN})
ROS_ENCODINGS = ("cdr", "ros1")
SINGLE_POSES = frozenset({definitions.POSE, definitions.POSE_COVARIANCE, definitions.PATH, definitions.TRANSFORM})
"""Types that are of use only on a topic that is named, or is named like a ground truth."""


def decoder(channel: Channel, *, poses: bool = False, topic: str | None = None) -> Callable[[bytes], Any] | None:
    """Return the function that decodes a channel's messages; None for types that mavnav does not use.

    The function returns a LaserMessage, an ImuMessage, or a list of TransformMessage for odometry and transforms, and
    raises DecodeError. With ``poses``, single poses and transforms are decoded too. A requested ``topic`` adds scans in
    messages of other types.
    """
    kind, part = (channel.encoding, channel.type), suffix_of(channel, topic)
    if part is not None and channel.encoding in ROS_ENCODINGS:
        return _unpack_first(_other_scans(channel, part))
    make = DECODERS.get(kind) if poses or channel.type not in SINGLE_POSES else None
    return None if make is None else _unpack_first(make(channel))


def decode_together(
    channel: Channel, messages: list[bytes], log_ns: NDArray[np.int64], decode: Callable[[bytes], Any]
) -> tuple[list[Any], dict[int, DecodeError]]:
    """Decode messages of poses, or of an inertial sensor, in columns; those of other layouts one by one.

    Returns the `Poses` or `Measurements`, and what is wrong with a message by its number. ``log_ns`` (n,) are the times
    of recording.
    """
    blocks, errors, left = [], dict[int, DecodeError](), np.ones(len(messages), np.bool_)
    if channel.encoding in ROS_ENCODINGS:
        blocks = [*read_blocks(messages, channel.encoding, _FIELD_READERS[channel.type])]
    for rows, _ in blocks:
        left[rows] = False
    singles = dict[int, Any]()
    for row in np.flatnonzero(left).tolist():
        try:
            singles[row] = decode(messages[row])
        except DecodeError as error:
            errors[row] = error
    return [*columns_of(blocks, singles, log_ns)], errors


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

    If ``topic`` is None, any channel with LaserScans is accepted. The frames of topics are left away.
    """
    if topic is None:
        return channel.topic if is_laser(channel) else None
    other = channel.encoding in ROS_ENCODINGS
    names = (
        name
        for name in (topic_and_frame(each)[0] for each in scan_topics(topic))
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


def _ros_decoder(read: Callable[[bytes, str], Any], channel: Channel) -> Callable[[bytes], Any]:
    type_name = definitions.TF if channel.type == definitions.TF_ROS1 else channel.type

    def decode(data: bytes) -> Any:  # noqa: ANN401
        message = read(data, channel.encoding)
        if message is None:
            _deserialize(data, channel.encoding, type_name)  # it says what is wrong
            raise DecodeError(f"no {type_name}")
        return message

    return decode


def _foxglove(channel: Channel) -> Callable[[bytes], LaserMessage]:
    from mavnav.logs.messages.foxglove import decode_json, protobuf_decoder  # noqa: PLC0415

    return decode_json if channel.encoding == "json" else protobuf_decoder(channel)


_FIELD_READERS: dict[str, Callable[[fast_cdr.CdrFields], Any]] = {
    definitions.ODOMETRY: partial(fast_cdr.read_pose, child=True, covariances=2 * fast_cdr.COVARIANCE + fast_cdr.TWIST),
    definitions.IMU: fast_cdr.read_imu,
    definitions.TF: fast_cdr.read_transforms,
    definitions.TF_ROS1: fast_cdr.read_transforms,
    definitions.POSE: fast_cdr.read_pose,
    definitions.POSE_COVARIANCE: partial(fast_cdr.read_pose, covariances=fast_cdr.COVARIANCE),
    definitions.PATH: fast_cdr.read_path,
    definitions.TRANSFORM: partial(fast_cdr.read_pose, child=True),
}
_ROS_READERS: dict[str, Callable[[bytes, str], Any]] = {
    definitions.SCAN: partial(fast_cdr.laser_of, any_stamp=True),
    **{name: fast_cdr.exactly(read) for name, read in _FIELD_READERS.items()},
}
DECODERS: dict[tuple[str, str], Callable[[Channel], Callable[[bytes], Any]]] = {
    ("json", definitions.FOXGLOVE_SCAN): _foxglove,
    ("protobuf", definitions.FOXGLOVE_SCAN): _foxglove,
    **{(each, name): partial(_ros_decoder, read) for name, read in _ROS_READERS.items() for each in ROS_ENCODINGS},
    (carmen.ENCODING, definitions.SCAN): carmen.scan_decoder,
    **{
        (carmen.ENCODING, name): (lambda _: carmen.decode_pose)
        for name in (definitions.ODOMETRY, definitions.TF, definitions.TRANSFORM)
    },
}


class Waiting(Struct):
    """Messages of a topic that are no scans, until they are decoded together and go to the ``takers``."""

    channel: Channel
    decode: Callable[[bytes], Any]
    takers: tuple[Callable[[list[Any]], None], ...]
    messages: list[bytes] = field(default_factory=list)
    log_ns: list[int] = field(default_factory=list)

    def pass_on(self, report: ReadReport) -> None:
        """Decode what waits; a message that does not decode is noted."""
        log_ns = np.array([*map(storable, self.log_ns)], np.int64)
        parts, errors = decode_together(self.channel, self.messages, log_ns, self.decode)
        for row, error in errors.items():
            where = f"{self.channel.topic}, {self.log_ns[row]} ns"
            report.damage(f"a message does not decode ({error})", where)
        for take in self.takers if parts else ():
            take(parts)
        self.messages, self.log_ns = [], []
