"""The survey: one pass over a log that collects all there is to know about it before it is used."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from msgspec import Struct, field
from msgspec.structs import replace

from mavnav.errors import MavnavError
from mavnav.logs.attitude import AttitudeTracks, ImuTrack
from mavnav.logs.content import check_file, check_files, check_window, reading, size_and_sha256
from mavnav.logs.formats import detect
from mavnav.logs.messages.decode import OTHER_TYPES, Waiting, decoder, is_laser, scan_topic, scan_topics
from mavnav.logs.messages.definitions import IMU, ODOMETRY, PATH, POSE, DecodeError
from mavnav.logs.preprocessing import ScanFilter
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import FRAME, Channel, LogContents, RawMessage, Topic, laser_topics, namespace
from mavnav.logs.segments import Recorded, SweepJoiners
from mavnav.logs.topic_scans import TopicScans
from mavnav.logs.trajectories import OdometryTracks, TruthTracks
from mavnav.logs.transforms import FrameTree, add_poses
from mavnav.profiling import as_stage

_PROGRESS_STEPS = 200
_MOST_WAITING_BYTES, _OVERHEAD_BYTES = 4 << 20, 100
MOST_SCAN_TOPICS = 100
"""Number of scan topics that are read unless one is named; no log has lasers of so many robots."""


class Survey(LogContents, frozen=True, kw_only=True):
    """What one pass over a log found, whether or not it can be used.

    ``scans`` holds the scan topics that have messages; a topic that was asked for alone. ``lasers`` are all topics that
    have messages of lasers.
    """

    lasers: tuple[str, ...]
    scans: dict[str, TopicScans]
    motion: Motion


class Motion(Struct):
    """What the messages of a log say about motion and mounting, besides the scans; ``frames`` by their namespace."""

    odometry: OdometryTracks
    truth: TruthTracks
    attitudes: AttitudeTracks
    imus: dict[str, ImuTrack] = field(default_factory=dict)
    frames: defaultdict[str, FrameTree] = field(default_factory=lambda: defaultdict(FrameTree))

    def takes(self, channel: Channel) -> bool:
        """Return whether single poses of a channel are wanted."""
        return any(tracks.takes(channel) for tracks in (self.truth, self.odometry, self.attitudes))

    def takers(self, channel: Channel) -> Iterator[Callable[[list[Any]], None]]:
        """Yield what takes in the messages of a channel that are no scans, in columns."""
        if self.attitudes.takes(channel):
            yield partial(self.attitudes.add, channel.topic)
        if self.truth.takes(channel):
            add = self.truth.add_path if channel.type == PATH else partial(add_poses, self.truth.topics)
            yield partial(add, channel.topic)
        elif channel.type == IMU:
            yield self.imus.setdefault(channel.topic, ImuTrack(channel.topic)).add
        elif channel.type == ODOMETRY or self.odometry.takes(channel):
            yield partial(add_poses, self.odometry.topics, channel.topic)
        elif channel.type != POSE:
            static = channel.topic.endswith("tf_static")
            yield partial(self.frames[namespace(channel.topic)].add, static=static)
            if not static:
                yield partial(self.odometry.add_transforms, channel.topic)
            if not static and self.truth.of_frames:
                yield partial(self.truth.add_transforms, channel.topic)


class _MessageKind(Struct):
    """What there is to know of a channel's messages; ``decode`` is None where there is no use for them.

    ``scans`` are those of the topic whose scans they are, None where they are none; others are ``waiting``.
    """

    decode: Callable[[bytes], Any] | None = None
    scans: TopicScans | None = None
    waiting: Waiting | None = None
    count: int = 0
    joiners: SweepJoiners | None = None


class _Pass(Struct):
    """The state of the pass, of a log in a file and ``more`` parts; ``progress`` gets the bytes done and in all."""

    path: Path
    more: tuple[Path, ...]
    progress: Callable[[int, int], None] | None
    topic: str | None
    strict: bool
    motion: Motion
    report: ReadReport = field(default_factory=ReadReport)
    kinds: dict[Channel, _MessageKind] = field(default_factory=dict)
    scans: dict[str, TopicScans] = field(default_factory=dict)
    waiting: dict[tuple[str, str, str], Waiting] = field(default_factory=dict)
    waiting_bytes: int = 0

    def run(self) -> None:
        """Take in all messages of the log."""
        report, next_bytes = self.report, 0
        for message in detect.read(self.path, report, self.more):
            self.take(message)
            if self.progress and report.done_bytes >= next_bytes:
                total = report.total_bytes
                self.progress(min(report.done_bytes, total), total)
                next_bytes = report.done_bytes + max(total // _PROGRESS_STEPS, 1)
        self.pass_on()
        for kind in self.kinds.values():
            if kind.scans and kind.joiners:
                for scan in kind.joiners.finish():
                    kind.scans.take(*scan)

    def take(self, message: RawMessage) -> None:
        """Take in one message; one that does not decode is noted and counted."""
        channel = message.channel
        kind = self.kinds.get(channel) or self._new_kind(channel)
        kind.count += 1
        if kind.decode is None:
            return
        if self.strict and message.suspect:
            if kind.scans:
                kind.scans.refuse("suspect")
            return
        if kind.waiting:
            kind.waiting.messages.append(message.data)
            kind.waiting.log_ns.append(message.log_ns)
            self.waiting_bytes += len(message.data) + _OVERHEAD_BYTES
            if self.waiting_bytes > _MOST_WAITING_BYTES:
                self.pass_on()
            return
        try:
            decoded = kind.decode(message.data)
        except DecodeError as error:
            self.report.damage(f"a message does not decode ({error})", f"{channel.topic}, {message.log_ns} ns")
            if kind.scans:
                kind.scans.refuse("undecodable")
            return
        if kind.scans and kind.joiners:
            for scan in kind.joiners.push(Recorded(decoded, message.log_ns, message.suspect)):
                kind.scans.take(*scan)

    def pass_on(self) -> None:
        """Decode the messages that wait, in the order in which their topics came."""
        for waiting in self.waiting.values():
            waiting.pass_on(self.report)
        self.waiting_bytes = 0

    def _new_kind(self, channel: Channel) -> _MessageKind:
        topic = scan_topic(channel, self.topic)
        kind = self.kinds[channel] = _MessageKind()
        if topic is None and is_laser(channel):
            return kind
        if topic is not None and topic not in self.scans and len(self.scans) >= MOST_SCAN_TOPICS:
            text = f"more than {MOST_SCAN_TOPICS} topics have scans"
            self.report.warn(f"{text}; others are left out, name one by --topic")
            return kind
        try:
            kind.decode = decoder(channel, poses=self.motion.takes(channel), topic=topic)
        except DecodeError as error:
            self.report.damage(str(error), channel.topic)
        if kind.decode and topic is not None:
            kind.scans = self.scans.setdefault(topic, TopicScans(ScanFilter(topic, self.report.warn)))
            kind.joiners = SweepJoiners(topic, self.report.warn)
        elif kind.decode:
            key = channel.topic, channel.type, channel.encoding
            waiting = Waiting(channel, kind.decode, tuple(self.motion.takers(channel)))
            kind.waiting = self.waiting.setdefault(key, waiting)
        return kind


@as_stage("reading")
def survey(
    path: Path,
    *,
    topic: str | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    progress: Callable[[int, int], None] | None = None,
    strict: bool = False,
    truth: str | None = None,
    odom: str = "auto",
    attitude: str = "auto",
    more: tuple[Path, ...] = (),
) -> Survey:
    """Read a log once, from front to back.

    Parameters
    ----------
    path
        A file, or the folder of a ROS 2 bag.
    topic
        Decode the scans of this topic alone, or of several, joined by commas.
    start_s, end_s
        Window of the scans to use, in seconds from the first usable scan.
    progress
        Called now and then with the bytes done and in all.
    strict
        Leave out scans from where a checksum does not match.
    truth
        Read the ground truth of this topic, or with ``auto`` of topics that are named like one. It is no odometry then.
    odom
        Read poses of this topic as odometry, too, whatever their type.
    attitude
        Read tilt and height of the laser from this topic, ``auto`` from where there are any, or not, with ``off``.
    more
        Files that are the further parts of the bag.

    Raises
    ------
    UsageError
        No such file, not a regular file or folder, not readable, files that are no parts of one bag, or an empty
        window. What is wrong with the content never raises: it stands in the survey.
    """
    check_files(path, more)
    check_window(start_s, end_s)

    def read(topic: str | None) -> Survey:
        motion = Motion(OdometryTracks(odom), TruthTracks(truth), AttitudeTracks(attitude))
        return _survey(_Pass(path, more, progress, topic, strict, motion), (start_s, end_s))

    contents = read(topic)
    others = [t.name for t in contents.topics if t.type in OTHER_TYPES and t.count]
    if topic is not None or contents.scans or len(others) != 1:
        return contents
    contents = read(others[0])
    text = f"the log has no LaserScan messages; the scans are taken from {others[0]}"
    return replace(contents, warnings=(text, *contents.warnings)) if contents.scans else contents


def _survey(state: _Pass, window_s: tuple[float | None, float | None]) -> Survey:
    report, path, more = state.report, state.path, state.more
    with reading(path):
        name = detect.sniff(path)
        if name == detect.UNKNOWN:
            report.damage(detect.refusal(path), path.name)
        else:
            state.run()
        size_bytes, sha256 = size_and_sha256(path, more)
    scans_of, topics = dict(_by_laser(state, report)), _topics(report, state.kinds)
    return Survey(
        path=path,
        format=name,
        size_bytes=size_bytes,
        sha256=sha256,
        topics=topics,
        lasers=tuple(laser_topics(topics)),
        scans=scans_of,
        motion=state.motion,
        damage=report.damages(),
        warnings=report.warnings,
        window_s=window_s,
        strict=state.strict,
        more=more,
    )


def _by_laser(state: _Pass, report: ReadReport) -> Iterator[tuple[str, TopicScans]]:
    """Yield the scans of every topic, or of every frame on it where it is of several lasers, or a frame is wanted."""
    wanted = scan_topics(state.topic or "")
    for topic, scans in state.scans.items():
        frames = scans.frames()
        chosen = [frame for frame in frames if f"{topic}{FRAME}{frame}" in wanted]
        if chosen or scans.is_of_several_lasers():
            yield from ((f"{topic}{FRAME}{frame}", scans.of_frame(frame)) for frame in chosen or frames)
            continue
        if len(frames) > 1:
            text = f"the frame of the scans changes on the way ({', '.join(frames[:4])}); the first is used"
            report.warn(f"{topic}: {text}")
        yield topic, scans


def motion_and_scan_topics(path: Path, most_s: float) -> tuple[set[str], set[str]]:
    """Return the topics of odometry and of scans that a log declares in what can be read of it in about ``most_s``.

    They are empty where the path is no log.
    """
    report, end_s = ReadReport(), monotonic() + most_s
    with suppress(OSError, MavnavError):
        check_file(path)
        for _ in detect.read(path, report):
            if monotonic() > end_s:
                break
    channels = report.channels.values()
    scans = {channel.topic for channel in channels if is_laser(channel) or channel.type in OTHER_TYPES}
    return {channel.topic for channel in channels if channel.type == ODOMETRY}, scans


def _topics(report: ReadReport, kinds: dict[Channel, _MessageKind]) -> tuple[Topic, ...]:
    counts = Counter[tuple[str, str, str]]()
    for channel in report.channels.values():
        counts[channel.topic, channel.type, channel.encoding] += kinds[channel].count if channel in kinds else 0
    return tuple(Topic(*key, count) for key, count in sorted(counts.items()))
