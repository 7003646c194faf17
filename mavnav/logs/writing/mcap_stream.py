"""The records of a new MCAP file in the order of writing (https://mcap.dev/spec).

Every replay writes a file, and the library of the format takes 4 % of its processor time. The bytes equal those of
that library with its default options.
"""

from __future__ import annotations

import struct
from itertools import accumulate
from typing import TYPE_CHECKING, Final
from zlib import crc32

from mavnav.logs.formats.mcap_records import HEAD, MAGIC, Op

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import BinaryIO

_MESSAGE: Final = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS: Final = _MESSAGE.size - HEAD.size
_INDEX_ENTRY: Final = struct.Struct("<QQ")
_CHUNK: Final = struct.Struct("<QQQI")
_CHUNK_INDEX: Final = struct.Struct("<QQQQ")
_STATISTICS: Final = struct.Struct("<QHIIIIQQ")
_PLACE: Final = struct.Struct("<BQQ")
_FOOTER: Final = struct.Struct("<BQQQ")
_COMPRESSION: Final = "zstd"


class McapStream:
    """Writes schemas, channels and messages in chunks, metadata and attachments between them, and the summary."""

    def __init__(self, file: BinaryIO, chunk_bytes: int, profile: str, library: str) -> None:
        """Write the begin of a file; a chunk is closed when it holds more than ``chunk_bytes``."""
        self._file, self._chunk_bytes = file, chunk_bytes
        self._summary: dict[Op, list[bytes]] = {op: [] for op in _SUMMARY_ORDER}
        self._counts: dict[int, int] = {}
        self._first_ns = self._last_ns = 0
        self._offset = 0
        self._begin_chunk()
        self._write(MAGIC, _record(Op.HEADER, _text(profile), _text(library)))

    def schema(self, name: str, encoding: str, text: bytes) -> int:
        """Add a type of messages; returns its number."""
        number = len(self._summary[Op.SCHEMA]) + 1
        return self._defined(Op.SCHEMA, number, _u16(number), _text(name), _text(encoding), _block(text))

    def channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Add a topic; returns its number."""
        number = len(self._summary[Op.CHANNEL]) + 1
        fields = (_u16(number), _u16(schema), _text(topic), _text(encoding), _texts(metadata))
        return self._defined(Op.CHANNEL, number, *fields)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write values by name."""
        self._indexed(Op.METADATA_INDEX, _record(Op.METADATA, _text(name), _texts(values)), _text(name))

    def attachment(self, stamp_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Write a file, with the time of its creation."""
        times, size = struct.pack("<QQ", stamp_ns, stamp_ns), struct.pack("<Q", len(data))
        content = b"".join((times, _text(name), _text(media_type), size, data))
        record = _record(Op.ATTACHMENT, content, struct.pack("<I", crc32(content)))
        self._indexed(Op.ATTACHMENT_INDEX, record, times, size, _text(name), _text(media_type))

    def message(self, channel: int, stamp_ns: int, message: bytes) -> None:
        """Add a message, recorded and published at a time."""
        if channel not in self._index:
            self._index[channel] = []
        self._index[channel].append(_INDEX_ENTRY.pack(stamp_ns, self._size))
        length = _MESSAGE_FIELDS + len(message)
        self._records += (_MESSAGE.pack(Op.MESSAGE, length, channel, 0, stamp_ns, stamp_ns), message)
        self._stamps_ns.append(stamp_ns)
        self._size += HEAD.size + length
        if self._size > self._chunk_bytes:
            self._end_chunk()

    def finish(self) -> None:
        """Write the last chunk, and the summary with its offsets and the checksum."""
        self._end_chunk()
        self._write(_record(Op.DATA_END, bytes(4)))
        self._summary[Op.STATISTICS] = [self._statistics()]
        groups = [b"".join(records) for records in self._summary.values()]
        starts = list(accumulate(map(len, groups), initial=self._offset))
        places = zip(self._summary, starts, groups, strict=False)
        offsets = (_record(Op.SUMMARY_OFFSET, _PLACE.pack(op, start, len(group))) for op, start, group in places)
        summary = b"".join((*groups, *offsets))
        footer = _FOOTER.pack(Op.FOOTER, 20, self._offset, starts[-1])
        self._write(summary, footer, struct.pack("<I", crc32(footer, crc32(summary))), MAGIC)

    def _write(self, *parts: bytes) -> None:
        self._offset += self._file.write(b"".join(parts))

    def _defined(self, op: Op, number: int, *fields: bytes) -> int:
        """Write the record of a schema or channel into the chunk, and into the summary."""
        record = _record(op, *fields)
        self._records.append(record)
        self._size += len(record)
        self._summary[op].append(record)
        return number

    def _indexed(self, op: Op, record: bytes, *fields: bytes) -> None:
        """Write a record outside of chunks, and its index into the summary."""
        place = struct.pack("<QQ", self._offset, len(record))
        self._summary[op].append(_record(op, place, *fields))
        self._write(record)

    def _begin_chunk(self) -> None:
        self._records: list[bytes] = []
        self._index: dict[int, list[bytes]] = {}
        self._stamps_ns: list[int] = []
        self._size = 0

    def _end_chunk(self) -> None:
        """Write the chunk with the index of its messages; one without messages is kept until there is one."""
        import zstandard  # noqa: PLC0415  only writers need it

        if not self._stamps_ns:
            return
        records = b"".join(self._records)
        stored = zstandard.compress(records)
        first_ns, last_ns = min(self._stamps_ns), max(self._stamps_ns)
        self._first_ns = min(first_ns, self._first_ns) if self._counts else first_ns
        self._last_ns = max(last_ns, self._last_ns)
        head = _CHUNK.pack(first_ns, last_ns, len(records), crc32(records))
        chunk = _record(Op.CHUNK, head, _text(_COMPRESSION), struct.pack("<Q", len(stored)), stored)
        start = self._offset
        self._write(chunk)
        indices = [_record(Op.MESSAGE_INDEX, _u16(k), _block(b"".join(found))) for k, found in self._index.items()]
        offsets = accumulate(map(len, indices), initial=self._offset)
        entry = (
            _CHUNK_INDEX.pack(first_ns, last_ns, start, len(chunk)),
            _block(b"".join(struct.pack("<HQ", k, at) for k, at in zip(self._index, offsets, strict=False))),
            struct.pack("<Q", sum(map(len, indices))),
            _text(_COMPRESSION),
            struct.pack("<QQ", len(stored), len(records)),
        )
        self._summary[Op.CHUNK_INDEX].append(_record(Op.CHUNK_INDEX, *entry))
        self._write(*indices)
        for k, found in self._index.items():
            self._counts[k] = self._counts.get(k, 0) + len(found)
        self._begin_chunk()

    def _statistics(self) -> bytes:
        kinds = (Op.SCHEMA, Op.CHANNEL, Op.ATTACHMENT_INDEX, Op.METADATA_INDEX, Op.CHUNK_INDEX)
        counted = [len(self._summary[kind]) for kind in kinds]
        numbers = _STATISTICS.pack(sum(self._counts.values()), *counted, self._first_ns, self._last_ns)
        each = b"".join(struct.pack("<HQ", k, count) for k, count in self._counts.items())
        return _record(Op.STATISTICS, numbers, _block(each))


_SUMMARY_ORDER: Final = (
    Op.SCHEMA, Op.CHANNEL, Op.STATISTICS, Op.CHUNK_INDEX, Op.ATTACHMENT_INDEX, Op.METADATA_INDEX,
)  # fmt: skip


def _record(op: Op, *fields: bytes) -> bytes:
    content = b"".join(fields)
    return HEAD.pack(op, len(content)) + content


def _u16(number: int) -> bytes:
    return number.to_bytes(2, "little")


def _block(content: bytes) -> bytes:
    return len(content).to_bytes(4, "little") + content


def _text(text: str) -> bytes:
    return _block(text.encode())


def _texts(values: Mapping[str, str]) -> bytes:
    return _block(b"".join(_text(name) + _text(value) for name, value in values.items()))
