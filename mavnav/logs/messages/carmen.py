"""Messages of CARMEN logs: lines of text.

``FLASER`` and ``RLASER`` are a front and a rear laser that cover half a turn. Lines of ``RAWLASERn`` and
``ROBOTLASERn``, from CARMEN's laser and robot modules, contain the geometry. The order of the words is described in
logger.h and readlog.c.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, inf, isfinite, pi, sin
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavnav.logs.messages.records import DecodeError, LaserMessage, TransformMessage
from mavnav.logs.records import Channel
from mavnav.pose import Pose
from mavnav.units import DEG

ENCODING: Final = "carmen"
_HALF_TURN_DEG: Final = 180.0
_GEOMETRY_WORDS: Final = 8
"""Index of the last word before the number of ranges in a RAWLASER or ROBOTLASER line."""


class LaserLine(NamedTuple):
    """A laser line: ``ranges_m`` as written (float32), and the poses in the line, None if it has none.

    ``geometry`` is the first angle and the step between beams, rad, and the maximum range, m; None if the line does not
    contain it.
    """

    kind: str
    stamp_ns: int
    ranges_m: NDArray[np.float32]
    geometry: tuple[float, float, float] | None
    odom_T_laser: Pose | None
    odom_T_base: Pose | None


def laser_of(words: Sequence[bytes]) -> LaserLine:
    """Parse a laser line; raises ValueError or IndexError if it is none."""
    kind, geometry = words[0].decode("ascii"), None
    if kind in ("FLASER", "RLASER"):
        at, poses = 2, 2
    else:
        start_rad, _, step_rad, max_range_m = (float(word) for word in words[2:6])
        geometry, at, poses = (start_rad, step_rad, max_range_m), _GEOMETRY_WORDS + 1, 2 * kind.startswith("ROBOT")
    count = int(words[at - 1])
    end = at + count
    if count < 0 or len(words) < end:
        raise ValueError(f"{count} ranges are announced")
    ranges_m = np.array(words[at:end], dtype=np.float32)
    if geometry:
        end += 1 + int(words[end])
    laser, base = (pose_of(words[end + 3 * k : end + 3 * k + 3]) if poses else None for k in (0, 1))
    if len(words) < end + 3 * poses + 3:
        raise ValueError("the line ends before its time")
    return LaserLine(kind, stamp_ns(words[-3]), ranges_m, geometry, laser, base)


def pose_of(words: Sequence[bytes]) -> Pose:
    """Parse x, y (m) and yaw (rad); raises ValueError."""
    x_m, y_m, yaw_rad = (float(word) for word in words)
    return Pose(x_m, y_m, yaw_rad)


def stamp_ns(word: bytes) -> int:
    """Parse a time in seconds without rounding; raises ValueError."""
    whole, _, digits = word.decode("ascii").partition(".")
    if not (whole + digits).isdigit():
        return round(float(word) * 1e9)
    return int(whole or "0") * 1_000_000_000 + int(digits[:9].ljust(9, "0"))


def pose_line(parent: str, child: str, pose: Pose, at_ns: int) -> bytes:
    """Write the pose of a frame as a line of this encoding, which `decode_pose` reads."""
    return f"POSE {parent} {child} {pose.x_m!r} {pose.y_m!r} {pose.yaw_rad!r} {at_ns}".encode()


def scan_decoder(channel: Channel) -> Callable[[bytes], LaserMessage]:
    """Return the decoder of laser lines; it raises DecodeError.

    The schema of the channel contains the frame, and the maximum range (m) and the step between beams (degrees) from
    the parameters of the log, NaN if unknown.
    """
    frame, *numbers = channel.schema.data.decode().split()
    range_max_m, step_deg = (float(word) for word in numbers)

    def decode(data: bytes) -> LaserMessage:
        try:
            line = laser_of(data.split())
        except (ValueError, IndexError) as error:
            raise DecodeError(f"no line of a laser ({error})") from error
        count = len(line.ranges_m)
        start_rad, step_rad, max_range_m = line.geometry or (-pi / 2, _step_rad(count, step_deg), range_max_m)
        angles = (float(np.float32(start_rad)), float(np.float32(step_rad)), None)
        limits, times = (0.0, max_range_m if isfinite(max_range_m) else inf), (0.0, 0.0)
        return LaserMessage(line.stamp_ns, frame, *angles, *limits, *times, line.ranges_m, isfinite(max_range_m))

    return decode


def _step_rad(beams: int, step_deg: float) -> float:
    """Return the angle between beams over half a turn; an odd number of beams has one at either end."""
    if isfinite(step_deg) and abs(beams * step_deg - _HALF_TURN_DEG) <= 1.5 * step_deg:
        return step_deg * DEG
    return _HALF_TURN_DEG * DEG / max(beams - beams % 2, 1)


def decode_pose(data: bytes) -> list[TransformMessage]:
    """Decode an ODOM line, or a line written by `pose_line`; raises DecodeError."""
    try:
        words = data.split()
        if words[0] == b"ODOM":
            parent, child, pose, at_ns = "odom", "base_link", pose_of(words[1:4]), stamp_ns(words[7])
        else:
            parent, child = words[1].decode(), words[2].decode()
            pose, at_ns = pose_of(words[3:6]), int(words[6])
        z, w = sin(pose.yaw_rad / 2), cos(pose.yaw_rad / 2)
    except (ValueError, IndexError) as error:
        raise DecodeError(f"no pose ({error})") from error
    return [TransformMessage(at_ns, parent, child, (pose.x_m, pose.y_m, 0.0), (0.0, 0.0, z, w))]
