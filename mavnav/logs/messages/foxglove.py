"""foxglove.LaserScan as protobuf and as JSON (https://docs.foxglove.dev/docs/visualization/message-schemas/laser-scan).

``end_angle`` is the bearing of the last point, and there are no range limits.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from mavnav.logs.messages.records import DecodeError, LaserMessage

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from mavnav.logs.records import Channel

_NAN = float("nan")


def json_decoder(_channel: Channel) -> Callable[[bytes], LaserMessage]:
    """Return the decoder of a JSON channel; it raises DecodeError."""

    def decode(data: bytes) -> LaserMessage:
        try:
            scan = json.loads(data)
            stamp = scan["timestamp"]
            return _laser(
                int(stamp["sec"]) * 1_000_000_000 + int(stamp["nsec"]),
                str(scan.get("frame_id", "")),
                (float(scan["start_angle"]), float(scan["end_angle"])),
                _floats(scan["ranges"]),
                has_pose=not _is_identity_json(scan.get("pose") or {}),
            )
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError) as error:
            raise DecodeError(f"no foxglove.LaserScan in JSON ({type(error).__name__}: {error})") from error

    return decode


def _floats(values: list[Any]) -> NDArray[np.float64]:
    """Turn JSON numbers into floats; null and "NaN", "Infinity" as the writers of JSON spell what it lacks."""
    return np.array([_NAN if value is None else float(value) for value in values], dtype=np.float64)


def _is_identity_json(pose: dict[str, Any]) -> bool:
    p, q = pose.get("position") or {}, pose.get("orientation") or {}
    return not any(p.get(axis) for axis in "xyz") and not any(q.get(axis) for axis in "xyz")


def protobuf_decoder(channel: Channel) -> Callable[[bytes], LaserMessage]:
    """Return the decoder of a protobuf channel, made from the descriptor in the log; both raise DecodeError."""
    from google.protobuf.message import DecodeError as ProtobufError  # noqa: PLC0415

    message_class = _message_class(channel)

    def decode(data: bytes) -> LaserMessage:
        try:
            scan = message_class.FromString(data)
            p, q = scan.pose.position, scan.pose.orientation
            return _laser(
                scan.timestamp.seconds * 1_000_000_000 + scan.timestamp.nanos,
                scan.frame_id,
                (scan.start_angle, scan.end_angle),
                np.fromiter(scan.ranges, dtype=np.float64, count=len(scan.ranges)),
                has_pose=any((p.x, p.y, p.z, q.x, q.y, q.z)),
            )
        except (ProtobufError, AttributeError) as error:
            raise DecodeError(f"no foxglove.LaserScan in protobuf ({error})") from error

    return decode


def _message_class(channel: Channel) -> Any:  # noqa: ANN401  (generated at run time)
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory  # noqa: PLC0415
    from google.protobuf.message import DecodeError as ProtobufError  # noqa: PLC0415

    pool = descriptor_pool.DescriptorPool()
    try:
        for file in descriptor_pb2.FileDescriptorSet.FromString(channel.schema.data).file:
            pool.Add(file)
        return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel.type))
    except (ProtobufError, KeyError, TypeError, ValueError) as error:
        raise DecodeError(f"the protobuf schema of {channel.topic} cannot be used ({error})") from error


def _laser(
    stamp_ns: int, frame_id: str, ends_rad: tuple[float, float], ranges_m: NDArray[np.float64], *, has_pose: bool
) -> LaserMessage:
    start, end = ends_rad
    step = (end - start) / (len(ranges_m) - 1) if len(ranges_m) > 1 else 0.0
    return LaserMessage(stamp_ns, frame_id, start, step, end, _NAN, _NAN, 0.0, 0.0, ranges_m, False, has_pose)
