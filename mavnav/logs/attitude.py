"""Tilt and height of bodies in a log: collected in one pass, for `levelling` to choose from."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field

from mavnav.errors import TopicError
from mavnav.logs.imu import usual_topic
from mavnav.logs.messages.definitions import IMU, ODOMETRY, POSE
from mavnav.logs.stamps import Stamps
from mavnav.logs.transforms import frame_name
from mavnav.pose import ups_of_quaternions

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from mavnav.logs.imu import ImuTracks
    from mavnav.logs.messages.records import TransformMessage
    from mavnav.logs.records import Channel, Topic

    Floats = NDArray[np.float64]

NAME: Final = "attitude"
"""The topic that ``auto`` uses however little the laser tilts."""

TYPES: Final = frozenset({POSE, ODOMETRY, IMU})


class AttitudeTrack(Struct):
    """The poses of a topic as they came, 36 bytes each: orientations as quaternions, and heights."""

    topic: str
    body_frame: str
    stamps: Stamps = field(default_factory=Stamps)
    numbers: array[float] = field(default_factory=lambda: array("f"))


class TopicAttitude(NamedTuple):
    """What one topic says: ``ups`` (n, 3) in the frame of the body, ``height_m`` (n,) of it, NaN if unknown."""

    topic: str
    kind: Literal["pose", "odom", "imu"]
    body_frame: str
    stamps: Stamps
    ups: Floats
    height_m: Floats


class AttitudeTracks(Struct):
    """All attitudes of a log by topic, but those of inertial sensors; ``wanted`` is auto, off, or a topic."""

    wanted: str = "auto"
    topics: dict[str, AttitudeTrack] = field(default_factory=dict)

    @property
    def is_named(self) -> bool:
        """Whether the user names the topic."""
        return self.wanted not in ("auto", "off")

    def takes(self, channel: Channel) -> bool:
        """Return whether the poses of a channel are of use."""
        if self.wanted == "off" or channel.type not in (POSE, ODOMETRY):
            return False
        named = frame_name(channel.topic) == frame_name(self.wanted if self.is_named else NAME)
        return named or (channel.type == ODOMETRY and not self.is_named)

    def add(self, topic: str, message: TransformMessage, log_ns: int) -> None:
        """Take in a pose."""
        track = self.topics.get(topic)
        if track is None:
            track = self.topics[topic] = AttitudeTrack(topic, frame_name(message.child))
        track.stamps.add(message.stamp_ns, log_ns)
        track.numbers.extend((*message.xyzw, message.xyz[2]))

    def sources(self, imus: ImuTracks, topics: Iterable[Topic]) -> list[TopicAttitude]:
        """Return what can be used, the best first; raises TopicError where the named topic holds no attitude."""
        if self.wanted == "off":
            return []
        wanted = frame_name(self.wanted if self.is_named else NAME)
        poses = sorted(self.topics.values(), key=lambda track: frame_name(track.topic) != wanted)
        sources = [_of_poses(track) for track in poses]
        imu = usual_topic([name for name in imus.topics if not self.is_named or frame_name(name) == wanted])
        sources += [] if imu is None else [_of_imu(imus, imu)]
        if self.is_named and not sources:
            raise TopicError(_no_attitude(self.wanted, topics))
        return sources


def _no_attitude(wanted: str, topics: Iterable[Topic]) -> str:
    topics = list(topics)
    able = ", ".join(f"{t.name} ({t.type}, {t.count})" for t in topics if t.type in TYPES) or "none"
    kind = next((t.type for t in topics if frame_name(t.name) == frame_name(wanted)), None)
    what = f"no topic {wanted!r}" if kind is None else f"{wanted} is of {kind}, which holds no attitude"
    if kind in TYPES:
        what = f"no message of {wanted} can be read"
    return f"--attitude: {what}; topics with poses or orientations: {able}; name one of them, or write --attitude off"


def _of_poses(track: AttitudeTrack) -> TopicAttitude:
    numbers = np.array(track.numbers, np.float64).reshape(-1, 5)
    kind: Literal["pose", "odom"] = "odom" if track.body_frame else "pose"
    ups = ups_of_quaternions(numbers[:, :4])
    return TopicAttitude(track.topic, kind, track.body_frame, track.stamps, ups, numbers[:, 4])


def _of_imu(imus: ImuTracks, topic: str) -> TopicAttitude:
    track = imus.topics[topic]
    ups = ups_of_quaternions(np.array(track.numbers, np.float64).reshape(-1, 10)[:, 6:])
    unknown = np.full(len(ups), np.nan)
    return TopicAttitude(topic, "imu", frame_name(track.frame_id), track.stamps, ups, unknown)
