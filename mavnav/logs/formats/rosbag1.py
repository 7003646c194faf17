"""Reader of ROS 1 bags, formats 2.0 and 1.2; reads from front to back, so that no index is needed.

Formats: http://wiki.ros.org/Bags/Format/2.0, and 1.2, which has no chunks and has topic and type in every message. A
bag is a magic line and records of ``header length u32, header, data length u32, data``; a header is fields of ``length
u32, name=value``. The data of a chunk are records too. The records of an uncompressed chunk are read as records of the
file: the length of the chunk is not needed, and memory use does not grow with it.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Iterator
from enum import IntEnum
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Final, NamedTuple

from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES, TOO_MANY, Allowance, DecompressError, decompress
from mavnav.logs.formats.source import BAG_MAGIC, MAGIC_WITHIN_BYTES, OLD_BAG_MAGIC, ReaderState, Source
from mavnav.logs.messages.definitions import MD5
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import LATCHING, Channel, RawMessage, Schema, ros_type

OP_FIELD: Final = b"\x04\x00\x00\x00op="
_MAX_HEADER_BYTES = 1 << 16
_USUAL_HEADER_BYTES = 256
_REACH_BYTES = 256
_BLOCK_BYTES = 1 << 20
_RECORD_COST = 4
"""Cost of a record of this format, or of a candidate for one, in the unit of ``Allowance.spend_record``."""
_U32 = struct.Struct("<I")
_USUAL_FIELDS = re.compile(rb"(?:\x04\0\0\0op=(.)|\x09\0\0\0conn=(.{4})|\x0d\0\0\0time=(.{8})){3}", re.DOTALL)
"""The header of a message, its three fields in any order: matched in a tenth of the time of splitting it."""
_VERSION = 1
"""Version of the index and of its entries for chunks."""
_U32_PAIR = struct.Struct("<II")


class _BagOp(IntEnum):
    """Kinds of records."""

    DEFINITION = 1
    MESSAGE = 2
    BAG = 3
    INDEX = 4
    CHUNK = 5
    CHUNK_INFO = 6
    CONNECTION = 7


_OPCODES = frozenset(_BagOp)


class _BagRecord(NamedTuple):
    """A record with a valid header, and data from ``start`` to ``end`` by its length.

    It is ``suspect`` if no valid record follows.
    """

    opcode: int
    fields: dict[bytes, bytes]
    start: int
    end: int
    suspect: bool = False


class _BagState(ReaderState):
    search: Callable[[], dict[int, Channel]] | None = None
    declared: int = 0


def read_rosbag1(path: Path, report: ReadReport) -> Iterator[RawMessage]:
    """Yield the messages of a ROS 1 bag, in the order of the file, in constant memory.

    Unreadable data are reported and left out. A message is complete only if a valid record or the end follows directly:
    in a bag that lost bytes, a message across the loss would decode to wrong values. Messages of a chunk that does not
    decompress to its end are marked as suspect.
    """
    with path.open("rb") as file:
        source = Source(file, path.stat().st_size)
        state = _BagState(report, Allowance(source.size))
        begin = _begin(source, report)
        if source.size == begin:
            report.damage("the bag ends behind its magic line", source.where(source.size))
        state.spare = _connections(source, _index_records(source))
        state.search = partial(_connections, source, _sound_records(source, begin, ReadReport()))
        for record in _sound_records(source, begin, report):
            report.here_bytes = record.start
            if record.opcode != _BagOp.MESSAGE:
                _check_numbers(record, report)
            if record.opcode == _BagOp.CHUNK and not _is_flat(record):
                yield from _chunk_messages(source, record, state)
            elif message := _take(source, record, state):
                yield message
    if state.declared > state.messages:
        missing = state.declared - state.messages
        report.damage(f"{missing} of the {state.declared} messages that the index counts are not there", path.name)


def _begin(source: Source, report: ReadReport) -> int:
    """Return the offset after the magic line, which may be damaged or have other bytes before it."""
    head = source.read(0, MAGIC_WITHIN_BYTES)
    for magic in (BAG_MAGIC, OLD_BAG_MAGIC):
        at = head.find(magic)
        if at >= 0:
            if at:
                report.damage(f"{at} bytes that are no bag lie before the magic line", source.where(0))
            return at + len(magic)
    report.damage("the bag does not begin with its magic line", source.where(0))
    return head.find(b"\n", 0, len(OLD_BAG_MAGIC)) + 1


def _index_records(source: Source) -> Iterator[_BagRecord]:
    """Yield the connections of the index, which are needed only if the chunk that declares them is damaged."""
    bag = _parse_header(source, len(BAG_MAGIC))
    index_at = _index_pos(bag) if bag else 0
    record = _parse_header(source, index_at) if len(BAG_MAGIC) < index_at < source.size else None
    while record is not None and record.opcode == _BagOp.CONNECTION and record.end <= source.size:
        yield record
        record = _parse_header(source, record.end)


def _connections(source: Source, records: Iterable[_BagRecord]) -> dict[int, Channel]:
    """Return the channels that the connections among some records declare, by number."""
    state = _BagState(ReadReport())
    for record in records:
        if record.opcode == _BagOp.CONNECTION:
            _take(source, record, state)
    return state.channels


def _chunk_messages(source: Source, record: _BagRecord, state: _BagState) -> Iterator[RawMessage]:
    """Yield the messages of a compressed chunk."""
    name = record.fields.get(b"compression", b"").decode(errors="replace")
    where = f"chunk at byte {record.start}"
    try:
        packed = source.read(record.start, min(record.end - record.start, MAX_CHUNK_BYTES))
        data, problem = decompress(name, packed, state.allowance)
    except DecompressError as error:
        state.report.damage(f"chunk left out: {error}", where)
        return
    declared = int.from_bytes(record.fields.get(b"size", b"")[:4], "little")
    if problem is None and len(data) != declared:
        problem = f"the chunk declares {declared} bytes and holds {len(data)}"
    if problem:
        state.report.damage(f"{problem}; what can be read of the chunk is suspect", where)
    inner = Source(BytesIO(data), len(data), f"{where}, ", state.allowance)
    state.allowance.begin_chunk()
    for inner_record in _sound_records(inner, 0, state.report):
        if not state.allowance.spend_record(_RECORD_COST):
            state.report.damage(TOO_MANY, inner.where(inner_record.start))
            return
        if message := _take(inner, inner_record, state):
            yield message._replace(suspect=message.suspect or problem is not None)


def _take(source: Source, record: _BagRecord, state: _BagState) -> RawMessage | None:
    """Return the message of a record; connections and counts of the index update the state."""
    try:
        if record.opcode == _BagOp.MESSAGE:
            return _message(source, record, state)
        if record.opcode == _BagOp.CONNECTION:
            _declare(source, record, state)
        elif record.opcode == _BagOp.BAG:
            _check_index(source, record, state)
        elif record.opcode == _BagOp.CHUNK_INFO:
            pairs = source.read(record.start, record.end - record.start)
            state.declared += sum(count for _, count in _U32_PAIR.iter_unpack(pairs[: len(pairs) // 8 * 8]))
    except (struct.error, KeyError) as error:
        state.report.damage(f"a record lacks a field ({error})", source.where(record.start))
    return None


def _check_index(source: Source, record: _BagRecord, state: _BagState) -> None:
    index_at = _index_pos(record)
    if not index_at:
        state.report.warn("the bag has no index, as after a crash of the recorder; it was read from front to back")
    elif index_at >= source.size:
        state.report.damage("the bag is cut: it ends before its index", source.where(source.size))


def _index_pos(bag: _BagRecord) -> int:
    return int.from_bytes(bag.fields.get(b"index_pos", b"")[:8], "little")


def _message(source: Source, record: _BagRecord, state: _BagState) -> RawMessage | None:
    state.messages += 1
    data = source.read(record.start, min(record.end - record.start, MAX_CHUNK_BYTES))
    if b"topic" in record.fields:
        return RawMessage(_old_channel(record, state), _time_ns(record), data, record.suspect)
    (number,) = _U32.unpack(record.fields[b"conn"])
    if number not in state.channels and number not in state.spare and state.search:
        state.spare, state.search = state.search() | state.spare, None
    channel, declared = state.channel(number, data, "connection", source, record.start)
    return None if channel is None else RawMessage(channel, _time_ns(record), data, record.suspect or not declared)


def _time_ns(record: _BagRecord) -> int:
    fields = record.fields
    seconds, nanoseconds = _U32_PAIR.unpack(fields[b"time"] if b"time" in fields else fields[b"sec"] + fields[b"nsec"])
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _old_channel(record: _BagRecord, state: _BagState) -> Channel:
    """Return the channel of a message of format 1.2, whose header has topic and type."""
    topic, kind = (record.fields[name].decode(errors="replace") for name in (b"topic", b"type"))
    return state.report.declare(Channel(topic, ros_type(kind), "ros1", Schema(kind, "ros1msg")))


def _declare(source: Source, record: _BagRecord, state: _BagState) -> None:
    (number,) = _U32.unpack(record.fields[b"conn"])
    fields = _parse_fields(source.read(record.start, record.end - record.start)) or {}
    topic = record.fields[b"topic"].decode(errors="replace")
    name = fields.get(b"type", b"").decode(errors="replace")
    schema = Schema(name, "ros1msg", fields.get(b"message_definition", b""))
    latching = fields.get(b"latching", b"").decode(errors="replace")
    channel = Channel(topic, ros_type(name), "ros1", schema, ((LATCHING, latching),) if latching else ())
    if not name:
        channel = state.spare.get(number, channel)
    md5 = fields.get(b"md5sum", b"*").decode(errors="replace")
    if md5 not in {"*", MD5.get(channel.type, md5)}:
        state.report.warn(f"{topic}: the md5 sum of {name} is {md5!r}, not that of its definition; it is read as usual")
    state.channels[number] = state.report.declare(channel)


def _check_numbers(record: _BagRecord, report: ReadReport) -> None:
    """Warn of a version or a size in the header of a record that is not right."""
    version = record.fields.get(b"ver")
    if version is not None and int.from_bytes(version[:4], "little") != _VERSION:
        what = _BagOp(record.opcode).name.lower().replace("_", " ")
        report.warn(f"a record ({what}) has the version {int.from_bytes(version[:4], 'little')}, not {_VERSION}")
    declared = int.from_bytes(record.fields.get(b"size", b"")[:4], "little")
    if _is_flat(record) and declared != record.end - record.start:
        report.warn(f"a chunk declares {declared} bytes and has {record.end - record.start}; all of it was read")


def _is_flat(record: _BagRecord) -> bool:
    """Return whether a record is an uncompressed chunk, whose records are read as records of the file."""
    return record.opcode == _BagOp.CHUNK and record.fields.get(b"compression", b"none") == b"none"


def _sound_records(source: Source, offset: int, report: ReadReport) -> Iterator[_BagRecord]:
    """Yield the complete records; after lost bytes, continue at the next valid header."""
    pending: _BagRecord | None = None
    while offset < source.size or (pending and offset > source.size):
        record = _parse_header(source, offset)
        if record is None:
            next_header = _find_header(source, (pending.start if pending else offset) + 1)
            if pending and _is_whole(source, pending, next_header):
                end = next_header if pending.opcode == _BagOp.CHUNK else pending.end  # a chunk's length may be wrong
                yield pending._replace(end=end, suspect=True)
            _report_loss(source, pending, offset, next_header, report)
            pending, offset = None, next_header
            continue
        if pending:
            yield pending
        pending = record
        offset = record.start if _is_flat(record) else record.end
    if pending:
        yield pending


def _report_loss(source: Source, pending: _BagRecord | None, offset: int, next_header: int, report: ReadReport) -> None:
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


def _is_whole(source: Source, pending: _BagRecord, next_header: int) -> bool:
    """Return whether a record is complete, if no header follows it.

    It is not if the next valid header is within its declared length. A compressed chunk always counts as complete,
    because its decompression shows a loss.
    """
    if pending.opcode == _BagOp.CHUNK:
        return True
    if next_header < source.size:
        return next_header >= pending.end
    left = source.read(pending.end, 4)  # the header that follows is cut by the end, or zeros follow
    return pending.end <= source.size and (len(left) < 4 or 0 < _U32.unpack(left)[0] <= _MAX_HEADER_BYTES)


def _parse_header(source: Source, offset: int) -> _BagRecord | None:
    """Parse the record header at an offset; None if there is none."""
    block = source.read(offset, _USUAL_HEADER_BYTES)
    if len(block) < 4:
        return None
    (length,) = _U32.unpack_from(block)
    if not 0 < length <= _MAX_HEADER_BYTES or offset + 8 + length > source.size:
        return None
    if length + 8 > len(block):
        block = source.read(offset, length + 8)
    fields = _parse_fields(block[4 : 4 + length])
    op = fields.get(b"op", b"") if fields is not None else b""
    if fields is None or len(op) != 1 or op[0] not in _OPCODES:
        return None
    start = offset + 8 + length
    return _BagRecord(op[0], fields, start, start + _U32.unpack_from(block, 4 + length)[0])


def _parse_fields(header: bytes) -> dict[bytes, bytes] | None:
    """Split a header into its fields; None unless they fill it exactly."""
    if (usual := _USUAL_FIELDS.fullmatch(header)) and None not in (values := usual.groups()):
        return {b"op": values[0], b"conn": values[1], b"time": values[2]}
    fields, offset = dict[bytes, bytes](), 0
    while offset + 4 <= len(header):
        (length,) = _U32.unpack_from(header, offset)
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
            if not source.allowance.spend_record(_RECORD_COST):
                return source.size
            record = _parse_header(source, offset + at)
            if record is not None and _is_followed(source, record):
                return offset + at
        if len(block) < _BLOCK_BYTES:
            break
        offset += len(block) - 2 * _REACH_BYTES
        offset = max(offset, source.next_data(offset) - 2 * _REACH_BYTES)
    return source.size


def _is_followed(source: Source, record: _BagRecord) -> bool:
    """Return whether a header belongs to the bag, rather than being bytes in compressed data that look like one."""
    return record.opcode == _BagOp.CHUNK or record.end == source.size or _parse_header(source, record.end) is not None


def _candidates(block: bytes) -> Iterator[int]:
    """Yield the offsets in the 256 bytes before an ``op`` field where a header may begin, each once."""
    tried, op_at = 0, block.find(OP_FIELD)
    while op_at >= 0:
        for at in range(max(tried, op_at - _REACH_BYTES), op_at - 3):
            if block[at + 2 : at + 4] == b"\0\0" == block[at + 6 : at + 8]:  # two lengths below 64 KiB
                yield at
        tried = max(tried, op_at - 3)
        op_at = block.find(OP_FIELD, op_at + 1)
