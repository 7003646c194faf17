"""Scans in messages that are no LaserScan: multi-echo scans (REP-138), and point clouds of which one layer is a scan.

Such a topic is read if it is requested, or if the log has no other scans. A suffix of its name selects one scan of the
message: ``/echoes/last``, ``/points/ring_7``, ``/points/z_-0.1_0.3``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from math import inf, pi
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavnav.logs.messages.definitions import CLOUD, MULTI_ECHO
from mavnav.logs.messages.records import DecodeError, LaserMessage
from mavnav.logs.records import Channel

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


def other_scan(message: Any, message_type: str, part: str, state: dict[str, Any]) -> LaserMessage:  # noqa: ANN401
    """Convert a deserialized message to a scan.

    ``state`` is kept between messages: the first point cloud with points decides on the layer, the first with points in
    it on the bearings; before that a scan has no beams. Raises DecodeError if the message contains no scan.
    """
    try:
        return _echo(message, part) if message_type == MULTI_ECHO else _layer(message, part, state)
    except KeyError as error:
        raise DecodeError(f"no scan in a {message_type} without the field {error}") from error
    except (ValueError, IndexError, TypeError, OverflowError) as error:
        raise DecodeError(f"no scan in a {message_type} ({error})") from error


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
