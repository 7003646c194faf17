"""What the readers of containers share: random access to their bytes, and the channels of their messages by number.

A source is the file itself, or a decompressed chunk of it. A LaserScan whose type or channel is lost is recognized by
its bytes: it contains the lengths of its fields and seven numbers within narrow bounds, so false positives are rare.
"""

from __future__ import annotations

import errno
import os
from math import isfinite, isnan, tau
from typing import IO, Final

from msgspec import Struct, field

from mavnav.logs.formats.decompress import Allowance
from mavnav.logs.messages.definitions import SCAN, LaserMessage
from mavnav.logs.messages.fast_cdr import laser_of
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import Channel

MAGIC_WITHIN_BYTES: Final = 1 << 16
"""The magic of a format is searched in so many bytes: others may lie before it."""

BAG_MAGIC: Final = b"#ROSBAG V2.0\n"
OLD_BAG_MAGIC: Final = b"#ROSRECORD V1.2\n"
SQLITE_MAGIC: Final = b"SQLite format 3\x00"


class Source(Struct, frozen=True):
    """A sequence of records in a file or in memory.

    ``name`` is the prefix of positions in messages; the ``allowance`` limits the search for records.
    """

    file: IO[bytes]
    size: int
    name: str = ""
    allowance: Allowance = field(default_factory=Allowance)

    def read(self, offset: int, count: int) -> bytes:
        """Read ``count`` bytes, fewer at the end."""
        self.file.seek(offset)
        return self.file.read(min(count, max(self.size - offset, 0)))

    def next_data(self, offset: int) -> int:
        """Return the offset of the next data after a hole of a sparse file; ``offset`` itself if not in a hole."""
        try:
            descriptor = self.file.fileno()
        except OSError:
            return offset
        here = os.lseek(descriptor, 0, os.SEEK_CUR)
        try:
            return os.lseek(descriptor, offset, os.SEEK_DATA)
        except OSError as error:
            return self.size if error.errno == errno.ENXIO else offset
        finally:
            os.lseek(descriptor, here, os.SEEK_SET)  # the buffered file expects its old position

    def where(self, offset: int) -> str:
        """Return the text of a position for messages."""
        return f"{self.name}byte {offset}"


_MAX_FRAME = 256

_ENCODINGS = ("cdr", "ros1")


class ReaderState(Struct):
    """What the reader of a file has come across so far: channels by number, and the number of messages.

    ``spare`` are channels as another part of the file declares them, for messages whose own declaration is lost.
    """

    report: ReadReport
    allowance: Allowance = field(default_factory=Allowance)
    channels: dict[int, Channel] = field(default_factory=dict)
    spare: dict[int, Channel] = field(default_factory=dict)
    undeclared: set[int] = field(default_factory=set)
    messages: int = 0

    def channel(self, number: int, data: bytes, kind: str, source: Source, at: int) -> tuple[Channel | None, bool]:
        """Return the channel of a message, and whether it is declared; the bytes decide where a declaration is lost.

        The channel is None if it is undeclared and the bytes are no LaserScan. ``kind`` is what the format calls it.
        The message is at an offset of the source.
        """
        channel = self.channels.get(number)
        if channel is not None and states_type(channel):  # as it nearly always is
            return channel, True
        if channel is None and number in self.spare:
            channel = self.report.declare(self.spare[number])
        if channel is not None:
            channel = self.channels[number] = with_known_type(channel, data, source.where(at), self.report)
            return channel, True
        channel = channel_of(data, f"/{kind}_{number}", self.report)
        if number not in self.undeclared:
            self.undeclared.add(number)
            outcome = f"scans by their bytes, and taken for {channel.topic}" if channel else "left out"
            text = f"messages of {kind} {number}, which is declared nowhere before, are {outcome}"
            self.report.damage(text, source.where(at))
        return channel, False


def channel_of(data: bytes, name: str, report: ReadReport) -> Channel | None:
    """Return a channel for a message of an undeclared channel; None unless the bytes are a LaserScan.

    This is the scan channel of the log if there is exactly one, else a new channel called ``name``.
    """
    encoding = _laser_encoding(data)
    known = report.only(SCAN)
    if encoding is None or (known is not None and known.encoding != encoding):
        return None
    return known or report.declare(Channel(name, SCAN, encoding))


def states_type(channel: Channel) -> bool:
    """Return whether a channel has a type, and an encoding of scans if that is LaserScan."""
    return bool(channel.type) and (channel.type != SCAN or channel.encoding in _ENCODINGS)


def with_known_type(channel: Channel, data: bytes, where: str, report: ReadReport) -> Channel:
    """Return a channel, with the type and encoding of a message's bytes if it lacks them; this is reported as damage.

    It is returned unchanged if the bytes are no LaserScan.
    """
    if states_type(channel):
        return channel
    encoding = _laser_encoding(data)
    if encoding is None:
        return channel
    lacks = f"is in no encoding {channel.encoding!r}" if channel.type else "has no stated type"
    report.damage(f"{channel.topic} {lacks}; its messages are scans by their bytes", where)
    return report.declare(Channel(channel.topic, SCAN, encoding))


def _laser_encoding(data: bytes) -> str | None:
    """Return the encoding (``cdr`` or ``ros1``) in which the bytes are a sensor_msgs/LaserScan; None if in neither."""
    fitting = (name for name in _ENCODINGS if (scan := laser_of(data, name)) and _is_plausible(scan))
    return next(fitting, None)


def _is_plausible(scan: LaserMessage) -> bool:
    named = len(scan.frame_id) <= _MAX_FRAME and scan.frame_id.isascii() and scan.frame_id.isprintable()
    ends = (scan.angle_min_rad, scan.last_angle_rad or 0.0)
    angles = all(isfinite(angle) and abs(angle) <= 2 * tau for angle in ends)
    times = all(isfinite(seconds) and 0 <= seconds < 1e3 for seconds in (scan.time_increment_s, scan.scan_time_s))
    low, high = scan.range_min_m, scan.range_max_m
    limits = isfinite(low) and not isnan(high) and 0 <= low < high
    return named and angles and times and limits and 1e-6 < abs(scan.angle_step_rad) < tau and len(scan.ranges_m) > 0
