"""Reader of ROS 1 bags, formats 2.0 and 1.2; reads from front to back, so that no index is needed.

Formats: http://wiki.ros.org/Bags/Format/2.0, and 1.2, which has no chunks and has topic and type in every message. A
bag is a magic line and records of ``header length u32, header, data length u32, data``; a header is fields of ``length
u32, name=value``. The data of a chunk are records too. The records of an uncompressed chunk are read as records of the
file: the length of the chunk is not needed, and memory use does not grow with it.
"""

from __future__ import annotations

import struct
from functools import partial
from io import BytesIO
from typing import TYPE_CHECKING

from mavnav.logs.formats.channels import ReaderState
from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES, TOO_MANY, Allowance, DecompressError, decompress
from mavnav.logs.formats.rosbag1_records import (
    RECORD_COST,
    U32,
    BagOp,
    BagRecord,
    is_flat,
    parse_fields,
    parse_header,
    sound_records,
)
from mavnav.logs.formats.source import BAG_MAGIC, MAGIC_WITHIN_BYTES, OLD_BAG_MAGIC, Source
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import LATCHING, Channel, RawMessage, Schema, ros_type

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path


_U32_PAIR = struct.Struct("<II")


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
        state.search = partial(_connections, source, sound_records(source, begin, ReadReport()))
        for record in sound_records(source, begin, report):
            report.at(record.start)
            if record.opcode == BagOp.CHUNK and not is_flat(record):
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


def _index_records(source: Source) -> Iterator[BagRecord]:
    """Yield the connections of the index, which are needed only if the chunk that declares them is damaged."""
    bag = parse_header(source, len(BAG_MAGIC))
    index_at = _index_pos(bag) if bag else 0
    record = parse_header(source, index_at) if len(BAG_MAGIC) < index_at < source.size else None
    while record is not None and record.opcode == BagOp.CONNECTION and record.end <= source.size:
        yield record
        record = parse_header(source, record.end)


def _connections(source: Source, records: Iterable[BagRecord]) -> dict[int, Channel]:
    """Return the channels that the connections among some records declare, by number."""
    state = _BagState(ReadReport())
    for record in records:
        if record.opcode == BagOp.CONNECTION:
            _take(source, record, state)
    return state.channels


def _chunk_messages(source: Source, record: BagRecord, state: _BagState) -> Iterator[RawMessage]:
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
    for inner_record in sound_records(inner, 0, state.report):
        if not state.allowance.spend_record(RECORD_COST):
            state.report.damage(TOO_MANY, inner.where(inner_record.start))
            return
        if message := _take(inner, inner_record, state):
            yield message._replace(suspect=message.suspect or problem is not None)


def _take(source: Source, record: BagRecord, state: _BagState) -> RawMessage | None:
    """Return the message of a record; connections and counts of the index update the state."""
    try:
        if record.opcode == BagOp.MESSAGE:
            return _message(source, record, state)
        if record.opcode == BagOp.CONNECTION:
            _declare(source, record, state)
        elif record.opcode == BagOp.BAG:
            _check_index(source, record, state)
        elif record.opcode == BagOp.CHUNK_INFO:
            pairs = source.read(record.start, record.end - record.start)
            state.declared += sum(count for _, count in _U32_PAIR.iter_unpack(pairs[: len(pairs) // 8 * 8]))
    except (struct.error, KeyError) as error:
        state.report.damage(f"a record lacks a field ({error})", source.where(record.start))
    return None


def _check_index(source: Source, record: BagRecord, state: _BagState) -> None:
    index_at = _index_pos(record)
    if not index_at:
        state.report.warn("the bag has no index, as after a crash of the recorder; it was read from front to back")
    elif index_at >= source.size:
        state.report.damage("the bag is cut: it ends before its index", source.where(source.size))


def _index_pos(bag: BagRecord) -> int:
    return int.from_bytes(bag.fields.get(b"index_pos", b"")[:8], "little")


def _message(source: Source, record: BagRecord, state: _BagState) -> RawMessage | None:
    state.messages += 1
    data = source.read(record.start, min(record.end - record.start, MAX_CHUNK_BYTES))
    if b"topic" in record.fields:
        return RawMessage(_old_channel(record, state), _time_ns(record), data, record.suspect)
    (number,) = U32.unpack(record.fields[b"conn"])
    if number not in state.channels and number not in state.spare and state.search:
        state.spare, state.search = state.search() | state.spare, None
    channel, declared = state.channel(number, data, "connection", source.where(record.start))
    return None if channel is None else RawMessage(channel, _time_ns(record), data, record.suspect or not declared)


def _time_ns(record: BagRecord) -> int:
    fields = record.fields
    seconds, nanoseconds = _U32_PAIR.unpack(fields[b"time"] if b"time" in fields else fields[b"sec"] + fields[b"nsec"])
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _old_channel(record: BagRecord, state: _BagState) -> Channel:
    """Return the channel of a message of format 1.2, whose header has topic and type."""
    topic, kind = (record.fields[name].decode(errors="replace") for name in (b"topic", b"type"))
    return state.report.declare(Channel(topic, ros_type(kind), "ros1", Schema(kind, "ros1msg")))


def _declare(source: Source, record: BagRecord, state: _BagState) -> None:
    (number,) = U32.unpack(record.fields[b"conn"])
    fields = parse_fields(source.read(record.start, record.end - record.start)) or {}
    topic = record.fields[b"topic"].decode(errors="replace")
    name = fields.get(b"type", b"").decode(errors="replace")
    schema = Schema(name, "ros1msg", fields.get(b"message_definition", b""))
    latching = fields.get(b"latching", b"").decode(errors="replace")
    channel = Channel(topic, ros_type(name), "ros1", schema, ((LATCHING, latching),) if latching else ())
    if not name:
        channel = state.spare.get(number, channel)
    state.channels[number] = state.report.declare(channel)
