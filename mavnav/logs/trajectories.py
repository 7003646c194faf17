"""Trajectories in a log, odometry and ground truth by motion capture or a simulator: collected first, chosen then."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Final

from msgspec import Struct, field

from mavnav.errors import TopicError
from mavnav.logs.log import Log
from mavnav.logs.messages.definitions import ODOMETRY, PATH, POSE, POSE_COVARIANCE, TRANSFORM, Poses
from mavnav.logs.messages.fast_cdr import merge, merge_by
from mavnav.logs.odometry_chains import without_jumps
from mavnav.logs.records import Channel, Odometry, RecordedTruth, Topic, Warn, laser_topics, of_same_robot
from mavnav.logs.transforms import TF_PREFIX, FramePoses, FrameTree, PoseTrack, frame_name, mounting
from mavnav.pose import Pose

TF_TOPIC = "/tf"
_ODOM_FRAME = "odom"

TRUTH_TYPES: Final = frozenset({POSE, ODOMETRY, TRANSFORM})
NAMED_TYPES: Final = TRUTH_TYPES | {PATH, POSE_COVARIANCE}
"""Types of a topic that is named: a path or a pose with a covariance is an estimate, and never found by ``auto``."""

TRUTH_NAMES: Final = re.compile(
    r"ground_?truth|(?:^|[/_])(?:gt|truth|mocap|vicon|optitrack|qualisys|vrpn)(?:[/_]|$)", re.IGNORECASE
)
"""Topic names that stand for ground truth; others may hold goals or estimates, and are never taken automatically."""


class OdometryTracks(Struct):
    """All odometry of a log: nav_msgs/Odometry by topic, and the edges of /tf that start at an ``odom`` frame.

    Single poses and transforms, as of motion capture, are odometry on the ``wanted`` topic alone.
    """

    wanted: str = "auto"
    topics: dict[str, PoseTrack] = field(default_factory=dict)
    transforms: dict[tuple[str, str], PoseTrack] = field(default_factory=dict)

    def takes(self, channel: Channel) -> bool:
        """Return whether the poses of a channel are wanted as odometry."""
        named = self.wanted not in ("auto", "off") and frame_name(channel.topic) == frame_name(self.wanted)
        return named and channel.type in (POSE, TRANSFORM)

    def add_transforms(self, topic: str, parts: list[Poses]) -> None:
        """Take in the transforms of /tf messages."""
        of_odom = (part for part in parts if frame_name(part.parent).rsplit("/", 1)[-1] == _ODOM_FRAME)
        for child, poses in merge_by(of_odom, lambda part: frame_name(part.child)).items():
            key = topic, child
            self.transforms.setdefault(key, PoseTrack(*key, source="tf")).add(poses)

    def choose(
        self, warn: Warn, leads_to_laser: Callable[[str], bool], topic: str, scan_topics: Sequence[str]
    ) -> PoseTrack | None:
        """Return the track to use: what is ``wanted``, a topic, ``off`` or ``auto``.

        The latter is the only nav_msgs/Odometry topic of the laser's robot, or the one named ``odom``, or the odometry
        of /tf; never one that is named like a ground truth.

        Parameters
        ----------
        warn
            Takes a line where ``auto`` cannot choose.
        leads_to_laser
            Whether the transforms lead from a frame to the laser; tracks of such frames are preferred.
        topic
            That of the scans; odometry of its robot is taken.
        scan_topics
            All scan topics of the log.

        Raises
        ------
        TopicError
            The topic asked for holds no odometry.
        """
        if self.wanted == "off":
            return None
        if self.wanted == "auto":
            return self._choose_auto(warn, leads_to_laser, topic, scan_topics)
        track = self.topics.get(self.wanted)
        if track is None and frame_name(self.wanted) == frame_name(TF_TOPIC):
            track = self._of_tf(leads_to_laser, topic, scan_topics)
        if track is None:
            known = ", ".join([*self.topics, *([TF_TOPIC] if self.transforms else [])])
            advice = f"name one that the log holds: {known}" if known else "the log holds none, leave --odom out"
            if self.wanted.lower() in ("auto", "off"):
                advice = f"write it in small letters, --odom {self.wanted.lower()}"
            raise TopicError(f"no odometry on topic {self.wanted!r}; {advice}")
        return track

    def _choose_auto(
        self, warn: Warn, leads_to_laser: Callable[[str], bool], topic: str, scan_topics: Sequence[str]
    ) -> PoseTrack | None:
        own = of_same_robot(self.topics, topic, scan_topics)
        truths = [name for name in own if TRUTH_NAMES.search(name)]
        for name in truths:
            text = f"compare with it by --truth topic:{name}, or use it with --odom {name}"
            warn(f"{name} is named like a ground truth and not used as odometry: {text}")
        own = of_same_robot((name for name in own if name not in truths), topic, scan_topics)
        fit = [name for name in own if leads_to_laser(self.topics[name].frame)] or own
        named = [name for name in fit if name.rsplit("/", 1)[-1] == _ODOM_FRAME]
        named = [name for name in named if all(name.count("/") < other.count("/") for other in named if other != name)]
        if len(fit) == 1 or len(named) == 1:
            return self.topics[[*named, *fit][0]]
        if fit:
            warn(f"several odometry topics, none is used: {', '.join(fit)}; choose with --odom TOPIC")
            return None
        return self._of_tf(leads_to_laser, topic, scan_topics)

    def _of_tf(self, leads_to_laser: Callable[[str], bool], topic: str, scan_topics: Sequence[str]) -> PoseTrack | None:
        """Return the track of the laser's robot, of several the one with the most poses."""
        own = of_same_robot((track.topic for track in self.transforms.values()), topic, scan_topics)
        tracks = [track for track in self.transforms.values() if track.topic in own]
        return max(tracks, key=lambda track: (leads_to_laser(track.frame), len(track.stamps)), default=None)


def laser_odometry(
    track: PoseTrack, log: Log, base_frame: str | None, base_T_laser: Pose | None, warn: Warn
) -> Odometry | None:
    """Return the odometry of a track, without jumps; None, with a warning, where it does not fit the scans."""
    odom_T_base, added_s = track.trajectory(log, warn)
    if not len(odom_T_base):
        return None
    if not log.shares_time(odom_T_base.stamps_ns):
        warn(f"{track.topic}: odometry and scans share no time; it is not used, check its clock")
        return None
    if base_T_laser is None:
        text = f"no transform from {base_frame!r} to {log.frame_id!r}; the odometry is taken as the laser's own"
        warn(f"{text} (give the mounting with --extrinsic x,y,yaw)")
    recorded_ns = odom_T_base.stamps_ns
    odom_T_base, left_out = without_jumps(odom_T_base)
    if left_out:
        warn(f"{track.topic}: {left_out.text}")
    odom_T_laser = odom_T_base.compose(base_T_laser or Pose())
    return Odometry(track.topic, track.source, odom_T_base, odom_T_laser, left_out, added_s, recorded_ns)


class TruthTracks(Struct):
    """The ground truth of a log by topic, as far as it is ``wanted``: ``auto``, a topic, or None for none at all.

    If the poses of a frame are wanted, ``tf:MAP,FRAME``, ``moving`` are the transforms of /tf by parent and child.
    """

    wanted: str | None = None
    topics: dict[str, PoseTrack] = field(default_factory=dict)
    moving: dict[tuple[str, str], PoseTrack] = field(default_factory=dict)

    @property
    def of_frames(self) -> bool:
        """Whether the poses of a frame are wanted."""
        return (self.wanted or "").startswith(TF_PREFIX)

    def takes(self, channel: Channel) -> bool:
        """Return whether the messages of a channel are wanted."""
        if self.wanted is None or channel.type not in NAMED_TYPES:
            return False
        if self.wanted == "auto":
            return channel.type in TRUTH_TYPES and TRUTH_NAMES.search(channel.topic) is not None
        return frame_name(channel.topic) == frame_name(self.wanted)

    def add_path(self, topic: str, parts: list[Poses]) -> None:
        """Take in paths, each of which replaces the one before."""
        poses = merge(parts)
        self.topics[topic] = PoseTrack(topic, "", is_path=True)
        self.topics[topic].add(poses.of_message(int(poses.rows[-1])))

    def add_transforms(self, topic: str, parts: list[Poses]) -> None:
        """Take in the transforms of /tf messages."""
        for edge, poses in merge_by(parts, lambda part: (frame_name(part.parent), frame_name(part.child))).items():
            self.moving.setdefault(edge, PoseTrack(topic, edge[1])).add(poses)

    def choose(
        self, topics: Sequence[Topic], topic: str, frames: FrameTree, laser: str
    ) -> PoseTrack | FramePoses | None:
        """Return the wanted track, None if none is wanted; of all ``topics``, for the scans on ``topic``.

        Without a frame in ``tf:MAP``, it is that of the ``laser``.

        Raises
        ------
        TopicError
            No ground truth on the wanted topic, or with ``auto`` none or several.
        """
        if self.wanted is None:
            return None
        if self.of_frames:
            return FramePoses(self.wanted, frame_name(self.wanted.partition(",")[2]) or laser, frames, self.moving)
        own = of_same_robot(self.topics, topic, laser_topics(topics)) if self.wanted == "auto" else [*self.topics]
        tracks = {name: self.topics[name] for name in sorted(own) if len(self.topics[name].stamps)}
        if len(tracks) == 1:
            return next(iter(tracks.values()))
        if tracks:
            names = ", ".join(f"{name} ({len(track.stamps)})" for name, track in tracks.items())
            raise TopicError(f"several ground truth topics: {names}; choose one with --truth topic:NAME")
        poses = ", ".join(f"{t.name} ({t.type}, {t.count})" for t in topics if t.type in NAMED_TYPES) or "none"
        on = f"no poses on topic {self.wanted!r}"
        missing = "no topic is named like a ground truth" if self.wanted == "auto" else on
        raise TopicError(f"{missing}; topics with poses: {poses}; give topic:NAME of one with poses, or a file")


def laser_truth(
    track: PoseTrack | FramePoses,
    log: Log,
    frames: FrameTree,
    base_T_laser: Pose | None,
    extrinsic: Pose | None,
    warn: Warn,
) -> RecordedTruth:
    """Return the true trajectory of the laser.

    Poses of the laser's own frame are used as they are. Others are those of a body that carries the laser: mounted by
    ``extrinsic``, else by the transforms from the body's frame, else like the base of the log. Without any of them the
    poses are taken as the laser's own, with a warning.
    """
    body_T_laser = Pose() if track.frame and track.frame == frame_name(log.frame_id) else extrinsic
    if body_T_laser is None and track.frame:
        mounted = mounting(frames, log.frame_id, [track.frame], warn)
        body_T_laser = mounted.base_T_laser if mounted else None
    body_T_laser = body_T_laser or base_T_laser
    if body_T_laser is None:
        text = f"no mounting of {log.frame_id!r} is known; the ground truth is taken as the laser's own"
        warn(f"{track.topic}: {text} (give the mounting with --extrinsic x,y,yaw)")
    world_T_body, _ = track.trajectory(log, warn)
    return RecordedTruth(track.topic, track.frame or None, world_T_body.compose(body_T_laser or Pose()))
