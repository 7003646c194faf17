"""Decoders of messages, selected by encoding and type.

ROS messages are decoded by the standard definitions; the schema text in the log, ros2msg or ros2idl, is not used.
Messages that are no scans wait here until they are decoded together, in columns.

Scans in messages that are no LaserScan are multi-echo scans (REP-138), and point clouds of which one layer is a scan.
Such a topic is read if it is requested, or if the log has no other scans. A suffix of its name selects one scan of the
message: ``/echoes/last``, ``/points/ring_7``, ``/points/z_-0.1_0.3``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from math import inf, pi
from typing import Any, Final

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.logs.formats import carmen
from mavnav.logs.formats.decompress import DecompressError, unpack_message
from mavnav.logs.messages import definitions, fast_cdr
from mavnav.logs.messages.definitions import CLOUD, MULTI_ECHO, DecodeError, LaserMessage
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel, topic_and_frame
from mavnav.logs.stamps import storable

Array = NDArray[np.float64]
Pick = Callable[[dict[str, Array]], NDArray[np.bool_]]

OTHER_TYPES: Final = frozenset({MULTI_ECHO, CLOUD})
ECHOES: Final = ("first", "strongest", "last")
_PARTS: Final = {
    MULTI_ECHO: re.compile("|".join(ECHOES)),
    CLOUD: re.compile(r"ring_\d{1,4}|z_-?\d+(?:\.\d+)?_-?\d+(?:\.\d+)?"),
}
_KINDS: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_LAYER_HALF_M: Final = 0.1
_MIN_STEP_RAD, _MAX_STEP_RAD = 0.05 * pi / 180, 5 * pi / 180
_DEFAULT_STEP_RAD: Final = 0.25 * pi / 180
_ROUNDING: Final = 1e-6


def suffix_of(channel: Channel, topic: str | None) -> str | None:
    """Return the suffix of a topic that selects a scan of a channel, empty for the default, None for another topic."""
    if topic is None or channel.type not in OTHER_TYPES:
        return None
    if topic == channel.topic:
        return ""
    name, _, part = topic.rpartition("/")
    return part if name == channel.topic and _PARTS[channel.type].fullmatch(part) else None


def _stamp_ns(message: Any) -> int:  # noqa: ANN401
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def _echo(message: Any, part: str) -> LaserMessage:  # noqa: ANN401
    echoes = [beam.echoes for beam in message.ranges]
    if part == "strongest" and len(message.intensities) == len(echoes):
        at = [int(np.argmax(beam.echoes)) if len(beam.echoes) else 0 for beam in message.intensities]
    else:
        at = [-1 if part == "last" else 0] * len(echoes)
    ranges_m = np.array([beam[k] if len(beam) else inf for beam, k in zip(echoes, at, strict=True)], dtype=np.float32)
    angles = (message.angle_min, message.angle_increment, message.angle_max)
    limits, times = (message.range_min, message.range_max), (message.time_increment, message.scan_time)
    return LaserMessage(_stamp_ns(message), message.header.frame_id, *angles, *limits, *times, ranges_m)


def _layer(message: Any, part: str, state: dict[str, Any]) -> LaserMessage:  # noqa: ANN401
    x, y = _points_in_layer(message, part, state)
    bearing_rad, range_m = np.arctan2(y, x), np.hypot(x, y)
    if "bearings" not in state and len(x):
        state["bearings"] = _bearings(bearing_rad)
    first_rad, step_rad, beams = state.get("bearings", (0.0, _DEFAULT_STEP_RAD, 0))
    beam = np.round((bearing_rad - first_rad) / step_rad).astype(np.int64) % beams
    ranges_m = np.full(beams, inf)
    np.minimum.at(ranges_m, beam, range_m)
    frame = message.header.frame_id
    return LaserMessage(
        _stamp_ns(message), frame, first_rad, step_rad, None, 0.0, inf, 0.0, 0.0, ranges_m, has_limits=False
    )


def _points_in_layer(message: Any, part: str, state: dict[str, Any]) -> tuple[Array, Array]:  # noqa: ANN401
    """Return x and y, m, of the points in the layer, (n,) each; none of an empty cloud, as drivers publish at first."""
    if not (message.width and message.height):
        return np.empty(0), np.empty(0)
    points = _points(message)
    if "pick" not in state:
        state["pick"] = _picker(points, part)
    used = state["pick"](points) & np.isfinite(points["x"]) & np.isfinite(points["y"])
    return points["x"][used], points["y"][used]


def _points(message: Any) -> dict[str, Array]:  # noqa: ANN401
    """Return the fields of a PointCloud2 by name, (n,) float64 each; x, y and z are in m."""
    order = ">" if message.is_bigendian else "<"
    count = int(message.width) * int(message.height)
    step, data = int(message.point_step), np.ascontiguousarray(message.data, dtype=np.uint8)
    if message.height > 1 and message.row_step != message.width * step:
        rows = data[: int(message.row_step) * int(message.height)].reshape(int(message.height), int(message.row_step))
        data = np.ascontiguousarray(rows[:, : int(message.width) * step]).ravel()
    if step <= 0 or len(data) < count * step:
        raise ValueError(f"{len(data)} bytes for {count} points of {step}")
    fields = {}
    for f in message.fields:
        if f.datatype not in _KINDS:
            raise ValueError(f"the field {f.name!r} is of no known type: {f.datatype}")
        kind = f"{order}{_KINDS[int(f.datatype)]}"
        fields[f.name] = np.ndarray((count,), kind, data.data, int(f.offset), (step,)).astype(np.float64)
    return {"z": np.zeros(count), **fields, "x": fields["x"], "y": fields["y"]}


def _picker(points: dict[str, Array], part: str) -> Pick:
    """Return the function that selects the points of a layer: a ring, a height interval, or the most level ring.

    The default is the most level ring, or, without rings, heights of at most 0.1 m above and below the sensor.
    """
    low_m, high_m, ring = -_LAYER_HALF_M, _LAYER_HALF_M, None
    if part.startswith("z_"):
        low_m, high_m = map(float, part.split("_")[1:])
    elif part.startswith("ring_"):
        ring = int(part.removeprefix("ring_"))
    elif "ring" in points and len(rings := np.unique(points["ring"][np.isfinite(points["ring"])])) > 1:
        level = np.abs(np.arctan2(points["z"], np.hypot(points["x"], points["y"])))
        slopes = [np.nanmedian(level[points["ring"] == number]) for number in rings]
        ring = int(rings[int(np.argmin(slopes))])
    if ring is None:
        return lambda points: (points["z"] >= low_m) & (points["z"] <= high_m)
    return lambda points: points["ring"] == ring


def _bearings(bearing_rad: Array) -> tuple[float, float, int]:
    """Return the first bearing and the step, rad, and the number of beams of a full turn that fit these bearings.

    The step is the typical distance between neighbors if most distances are multiples of it, else 0.25 degrees.
    """
    apart = np.diff(np.sort(bearing_rad))
    apart = apart[apart > _MIN_STEP_RAD / 2]
    step_rad = float(np.median(apart)) if len(apart) else _DEFAULT_STEP_RAD
    whole = np.round(apart / step_rad)
    regular = np.abs(apart - whole * step_rad) < 0.2 * step_rad
    if len(apart) and regular.mean() > 0.8 and _MIN_STEP_RAD <= step_rad <= _MAX_STEP_RAD:
        step_rad = float(apart[regular].sum() / whole[regular].sum())
    else:
        step_rad = _DEFAULT_STEP_RAD
    beams = int(2 * pi / step_rad + _ROUNDING)
    phase = np.exp(2j * pi * bearing_rad / step_rad).mean()
    first_rad = float(np.angle(phase)) / (2 * pi) * step_rad - (beams // 2) * step_rad
    return first_rad, step_rad, beams


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
        blocks = [*fast_cdr.read_blocks(messages, channel.encoding, _FIELD_READERS[channel.type])]
    for rows, _ in blocks:
        left[rows] = False
    singles = dict[int, Any]()
    for row in np.flatnonzero(left).tolist():
        try:
            singles[row] = decode(messages[row])
        except DecodeError as error:
            errors[row] = error
    return [*fast_cdr.columns_of(blocks, singles, log_ns)], errors


def _unpack_first(decode: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
    def decode_unpacked(data: bytes) -> Any:  # noqa: ANN401
        try:
            return decode(unpack_message(data))
        except DecompressError as error:
            raise DecodeError(str(error)) from error

    return decode_unpacked


def _other_scans(channel: Channel, part: str) -> Callable[[bytes], LaserMessage]:
    """Return the decoder of scans in messages of another type.

    It keeps a ``state``: the first point cloud with points decides on the layer, the first with points in it on the
    bearings; before that a scan has no beams. It raises DecodeError if the message contains no scan.
    """
    state: dict[str, Any] = {}

    def decode(data: bytes) -> LaserMessage:
        message = _deserialize(data, channel.encoding, channel.type)
        try:
            return _echo(message, part) if channel.type == MULTI_ECHO else _layer(message, part, state)
        except KeyError as error:
            raise DecodeError(f"no scan in a {channel.type} without the field {error}") from error
        except (ValueError, IndexError, TypeError, OverflowError) as error:
            raise DecodeError(f"no scan in a {channel.type} ({error})") from error

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
            report.damage(f"a message does not decode ({error})", f"{self.channel.topic}, {self.log_ns[row]} ns")
        for take in self.takers if parts else ():
            take(parts)
        self.messages, self.log_ns = [], []
