"""Records of a ROS 1 bag: parsing of their headers, and the search for the next record after damage.

A record is ``header length u32, header, data length u32, data``; a header is fields of ``length u32, name=value``
(http://wiki.ros.org/Bags/Format/2.0).
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavnav.logs.formats.source import Source
    from mavnav.logs.read_report import ReadReport

OP_FIELD: Final = b"\x04\x00\x00\x00op="
_MAX_HEADER_BYTES = 1 << 16
_USUAL_HEADER_BYTES = 256
_REACH_BYTES = 256
_BLOCK_BYTES = 1 << 20
RECORD_COST = 4
"""Cost of a record of this format, or of a candidate for one, in the unit of ``Allowance.spend_record``."""
U32: Final = struct.Struct("<I")


class BagOp(IntEnum):
    """Kinds of records."""

    DEFINITION = 1
    MESSAGE = 2
    BAG = 3
    INDEX = 4
    CHUNK = 5
    CHUNK_INFO = 6
    CONNECTION = 7


_OPCODES = frozenset(BagOp)


class BagRecord(NamedTuple):
    """A record with a valid header, and data from ``start`` to ``end`` by its length.

    It is ``suspect`` if no valid record follows.
    """

    opcode: int
    fields: dict[bytes, bytes]
    start: int
    end: int
    suspect: bool = False


def is_flat(record: BagRecord) -> bool:
    """Return whether a record is an uncompressed chunk, whose records are read as records of the file."""
    return record.opcode == BagOp.CHUNK and record.fields.get(b"compression", b"none") == b"none"


def sound_records(source: Source, offset: int, report: ReadReport) -> Iterator[BagRecord]:
    """Yield the complete records; after lost bytes, continue at the next valid header."""
    pending: BagRecord | None = None
    while offset < source.size or (pending and offset > source.size):
        record = parse_header(source, offset)
        if record is None:
            next_header = _find_header(source, (pending.start if pending else offset) + 1)
            if pending and _is_whole(source, pending, next_header):
                end = next_header if pending.opcode == BagOp.CHUNK else pending.end  # a chunk's length may be wrong
                yield pending._replace(end=end, suspect=True)
            _report_loss(source, pending, offset, next_header, report)
            pending, offset = None, next_header
            continue
        if pending:
            yield pending
        pending = record
        offset = record.start if is_flat(record) else record.end
    if pending:
        yield pending


def _report_loss(source: Source, pending: BagRecord | None, offset: int, next_header: int, report: ReadReport) -> None:
    """Report lost bytes or a wrong length; ``offset`` is where a header is expected."""
    if offset > source.size == next_header and pending:
        text, at = "the last record is cut by the end", pending.start
    elif pending and not _is_whole(source, pending, next_header):
        text, at = f"{next_header - pending.start} bytes are no record", pending.start
    elif offset >= next_header and pending:
        text, at = "the length of a record is wrong", pending.start
    else:
        text, at = f"{next_header - offset} bytes are no record", offset
    report.damage(text, source.where(at))


def _is_whole(source: Source, pending: BagRecord, next_header: int) -> bool:
    """Return whether a record is complete, if no header follows it.

    It is not if the next valid header is within its declared length. A compressed chunk always counts as complete,
    because its decompression shows a loss.
    """
    if pending.opcode == BagOp.CHUNK:
        return True
    if next_header < source.size:
        return next_header >= pending.end
    left = source.read(pending.end, 4)  # the header that follows is cut by the end, or zeros follow
    return pending.end <= source.size and (len(left) < 4 or 0 < U32.unpack(left)[0] <= _MAX_HEADER_BYTES)


def parse_header(source: Source, offset: int) -> BagRecord | None:
    """Parse the record header at an offset; None if there is none."""
    block = source.read(offset, _USUAL_HEADER_BYTES)
    if len(block) < 4:
        return None
    (length,) = U32.unpack_from(block)
    if not 0 < length <= min(_MAX_HEADER_BYTES, source.size - offset - 8):
        return None
    if length + 8 > len(block):
        block = source.read(offset, length + 8)
    fields = parse_fields(block[4 : 4 + length])
    op = fields.get(b"op", b"") if fields is not None else b""
    if fields is None or len(op) != 1 or op[0] not in _OPCODES:
        return None
    start = offset + 8 + length
    return BagRecord(op[0], fields, start, start + U32.unpack_from(block, 4 + length)[0])


def parse_fields(header: bytes) -> dict[bytes, bytes] | None:
    """Split a header into its fields; None unless they fill it exactly."""
    fields: dict[bytes, bytes] = {}
    offset = 0
    while offset + 4 <= len(header):
        (length,) = U32.unpack_from(header, offset)
        name, equals, value = header[offset + 4 : offset + 4 + length].partition(b"=")
        offset += 4 + length
        if not equals or offset > len(header):
            return None
        fields[name] = value
    return fields if offset == len(header) else None


def _find_header(source: Source, offset: int) -> int:
    """Return the offset of the next valid header, found by its ``op`` field; the size of the source if none."""
    while offset < source.size:
        block = source.read(offset, _BLOCK_BYTES)
        for at in _candidates(block):
            if not source.allowance.spend_record(RECORD_COST):
                return source.size
            record = parse_header(source, offset + at)
            if record is not None and _is_followed(source, record):
                return offset + at
        if len(block) < _BLOCK_BYTES:
            break
        offset += len(block) - 2 * _REACH_BYTES
        offset = max(offset, source.next_data(offset) - 2 * _REACH_BYTES)
    return source.size


def _is_followed(source: Source, record: BagRecord) -> bool:
    """Return whether a header belongs to the bag, rather than being bytes in compressed data that look like one."""
    return record.opcode == BagOp.CHUNK or record.end == source.size or parse_header(source, record.end) is not None


def _candidates(block: bytes) -> Iterator[int]:
    """Yield the offsets in the 256 bytes before an ``op`` field where a header may begin, each once."""
    tried, op_at = 0, block.find(OP_FIELD)
    while op_at >= 0:
        for at in range(max(tried, op_at - _REACH_BYTES), op_at - 3):
            if block[at + 2 : at + 4] == b"\0\0" == block[at + 6 : at + 8]:  # two lengths below 64 KiB
                yield at
        tried = max(tried, op_at - 3)
        op_at = block.find(OP_FIELD, op_at + 1)
