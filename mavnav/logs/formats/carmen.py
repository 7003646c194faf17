"""Reader of CARMEN logs: one line of text per message, with poses from odometry or a SLAM system in the scan lines.

Format: CARMEN's logger (https://carmen.sourceforge.net/logger_playback.html). A line ends with the time of its message,
the name of a computer, and the time since the logger started.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from enum import Enum
from itertools import islice
from pathlib import Path
from typing import IO, Final

from msgspec import Struct, field

from mavnav.logs.messages.carmen import ENCODING, LaserLine, laser_of, pose_line, pose_of, stamp_ns
from mavnav.logs.messages.definitions import ODOMETRY, SCAN, TF, TRANSFORM
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel, RawMessage, Schema
from mavnav.pose import Pose

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


class PoseKind(Enum):
    """Source of the poses in the scan lines: odometry, odometry and a SLAM system, or a SLAM system alone."""

    ODOMETRY = "odometry"
    BOTH = "both"
    CORRECTED = "corrected"


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
        if state.poses is PoseKind.CORRECTED:
            report.warn("the poses in the log are those of a SLAM and no odometry; --truth auto compares with them")
        file.seek(0)
        for number, line in enumerate(_lines(file), start=1):
            report.at(report.here_bytes + len(line))
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
        return PoseKind.CORRECTED, bool(by_time)
    moved = any(mounting.gap(mountings[0])[0] > _ROUNDING_M for mounting in mountings)
    return PoseKind.BOTH if moved else PoseKind.ODOMETRY, bool(by_time)


def _messages(line: bytes, state: _CarmenState) -> Iterator[RawMessage]:
    """Yield the messages of a line: a scan with its poses, odometry, or nothing."""
    if LASER_LINE.match(line):
        yield from _scan(line, state)
    elif line.startswith(b"PARAM "):
        _, name, value, *_ = line.decode(errors="replace").split()
        if name in _NUMBERS:
            state.parameters[name] = repr(float(value))
    elif line.startswith(b"ODOM ") and state.poses is not PoseKind.CORRECTED:
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
    if state.poses is not PoseKind.ODOMETRY:
        text = pose_line("world", frame, laser.odom_T_laser, at_ns)
        yield RawMessage(state.channel("/truth", TRANSFORM), at_ns, text)
    if state.poses is not PoseKind.CORRECTED and not state.has_odometry_lines:
        text = pose_line("odom", "base_link", laser.odom_T_base, at_ns)
        yield RawMessage(state.channel("/odom", ODOMETRY), at_ns, text)


def _mounting(laser: LaserLine, state: _CarmenState) -> Pose | None:
    """Return ``base_T_laser`` from the poses of both, else from the parameters; None if unknown."""
    if state.poses is PoseKind.ODOMETRY and laser.odom_T_base and laser.odom_T_laser:
        return laser.odom_T_base.between(laser.odom_T_laser)
    name, yaw_rad = _OFFSETS.get(laser.kind, ("", 0.0))
    offset_m = state.parameters.get(name)
    return None if offset_m is None else Pose(float(offset_m), 0.0, yaw_rad)
