"""Recognising a scan by its bytes alone, where the record that names its type is lost.

A LaserScan contains the lengths of its parts and has seven numbers within narrow bounds, so that hardly anything else
passes.
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
    """Return the channel of a message on one that is declared nowhere; None unless it is a scan by its bytes.

    It is taken for one of the only scan channel that is known, else for one of a channel of this ``name``.
    """
    encoding = laser_encoding(data)
    known = report.only(SCAN)
    if encoding is None or (known is not None and known.encoding != encoding):
        return None
    return known or report.declare(Channel(name, SCAN, encoding))


def typed(channel: Channel, data: bytes, where: str, report: ReadReport) -> Channel:
    """Return the channel with the type and encoding that a message of it turns out to have, reported as damage.

    Only of one that ``is_vague``.
    """
    encoding = laser_encoding(data)
    if encoding is None:
        return channel
    lacks = f"is in no encoding {channel.encoding!r}" if channel.type else "has no stated type"
    report.damage(f"{channel.topic} {lacks}; its messages are scans by their bytes", where)
    return report.declare(Channel(channel.topic, SCAN, encoding))


def is_vague(channel: Channel) -> bool:
    """Tell whether a channel does not say what its messages are, or in an encoding that no scan has."""
    return not channel.type or (channel.type == SCAN and channel.encoding not in ENCODINGS)


def laser_encoding(data: bytes) -> str | None:
    """Return the encoding (``cdr`` or ``ros1``) by which the bytes are a sensor_msgs/LaserScan; None if by neither."""
    for encoding in ENCODINGS:
        scan = laser_of(data, encoding)
        if scan is not None and _is_likely(scan):
            return encoding
    return None


def _is_likely(scan: LaserMessage) -> bool:
    named = len(scan.frame_id) <= _MAX_FRAME and scan.frame_id.isascii() and scan.frame_id.isprintable()
    ends = (scan.angle_min_rad, scan.last_angle_rad or 0.0)
    angles = all(isfinite(angle) and abs(angle) <= 2 * tau for angle in ends)
    times = all(isfinite(seconds) and 0 <= seconds < 1e3 for seconds in (scan.time_increment_s, scan.scan_time_s))
    low, high = scan.range_min_m, scan.range_max_m
    limits = isfinite(low) and not isnan(high) and 0 <= low < high
    return named and angles and times and limits and 1e-6 < abs(scan.angle_step_rad) < tau and len(scan.ranges_m) > 0
