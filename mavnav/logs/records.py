"""The records of a log: what containers hold, what a survey finds in it, and whose the topics are.

There may be several robots, or several lasers, in one log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import takewhile
from pathlib import Path
from string import digits
from typing import Final, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.logs.messages.definitions import FOXGLOVE_SCAN, MULTI_ECHO, SCAN
from mavnav.logs.odometry_chains import LeftOut
from mavnav.pose import Rotation, Trajectory

Warn = Callable[[str], None]
"""Takes a line about something odd."""


class Schema(Struct, frozen=True):
    """The definition of a message type as stored: a text or a descriptor, by the name that the log gives it."""

    name: str = ""
    encoding: str = ""
    data: bytes = b""


class Channel(Struct, frozen=True):
    """A stream of messages of one type on one topic.

    ``type`` is spelt as in ROS 2 (``sensor_msgs/msg/LaserScan``), also where the log is of ROS 1; empty where it is
    written nowhere. ``metadata`` is what the log says besides, as the quality of service, by the names of MCAP.
    """

    topic: str
    type: str
    encoding: str
    schema: Schema = Schema()
    metadata: tuple[tuple[str, str], ...] = ()


class RawMessage(NamedTuple):
    """One message as stored. ``log_ns`` is the time at which it was recorded, ``publish_ns`` that of sending, if known.

    A ``suspect`` one comes from where a checksum does not match, or could not be checked.
    """

    channel: Channel
    log_ns: int
    data: bytes
    suspect: bool = False
    publish_ns: int | None = None


class AttachedFile(Struct, frozen=True):
    """A file that an MCAP contains besides messages: its times in ns, its name, and its content."""

    log_ns: int
    created_ns: int
    name: str
    media_type: str
    data: bytes


class MetadataRecord(Struct, frozen=True):
    """A record of texts by name that an MCAP contains besides messages."""

    name: str
    values: dict[str, str]


QOS: Final = "offered_qos_profiles"
"""Key of the quality of service in a channel's metadata, a text in YAML."""

LATCHING: Final = "latching"
"""Key of whether ROS 1 sends the last message to late subscribers."""


class Topic(Struct, frozen=True):
    """A topic as a log lists it, with the number of messages read."""

    name: str
    type: str
    encoding: str
    count: int


class Damage(Struct, frozen=True):
    """Something of the input that could not be read, or is suspect, and where."""

    what: str
    where: str


class LogContents(Struct, frozen=True, kw_only=True):
    """A log as a whole, whatever is used of it: its files, its topics, and what is odd or damaged; see `Log`."""

    path: Path
    format: str
    size_bytes: int
    sha256: str
    topics: tuple[Topic, ...]
    damage: tuple[Damage, ...]
    warnings: tuple[str, ...]
    window_s: tuple[float | None, float | None]
    strict: bool
    more: tuple[Path, ...] = ()


class Gap(Struct, frozen=True):
    """A pause between two usable scans, much longer than the usual period."""

    start_ns: int
    duration_s: float


class ScanCounts(Struct, frozen=True):
    """What became of the scan messages: ``total`` is ``usable`` and all the skipped.

    ``suspect`` of the usable ones come from where a checksum does not match, or could not be checked, and ``repeated``
    have the ranges of the one before.
    """

    total: int
    usable: int
    skipped: dict[str, int]
    suspect: int = 0
    repeated: int = 0


class Odometry(Struct, frozen=True):
    """Odometry of a log: the base's and the laser's poses in the odometry frame, at the same stamps.

    Without a known mounting the laser is taken to sit on the base's origin. ``left_out`` is what was not used of it,
    ``clock_s`` the time that was added to its stamps, s, because its clock is another than that of the scans.
    ``recorded_ns`` (n,) are the stamps of all its poses.
    """

    topic: str
    source: Literal["odom", "tf"]
    odom_T_base: Trajectory
    odom_T_laser: Trajectory
    left_out: LeftOut | None = None
    clock_s: float = 0.0
    recorded_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))


class Imu(Struct, frozen=True):
    """What an inertial sensor of a log measured of the laser's rotation."""

    topic: str
    rotation: Rotation

    def without_tilt(self) -> Imu:
        """Return the same without its tilt, of scans that were levelled."""
        return replace(self, rotation=replace(self.rotation, tilt_rad=np.zeros(len(self.rotation.tilt_rad))))


class RecordedTruth(Struct, frozen=True):
    """The ground truth of a log: the laser's poses in a fixed frame. ``body_frame`` is what was tracked, if stored."""

    topic: str
    body_frame: str | None
    world_T_laser: Trajectory


def ros_type(name: str) -> str:
    """Spell the type names of ROS 1 (``sensor_msgs/LaserScan``) and DDS (``sensor_msgs::msg::dds_::LaserScan_``).

    As ROS 2 does; others are left alone.
    """
    if "::dds_::" in name:
        return name.replace("::dds_::", "::").replace("::", "/").removesuffix("_")
    package, slash, kind = name.partition("/")
    return f"{package}/msg/{kind}" if slash and "/" not in kind else name


FRAME: Final = "@"
"""Between a topic and a frame, where one topic has the scans of several lasers; no ROS name contains it."""

_OF_LASERS = frozenset({SCAN, FOXGLOVE_SCAN, MULTI_ECHO})


def namespace(name: str) -> str:
    """Return the namespace of a frame or a topic, empty for none: all before its last slash."""
    return name.rpartition("/")[0]


def topic_and_frame(name: str) -> tuple[str, str | None]:
    """Split the name of a scan topic into the topic and the frame of its laser, None for any."""
    topic, separator, frame = name.partition(FRAME)
    return topic, frame if separator else None


def shared_levels(a: str, b: str) -> int:
    """Count the levels that the namespaces of two topics share, from the root on."""
    return len([*takewhile(lambda pair: pair[0] == pair[1], zip(_levels(a), _levels(b), strict=False))])


def _levels(name: str) -> list[str]:
    return [level for level in namespace(name).split("/") if level]


def laser_topics(topics: Iterable[Topic]) -> list[str]:
    """Return the topics that have messages of lasers."""
    return [topic.name for topic in topics if topic.type in _OF_LASERS and topic.count]


def is_of_another_robot(name: str, topic: str, scan_topics: Iterable[str]) -> bool:
    """Return whether a topic is not of the robot of a scan topic: nearer to another one, or of another number."""
    shared = shared_levels(name, topic)
    if any(shared_levels(name, other) > shared for other in scan_topics):
        return True
    level, other = (levels[shared] if len(levels := _levels(each)) > shared else "" for each in (name, topic))
    return level != other and bool(level) and level.rstrip(digits) == other.rstrip(digits) != ""


def of_same_robot(names: Iterable[str], topic: str, scan_topics: Iterable[str]) -> list[str]:
    """Return those topics that are of the robot of a scan topic, the nearest in their namespaces.

    So, beside /robot2/scan, /robot2/odom is never that of /robot1/scan, while /odom is if there is no /robot1/odom.
    """
    others = [*scan_topics]
    own = [name for name in names if not is_of_another_robot(name, topic, others)]
    nearest = max((shared_levels(name, topic) for name in own), default=0)
    return [name for name in own if shared_levels(name, topic) == nearest]
