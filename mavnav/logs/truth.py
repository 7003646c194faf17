"""Recorded ground truth: poses of the robot by motion capture or a simulator, on a topic of the log."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from msgspec import Struct, field

from mavnav.errors import TopicError
from mavnav.logs.messages.definitions import ODOMETRY, POSE, TRANSFORM
from mavnav.logs.odometry import PoseTrack
from mavnav.logs.records import RecordedTruth
from mavnav.logs.transforms import frame_name, mounting
from mavnav.pose import Pose

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from mavnav.logs.log import Log
    from mavnav.logs.messages.records import TransformMessage
    from mavnav.logs.records import Channel, Topic
    from mavnav.logs.transforms import FrameTree

AUTO: Final = "auto"
TYPES: Final = frozenset({POSE, ODOMETRY, TRANSFORM})
NAMES: Final = re.compile(
    r"ground_?truth|(?:^|[/_])(?:gt|truth|mocap|vicon|optitrack|qualisys|vrpn)(?:[/_]|$)", re.IGNORECASE
)
"""Topic names that stand for ground truth; others may hold goals or estimates, and are never taken automatically."""


class TruthTracks(Struct):
    """The ground truth of a log by topic, as far as it is ``wanted``: ``auto``, a topic, or None for none at all."""

    wanted: str | None = None
    topics: dict[str, PoseTrack] = field(default_factory=dict)

    def takes(self, channel: Channel) -> bool:
        """Return whether the messages of a channel are wanted."""
        if self.wanted is None or channel.type not in TYPES:
            return False
        if self.wanted == AUTO:
            return NAMES.search(channel.topic) is not None
        return frame_name(channel.topic) == frame_name(self.wanted)

    def add(self, topic: str, message: TransformMessage, log_ns: int) -> None:
        """Take in one pose."""
        track = self.topics.get(topic)
        if track is None:
            track = self.topics[topic] = PoseTrack(topic, frame_name(message.child))
        track.add(message, log_ns)

    def choose(self, topics: Iterable[Topic]) -> PoseTrack | None:
        """Return the wanted track, None if none is wanted; ``topics`` are all of the log.

        Raises
        ------
        TopicError
            No ground truth on the wanted topic, or with ``auto`` none or several.
        """
        if self.wanted is None:
            return None
        tracks = {name: track for name, track in sorted(self.topics.items()) if len(track.stamps)}
        if len(tracks) == 1:
            return next(iter(tracks.values()))
        if tracks:
            names = ", ".join(f"{name} ({len(track.stamps)})" for name, track in tracks.items())
            raise TopicError(f"several ground truth topics: {names}; choose one with --truth topic:NAME")
        poses = ", ".join(f"{t.name} ({t.type}, {t.count})" for t in topics if t.type in TYPES) or "none"
        on = f"no ground truth on topic {self.wanted!r}"
        missing = "no topic is named like a ground truth" if self.wanted == AUTO else on
        raise TopicError(f"{missing}; topics with poses: {poses}; give --truth topic:NAME, or a file")


def laser_truth(
    track: PoseTrack,
    log: Log,
    frames: FrameTree,
    base_T_laser: Pose | None,
    extrinsic: Pose | None,
    warn: Callable[[str], None],
) -> RecordedTruth:
    """Return the true trajectory of the laser.

    Poses of the laser's own frame are used as they are. Others are those of a body that carries the laser: mounted by
    ``extrinsic``, else by the transforms from the body's frame, else like the base of the log. Without any of them the
    poses are taken as the laser's own, with a warning.
    """
    body_T_laser = Pose() if track.base_frame and track.base_frame == frame_name(log.frame_id) else extrinsic
    if body_T_laser is None and track.base_frame:
        mounted = mounting(frames, log.frame_id, [track.base_frame], warn)
        body_T_laser = mounted.base_T_laser if mounted else None
    body_T_laser = body_T_laser or base_T_laser
    if body_T_laser is None:
        text = f"no mounting of {log.frame_id!r} is known; the ground truth is taken as the laser's own"
        warn(f"{track.topic}: {text} (give the mounting with --extrinsic x,y,yaw)")
    world_T_laser = track.trajectory(log.stamp_source, warn).compose(body_T_laser or Pose())
    return RecordedTruth(track.topic, track.base_frame or None, world_T_laser)
