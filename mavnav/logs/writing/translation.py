"""Translation of the messages of a log into what ``convert`` writes: ROS 2 messages, where their type is known there.

The definition of a type decides, not its first message, which may be cut, or empty and fit any definition.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from itertools import chain
from typing import Any, Final, NamedTuple

from msgspec import Struct, field

from mavnav.logs.formats.carmen import ENCODING, decode_pose, scan_decoder
from mavnav.logs.messages import cdr, ros
from mavnav.logs.messages.decode import decoder
from mavnav.logs.messages.definitions import ODOMETRY, SCAN, TF, TF_ROS1, TRANSFORM, DecodeError, LaserMessage
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel, Schema
from mavnav.logs.transforms import planar_pose
from mavnav.pose import Pose
from mavnav.scan import LaserSpec, Scan

_ROS1_ONLY: Final = {TF_ROS1: TF}
_MAX_DEFINITION_BYTES: Final = 1 << 20
_SIMPLE: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration", "std_msgs/msg/Header")
"""Types that are translated by name: ROS 1 has them built in, or with a sequence number."""

_BYTES: Final = dict.fromkeys(("int8", "uint8", "byte", "char"), "byte")
_FILLER: Final = "structure_needs_at_least_one_member"


class _Translation(NamedTuple):
    """The channel to write, a check of messages, and their conversion; both raise DecodeError, or are None.

    One with a ``warning`` is the last resort: it is for single messages, and others come first for the next.
    """

    channel: Channel
    check: Callable[[bytes], Any] | None = None
    convert: Callable[[bytes], bytes] | None = None
    warning: str = ""

    def translate(self, data: bytes) -> bytes:
        """Return the message to write; raises DecodeError."""
        if self.check:
            self.check(data)
        return bytes(self.convert(data)) if self.convert else data


class Translator(Struct):
    """Translates messages, each by the first translation that fits it."""

    report: ReadReport
    _choices: dict[Channel, tuple[list[_Translation], Iterator[_Translation]]] = field(default_factory=dict)
    """Channel -> the translations tried so far, the last that fitted first, and those not tried yet."""

    def translate(self, channel: Channel, data: bytes) -> tuple[Channel, bytes]:
        """Return the channel to write a message to, and its bytes there; raises DecodeError."""
        tried, others = self._choices.setdefault(channel, ([], _translations(channel)))
        error = None
        for number, translation in enumerate(_all(tried, others)):
            try:
                message = translation.translate(data)
            except DecodeError as reason:
                error = error or reason
                continue
            if translation.warning:
                self.report.warn(translation.warning)
            elif number:
                tried.insert(0, tried.pop(number))
            return translation.channel, message
        raise error or DecodeError("no definition fits")


def _all(tried: list[_Translation], others: Iterator[_Translation]) -> Iterator[_Translation]:
    """Yield the translations tried, then the others, which count as tried from then on."""
    yield from list(tried)
    for translation in others:
        tried.append(translation)
        yield translation


def _translations(channel: Channel) -> Iterator[_Translation]:
    """Yield the translations of a channel, the best first."""
    check = decoder(channel)
    name = _ROS1_ONLY.get(channel.type, channel.type)
    known = name in ros.types_ros2().types
    if channel.encoding == ENCODING:
        yield _Translation(_ros2(channel, channel.type), check, _carmen_to_cdr(channel))
    elif channel.encoding == "ros1" and known and (check or _same_layout(channel, name)):
        yield _Translation(_ros2(channel, name), check, partial(_read, ros.types_ros2().ros1_to_cdr, name=name))
        warning = f"{channel.topic}: messages that do not fit {name} of ROS 2 are copied as they are"
        yield _Translation(channel, check, partial(_read_ros1, name=name), warning)
    elif channel.encoding == "cdr" and name and not channel.schema.data:
        yield from _with_definition(channel, name, check)
    else:
        yield _Translation(channel, check)


def _with_definition(channel: Channel, name: str, check: Callable[[bytes], Any] | None) -> Iterator[_Translation]:
    """Yield a channel without a definition with those of ROS 2's distributions that fit the bytes, the newest first."""
    if check:  # a type that has not changed
        yield _Translation(_ros2(channel, name), check)
        return
    texts = set()
    for types in chain([ros.types_ros2()], map(ros.types_ros2, ros.OLDER)):
        text = ros.definition(name, types) if name in types.types else ""
        if text and text not in texts:
            texts.add(text)
            yield _Translation(_ros2(channel, name, text), partial(_read, types.deserialize_cdr, name=name))
    warning = f"{channel.topic}: no definition of {name} fits its messages; they are copied without one"
    yield _Translation(Channel(channel.topic, name, "cdr", Schema(name), channel.metadata), warning=warning)


def _ros2(channel: Channel, name: str, text: str = "") -> Channel:
    """Return the channel of CDR messages of a type, defined by the text, or as in the newest ROS 2."""
    schema = Schema(name, "ros2msg", (text or ros.definition(name)).encode())
    return Channel(channel.topic, name, "cdr", schema, channel.metadata)


def _carmen_to_cdr(channel: Channel) -> Callable[[bytes], bytes]:
    """Return the function that converts a line of a CARMEN log to a message of its channel; it raises DecodeError."""
    if channel.type == SCAN:
        decode = scan_decoder(channel)
        return lambda line: _laser_scan(decode(line))
    write = {ODOMETRY: cdr.odometry, TRANSFORM: cdr.transform}.get(channel.type, cdr.transforms)

    def convert(line: bytes) -> bytes:
        (pose,) = decode_pose(line)
        return write(pose.parent, pose.child)(pose.stamp_ns, planar_pose(pose) or Pose())

    return convert


def _laser_scan(laser: LaserMessage) -> bytes:
    limits, times = (laser.range_min_m, laser.range_max_m), (laser.time_increment_s, laser.scan_time_s)
    spec = LaserSpec(laser.angle_min_rad, laser.angle_step_rad, len(laser.ranges_m), *limits, *times)
    return cdr.scans(laser.frame_id)(Scan(laser.stamp_ns, laser.ranges_m, spec))


def _read_ros1(data: bytes, name: str) -> bytes:
    """Return a message as it is, if the standard definition of ROS 1 decodes it."""
    if name not in ros.types_ros1().types:
        raise DecodeError(f"{name} is not known in ROS 1")
    _read(ros.types_ros1().deserialize_ros1, data, name)
    return data


def _read(read: Callable[[bytes, str], Any], data: bytes, name: str) -> Any:  # noqa: ANN401
    from rosbags.serde import SerdeError  # noqa: PLC0415

    try:
        return read(data, name)
    except (SerdeError, ValueError, IndexError, AssertionError) as error:
        raise DecodeError(str(error)) from error


def _same_layout(channel: Channel, name: str) -> bool:
    """Return whether the ROS 1 definition of a channel has the fields of ROS 2's type, whatever their names."""
    types = _definitions_ros1(channel.schema.data, channel.type) or ros.types_ros1().fielddefs
    kind = channel.type if channel.type in types else name
    return kind not in types or _same_fields(types, kind, name)  # else the messages decide


@cache
def _definitions_ros1(text: bytes, name: str) -> Mapping[str, Any]:
    """Return the definitions in a ROS 1 bag by type; empty where they cannot be read. They are not compiled."""
    from rosbags.typesys import TypesysError, get_types_from_msg  # noqa: PLC0415

    if not 0 < len(text) <= _MAX_DEFINITION_BYTES:
        return {}
    try:
        return dict(get_types_from_msg(text.decode(errors="replace"), name))
    except (TypesysError, ValueError, RecursionError):
        return {}


def _same_fields(types: Mapping[str, Any], one: str, other: str) -> bool:
    if one == other and one in _SIMPLE:
        return True
    there = ros.types_ros2().fielddefs
    if one not in types or other not in there:
        return False
    fields, others = ([kind for word, kind in known[1] if word != _FILLER] for known in (types[one], there[other]))
    return len(fields) == len(others) and all(_same_kind(types, *pair) for pair in zip(fields, others, strict=True))


def _same_kind(types: Mapping[str, Any], one: Any, other: Any) -> bool:  # noqa: ANN401  as rosbags writes them
    from rosbags.interfaces import Nodetype  # noqa: PLC0415

    if one[0] != other[0]:
        return False
    if one[0] == Nodetype.NAME:
        return _same_fields(types, one[1], other[1])
    if one[0] == Nodetype.BASE:
        return bool(_BYTES.get(one[1][0], one[1][0]) == _BYTES.get(other[1][0], other[1][0]))
    same_length = one[0] == Nodetype.SEQUENCE or one[1][1] == other[1][1]
    return same_length and _same_kind(types, one[1][0], other[1][0])
