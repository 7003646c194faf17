"""Writer of visualization_msgs/MarkerArray that builds the CDR bytes directly: lines and texts in the plane."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavnav.logs.messages.cdr import LITTLE_ENDIAN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

LINE_STRIP, LINE_LIST, TEXT = 4, 5, 9
"""Types of visualization_msgs/Marker that are written."""


class Marker(NamedTuple):
    """A marker: lines through ``points`` (n, 2), m, with ``width_m``; or a ``text`` of this height at the first point.

    ``group`` and ``number`` identify it; ``rgba`` are from 0 to 1.
    """

    group: str
    number: int
    kind: int
    points: NDArray[np.float64]
    width_m: float
    rgba: tuple[float, float, float, float]
    text: str = ""


def marker_array(stamp_ns: int, frame: str, markers: Sequence[Marker]) -> bytes:
    """Serialize markers of one frame; the bytes equal those of ``ros.cdr``."""
    out = _Writer()
    out.put("I", len(markers))
    for marker in markers:
        _write(out, stamp_ns, frame, marker)
    return LITTLE_ENDIAN + bytes(out.data)


def _write(out: _Writer, stamp_ns: int, frame: str, marker: Marker) -> None:
    x, y = marker.points[0].tolist() if marker.kind == TEXT else (0.0, 0.0)
    points = marker.points[:0] if marker.kind == TEXT else marker.points
    scale = (0.0, 0.0, marker.width_m) if marker.kind == TEXT else (marker.width_m, 0.0, 0.0)
    out.header(stamp_ns, frame)
    out.text(marker.group)
    out.put("iii", marker.number, marker.kind, 0)
    out.put("10d", x, y, 0.0, 0.0, 0.0, 0.0, 1.0, *scale)
    out.put("4f", *marker.rgba)
    out.put("iI?", 0, 0, False)
    out.put("I", len(points))
    if len(points):
        out.put(f"{3 * len(points)}d", *np.column_stack((points, np.zeros(len(points)))).ravel().tolist())
    out.put("I", 0)  # colors
    out.text("")  # texture
    out.header(0, "")
    out.text("")
    out.put("II", 0, 0)
    out.text(marker.text)
    out.text("")  # mesh
    out.text("")
    out.put("I", 0)
    out.put("?", False)


class _Writer:
    """Writer of CDR fields, each aligned to its own size."""

    def __init__(self) -> None:
        self.data = bytearray()

    def put(self, kinds: str, *values: object) -> None:
        """Append numbers, aligned to the size of the first one."""
        size = struct.calcsize(kinds.lstrip("0123456789")[0])
        self.data += b"\0" * (-len(self.data) % size) + struct.pack(f"<{kinds}", *values)

    def text(self, text: str) -> None:
        """Append a string."""
        raw = text.encode() + b"\0"
        self.put("I", len(raw))
        self.data += raw

    def header(self, stamp_ns: int, frame: str) -> None:
        """Append a std_msgs/Header."""
        self.put("iI", *divmod(stamp_ns, 1_000_000_000))
        self.text(frame)
