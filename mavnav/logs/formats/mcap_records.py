"""MCAP records: what their fields say, and whether bytes can be the head of one (https://mcap.dev/spec).

A record is ``opcode u8, length u64, content``, little-endian. Nothing guards a record's head, so a head is trusted
only if its content can be what its opcode says.
"""

from __future__ import annotations

import re
import struct
from enum import IntEnum
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from mavnav.logs.formats.decompress import CODECS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mavnav.logs.formats.source import Source

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD: Final = struct.Struct("<BQ")
MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_COMPRESSION = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4|\x03\0\0\0bz2")
_NAME_LENGTH = slice(_CHUNK_HEAD.size, _CHUNK_HEAD.size + 4)
_NAME_LENGTHS = frozenset(len(name).to_bytes(4, "little") for name in CODECS)
_PREFIX_BYTES = 64
_FIRST_BLOCK_BYTES, _BLOCK_BYTES = 1 << 12, 1 << 20
_MOST_CANDIDATES = 200_000


class Op(IntEnum):
    """Opcodes."""

    HEADER = 1
    FOOTER = 2
    SCHEMA = 3
    CHANNEL = 4
    MESSAGE = 5
    CHUNK = 6
    MESSAGE_INDEX = 7
    CHUNK_INDEX = 8
    ATTACHMENT = 9
    ATTACHMENT_INDEX = 10
    STATISTICS = 11
    METADATA = 12
    METADATA_INDEX = 13
    SUMMARY_OFFSET = 14
    DATA_END = 15


IN_CHUNKS: Final = frozenset({Op.SCHEMA, Op.CHANNEL, Op.MESSAGE})
"""Records that stand in chunks."""

PRIVATE: Final = 0x80
"""Opcodes from here on are free for anybody's use."""


class Record(NamedTuple):
    """A record: its content lies from ``start`` to ``end``. ``odd`` says what had to be put right to read it."""

    opcode: int
    start: int
    end: int
    odd: str = ""


class Fields:
    """The fields of a record's content, one after the other; raises struct.error where they are cut."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self.offset = 0

    def number(self, kind: str) -> int:
        """Read a number of a ``struct`` format."""
        (value,) = struct.unpack_from(f"<{kind}", self._content, self.offset)
        self.offset += struct.calcsize(f"<{kind}")
        return int(value)

    def block(self) -> bytes:
        """Read bytes with their length (u32) before them."""
        length = self.number("I")
        end = self.offset + length
        if end > len(self._content):
            raise struct.error("a field is longer than its record")
        block = self._content[self.offset : end]
        self.offset = end
        return block

    def text(self) -> str:
        """Read a string; bytes that are no UTF-8 are replaced."""
        return self.block().decode(errors="replace")


class ChunkHead(NamedTuple):
    """The fields of a chunk before its data; ``start`` is where these begin in the content."""

    declared_bytes: int
    crc: int
    compression: str
    stored_bytes: int
    start: int


def chunk_head(content: bytes) -> ChunkHead:
    """Read the fields of a chunk; raises struct.error."""
    _, _, declared, crc = _CHUNK_HEAD.unpack_from(content)
    fields = Fields(content)
    fields.offset = _CHUNK_HEAD.size
    compression = fields.text()
    return ChunkHead(declared, crc, compression, fields.number("Q"), fields.offset)


def record_at(source: Source, offset: int, *, mend: bool = True) -> Record | None:
    """Read the record head at an offset; None where none is, or where its content cannot be what it says.

    A chunk whose own fields give its length is preferred to another length or opcode of the record (``mend``), if a
    record follows there. The opcode of another record that can be one is believed, unless its length is the chunk's.
    """
    prefix = source.read(offset, HEAD.size + _PREFIX_BYTES)
    if len(prefix) < HEAD.size:
        return None
    opcode, length = HEAD.unpack_from(prefix)
    start, rest, content = offset + HEAD.size, source.size - offset - HEAD.size, prefix[HEAD.size :]
    known = _CHECKS.get(opcode, _never if opcode == 0 else _any)
    declared = None if length > rest or not known(content, length) else Record(opcode, start, start + length)
    if declared is not None and not (mend and _may_be_chunk(opcode, length)):
        return declared
    head = _head_of_chunk(content)
    if head is None:
        return declared
    stored = head.start + head.stored_bytes
    if mend and (opcode, length) != (Op.CHUNK, stored) and _is_chunk_instead(source, declared, opcode, start, head):
        return Record(Op.CHUNK, start, start + stored, f"the record says kind {opcode} and {length} bytes")
    if opcode == Op.CHUNK and stored == length > rest:
        return Record(Op.CHUNK, start, source.size, "the chunk is cut by the end of the file")
    return declared


def _may_be_chunk(opcode: int, length: int) -> bool:
    """Tell whether a head is that of a chunk, also with one bit of its opcode wrong, or of no record that is known."""
    long_enough = length > _CHUNK_HEAD.size or opcode == Op.CHUNK
    return long_enough and (opcode > Op.DATA_END or (opcode ^ Op.CHUNK).bit_count() <= 1)


def _is_chunk_instead(source: Source, declared: Record | None, opcode: int, start: int, head: ChunkHead) -> bool:
    """Tell whether a chunk that ends by its own fields stands where a record's head says otherwise."""
    if not _may_be_chunk(opcode, _PREFIX_BYTES) and not head.compression:
        return False
    end = start + head.start + head.stored_bytes
    if end > source.size or not is_boundary(source, end):
        return False
    known = opcode not in (0, Op.CHUNK) and opcode <= Op.DATA_END and declared is not None
    return not known or (declared is not None and declared.end == end and bool(head.compression))


def _head_of_chunk(content: bytes) -> ChunkHead | None:
    """Return the head of a chunk; None where the bytes cannot be one."""
    if content[_NAME_LENGTH] not in _NAME_LENGTHS:  # a quick no for millions of others
        return None
    try:
        head = chunk_head(content[:_PREFIX_BYTES])
    except struct.error:
        return None
    return head if head.compression in CODECS else None


def plain_records(records: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of records in memory, up to the first that is cut."""
    offset = 0
    while len(records) - offset >= HEAD.size:
        opcode, length = HEAD.unpack_from(records, offset)
        start = offset + HEAD.size
        if length > len(records) - start:
            return
        yield opcode, records[start : start + length]
        offset = start + length


def is_boundary(source: Source, offset: int) -> bool:
    """Tell whether a record, the magic or the end stands at an offset.

    Where bytes are lost or gained, a length is easily taken for an unknown kind: such a record has another behind it.
    """
    if offset == source.size or source.read(offset, len(MAGIC)) == MAGIC:
        return True
    record = record_at(source, offset, mend=False)
    if record is None or record.opcode <= Op.DATA_END or record.end == source.size:
        return record is not None
    return record_at(source, record.end, mend=False) is not None


def find_record(source: Source, offset: int, *, outer: bool = False) -> int:
    """Return the offset of the next record that is followed by another, a chunk, or the magic; the size if none.

    Only heads whose length is below 4 GiB are looked at, and only so many that hostile bytes cost seconds at most.
    Records that stand in chunks are passed over if only ``outer`` ones are wanted.
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
        if tried > _MOST_CANDIDATES:
            return source.size
        offset = max(offset + reach, source.next_data(offset + reach) - HEAD.size)
        reach = min(2 * reach, _BLOCK_BYTES)
    return source.size


def _candidates(block: bytes, reach: int) -> list[int]:
    """Return the places in the first ``reach`` bytes with an opcode, and zeros where a length has its upper half.

    So are those before what reads like the head of a compressed chunk.
    """
    count = min(len(block) - HEAD.size + 1, reach)
    if count <= 0:
        return []
    values = np.frombuffer(block, np.uint8)
    upper = values[5 : 5 + count] | values[6 : 6 + count] | values[7 : 7 + count] | values[8 : 8 + count]
    good = (values[:count] > 0) & (values[:count] <= Op.DATA_END) & (upper == 0)
    places: list[int] = np.flatnonzero(good)[:_MOST_CANDIDATES].tolist()
    named = (match.start() - HEAD.size - _CHUNK_HEAD.size for match in _COMPRESSION.finditer(block))
    magic = block.find(MAGIC)
    return sorted({*places, *(at for at in named if 0 <= at < count), *([magic] if magic >= 0 else [])})


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


def _never(_content: bytes, _length: int) -> bool:
    return False


def _any(_content: bytes, _length: int) -> bool:
    return True


def _at_least(least: int, most: int = 1 << 63) -> Callable[[bytes, int], bool]:
    return lambda _content, length: least <= length <= most


def _text_within(offset: int, behind: int) -> Callable[[bytes, int], bool]:
    """Make the check of a record with a string at ``offset`` and at least ``behind`` bytes after it."""

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
    Op.CHUNK: _text_within(_CHUNK_HEAD.size, 8),  # whatever its compression is called
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
"""Opcode -> whether content (its beginning) and length can be such a record; padding behind the fields is legal."""
