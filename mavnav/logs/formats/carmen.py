"""CARMEN logs: their reader, and decoders of their messages, which are lines of text.

Format: CARMEN's logger (https://carmen.sourceforge.net/logger_playback.html), logger.h and readlog.c. ``FLASER`` and
``RLASER`` are a front and a rear laser that cover half a turn. Lines of ``RAWLASERn`` and ``ROBOTLASERn``, from the
laser and robot modules of CARMEN, contain the geometry. Scan lines have poses from odometry or a SLAM system. A line
ends with the time of its message, the name of a computer, and the time since the logger started.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from math import cos, inf, isfinite, pi, sin
from pathlib import Path
from typing import IO, Final, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.logs.messages.definitions import ODOMETRY, SCAN, TF, TRANSFORM, DecodeError, LaserMessage, TransformMessage
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel, RawMessage, Schema
from mavnav.pose import Pose
from mavnav.units import DEG

ENCODING: Final = "carmen"
_HALF_TURN_DEG: Final = 180.0
_GEOMETRY_WORDS: Final = 8
"""Index of the last word before the number of ranges in a RAWLASER or ROBOTLASER line."""

LASER_LINE: Final = re.compile(rb"^(?:[FR]LASER|(?:RAW|ROBOT)LASER\d) ", re.MULTILINE)
_PARAMETER_LINE: Final = re.compile(rb"^PARAM \w+ ", re.MULTILINE)
_TOPICS: Final = {"FLASER": "/scan", "RLASER": "/rear_scan"}
_FRAMES: Final = {"FLASER": "laser", "RLASER": "rear_laser"}
_MAXIMA: Final = {"FLASER": "robot_front_laser_max", "RLASER": "robot_rear_laser_max"}
_STEPS: Final = {"FLASER": "laser_front_laser_resolution", "RLASER": "laser_rear_laser_resolution"}
_OFFSETS: Final = {"FLASER": ("robot_frontlaser_offset", 0.0), "RLASER": ("robot_rearlaser_offset", 3.141592653589793)}
_NUMBERS: Final = {*_MAXIMA.values(), *_STEPS.values(), *(name for name, _ in _OFFSETS.values())}
_MAX_LINE_BYTES: Final = 1 << 20
_INSPECTED_LINES: Final = 4000
_ROUNDING_M: Final = 2e-3
"""Largest position difference, in m, that rounding can cause: poses are written with six digits."""

PoseKind = Literal["odometry", "both", "corrected"]
"""Source of the poses in the scan lines: odometry, odometry and a SLAM system, or a SLAM system alone."""


def is_carmen(head: bytes) -> bool:
    """Return whether the first bytes of a file contain a laser line or two parameter lines of CARMEN."""
    return LASER_LINE.search(head) is not None or len(_PARAMETER_LINE.findall(head)) > 1


class _CarmenState(Struct):
    """Parameters and channels read so far."""

    report: ReadReport
    poses: PoseKind
    has_odometry_lines: bool
    parameters: dict[str, str] = field(default_factory=dict)
    channels: dict[str, Channel] = field(default_factory=dict)

    def channel(self, topic: str, kind: str, schema: bytes = b"") -> Channel:
        if topic not in self.channels:
            channel = Channel(topic, kind, ENCODING, Schema(kind, ENCODING, schema))
            self.channels[topic] = self.report.declare(channel)
        return self.channels[topic]


def read_carmen(path: Path, report: ReadReport) -> Iterator[RawMessage]:
    """Yield scans and poses of a CARMEN log, line by line.

    Poses corrected by a SLAM system are ground truth, not odometry; the first 4000 lines decide which they are. A line
    that cannot be parsed is reported and left out.
    """
    with path.open("rb") as file:
        state = _CarmenState(report, *kinds_of_poses(islice(_lines(file), _INSPECTED_LINES)))
        if state.poses == "corrected":
            report.warn("the poses in the log are those of a SLAM and no odometry; --truth auto compares with them")
        file.seek(0)
        for number, line in enumerate(_lines(file), start=1):
            report.here_bytes += len(line)
            try:
                yield from _messages(line, state)
            except (ValueError, IndexError, OverflowError, UnicodeDecodeError):
                end = "" if line.endswith(b"\n") else ": the log ends, or is too long, within it"
                report.damage(f"a line is no message of its kind{end}", f"{path.name}, line {number}")


def _lines(file: IO[bytes]) -> Iterator[bytes]:
    """Yield the lines of a file; a line over 1 MiB, longer than any scan, is yielded in parts."""
    while line := file.readline(_MAX_LINE_BYTES):
        yield line


def kinds_of_poses(lines: Iterable[bytes]) -> tuple[PoseKind, bool]:
    """Return the source of the poses in the scan lines, and whether odometry has lines of its own.

    Parameters
    ----------
    lines : the first lines of a log

    Poses are corrected if the log contains weights of a particle filter (``NEFF``), or if an odometry line with the
    same time has another position. Otherwise, if the pose of the laser relative to the robot changes, the laser poses
    are those of a SLAM system and the robot poses are odometry.
    """
    by_time: dict[int, Pose] = {}
    mountings, corrected = list[Pose](), False
    for line in lines:
        words = line.split()
        try:
            if words[:1] == [b"NEFF"]:
                corrected = True
            elif words[:1] == [b"ODOM"]:
                by_time[stamp_ns(words[7])] = pose_of(words[1:4])
            elif LASER_LINE.match(line):
                laser = laser_of(words)
                if (base := laser.odom_T_base) and laser.odom_T_laser:
                    mountings.append(base.between(laser.odom_T_laser))
                    corrected |= base.gap(by_time.get(laser.stamp_ns, base))[0] > _ROUNDING_M
        except (ValueError, IndexError, OverflowError):
            continue
    if corrected:
        return "corrected", bool(by_time)
    moved = any(mounting.gap(mountings[0])[0] > _ROUNDING_M for mounting in mountings)
    return "both" if moved else "odometry", bool(by_time)


def _messages(line: bytes, state: _CarmenState) -> Iterator[RawMessage]:
    """Yield the messages of a line: a scan with its poses, odometry, or nothing."""
    if LASER_LINE.match(line):
        yield from _scan(line, state)
    elif line.startswith(b"PARAM "):
        _, name, value, *_ = line.decode(errors="replace").split()
        if name in _NUMBERS:
            state.parameters[name] = repr(float(value))
    elif line.startswith(b"ODOM ") and state.poses != "corrected":
        words = line.split()
        pose_of(words[1:4])
        yield RawMessage(state.channel("/odom", ODOMETRY), stamp_ns(words[7]), line)
    elif b"\0" in line:
        raise ValueError("zeros, as a crash leaves them, are no text")


def _scan(line: bytes, state: _CarmenState) -> Iterator[RawMessage]:
    """Yield a scan and the poses in its line; before the first scan, also the mounting of the laser."""
    laser = laser_of(line.split())
    kind, at_ns = laser.kind, laser.stamp_ns
    topic, frame = _TOPICS.get(kind, f"/{kind.lower()}"), _FRAMES.get(kind, kind.lower())
    if topic not in state.channels:
        limits = [state.parameters.get(names.get(kind, ""), "nan") for names in (_MAXIMA, _STEPS)]
        state.channel(topic, SCAN, " ".join((frame, *limits)).encode())
        if (mounting := _mounting(laser, state)) is not None:
            text = pose_line("base_link", frame, mounting, at_ns)
            yield RawMessage(state.channel("/tf_static", TF), at_ns, text)
    yield RawMessage(state.channels[topic], at_ns, line)
    if not laser.odom_T_base or not laser.odom_T_laser or kind == "RLASER":
        return
    if state.poses != "odometry":
        text = pose_line("world", frame, laser.odom_T_laser, at_ns)
        yield RawMessage(state.channel("/truth", TRANSFORM), at_ns, text)
    if state.poses != "corrected" and not state.has_odometry_lines:
        text = pose_line("odom", "base_link", laser.odom_T_base, at_ns)
        yield RawMessage(state.channel("/odom", ODOMETRY), at_ns, text)


def _mounting(laser: LaserLine, state: _CarmenState) -> Pose | None:
    """Return ``base_T_laser`` from the poses of both, else from the parameters; None if unknown."""
    if state.poses == "odometry" and laser.odom_T_base and laser.odom_T_laser:
        return laser.odom_T_base.between(laser.odom_T_laser)
    name, yaw_rad = _OFFSETS.get(laser.kind, ("", 0.0))
    offset_m = state.parameters.get(name)
    return None if offset_m is None else Pose(float(offset_m), 0.0, yaw_rad)


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
