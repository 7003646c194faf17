"""foxglove.LaserScan as protobuf and as JSON (https://docs.foxglove.dev/docs/visualization/message-schemas/laser-scan).

``end_angle`` is the bearing of the last point. The message has no range limits.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError as ProtobufError
from numpy.typing import NDArray

from mavnav.logs.messages.definitions import DecodeError, LaserMessage
from mavnav.logs.records import Channel

_NAN = float("nan")
_MAX_JSON_BYTES = 8 << 20
"""Maximum size of a scan in JSON, in bytes, above that of any real scan; the parsed objects take many times as much."""

_MAX_DESCRIPTOR_BYTES = 1 << 20
_NUMBER, _XYZ = ("double", "float"), dict.fromkeys("xyz", ("double", "float"))
_TIME = {"seconds": ("int64", "int32", "uint64", "uint32"), "nanos": ("int32", "int64", "uint32", "uint64")}
_Kinds = dict[str, Any]
_SCAN: _Kinds = {
    "timestamp": _TIME,
    "frame_id": ("string",),
    "pose": {"position": _XYZ, "orientation": _XYZ},
    "start_angle": _NUMBER,
    "end_angle": _NUMBER,
    "ranges": ("repeated double", "repeated float"),
}
"""Field that is read -> its allowed types, or the fields of its message."""


def decode_json(data: bytes) -> LaserMessage:
    """Decode a message in JSON; raises DecodeError."""
    if len(data) > _MAX_JSON_BYTES:
        raise DecodeError(f"{len(data)} bytes of JSON; no more than {_MAX_JSON_BYTES} are read")
    try:
        scan = json.loads(data)
        stamp = scan["timestamp"]
        stamp_ns, frame_id = int(stamp["sec"]) * 1_000_000_000 + int(stamp["nsec"]), str(scan.get("frame_id", ""))
        ends_rad, ranges_m = (float(scan["start_angle"]), float(scan["end_angle"])), _floats(scan["ranges"])
        return _laser(stamp_ns, frame_id, ends_rad, ranges_m, has_pose=not _is_identity_json(scan.get("pose") or {}))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        raise DecodeError(f"no foxglove.LaserScan in JSON ({type(error).__name__}: {error})") from error


def _floats(values: list[Any]) -> NDArray[np.float64]:
    """Convert JSON numbers to float64; null is NaN, and "NaN" and "Infinity" are accepted as strings."""
    return np.array([_NAN if value is None else float(value) for value in values], dtype=np.float64)


def _is_identity_json(pose: dict[str, Any]) -> bool:
    p, q = pose.get("position") or {}, pose.get("orientation") or {}
    return not any(p.get(axis) for axis in "xyz") and not any(q.get(axis) for axis in "xyz")


def protobuf_decoder(channel: Channel) -> Callable[[bytes], LaserMessage]:
    """Return the decoder of a protobuf channel, built from the descriptor in the log; both raise DecodeError."""
    message_class = _message_class(channel)

    def decode(data: bytes) -> LaserMessage:
        try:
            scan = message_class.FromString(data)
            p, q = scan.pose.position, scan.pose.orientation
            stamp_ns = scan.timestamp.seconds * 1_000_000_000 + scan.timestamp.nanos
            ranges_m = np.fromiter(scan.ranges, dtype=np.float64, count=len(scan.ranges))
            has_pose = any((p.x, p.y, p.z, q.x, q.y, q.z))
            return _laser(stamp_ns, scan.frame_id, (scan.start_angle, scan.end_angle), ranges_m, has_pose=has_pose)
        except (ProtobufError, AttributeError) as error:
            raise DecodeError(f"no foxglove.LaserScan in protobuf ({error})") from error

    return decode


def _message_class(channel: Channel) -> Any:  # noqa: ANN401  (generated at run time)
    pool, data = descriptor_pool.DescriptorPool(), channel.schema.data
    if len(data) > _MAX_DESCRIPTOR_BYTES:
        raise DecodeError(f"the protobuf schema of {channel.topic} has more than {_MAX_DESCRIPTOR_BYTES} bytes")
    try:
        for file in descriptor_pb2.FileDescriptorSet.FromString(data).file:
            pool.Add(file)
        descriptor = pool.FindMessageTypeByName(channel.type)
        _check_fields(descriptor, _SCAN, "")
        return message_factory.GetMessageClass(descriptor)
    except (ProtobufError, KeyError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:160]
        raise DecodeError(f"the protobuf schema of {channel.topic} cannot be used ({reason})") from error


def _check_fields(descriptor: Any, wanted: _Kinds, above: str) -> None:  # noqa: ANN401
    """Raise TypeError with the name of a field that is missing or has an unsupported type."""
    for name, kinds in wanted.items():
        kind, nested = _kind(descriptor, name), isinstance(kinds, dict)
        if kind not in (("message",) if nested else kinds):
            raise TypeError(f"field {above}{name} is {kind}, it should be {'a message' if nested else kinds[0]}")
        if nested:
            _check_fields(descriptor.fields_by_name[name].message_type, kinds, f"{above}{name}.")


def _kind(descriptor: Any, name: str) -> str:  # noqa: ANN401
    """Return the type of a field as it is written in a .proto file."""
    proto, kinds = descriptor_pb2.DescriptorProto(), descriptor_pb2.FieldDescriptorProto
    descriptor.CopyToProto(proto)
    field = next((field for field in proto.field if field.name == name), None)
    if field is None:
        return "missing"
    kind = kinds.Type.Name(field.type).removeprefix("TYPE_").lower()
    return f"repeated {kind}" if field.label == kinds.LABEL_REPEATED else kind


def _laser(
    stamp_ns: int, frame_id: str, ends_rad: tuple[float, float], ranges_m: NDArray[np.float64], *, has_pose: bool
) -> LaserMessage:
    start, end = ends_rad
    step = (end - start) / (len(ranges_m) - 1) if len(ranges_m) > 1 else 0.0
    return LaserMessage(stamp_ns, frame_id, start, step, end, _NAN, _NAN, 0.0, 0.0, ranges_m, False, has_pose)
