"""The records of a log: what containers hold, and what a survey finds in it."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.logs.odometry_chains import LeftOut
from mavnav.pose import Rotation, Trajectory


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
