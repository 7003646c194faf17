"""MCAP records: their fields, and checks whether bytes can be the head of a record (https://mcap.dev/spec).

A record is ``opcode u8, length u64, content``, little-endian. No checksum covers the head of a record, so a head is
accepted only if the content can be that of a record with this opcode.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

import numpy as np
from mcap.opcode import Opcode as Op

from mavnav.logs.formats.decompress import COMPRESSIONS
from mavnav.logs.formats.source import Source

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD: Final = struct.Struct("<BQ")
MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_NUMBERS = {kind: struct.Struct(f"<{kind}") for kind in "HIQ"}
_COMPRESSION = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4|\x03\0\0\0bz2")
_NAME_LENGTH = slice(_CHUNK_HEAD.size, _CHUNK_HEAD.size + 4)
_NAME_LENGTHS = frozenset(len(name).to_bytes(4, "little") for name in COMPRESSIONS)
_PREFIX_BYTES = 64
_FIRST_BLOCK_BYTES, _BLOCK_BYTES = 1 << 12, 1 << 20
_MAX_CANDIDATES = 200_000

IN_CHUNKS: Final = frozenset({Op.SCHEMA, Op.CHANNEL, Op.MESSAGE})
"""Records that chunks contain."""

PRIVATE: Final = 0x80
"""First of the opcodes that the format reserves for applications."""


class McapRecord(NamedTuple):
    """A record with its content from ``start`` to ``end``; ``correction`` describes a repair of its head, if any."""

    opcode: int
    start: int
    end: int
    correction: str = ""


class RecordFields:
    """Sequential reader of the fields of a record; raises struct.error at a field that is cut."""

    def __init__(self, content: bytes, offset: int = 0) -> None:
        self._content = content
        self.offset = offset

    def number(self, kind: str) -> int:
        """Read a number of a ``struct`` format."""
        number = _NUMBERS[kind]
        (value,) = number.unpack_from(self._content, self.offset)
        self.offset += number.size
        return int(value)

    def block(self) -> bytes:
        """Read bytes that follow their length (u32)."""
        length = self.number("I")
        end = self.offset + length
        if end > len(self._content):
            raise struct.error("a field is longer than its record")
        block = self._content[self.offset : end]
        self.offset = end
        return block

    def text(self) -> str:
        """Read a string; bytes that are not UTF-8 are replaced."""
        return self.block().decode(errors="replace")

    def texts(self) -> dict[str, str]:
        """Read strings by name."""
        inner = RecordFields(self.block())
        texts = {}
        while inner.offset < len(inner._content):
            name = inner.text()
            texts[name] = inner.text()
        return texts


class ChunkHead(NamedTuple):
    """The fields of a chunk before its data; ``start`` is the offset of the data in the content."""

    declared_bytes: int
    crc: int
    compression: str
    stored_bytes: int
    start: int


def chunk_head(content: bytes) -> ChunkHead:
    """Read the fields of a chunk; raises struct.error."""
    _, _, declared, crc = _CHUNK_HEAD.unpack_from(content)
    fields = RecordFields(content, _CHUNK_HEAD.size)
    compression = fields.text()
    return ChunkHead(declared, crc, compression, fields.number("Q"), fields.offset)


def record_at(source: Source, offset: int, *, repair: bool = True) -> McapRecord | None:
    """Read the record head at an offset; None if there is none, or if the content does not fit the opcode.

    With ``repair``, the fields of a chunk take precedence over a wrong opcode or length in the head, if a record
    follows at the end that these fields give. A known opcode with fitting content is kept, unless its length is the
    chunk's and the chunk is compressed.
    """
    prefix = source.read(offset, HEAD.size + _PREFIX_BYTES)
    if len(prefix) < HEAD.size:
        return None
    opcode, length = HEAD.unpack_from(prefix)
    start, rest, content = offset + HEAD.size, source.size - offset - HEAD.size, prefix[HEAD.size :]
    fits = opcode > 0 and length <= rest and _CHECKS.get(opcode, _at_least(0))(content, length)
    declared = McapRecord(opcode, start, start + length) if fits else None
    if declared is not None and not (repair and _may_be_chunk(opcode, length)):
        return declared
    head = _head_of_chunk(content)
    if head is None:
        return declared
    stored = head.start + head.stored_bytes
    if repair and (opcode, length) != (Op.CHUNK, stored) and _is_chunk_instead(source, declared, opcode, start, head):
        return McapRecord(Op.CHUNK, start, start + stored, f"the record says kind {opcode} and {length} bytes")
    if opcode == Op.CHUNK and stored == length > rest:
        return McapRecord(Op.CHUNK, start, source.size, "the chunk is cut by the end of the file")
    return declared


def _may_be_chunk(opcode: int, length: int) -> bool:
    """Return whether a head can be a chunk's: its opcode is a chunk's with at most one wrong bit, or unknown."""
    long_enough = length > _CHUNK_HEAD.size or opcode == Op.CHUNK
    return long_enough and bool(opcode > Op.DATA_END or (opcode ^ Op.CHUNK).bit_count() <= 1)


def _is_chunk_instead(source: Source, declared: McapRecord | None, opcode: int, start: int, head: ChunkHead) -> bool:
    """Return whether the content is a chunk by its own fields, although the head has another opcode or length."""
    if not _may_be_chunk(opcode, _PREFIX_BYTES) and not head.compression:
        return False
    end = start + head.start + head.stored_bytes
    if end > source.size or not is_boundary(source, end):
        return False
    known = opcode not in (0, Op.CHUNK) and opcode <= Op.DATA_END and declared is not None
    return not known or (declared is not None and declared.end == end and bool(head.compression))


def _head_of_chunk(content: bytes) -> ChunkHead | None:
    """Return the head of a chunk; None if the bytes cannot be one."""
    if content[_NAME_LENGTH] not in _NAME_LENGTHS:  # rejects nearly all candidates quickly
        return None
    try:
        head = chunk_head(content[:_PREFIX_BYTES])
    except struct.error:
        return None
    return head if head.compression in COMPRESSIONS else None


def plain_records(records: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of records in memory, up to the first one that is cut."""
    offset = 0
    while len(records) - offset >= HEAD.size:
        opcode, length = HEAD.unpack_from(records, offset)
        start = offset + HEAD.size
        if length > len(records) - start:
            return
        yield opcode, records[start : start + length]
        offset = start + length


def is_boundary(source: Source, offset: int) -> bool:
    """Return whether a record, the magic or the end of the source is at an offset.

    After lost or added bytes, a length field can look like a record of an unknown kind. Such a record counts only if
    another record follows it.
    """
    if offset == source.size or source.read(offset, len(MAGIC)) == MAGIC:
        return True
    record = record_at(source, offset, repair=False)
    if record is None or record.opcode <= Op.DATA_END or record.end == source.size:
        return record is not None
    return record_at(source, record.end, repair=False) is not None


def find_record(source: Source, offset: int, *, outer: bool = False) -> int:
    """Return the offset of the next magic, chunk, or record followed by another; the size of the source if none.

    Only heads with a length below 4 GiB are considered, and at most 200,000 of them, so that hostile bytes cost seconds
    at most. With ``outer``, the kinds of records that chunks contain are skipped.
    """
    tried, reach = 0, _FIRST_BLOCK_BYTES
    while offset < source.size:
        block = source.read(offset, reach + HEAD.size + _PREFIX_BYTES)
        for at in _candidates(block, reach):
            if outer and block[at] in IN_CHUNKS:
                continue
            tried += 1
            if _is_record(source, offset + at):
                return offset + at
        if tried > _MAX_CANDIDATES:
            return source.size
        offset = max(offset + reach, source.next_data(offset + reach) - HEAD.size)
        reach = min(2 * reach, _BLOCK_BYTES)
    return source.size


def _candidates(block: bytes, reach: int) -> list[int]:
    """Return the offsets in the first ``reach`` bytes where a record head may begin.

    These are an opcode with zeros in the upper half of the length, the head of a compressed chunk, and the magic.
    """
    count = min(len(block) - HEAD.size + 1, reach)
    if count <= 0:
        return []
    values = np.frombuffer(block, np.uint8)
    upper = values[5 : 5 + count] | values[6 : 6 + count] | values[7 : 7 + count] | values[8 : 8 + count]
    good = (values[:count] > 0) & (values[:count] <= Op.DATA_END) & (upper == 0)
    offsets: list[int] = np.flatnonzero(good)[:_MAX_CANDIDATES].tolist()
    compressed = (match.start() - HEAD.size - _CHUNK_HEAD.size for match in _COMPRESSION.finditer(block))
    magic = block.find(MAGIC)
    return sorted({*offsets, *(at for at in compressed if 0 <= at < count), *([magic] if magic >= 0 else [])})


def _is_record(source: Source, offset: int) -> bool:
    if source.read(offset, len(MAGIC)) == MAGIC:
        return True
    record = record_at(source, offset)
    if record is None:
        return False
    if record.opcode != Op.CHUNK:
        return is_boundary(source, record.end)
    head = _head_of_chunk(source.read(record.start, _PREFIX_BYTES))
    return head is not None and (bool(head.compression) or is_boundary(source, record.end))


def _at_least(min_bytes: int, max_bytes: int = 1 << 63) -> Callable[[bytes, int], bool]:
    return lambda _content, length: min_bytes <= length <= max_bytes


def _text_within(offset: int, behind: int) -> Callable[[bytes, int], bool]:
    """Return the check of a record with a string at ``offset`` and at least ``behind`` bytes after it."""

    def fits(content: bytes, length: int) -> bool:
        if length < offset + 4 + behind or len(content) < offset + 4:
            return False
        return offset + 4 + int.from_bytes(content[offset : offset + 4], "little") + behind <= length

    return fits


_CHECKS: Final[dict[int, Callable[[bytes, int], bool]]] = {
    Op.HEADER: _text_within(0, 4),
    Op.FOOTER: _at_least(20, 1 << 10),
    Op.SCHEMA: _text_within(2, 8),
    Op.CHANNEL: _text_within(4, 8),
    Op.MESSAGE: _at_least(MESSAGE_HEAD.size),
    Op.CHUNK: _text_within(_CHUNK_HEAD.size, 8),  # with any compression, also an unknown one
    Op.MESSAGE_INDEX: _text_within(2, 0),
    Op.CHUNK_INDEX: _at_least(60),
    Op.ATTACHMENT: _text_within(16, 16),
    Op.ATTACHMENT_INDEX: _at_least(40),
    Op.STATISTICS: _at_least(46),
    Op.METADATA: _text_within(0, 4),
    Op.METADATA_INDEX: _text_within(16, 0),
    Op.SUMMARY_OFFSET: _at_least(17, 1 << 10),
    Op.DATA_END: _at_least(4, 1 << 10),
}
"""Opcode -> check of the first content bytes and the length of such a record; padding after the fields is legal."""
