"""Recognising a scan by its bytes alone, where the record that names its type is lost.

A LaserScan tells the lengths of its parts and has seven numbers within narrow bounds, so that hardly anything else
passes: the parts must fill the message exactly.
"""

from __future__ import annotations

import struct
from math import isfinite, isnan, tau
from typing import TYPE_CHECKING

from mavnav.logs.records import Channel

if TYPE_CHECKING:
    from mavnav.logs.ledger import Ledger

_SECONDS = 1_000_000_000
_CDR_LITTLE_ENDIAN = b"\x00\x01"
_MAX_FRAME_BYTES = 256
_MAX_PADDING = 4


LASER = "sensor_msgs/msg/LaserScan"


def channel_of(data: bytes, name: str, ledger: Ledger) -> Channel | None:
    """Return the channel of a message on one that is declared nowhere; None unless it is a scan by its bytes.

    It is taken for one of the only scan channel that is known, else for one of a channel of this ``name``.
    """
    encoding = laser_encoding(data)
    known = ledger.only(LASER)
    if encoding is None or (known is not None and known.encoding != encoding):
        return None
    return known or ledger.declare(Channel(name, LASER, encoding))


def laser_encoding(data: bytes) -> str | None:
    """Return the encoding (``cdr`` or ``ros1``) by which the bytes are a sensor_msgs/LaserScan; None if by neither."""
    try:
        if data[:2] == _CDR_LITTLE_ENDIAN and _is_laser(data[4:], 0, 4):
            return "cdr"
        return "ros1" if _is_laser(data, 4, 1) else None
    except struct.error:
        return None


def _is_laser(body: bytes, start: int, align: int) -> bool:
    """Tell whether a LaserScan fills ``body``, whose stamp begins at ``start``; raises struct.error where it is cut."""
    _, nanoseconds, length = struct.unpack_from("<III", body, start)
    offset = start + 12 + length
    frame = body[start + 12 : offset].rstrip(b"\0")
    if nanoseconds >= _SECONDS or length > _MAX_FRAME_BYTES or not all(32 <= byte < 127 for byte in frame):
        return False
    offset += -offset % align
    numbers = struct.unpack_from("<7f", body, offset)
    offset += 28
    (beams,) = struct.unpack_from("<I", body, offset)
    offset += 4 + 4 * beams
    (intensities,) = struct.unpack_from("<I", body, offset)
    left = len(body) - (offset + 4 + 4 * intensities)
    return beams > 0 and 0 <= left < (_MAX_PADDING if align > 1 else 1) and _is_geometry(*numbers)


def _is_geometry(
    first: float, last: float, step: float, increment_s: float, scan_s: float, low: float, high: float
) -> bool:
    angles = all(isfinite(angle) and abs(angle) <= 2 * tau for angle in (first, last)) and 1e-6 < abs(step) < tau
    times = all(isfinite(seconds) and 0 <= seconds < 1e3 for seconds in (increment_s, scan_s))
    return angles and times and isfinite(low) and not isnan(high) and 0 <= low < high
