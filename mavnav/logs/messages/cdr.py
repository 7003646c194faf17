"""Writers of frequent messages that build the CDR bytes directly: faster than serializing objects.

The bytes equal those of ``ros.cdr``. Strings are UTF-8 with a final null byte; numbers are little-endian and aligned to
their own size, counted from the end of the 4-byte encapsulation header.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from math import cos, nan, sin
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.scan import Attitude, Scan

_LITTLE_ENDIAN: Final = b"\0\1\0\0"
"""The encapsulation header of plain CDR."""

LINE_STRIP, LINE_LIST, TEXT = 4, 5, 9
"""Types of visualization_msgs/Marker that are written."""

_STAMP: Final = struct.Struct("<iI")
_COUNT: Final = struct.Struct("<I")
_POSE: Final = struct.Struct("<7d")
_SCAN: Final = struct.Struct("<7fI")


def _text(at: int, text: str, then: int) -> bytes:
    """Return a string at offset ``at``, a multiple of 4, padded so that a number of ``then`` bytes can follow."""
    raw = text.encode() + b"\0"
    data = _COUNT.pack(len(raw)) + raw
    return data + b"\0" * (-(at + len(data)) % then)


def _pose(pose: Pose) -> bytes:
    return _POSE.pack(pose.x_m, pose.y_m, 0.0, 0.0, 0.0, sin(pose.yaw_rad / 2.0), cos(pose.yaw_rad / 2.0))


def _stamp(stamp_ns: int) -> bytes:
    return _STAMP.pack(*divmod(stamp_ns, 1_000_000_000))


def _pose_between(before: bytes, parent: str, child: str, after: bytes) -> Callable[[int, Pose], bytes]:
    """Return the function that serializes a message of header, child frame and pose, with other bytes around them."""
    outer = _text(len(before) + 8, parent, 4)
    inner = _text(len(before) + 8 + len(outer), child, 8)
    head = _LITTLE_ENDIAN + before
    return lambda stamp_ns, pose: b"".join((head, _stamp(stamp_ns), outer, inner, _pose(pose), after))


def transform(parent: str, child: str) -> Callable[[int, Pose], bytes]:
    """Return the function that serializes a TransformStamped from stamp (ns) and ``parent_T_child``."""
    return _pose_between(b"", parent, child, b"")


def transforms(parent: str, child: str) -> Callable[[int, Pose], bytes]:
    """Return the function that serializes a TFMessage of one transform from stamp (ns) and ``parent_T_child``."""
    return _pose_between(_COUNT.pack(1), parent, child, b"")


def odometry(parent: str, child: str) -> Callable[[int, Pose], bytes]:
    """Return the function that serializes an Odometry; velocities and covariances are zero, which means unknown."""
    return _pose_between(b"", parent, child, bytes(8 * (36 + 6 + 36)))


def attitudes(frame: str) -> Callable[[int, Attitude], bytes]:
    """Return the function that serializes a PoseStamped of tilt and height: ``Ry(pitch) Rx(roll)``, x = y = 0."""
    name = _text(8, frame, 8)

    def write(stamp_ns: int, attitude: Attitude) -> bytes:
        (a, c), (b, d) = ((sin(angle / 2.0), cos(angle / 2.0)) for angle in attitude[:2])
        pose = _POSE.pack(0.0, 0.0, attitude.height_m, a * d, c * b, -a * b, c * d)
        return b"".join((_LITTLE_ENDIAN, _stamp(stamp_ns), name, pose))

    return write


def poses(frame: str) -> Callable[[int, Pose], bytes]:
    """Return the function that serializes a PoseStamped from stamp (ns) and pose."""
    name = _text(8, frame, 8)
    return lambda stamp_ns, pose: b"".join((_LITTLE_ENDIAN, _stamp(stamp_ns), name, _pose(pose)))


def scans(frame: str, no_return_m: float = nan) -> Callable[[Scan], bytes]:
    """Return the function that serializes a LaserScan with ``no_return_m`` where there is no return; no intensities."""
    name, none = _text(8, frame, 4), _COUNT.pack(0)

    def write(scan: Scan) -> bytes:
        spec = scan.spec
        last = spec.angle_min_rad + spec.angle_step_rad * max(spec.beams - 1, 0)
        times = (spec.time_increment_s, spec.scan_time_s)
        head = _SCAN.pack(
            spec.angle_min_rad, last, spec.angle_step_rad, *times, spec.range_min_m, spec.range_max_m, spec.beams
        )
        ranges = np.where(np.isnan(scan.ranges_m), no_return_m, scan.ranges_m).astype(np.dtype("<f4")).tobytes()
        return b"".join((_LITTLE_ENDIAN, _stamp(scan.stamp_ns), name, head, ranges, none))

    return write


def path(stamp_ns: int, frame: str, stamps_ns: NDArray[np.int64], xyyaw: NDArray[np.float64]) -> bytes:
    """Serialize a Path of poses (n, 3), m and rad, with stamps (n,), ns, all in one frame."""
    head = _stamp(stamp_ns) + _text(8, frame, 4) + _COUNT.pack(len(stamps_ns))
    if not len(stamps_ns):
        return _LITTLE_ENDIAN + head
    # Each pose begins where the one before ends, at a multiple of 8; only the first may need other padding.
    first, name = _text(len(head) + 8, frame, 8), _text(8, frame, 8)
    rows = np.zeros(len(stamps_ns), [("s", "<i4"), ("ns", "<u4"), ("name", f"V{len(name)}"), ("pose", "<f8", 7)])
    rows["s"], rows["ns"] = np.divmod(stamps_ns, 1_000_000_000)
    rows["name"] = np.void(name)
    rows["pose"][:, :2] = xyyaw[:, :2]
    rows["pose"][:, 5], rows["pose"][:, 6] = np.sin(xyyaw[:, 2] / 2.0), np.cos(xyyaw[:, 2] / 2.0)
    body = rows.view(np.uint8).data
    return b"".join((_LITTLE_ENDIAN, head, body[:8], first, body[8 + len(name) :]))


def occupancy_grid(
    stamp_ns: int, frame: str, cells: NDArray[np.int8], cell_m: float, origin_xy_m: tuple[float, float]
) -> bytes:
    """Serialize an OccupancyGrid of ``cells`` (rows, cols), whose cell [0, 0] has its corner at ``origin_xy_m``."""
    rows, cols = cells.shape
    stamp = _stamp(stamp_ns)
    head = stamp + _text(8, frame, 4) + stamp + struct.pack("<fII", cell_m, cols, rows)
    gap = b"\0" * (-len(head) % 8)
    origin, size = _pose(Pose(*origin_xy_m)), _COUNT.pack(cells.size)
    return b"".join((_LITTLE_ENDIAN, head, gap, origin, size, np.ascontiguousarray(cells).data))


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
        _write_marker(out, stamp_ns, frame, marker)
    return _LITTLE_ENDIAN + bytes(out.data)


def _write_marker(out: _Writer, stamp_ns: int, frame: str, marker: Marker) -> None:
    x, y = marker.points[0].tolist() if marker.kind == TEXT else (0.0, 0.0)
    points = marker.points[:0] if marker.kind == TEXT else marker.points
    scale = (0.0, 0.0, marker.width_m) if marker.kind == TEXT else (marker.width_m, 0.0, 0.0)
    out.header(stamp_ns, frame)
    out.text(marker.group)
    out.put("iii", marker.number, marker.kind, 0)
    out.put("10d", x, y, 0.0, 0.0, 0.0, 0.0, 1.0, *scale)
    out.put("4fiI?", *marker.rgba, 0, 0, False)
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
    out.put("I?", 0, False)


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
