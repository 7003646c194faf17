"""Turns, tilt and height of bodies in a log, collected in one pass, and brought to the laser.

An inertial sensor gives the yaw rate about the vertical, integrated, and the tilt. Of the attitudes the best source is
checked first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import pi
from typing import Final, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from mavnav.errors import TopicError
from mavnav.logs.derived_scans import MOST_RAD, RecordedAttitude
from mavnav.logs.log import Log
from mavnav.logs.messages.definitions import IMU, ODOMETRY, POSE, Measurements, Poses
from mavnav.logs.messages.fast_cdr import merge
from mavnav.logs.records import Channel, Imu, Topic, Warn, laser_topics, of_same_robot
from mavnav.logs.stamps import MessageTrack, Stamps, StampSource, in_order
from mavnav.logs.transforms import FrameTree, frame_name
from mavnav.pose import Rotation, ups_of_quaternions
from mavnav.units import DEG, NS

Floats = NDArray[np.float64]

USUAL_NAMES: Final = ("/imu/data", "/imu", "/imu/data_raw")
"""Of several topics of a robot the first of these is used."""

STANDARD_GRAVITY_M_S2: Final = 9.81
GRAVITY_SHARE: Final = 0.2
"""A mean acceleration that differs from gravity by more of it does not give the vertical; some sensors count in g."""

SMOOTHED_S: Final = 1.0
"""Accelerations are averaged over this time: what is left is gravity."""

LEAST_MESSAGES: Final = 10
MOST_RAD_S, MOST_M_S2 = 100.0, 1e4


class ImuTrack(MessageTrack):
    """The messages of an inertial sensor: rates, accelerations and orientation, 56 bytes each."""

    def add(self, parts: list[Measurements]) -> None:
        """Take in messages; those with rates or accelerations that are not finite, or impossible, are dropped."""
        part = merge(parts)
        rates, accelerations = part.angular_velocity_rad_s, part.acceleration_m_s2
        self.frame = self.frame or next((each.frame_id for each in parts if each.frame_id), "")
        possible = (np.abs(accelerations) <= MOST_M_S2).all(axis=0) & (np.abs(rates) <= MOST_RAD_S).all(axis=0)
        numbers = np.vstack((rates, accelerations, part.xyzw)).T
        self.extend(part.stamps_ns[possible], part.log_ns[possible], numbers[possible])

    def rotation(self, stamp_source: StampSource, half_sweep_ns: int, warn: Warn) -> Rotation | None:
        """Return the rotation at mid-sweep by the stamps of scans; None of too few messages."""
        stamps, recorded = self.stamps.by(stamp_source)
        keep = in_order(stamps, recorded, self.topic, warn)
        if len(keep) < LEAST_MESSAGES:
            if len(stamps) >= LEAST_MESSAGES:
                text = f"the stamps of the inertial sensor ascend in {len(keep)} of {len(stamps)} messages"
                warn(f"{self.topic}: {text}; it is not used, check its clock")
            return None
        numbers = self.rows(10)[keep]
        stamps, rates, ups = stamps[keep], numbers[:, :3], _ups(stamps[keep], numbers[:, 3:6], numbers[:, 6:])
        usual = _unit(np.median(ups, axis=0))
        about = np.einsum("ij,ij->i", rates, ups)
        turns: Floats = 0.5 * (about[1:] + about[:-1]) * np.diff(stamps) * NS
        tilt_rad = np.arccos(np.clip(ups @ usual, -1.0, 1.0))
        return Rotation(stamps - half_sweep_ns, np.concatenate(([0.0], np.cumsum(turns))), tilt_rad)


def _ups(stamps_ns: NDArray[np.int64], accelerations: Floats, xyzw: Floats) -> Floats:
    """Return the upward direction in the sensor's frame, (n, 3): by its orientation, else by gravity, else z."""
    if np.isfinite(xyzw).all() and (np.linalg.norm(xyzw, axis=1) > 0.5).all() and np.ptp(xyzw, axis=0).any():
        return ups_of_quaternions(xyzw)
    gravity = np.linalg.norm(np.median(accelerations, axis=0))
    in_m_s2, in_g = abs(gravity / STANDARD_GRAVITY_M_S2 - 1.0), abs(gravity - 1.0)
    if min(in_m_s2, in_g) > GRAVITY_SHARE:
        return np.tile((0.0, 0.0, 1.0), (len(accelerations), 1))
    return _unit(_smooth(stamps_ns, accelerations))


def _smooth(stamps_ns: NDArray[np.int64], values: Floats) -> Floats:
    """Return the means of values (n, 3) over windows of `SMOOTHED_S` about each."""
    half_ns = round(0.5 * SMOOTHED_S / NS)
    start, end = (np.searchsorted(stamps_ns, stamps_ns + off) for off in (-half_ns, half_ns + 1))
    sums = np.vstack((np.zeros(3), np.cumsum(values, axis=0)))
    return np.asarray((sums[end] - sums[start]) / (end - start)[:, None])


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9))


def usual_topic(names: list[str], scan_topic: str, scan_topics: Iterable[str]) -> str | None:
    """Return which of several topics to use for a scan topic, of all that the log has; None if that is not clear.

    Of those of its robot it is the first of the usual names, or the only one.
    """
    own = of_same_robot(names, scan_topic, scan_topics)
    named = ((name, name.removesuffix(end)) for end in USUAL_NAMES for name in own if name.endswith(end))
    usual = (name for name, space in named if scan_topic.startswith(f"{space}/"))
    return next(usual, own[0] if len(own) == 1 else None)


def laser_rotation(tracks: dict[str, ImuTrack], log: Log, odom: str, warn: Warn) -> Imu | None:
    """Return the sensor to use of those of a log, by topic, at mid-sweep; None without one, or with ``odom`` off.

    Of several of the robot without a usual name none is used, with a warning.
    """
    names = [name for name, track in tracks.items() if len(track.stamps)]
    if odom == "off" or not names:
        return None
    usual = usual_topic(names, log.topic, laser_topics(log.topics))
    if usual is None:
        if own := of_same_robot(names, log.topic, laser_topics(log.topics)):
            warn(f"several Imu topics, none is used: {', '.join(own)}")
        return None
    rotation = tracks[usual].rotation(log.stamp_source, round(0.5 * log.sensor.sweep_s / NS), warn)
    if rotation and not log.shares_time(rotation.stamps_ns):
        warn(f"{usual}: inertial sensor and scans share no time; it is not used, check its clock")
        return None
    return Imu(usual, rotation) if rotation else None


NAME: Final = "attitude"
"""The topic that ``auto`` uses however little the laser tilts."""

TYPES: Final = frozenset({POSE, ODOMETRY, IMU})

LEAST_RAD, LEAST_SHARE = 5 * DEG, 0.1
"""Sensors of other names are used if so much of the time the laser tilts by more than this from how it usually is."""


class TopicAttitude(NamedTuple):
    """What one topic says: ``ups`` (n, 3) in the frame of the body, ``height_m`` (n,) of it, NaN if unknown."""

    topic: str
    kind: Literal["pose", "odom", "imu"]
    body_frame: str
    stamps: Stamps
    ups: Floats
    height_m: Floats


class AttitudeTracks(Struct):
    """All attitudes of a log by topic, but those of inertial sensors; ``wanted`` is auto, off, or a topic.

    Of each message the orientation, a quaternion, and the height are kept.
    """

    wanted: str = "auto"
    topics: dict[str, MessageTrack] = field(default_factory=dict)

    @property
    def is_named(self) -> bool:
        """Whether the user names the topic."""
        return self.wanted not in ("auto", "off")

    def takes(self, channel: Channel) -> bool:
        """Return whether the poses of a channel are of use."""
        if self.wanted == "off" or channel.type not in (POSE, ODOMETRY):
            return False
        named = frame_name(channel.topic) == frame_name(self.wanted) if self.is_named else is_usual(channel.topic)
        return named or (channel.type == ODOMETRY and not self.is_named)

    def add(self, topic: str, parts: list[Poses]) -> None:
        """Take in messages of one pose each."""
        poses = merge(parts)
        track = self.topics.setdefault(topic, MessageTrack(topic, frame_name(poses.child)))
        track.extend(poses.stamps_ns, poses.log_ns, np.vstack((poses.xyzw, poses.xyz[2:])).T)

    def sources(self, imus: dict[str, ImuTrack], log: Log) -> list[TopicAttitude]:
        """Return what can be used, the best first; raises TopicError where the named topic holds no attitude."""
        if self.wanted == "off" or not (self.is_named or self.topics or imus):
            return []
        lasers, topics = laser_topics(log.topics), log.topics
        names = self.topics if self.is_named else of_same_robot(self.topics, log.topic, lasers)
        sources = [_of_poses(self.topics[name]) for name in sorted(names, key=lambda name: not is_usual(name))]
        named = [name for name in imus if frame_name(name) == frame_name(self.wanted)]
        imu = next(iter(named), None) if self.is_named else usual_topic([*imus], log.topic, lasers)
        sources += [] if imu is None else [_of_imu(imus[imu])]
        if self.is_named and not sources:
            raise TopicError(_no_attitude(self.wanted, topics))
        return sources


def is_usual(topic: str) -> bool:
    """Return whether a topic, of any robot, is named as attitudes are."""
    return topic.rsplit("/", 1)[-1] == NAME


def _no_attitude(wanted: str, topics: Iterable[Topic]) -> str:
    topics = list(topics)
    able = ", ".join(f"{t.name} ({t.type}, {t.count})" for t in topics if t.type in TYPES) or "none"
    kind = next((t.type for t in topics if frame_name(t.name) == frame_name(wanted)), None)
    what = f"no topic {wanted!r}" if kind is None else f"{wanted} is of {kind}, which holds no attitude"
    if kind in TYPES:
        what = f"no message of {wanted} can be read"
    return f"--attitude: {what}; topics with poses or orientations: {able}; name one of them, or write --attitude off"


def _of_poses(track: MessageTrack) -> TopicAttitude:
    xyzw, height_m = np.split(track.rows(5), [4], axis=1)
    kind: Literal["pose", "odom"] = "odom" if track.frame else "pose"
    return TopicAttitude(track.topic, kind, track.frame, track.stamps, ups_of_quaternions(xyzw), height_m[:, 0])


def _of_imu(track: ImuTrack) -> TopicAttitude:
    ups = ups_of_quaternions(track.rows(10)[:, 6:])
    unknown = np.full(len(ups), np.nan)
    return TopicAttitude(track.topic, "imu", frame_name(track.frame), track.stamps, ups, unknown)


def laser_attitude(
    tracks: AttitudeTracks, imus: dict[str, ImuTrack], frames: FrameTree, log: Log, warn: Warn
) -> RecordedAttitude | None:
    """Return the attitude of the laser of ``log`` from the first source that can be used; None without any.

    Poses (PoseStamped) are those of the laser. Orientations of another frame are brought to the laser by the static
    transforms, without which only a topic that the user names is used. Scans without an attitude, and what else is
    odd, are reported to ``warn``.

    Raises
    ------
    TopicError
        The named topic holds nothing that can be used.
    """
    stamps_ns, laser_frame = log.mounting.stamps_ns, frame_name(log.frame_id)
    for source in tracks.sources(imus, log):
        body_T_laser = _mounting(source, frames, laser_frame)
        left_out: list[str] = []
        mounted = np.eye(4) if body_T_laser is None else body_T_laser
        attitude = _recorded_attitude(source, mounted, log, left_out.append)
        wanted = tracks.is_named or is_usual(source.topic)
        if not wanted and not _tilts(attitude):
            continue
        if body_T_laser is None:
            text = f"{source.topic}: no transform from {source.body_frame!r} to {laser_frame!r}"
            if not wanted:
                warn(f"{text}; its tilt is not used (record /tf_static, or give --attitude {source.topic})")
                continue
            warn(f"{text}; their axes are taken as parallel")
        problem = _problem(attitude, stamps_ns)
        if problem and tracks.is_named:
            raise TopicError(f"{source.topic}: {problem}, or write --attitude off")
        for text in [f"{problem}; it is not used"] if problem else _oddities(source, attitude, stamps_ns):
            warn(f"{source.topic}: {text}")
        for text in left_out:
            warn(text)
        return None if problem else attitude
    return None


def _mounting(source: TopicAttitude, frames: FrameTree, laser_frame: str) -> NDArray[np.floating] | None:
    if source.kind == "pose" or source.body_frame == laser_frame:
        return np.eye(4)
    return frames.find(source.body_frame, laser_frame)


def _recorded_attitude(
    source: TopicAttitude, body_T_laser: NDArray[np.floating], log: Log, warn: Warn
) -> RecordedAttitude:
    """Return the attitude of the laser, as seen from above, without messages that are not finite or not in order."""
    finite = _finite(source)
    stamps_ns, recorded_ns = (each[finite] for each in source.stamps.by(log.stamp_source))
    order = in_order(stamps_ns, recorded_ns, source.topic, warn)
    stamps_ns, ups, height_m = stamps_ns[order], source.ups[finite][order], source.height_m[finite][order]
    height_m = height_m + ups @ body_T_laser[:3, 3]
    if len(height_m) and height_m.min() <= 0.0:
        height_m = np.full(len(height_m), np.nan)
    x, y, z = (ups @ body_T_laser[:3, :3]).T
    if log.upside_down and source.kind != "pose":
        y, z = -y, -z
    return RecordedAttitude(
        source.topic, source.kind, stamps_ns, np.arctan2(y, z), -np.arcsin(np.clip(x, -1.0, 1.0)), height_m
    )


def _tilts(attitude: RecordedAttitude) -> bool:
    """Return whether the laser tilts often and by much from how it usually is."""
    if not len(attitude.stamps_ns):
        return False
    off = [(v - np.median(v) + pi) % (2 * pi) - pi for v in (attitude.roll_rad, attitude.pitch_rad)]
    return float((np.hypot(*off) > LEAST_RAD).mean()) >= LEAST_SHARE


def _problem(attitude: RecordedAttitude, stamps_ns: NDArray[np.int64]) -> str:
    """Return why an attitude cannot be used at all; empty if it can."""
    if not len(attitude.stamps_ns):
        return "no attitude in it is finite; see what publishes it"
    known = attitude.known_at(stamps_ns)
    if not known.any():
        return "attitude and scans share no time; check its clock"
    if (attitude.tilts_at(stamps_ns[known]) > MOST_RAD).all():
        return "all scans are tilted by more than 60 deg; check its axes (x forward, z up) and the mounting"
    return ""


def _oddities(source: TopicAttitude, attitude: RecordedAttitude, stamps_ns: NDArray[np.int64]) -> Iterator[str]:
    """Say what of an attitude, or of which scans, is not used."""
    n, known = len(stamps_ns), attitude.known_at(stamps_ns)
    bad = int((~_finite(source)).sum())
    if bad:
        yield f"{bad} of {len(source.ups)} attitudes are not finite; they are left out, see what publishes them"
    if not known.all():
        first_s, last_s = ((stamps_ns[~known] - stamps_ns[0]) * NS)[[0, -1]]
        text = f"{int((~known).sum())} of {n} scans, from {first_s:.1f} to {last_s:.1f} s, have no attitude in 0.5 s"
        yield f"{text}; they are not used: record it for the whole log, or cut the log with --start and --end"
    tilts_rad = attitude.tilts_at(stamps_ns[known])
    if (steep := tilts_rad > MOST_RAD).any():
        most_deg = tilts_rad.max() / DEG
        text = f"{int(steep.sum())} of {n} scans are tilted by more than 60 deg, by up to {most_deg:.0f} deg"
        yield f"{text}; they are not used, check its axes (x forward, z up) and the mounting"
    if source.kind != "imu" and not attitude.has_heights:
        yield "the heights (position.z) are not all above the floor; they are not used, and there are no slices"


def _finite(source: TopicAttitude) -> NDArray[np.bool_]:
    """Return which attitudes are finite, (n,); an inertial sensor knows no height."""
    known = np.isfinite(source.ups).all(axis=1)
    return np.asarray(known if source.kind == "imu" else known & np.isfinite(source.height_m))
