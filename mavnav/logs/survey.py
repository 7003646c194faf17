"""The survey: one pass over a log that collects all there is to know about it before it is used."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from contextlib import suppress
from functools import partial
from math import isfinite
from time import monotonic
from typing import TYPE_CHECKING, Any

from msgspec import Struct, field
from msgspec.structs import replace

from mavnav.errors import MavnavError, NoScansError, UsageError, lacks_memory
from mavnav.logs.attitude import AttitudeTracks
from mavnav.logs.formats import detect
from mavnav.logs.formats.rosbag2 import METADATA
from mavnav.logs.formats.source import Source
from mavnav.logs.imu import ImuTracks
from mavnav.logs.messages.decode import decoder, is_laser, scan_topic
from mavnav.logs.messages.definitions import IMU, ODOMETRY, POSE
from mavnav.logs.messages.other_scans import OTHER_TYPES
from mavnav.logs.messages.records import DecodeError
from mavnav.logs.odometry import OdometryTracks
from mavnav.logs.preprocessing import ScanFilter
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel, Damage, RawMessage, Topic
from mavnav.logs.stamps import TopicScans
from mavnav.logs.transforms import FrameTree
from mavnav.logs.truth import TruthTracks
from mavnav.profiling import timed

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mavnav.logs.messages.records import LaserMessage

_PROGRESS_STEPS = 200
_MOST_HOLES_BYTES = 4 << 30
"""Holes take no space on the disk, but must be hashed as zeros; no recorder leaves any."""

_MOST_EXTENTS = 10_000
_ZEROS = memoryview(bytes(1 << 16))


class Survey(Struct, frozen=True):
    """What one pass over a log found, whether or not it can be used.

    ``scans`` holds the scan topics that have messages; a topic that was asked for alone.
    """

    path: Path
    format: str
    size_bytes: int
    sha256: str
    topics: tuple[Topic, ...]
    scans: dict[str, TopicScans]
    odometry: OdometryTracks
    imus: ImuTracks
    truth: TruthTracks
    attitudes: AttitudeTracks
    frames: FrameTree
    damage: tuple[Damage, ...]
    warnings: tuple[str, ...]
    window_s: tuple[float | None, float | None]
    strict: bool


class _Kind(Struct):
    """What there is to know of a channel's messages; ``decode`` is None where there is no use for them.

    ``scan_topic`` is the topic whose scans they are, None where they are none.
    """

    decode: Callable[[bytes], Any] | None
    scan_topic: str | None
    count: int = 0


class _Pass(Struct):
    """The state of the pass."""

    topic: str | None
    strict: bool
    report: ReadReport
    kinds: dict[Channel, _Kind] = field(default_factory=dict)
    doors: dict[str, ScanFilter] = field(default_factory=dict)
    scans: dict[str, TopicScans] = field(default_factory=dict)
    odometry: OdometryTracks = field(default_factory=OdometryTracks)
    imus: ImuTracks = field(default_factory=ImuTracks)
    truth: TruthTracks = field(default_factory=TruthTracks)
    attitudes: AttitudeTracks = field(default_factory=AttitudeTracks)
    frames: FrameTree = field(default_factory=FrameTree)

    def take(self, message: RawMessage) -> None:
        """Take in one message; one that does not decode is noted and counted."""
        channel = message.channel
        kind = self.kinds.get(channel) or self._meet(channel)
        kind.count += 1
        if kind.decode is None:
            return
        if self.strict and message.suspect:
            self._refuse(kind.scan_topic, "suspect")
            return
        try:
            decoded = kind.decode(message.data)
        except DecodeError as error:
            self.report.damage(f"a message does not decode ({error})", f"{channel.topic}, {message.log_ns} ns")
            self._refuse(kind.scan_topic, "undecodable")
            return
        if kind.scan_topic is not None:
            self._take_scan(kind.scan_topic, message, decoded)
        else:
            self._take_motion(message, decoded)

    def _meet(self, channel: Channel) -> _Kind:
        topic = scan_topic(channel, self.topic)
        self.kinds[channel] = _Kind(self._decoder(channel, topic), topic)
        return self.kinds[channel]

    def _decoder(self, channel: Channel, topic: str | None) -> Callable[[bytes], Any] | None:
        if is_laser(channel) and topic is None:
            return None
        try:
            takers = (self.truth, self.odometry, self.attitudes)
            return decoder(channel, poses=any(taker.takes(channel) for taker in takers), topic=topic)
        except DecodeError as error:
            self.report.damage(str(error), channel.topic)
            return None

    def _take_motion(self, message: RawMessage, decoded: Any) -> None:  # noqa: ANN401
        channel, log_ns = message.channel, message.log_ns
        if self.attitudes.takes(channel):
            self.attitudes.add(channel.topic, decoded[0], log_ns)
        if self.truth.takes(channel):
            self.truth.add(channel.topic, decoded[0], log_ns)
        elif channel.type == IMU:
            self.imus.add(channel.topic, decoded, log_ns)
        elif channel.type == ODOMETRY or self.odometry.takes(channel):
            self.odometry.add_odometry(channel.topic, decoded[0], log_ns)
        elif channel.type != POSE:
            static = channel.topic.endswith("tf_static")
            self.frames.add(decoded, static=static)
            if not static:
                self.odometry.add_transforms(channel.topic, decoded, log_ns)

    def _take_scan(self, topic: str, message: RawMessage, laser: LaserMessage) -> None:
        scans = self._scans(topic)
        scans.total += 1
        admitted = self.doors[topic].admit(laser)
        if isinstance(admitted, str):
            scans.refused[admitted] += 1
            return
        spec, ranges_m, counts = admitted
        scans.keep(spec, ranges_m)
        scans.add((laser.stamp_ns, message.log_ns), spec, laser.frame_id, counts, suspect=message.suspect)

    def _refuse(self, topic: str | None, reason: str) -> None:
        if topic is not None:
            scans = self._scans(topic)
            scans.total += 1
            scans.refused[reason] += 1

    def _scans(self, topic: str) -> TopicScans:
        if topic not in self.scans:
            self.doors[topic] = ScanFilter(topic, self.report.warn)
            self.scans[topic] = TopicScans()
        return self.scans[topic]

    def conclude(self) -> None:
        """Note what shows at the end only."""
        for topic, scans in self.scans.items():
            scans.doubt, scans.invalid = self.doors[topic].doubt, self.doors[topic].invalid
            if len(scans.frames) > 1:
                names = ", ".join(sorted(scans.frames)[:4])
                self.report.warn(f"{topic}: the frame of the scans changes on the way ({names}); the first is used")


@timed("reading")
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

    Raises
    ------
    UsageError
        No such file, not a regular file or folder, not readable, or an empty window. What is wrong with the content
        never raises: it stands in the survey.
    """
    _check(path, start_s, end_s)
    again = partial(_survey, window_s=(start_s, end_s), strict=strict, truth=truth, odom=odom, attitude=attitude)
    found = again(path, topic, progress=progress)
    others = [t.name for t in found.topics if t.type in OTHER_TYPES and t.count]
    if topic is not None or found.scans or len(others) != 1:
        return found
    found = again(path, others[0], progress=progress)
    text = f"the log has no LaserScan messages; the scans are taken from {others[0]}"
    return replace(found, warnings=(text, *found.warnings)) if found.scans else found


def _survey(
    path: Path,
    topic: str | None,
    *,
    window_s: tuple[float | None, float | None],
    progress: Callable[[int, int], None] | None,
    strict: bool,
    truth: str | None,
    odom: str,
    attitude: str,
) -> Survey:
    report = ReadReport()
    wanted = {"odometry": OdometryTracks(odom), "truth": TruthTracks(truth), "attitudes": AttitudeTracks(attitude)}
    state = _Pass(topic, strict, report, **wanted)  # type: ignore[arg-type]
    try:
        name = detect.sniff(path)
        if name == detect.UNKNOWN:
            report.damage(detect.refusal(path), path.name)
        else:
            _run(path, state, progress)
            state.conclude()
        size_bytes, sha256 = _identity(path)
    except OSError as error:
        raise unreadable(path, error) from error
    return Survey(
        path=path,
        format=name,
        size_bytes=size_bytes,
        sha256=sha256,
        topics=_topics(report, state.kinds),
        scans=state.scans,
        odometry=state.odometry,
        imus=state.imus,
        truth=state.truth,
        attitudes=state.attitudes,
        frames=state.frames,
        damage=report.damages(),
        warnings=tuple(report.warnings),
        window_s=window_s,
        strict=strict,
    )


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


def content_sha256(path: Path) -> str:
    """Return the SHA-256 by which a survey knows a log's content, without reading its messages; raises UsageError."""
    _check(path, None, None)
    try:
        return _identity(path)[1]
    except OSError as error:
        raise unreadable(path, error) from error


def check_log(path: Path, start_s: float | None = None, end_s: float | None = None) -> None:
    """Raise UsageError or NoScansError for what shows at a glance: no such log, no log at all, an empty window."""
    _check(path, start_s, end_s)
    try:
        if detect.sniff(path) == detect.UNKNOWN:
            raise NoScansError(f"{path}: no usable scans; {detect.refusal(path)}")
    except OSError as error:
        raise unreadable(path, error) from error


def unreadable(path: Path, error: OSError) -> UsageError | MemoryError:
    """Return what is raised where the system cannot read a log."""
    if lacks_memory(error):
        return MemoryError(str(error))
    return UsageError(f"{path}: cannot be read ({error.strerror}); check the file and its permissions")


def _check(path: Path, start_s: float | None, end_s: float | None) -> None:
    check_file(path)
    for name, value in (("--start", start_s), ("--end", end_s)):
        if value is not None and not (isfinite(value) and value >= 0.0):
            raise UsageError(f"{name} {value:g} is no time; it counts in seconds from the first usable scan, 0 or more")
    if start_s is not None and end_s is not None and end_s <= start_s:
        raise UsageError(f"the window from {start_s:g} s to {end_s:g} s is empty; --end must be later than --start")


def check_file(path: Path) -> None:
    """Raise UsageError where there is no file or folder, NoScansError where a file is hardly more than holes."""
    if not path.exists():
        raise UsageError(f"{path}: no such file or folder; give the path of a log")
    if not (path.is_file() or path.is_dir()):
        raise UsageError(f"{path}: neither a regular file nor a folder; give the path of a log")
    if path.is_file() and (holes_bytes := _holes(path)) > _MOST_HOLES_BYTES:
        text = f"{holes_bytes / 1e9:.0f} GB of the file are holes that no recorder wrote"
        raise NoScansError(f"{path}: no usable scans; {text}; get a whole copy, or cut it with truncate")


def _holes(path: Path) -> int:
    """Count the bytes of a file before its end that the file system does not keep; 0 where few can be missing."""
    status = path.stat()
    if status.st_size - getattr(status, "st_blocks", status.st_size) * 512 <= _MOST_HOLES_BYTES:
        return 0
    holes_bytes, end = 0, 0
    with path.open("rb") as file:
        for _ in range(_MOST_EXTENTS):
            start = os.lseek(file.fileno(), end, os.SEEK_HOLE)
            end = Source(file, status.st_size).next_data(start)
            holes_bytes += end - start
            if end >= status.st_size:
                break
    return holes_bytes


def _run(path: Path, state: _Pass, progress: Callable[[int, int], None] | None) -> None:
    reported = -1
    for message in detect.read(path, state.report):
        state.take(message)
        if progress is None:
            continue
        total = state.report.total_bytes
        done = min(state.report.done_bytes, total)
        if (step := done * _PROGRESS_STEPS // max(total, 1)) > reported:
            reported = step
            progress(done, total)


def _topics(report: ReadReport, kinds: dict[Channel, _Kind]) -> tuple[Topic, ...]:
    counts = Counter[tuple[str, str, str]]()
    for channel in report.channels.values():
        counts[channel.topic, channel.type, channel.encoding] += kinds[channel].count if channel in kinds else 0
    return tuple(Topic(*key, count) for key, count in sorted(counts.items()))


def _identity(path: Path) -> tuple[int, str]:
    """Return size and SHA-256: of a file; of a folder, over the lines ``<sha256>  <name>`` of its bag's files."""
    if path.is_file():
        return path.stat().st_size, _sha256(path)
    files = sorted({*detect.parts(path, ReadReport()), *[f for f in [path / METADATA] if f.is_file()]})
    lines = "".join(f"{_sha256(file)}  {file.relative_to(path)}\n" for file in files)
    return sum(file.stat().st_size for file in files), hashlib.sha256(lines.encode()).hexdigest()


def _sha256(path: Path) -> str:
    """Return the SHA-256 of a file; the zeros of its holes are not read, which would take longer than to count them."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        source = Source(file, path.stat().st_size)
        offset = 0
        while offset < source.size:
            data_at = min(source.next_data(offset), source.size)
            for at in range(offset, data_at, len(_ZEROS)):
                digest.update(_ZEROS[: data_at - at])
            block = source.read(data_at, len(_ZEROS))
            digest.update(block)
            offset = data_at + len(_ZEROS)
    return digest.hexdigest()
