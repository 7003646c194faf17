"""Poses and inertial measurements of many messages, read in columns: messages of a topic mostly have one layout."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from mavnav.logs.messages.fast_cdr import CdrFields
from mavnav.logs.messages.records import ImuMessage, Measurements, Poses
from mavnav.logs.stamps import storable

Rows = NDArray[np.int64]

T = TypeVar("T", "Poses", "Measurements")

MOST_LAYOUTS: Final = 32
"""Messages of one length that have none of the first so many layouts are read one by one."""

_SECOND_NS = 1_000_000_000
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
