"""Recognition of a LaserScan by its bytes, for messages whose type is lost.

A LaserScan contains the lengths of its fields and seven numbers within narrow bounds, so false positives are rare.
"""

from __future__ import annotations

from math import isfinite, isnan, tau
from typing import TYPE_CHECKING

from mavnav.logs.messages.definitions import SCAN
from mavnav.logs.messages.fast_cdr import laser_of
from mavnav.logs.records import Channel

if TYPE_CHECKING:
    from mavnav.logs.messages.records import LaserMessage
    from mavnav.logs.read_report import ReadReport

_MAX_FRAME = 256

ENCODINGS = ("cdr", "ros1")


def channel_of(data: bytes, name: str, report: ReadReport) -> Channel | None:
    """Return a channel for a message of an undeclared channel; None unless the bytes are a LaserScan.

    This is the scan channel of the log if there is exactly one, else a new channel called ``name``.
    """
    encoding = laser_encoding(data)
    known = report.only(SCAN)
    if encoding is None or (known is not None and known.encoding != encoding):
        return None
    return known or report.declare(Channel(name, SCAN, encoding))


def with_detected_type(channel: Channel, data: bytes, where: str, report: ReadReport) -> Channel:
    """Return the channel with the type and encoding detected from the bytes of a message, and report it as damage.

    Call it only for a channel that ``lacks_type``. Returns the channel unchanged if the bytes are no LaserScan.
    """
    encoding = laser_encoding(data)
    if encoding is None:
        return channel
    lacks = f"is in no encoding {channel.encoding!r}" if channel.type else "has no stated type"
    report.damage(f"{channel.topic} {lacks}; its messages are scans by their bytes", where)
    return report.declare(Channel(channel.topic, SCAN, encoding))


def lacks_type(channel: Channel) -> bool:
    """Return whether a channel has no message type, or is of type LaserScan with an unknown encoding."""
    return not channel.type or (channel.type == SCAN and channel.encoding not in ENCODINGS)


def laser_encoding(data: bytes) -> str | None:
    """Return the encoding (``cdr`` or ``ros1``) in which the bytes are a sensor_msgs/LaserScan; None if in neither."""
    for encoding in ENCODINGS:
        scan = laser_of(data, encoding)
        if scan is not None and _is_plausible(scan):
            return encoding
    return None


def _is_plausible(scan: LaserMessage) -> bool:
    named = len(scan.frame_id) <= _MAX_FRAME and scan.frame_id.isascii() and scan.frame_id.isprintable()
    ends = (scan.angle_min_rad, scan.last_angle_rad or 0.0)
    angles = all(isfinite(angle) and abs(angle) <= 2 * tau for angle in ends)
    times = all(isfinite(seconds) and 0 <= seconds < 1e3 for seconds in (scan.time_increment_s, scan.scan_time_s))
    low, high = scan.range_min_m, scan.range_max_m
    limits = isfinite(low) and not isnan(high) and 0 <= low < high
    return named and angles and times and limits and 1e-6 < abs(scan.angle_step_rad) < tau and len(scan.ranges_m) > 0
