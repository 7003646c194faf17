"""Decoders that read the fields of a message directly: faster than by its definition, which takes 0.1 s to load.

The fields must fill the message exactly. The strings of a LaserScan are not checked, neither for their final null byte
nor for UTF-8, because the ranges do not depend on them: messages that libraries reject, and messages without a stated
type, can be read. Both versions of plain CDR give a LaserScan the same layout, because none of its fields is longer
than four bytes (OMG DDS-XTypes 1.3, 7.6.3). Other messages are read as their definitions demand. Poses and inertial
measurements of many messages are read in columns: messages of a topic mostly have one layout.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from functools import wraps
from typing import Any, Final, TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.logs.messages.definitions import ImuMessage, LaserMessage, Measurements, Poses, TransformMessage
from mavnav.logs.stamps import storable

_ENCAPSULATIONS = {0: (">", 0), 1: ("<", 0), 6: (">", 0), 7: ("<", 0), 8: (">", 4), 9: ("<", 4)}
"""Encapsulation kind of a CDR message -> byte order, and bytes of a header before the fields."""

_MAX_PADDING = 4
COVARIANCE, TWIST = 36, 6
"""Numbers of a covariance of six quantities, and of a twist."""

_SECOND_NS = 1_000_000_000


def laser_of(data: bytes, encoding: str, *, any_stamp: bool = False) -> LaserMessage | None:
    """Decode a sensor_msgs/LaserScan in ``cdr`` or ``ros1``; None if the bytes are none.

    A stamp of a second of nanoseconds or more contradicts a LaserScan, unless the type is known: ``any_stamp``.
    """
    try:
        if encoding == "ros1":
            return _laser(data, 4, 1, "<", any_stamp)
        order, head = _ENCAPSULATIONS.get(int.from_bytes(data[:2], "big"), ("", 0))
        return _laser(data[4 + head :], 0, 4, order, any_stamp) if order and len(data) > 4 else None
    except struct.error:
        return None


def _laser(body: bytes, start: int, align: int, order: str, any_stamp: bool) -> LaserMessage | None:
    """Decode the scan that fills ``body``, whose stamp begins at ``start``; raises struct.error if it is cut."""
    seconds, nanoseconds, length = struct.unpack_from(f"{order}{'i' if align > 1 else 'I'}II", body, start)
    offset = start + 12 + length
    frame = body[start + 12 : offset].rstrip(b"\0").decode(errors="replace")
    offset += -offset % align
    first, last, step, increment_s, scan_s, low, high, beams = struct.unpack_from(f"{order}7fI", body, offset)
    ranges_at = offset + 32
    offset = ranges_at + 4 * beams
    (intensities,) = struct.unpack_from(f"{order}I", body, offset)
    left = len(body) - (offset + 4 + 4 * intensities)
    if (nanoseconds >= _SECOND_NS and not any_stamp) or not 0 <= left < (_MAX_PADDING if align > 1 else 1):
        return None
    ranges_m = np.frombuffer(body, f"{order}f4", beams, ranges_at)
    stamp_ns = seconds * _SECOND_NS + nanoseconds
    return LaserMessage(stamp_ns, frame, first, step, last, low, high, increment_s, scan_s, ranges_m)


def exactly(read: Callable[[CdrFields], Any]) -> Callable[[bytes, str], Any]:
    """Return the function that decodes a message in ``cdr`` or ``ros1``; None if the bytes are not exactly one."""

    @wraps(read)
    def decode(data: bytes, encoding: str) -> Any:  # noqa: ANN401
        try:
            fields = CdrFields.of(data, encoding)
            message = read(fields)
        except (struct.error, ValueError):
            return None
        return message if fields.at_end else None

    return decode


def read_transforms(fields: CdrFields) -> list[TransformMessage]:
    """Read the fields of a tf2_msgs/TFMessage."""
    return [fields.transform() for _ in range(fields.count())]


def read_pose(fields: CdrFields, *, child: bool = False, covariances: int = 0) -> list[TransformMessage]:
    """Read the fields of a message of one pose, with the frame of its ``child`` if it has one.

    That is a geometry_msgs/PoseStamped, PoseWithCovarianceStamped or TransformStamped, or a nav_msgs/Odometry: after
    the pose come so many numbers of ``covariances`` and twists.
    """
    pose = fields.transform(child=child)
    if covariances:
        fields.doubles(covariances)
    return [pose]


def read_path(fields: CdrFields) -> list[TransformMessage]:
    """Read the fields of a nav_msgs/Path, and return its poses."""
    fields.stamp_ns(), fields.text()
    return [fields.transform(child=False) for _ in range(fields.count())]


def read_imu(fields: CdrFields) -> ImuMessage:
    """Read the fields of a sensor_msgs/Imu.

    Quaternion, angular velocity and acceleration are each followed by a covariance of 9 values. A first covariance of
    -1 means that there is no orientation.
    """
    stamp_ns, frame_id, values = fields.stamp_ns(), fields.text(), fields.doubles(37)
    return ImuMessage(stamp_ns, fields.orientation(values), values[13:16], values[25:28], frame_id)  # type: ignore[arg-type]


class CdrFields(Struct):
    """Sequential reader of the fields of a message; raises struct.error or ValueError if a field is missing."""

    body: bytes
    order: str
    aligned: bool
    offset: int = 0

    @classmethod
    def of(cls, data: bytes, encoding: str) -> CdrFields:
        """Return a reader at the first field of a message; raises ValueError for other kinds of CDR."""
        if encoding == "ros1":
            return cls(data, "<", aligned=False)
        if data[:2] not in (b"\0\0", b"\0\1"):
            raise ValueError(data[:2])
        return cls(data[4:], "<" if data[1] else ">", aligned=True)

    @property
    def at_end(self) -> bool:
        """Whether all bytes except padding were read."""
        return 0 <= len(self.body) - self.offset < (_MAX_PADDING if self.aligned else 1)

    def count(self) -> int:
        """Read the length of a list or string."""
        self._align(4)
        (count,) = struct.unpack_from(f"{self.order}I", self.body, self.offset)
        self.offset += 4
        return int(count)

    def doubles(self, count: int) -> tuple[float, ...]:
        """Read ``count`` numbers of eight bytes."""
        self._align(8)
        numbers = struct.unpack_from(f"{self.order}{count}d", self.body, self.offset)
        self.offset += 8 * count
        return numbers

    def transform(self, *, child: bool = True) -> TransformMessage:
        """Read a header, the child frame if there is one, and the pose of the child."""
        stamp_ns = self.stamp_ns()
        parent, name = self.text(), self.text() if child else ""
        numbers = self.doubles(7)
        return TransformMessage(stamp_ns, parent, name, numbers[:3], numbers[3:])  # type: ignore[arg-type]

    def orientation(self, values: tuple[float, ...]) -> tuple[float, ...] | None:
        """Return the quaternion of an Imu by its numbers."""
        return None if values[4] == -1.0 else values[:4]

    def stamp_ns(self) -> int:
        """Read the stamp of a header, in ns."""
        self.offset += 0 if self.aligned else 4  # the sequence number of ROS 1
        kinds = "iI" if self.aligned else "II"
        seconds, nanoseconds = struct.unpack_from(f"{self.order}{kinds}", self.body, self.offset)
        self.offset += 8
        return int(seconds * _SECOND_NS + nanoseconds)

    def text(self) -> str:
        """Read a string."""
        length = self.count()
        raw = self.body[self.offset : self.offset + length]
        self.offset += length
        if len(raw) < length or (self.aligned and raw[-1:] != b"\0"):
            raise ValueError(raw)
        return (raw[:-1] if self.aligned else raw).decode()

    def _align(self, size: int) -> None:
        if self.aligned:
            self.offset += -self.offset % size


Rows = NDArray[np.int64]

T = TypeVar("T", "Poses", "Measurements")

MOST_LAYOUTS: Final = 32
"""Messages of one length that have none of the first so many layouts are read one by one."""

_NO_ORIENTATION: Final = (np.nan,) * 4


class _Columns(CdrFields, kw_only=True):
    """Reader of the fields of many messages, ``block`` (n, bytes), as they lie in the first of them.

    Stamps are (n,) and numbers (count, n). The messages are alike in all bytes but these, which are ``varying``.
    """

    block: NDArray[np.uint8]
    varying: NDArray[np.bool_]

    @classmethod
    def of_block(cls, block: NDArray[np.uint8], encoding: str) -> _Columns:
        first = CdrFields.of(block[0].tobytes(), encoding)
        varying = np.zeros(block.shape[1], np.bool_)
        return cls(first.body, first.order, first.aligned, block=block, varying=varying)

    @property
    def alike(self) -> NDArray[np.bool_]:
        """Which messages, (n,), have the layout of the first."""
        fixed = self.block[:, ~self.varying]
        return np.asarray((fixed == fixed[0]).all(axis=1))

    def doubles(self, count: int) -> Any:  # noqa: ANN401
        self._align(8)
        return self._take("f8", count)

    def orientation(self, values: Any) -> Any:  # noqa: ANN401
        return np.where(values[4] == -1.0, np.nan, values[:4])

    def stamp_ns(self) -> Any:  # noqa: ANN401
        if not self.aligned:
            self._take("u4", 1)
        seconds, nanoseconds = self._take("i4" if self.aligned else "u4", 1), self._take("u4", 1)
        return (seconds.astype(np.int64) * _SECOND_NS + nanoseconds)[0]

    def _take(self, kind: str, count: int) -> NDArray[Any]:
        dtype = np.dtype(f"{self.order}{kind}")
        begin = self.block.shape[1] - len(self.body) + self.offset
        part = slice(begin, begin + count * dtype.itemsize)
        if part.stop > self.block.shape[1]:
            raise struct.error("the message is cut")
        self.varying[part] = True
        self.offset += count * dtype.itemsize
        return np.ascontiguousarray(self.block[:, part]).view(dtype).T


def read_blocks(
    messages: Sequence[bytes], encoding: str, read: Callable[[CdrFields], Any]
) -> Iterator[tuple[Rows, Any]]:
    """Yield what ``read`` takes from all messages of one layout, and their numbers (n,); others are left out."""
    by_length = defaultdict[int, list[int]](list)
    for number, message in enumerate(messages):
        by_length[len(message)].append(number)
    for length, numbers in by_length.items():
        rows = np.array(numbers)
        block = np.frombuffer(b"".join(messages[k] for k in numbers), np.uint8).reshape(len(rows), length)
        for _ in range(MOST_LAYOUTS):
            if not block.size:
                break
            alike, fields = _read_alike(block, encoding, read)
            if fields is not None:
                yield rows[alike], fields
            block, rows = block[~alike], rows[~alike]


def _read_alike(
    block: NDArray[np.uint8], encoding: str, read: Callable[[CdrFields], Any]
) -> tuple[NDArray[np.bool_], Any]:
    """Return which messages are like the first, and what is read from these; None if the first cannot be read."""
    try:
        fields = _Columns.of_block(block, encoding)
        value, alike = read(fields), fields.alike
        if fields.at_end:
            return alike, value if alike.all() else read(_Columns.of_block(block[alike], encoding))
    except (struct.error, ValueError):
        pass
    return np.arange(len(block)) == 0, None


def columns_of(
    blocks: Iterable[tuple[Rows, Any]], singles: dict[int, Any], log_ns: Rows
) -> Iterator[Poses | Measurements]:
    """Yield the poses by their frames, or measurements, of messages read in blocks and of single ones by number.

    ``log_ns`` (n,) are the times of recording of all messages.
    """
    yield from (_columns(rows, log_ns, each) for rows, value in blocks for each in _parts(value))
    groups = defaultdict[tuple[str, ...], list[tuple[int, Any]]](list)
    for row, value in singles.items():
        for each in _parts(value):
            groups[tuple(name for name in each if isinstance(name, str))].append((row, each))
    for group in groups.values():
        rows, messages = zip(*group, strict=True)
        yield _columns(np.array(rows), log_ns, type(messages[0])(*map(_stack, zip(*messages, strict=True))))


def _parts(value: Any) -> list[Any]:  # noqa: ANN401
    return [value] if isinstance(value, ImuMessage) else value


def _stack(values: tuple[Any, ...]) -> Any:  # noqa: ANN401
    """Return a field of several messages, (n,) or (k, n); frames are the same in all."""
    if isinstance(values[0], str):
        return values[0]
    if isinstance(values[0], int):
        return np.array([*map(storable, values)], np.int64)
    return np.array([_NO_ORIENTATION if value is None else value for value in values], np.float64).T


def _columns(rows: Rows, log_ns: Rows, message: Any) -> Poses | Measurements:  # noqa: ANN401
    kind = Measurements if isinstance(message, ImuMessage) else Poses
    return kind(rows, message.stamp_ns, log_ns[rows], *message[1:])


def merge_by(parts: Iterable[T], key: Callable[[T], Hashable]) -> dict[Any, T]:
    """Return columns by a key, those of one key in the order of their messages, the keys by their first message."""
    groups = defaultdict[Any, list[T]](list)
    for part in sorted(parts, key=lambda part: int(part.rows[0])):
        groups[key(part)].append(part)
    return {name: group[0] if len(group) == 1 else _merge(group) for name, group in groups.items()}


def merge(parts: Iterable[T]) -> T:
    """Return the columns of all parts in the order of their messages, with the frames of the first."""
    (columns,) = merge_by(parts, lambda _: None).values()
    return columns


def _merge(parts: list[T]) -> T:
    order = np.argsort(np.concatenate([part.rows for part in parts]), kind="stable")
    fields: Iterator[Any] = (
        values[0] if isinstance(values[0], str) else np.concatenate(values, axis=-1)[..., order]
        for values in zip(*parts, strict=True)
    )
    return type(parts[0])(*fields)
