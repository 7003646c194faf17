"""The layout of a LaserScan, read field by field: for bytes that no library takes, or whose type no record tells.

The parts must fill the message exactly. What a string should look like is not asked: neither the zero that ends it, nor
UTF-8 decide on ranges. Plain CDR of both versions lays the fields out alike, because none is longer than four bytes
(OMG DDS-XTypes 1.3, 7.6.3).
"""

from __future__ import annotations

import struct

import numpy as np

from mavnav.logs.messages import LaserMessage

_ENCAPSULATIONS = {0: (">", 0), 1: ("<", 0), 6: (">", 0), 7: ("<", 0), 8: (">", 4), 9: ("<", 4)}
"""Kind of a CDR message -> byte order, and bytes of a header before the fields."""

_MAX_PADDING = 4
_SECOND_NS = 1_000_000_000


def laser_of(data: bytes, encoding: str) -> LaserMessage | None:
    """Read a sensor_msgs/LaserScan of ``cdr`` or ``ros1``; None where the bytes are none."""
    try:
        if encoding == "ros1":
            return _laser(data, 4, 1, "<")
        order, head = _ENCAPSULATIONS.get(int.from_bytes(data[:2], "big"), ("", 0))
        return _laser(data[4 + head :], 0, 4, order) if order and len(data) > 4 else None
    except struct.error:
        return None


def _laser(body: bytes, start: int, align: int, order: str) -> LaserMessage | None:
    """Read the scan that fills ``body``, whose stamp begins at ``start``; raises struct.error where it is cut."""
    seconds, nanoseconds, length = struct.unpack_from(f"{order}{'i' if align > 1 else 'I'}II", body, start)
    offset = start + 12 + length
    frame = body[start + 12 : offset].rstrip(b"\0").decode(errors="replace")
    offset += -offset % align
    first, last, step, increment_s, scan_s, low, high, beams = struct.unpack_from(f"{order}7fI", body, offset)
    ranges_at = offset + 32
    offset = ranges_at + 4 * beams
    (intensities,) = struct.unpack_from(f"{order}I", body, offset)
    left = len(body) - (offset + 4 + 4 * intensities)
    if nanoseconds >= _SECOND_NS or not 0 <= left < (_MAX_PADDING if align > 1 else 1):
        return None
    ranges_m = np.frombuffer(body, f"{order}f4", beams, ranges_at)
    stamp_ns = seconds * _SECOND_NS + nanoseconds
    return LaserMessage(stamp_ns, frame, first, step, last, low, high, increment_s, scan_s, ranges_m)
