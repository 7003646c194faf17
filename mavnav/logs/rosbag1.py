"""ROS 1 bags, formats 2.0 and 1.2, read from front to back, so that no index is needed.

Formats: http://wiki.ros.org/Bags/Format/2.0, and 1.2, which has no chunks and tells topic and type in every message. A
bag is a magic line and records of ``header length u32, header, data length u32, data``; a header is fields of ``length
u32, name=value``. A chunk's data are records again. The records of an uncompressed chunk are read as if they stood in
the file itself: so nothing depends on the chunk's length, and memory does not grow with it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from io import BytesIO
from typing import TYPE_CHECKING, NamedTuple

from mavnav.logs.guess import channel_of
from mavnav.logs.ledger import Ledger
from mavnav.logs.records import Channel, RawMessage, Schema, ros_type
from mavnav.logs.source import Source
from mavnav.logs.unpack import MAX_CHUNK_BYTES, UnpackError, unpack

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MAGIC = b"#ROSBAG V2.0\n"
OLD_MAGIC = b"#ROSRECORD V1.2\n"

_DEFINITION, _MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 1, 2, 3, 4, 5, 6, 7
_OPCODES = frozenset({_DEFINITION, _MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION})
_OP_FIELD = b"\x04\x00\x00\x00op="
_MAX_HEADER_BYTES = 1 << 16
_USUAL_HEADER_BYTES = 256
_REACH_BYTES = 256
_BLOCK_BYTES = 1 << 20
_SEARCH_BYTES = 1 << 16
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")
_U32_PAIR = struct.Struct("<II")


class _Record(NamedTuple):
    """A record whose header is sound. ``start`` is where its data begin, ``end`` where they should end.

    It is ``suspect`` where no sound record follows.
    """

    opcode: int
    fields: dict[bytes, bytes]
    start: int
    end: int
    suspect: bool = False


@dataclass
class _State:
    ledger: Ledger
    channels: dict[int, Channel] = field(default_factory=dict)
    spare: dict[int, Channel] = field(default_factory=dict)
    strangers: set[int] = field(default_factory=set)
    messages: int = 0
    declared: int = 0


def read_rosbag1(path: Path, ledger: Ledger) -> Iterator[RawMessage]:
    """Yield the messages of a ROS 1 bag, in the order of the file, in constant memory.

    What cannot be read is left out and noted. A message counts as whole only if a sound record, or the end,
    follows right behind it: in a bag that lost bytes, a message that spans the loss would decode to wrong values. What
    is read of a chunk that does not decompress to its end is suspect.
    """
    state = _State(ledger)
    with path.open("rb") as file:
        source = Source(file, path.stat().st_size, "")
        begin = _begin(source, ledger)
        if source.size == begin:
            ledger.damage("the bag ends behind its magic line", source.where(source.size))
        state.spare = _index_connections(source)
        for record in _records(source, begin, state):
            ledger.at(record.start)
            if record.opcode == _CHUNK and not _is_flat(record):
                yield from _chunk_messages(source, record, state)
            else:
                yield from _take(source, record, state)
    if state.declared > state.messages:
        missing = state.declared - state.messages
        ledger.damage(f"{missing} of the {state.declared} messages that the index counts are not there", path.name)


def _begin(source: Source, ledger: Ledger) -> int:
    """Return where the records begin: behind the magic line, which may be broken or have other bytes before it."""
    head = source.read(0, _SEARCH_BYTES)
    for magic in (MAGIC, OLD_MAGIC):
        at = head.find(magic)
        if at >= 0:
            if at:
                ledger.damage(f"{at} bytes that are no bag lie before the magic line", source.where(0))
            return at + len(magic)
    ledger.damage("the bag does not begin with its magic line", source.where(0))
    return head.find(b"\n", 0, len(OLD_MAGIC)) + 1


def _index_connections(source: Source) -> dict[int, Channel]:
    """Return the connections that the index repeats: needed only where the chunk that declares them is damaged."""
    spare = _State(Ledger())
    bag = _parse_header(source, len(MAGIC))
    index_at = _index_pos(bag) if bag else 0
    record = _parse_header(source, index_at) if len(MAGIC) < index_at < source.size else None
    while record is not None and record.opcode == _CONNECTION and record.end <= source.size:
        for _ in _take(source, record, spare):
            pass
        record = _parse_header(source, record.end)
    return spare.channels


def _is_flat(record: _Record) -> bool:
    return record.opcode == _CHUNK and record.fields.get(b"compression", b"none") == b"none"


def _records(source: Source, offset: int, state: _State) -> Iterator[_Record]:
    """Yield the records that are whole; behind a loss, go on at the next sound header."""
    pending: _Record | None = None
    while offset < source.size or (pending and offset > source.size):
        record = _parse_header(source, offset)
        if record is None:
            found = _find_header(source, (pending.start if pending else offset) + 1)
            if pending and _is_whole(source, pending, found):
                yield _clipped(source, pending, found)
            _tell_loss(source, pending, offset, found, state)
            pending = None
            if found is None:
                return
            offset = found
            continue
        if pending:
            yield pending
        pending = record
        offset = record.start if _is_flat(record) else record.end
    if pending:
        yield pending


def _clipped(source: Source, pending: _Record, found: int | None) -> _Record:
    """Let a compressed chunk reach to the next sound header, because its length may lie."""
    end = pending.end if pending.opcode != _CHUNK else source.size if found is None else found
    return pending._replace(end=end, suspect=True)


def _tell_loss(source: Source, pending: _Record | None, offset: int, found: int | None, state: _State) -> None:
    """Tell which bytes are lost, or whose length lies; ``offset`` is where a header should stand."""
    upto = source.size if found is None else found
    if offset > source.size and found is None and pending:
        text, at = "the last record is cut by the end", pending.start
    elif pending and not _is_whole(source, pending, found):
        text, at = f"{upto - pending.start} bytes are no record", pending.start
    elif offset >= upto and pending:
        text, at = "the length of a record lies", pending.start
    else:
        text, at = f"{upto - offset} bytes are no record", offset
    state.ledger.damage(text, source.where(at))


def _is_whole(source: Source, pending: _Record, found: int | None) -> bool:
    """Tell whether a record before bytes that are no header lost none of its own.

    It did, if the next sound header stands within the length that it claims. A compressed chunk is asked itself.
    """
    if pending.opcode == _CHUNK:
        return True
    if found is not None:
        return found >= pending.end
    left = source.read(pending.end, 4)  # the header that follows is cut by the end, or zeros follow
    return pending.end <= source.size and (len(left) < 4 or 0 < _U32.unpack(left)[0] <= _MAX_HEADER_BYTES)


def _parse_header(source: Source, offset: int) -> _Record | None:
    """Parse the record header at an offset; None where none is."""
    block = source.read(offset, _USUAL_HEADER_BYTES)
    if len(block) < 4:
        return None
    (length,) = _U32.unpack_from(block)
    if not 0 < length <= min(_MAX_HEADER_BYTES, source.size - offset - 8):
        return None
    if length + 8 > len(block):
        block = source.read(offset, length + 8)
    fields = _parse_fields(block[4 : 4 + length])
    op = fields.get(b"op", b"") if fields is not None else b""
    if fields is None or len(op) != 1 or op[0] not in _OPCODES:
        return None
    start = offset + 8 + length
    return _Record(op[0], fields, start, start + _U32.unpack_from(block, 4 + length)[0])


def _parse_fields(header: bytes) -> dict[bytes, bytes] | None:
    """Split a header into its fields; None unless they fill it exactly."""
    fields: dict[bytes, bytes] = {}
    offset = 0
    while offset + 4 <= len(header):
        (length,) = _U32.unpack_from(header, offset)
        name, equals, value = header[offset + 4 : offset + 4 + length].partition(b"=")
        offset += 4 + length
        if not equals or offset > len(header):
            return None
        fields[name] = value
    return fields if offset == len(header) else None


def _find_header(source: Source, offset: int) -> int | None:
    """Return the offset of the next sound header; found by its ``op`` field, which every header has."""
    while offset < source.size:
        block = source.read(offset, _BLOCK_BYTES)
        for at in _candidates(block):
            record = _parse_header(source, offset + at)
            if record is not None and _is_followed(source, record):
                return offset + at
        if len(block) < _BLOCK_BYTES:
            return None
        offset += len(block) - 2 * _REACH_BYTES
        offset = max(offset, source.next_data(offset) - 2 * _REACH_BYTES)
    return None


def _is_followed(source: Source, record: _Record) -> bool:
    """Tell whether a header is one of the bag's, and none that shows through in compressed data."""
    return record.opcode == _CHUNK or record.end == source.size or _parse_header(source, record.end) is not None


def _candidates(block: bytes) -> Iterator[int]:
    """Yield, each once, the places shortly before an ``op`` field where a header of fields may begin."""
    tried, op_at = 0, block.find(_OP_FIELD)
    while op_at >= 0:
        for at in range(max(tried, op_at - _REACH_BYTES), op_at - 3):
            if block[at + 2 : at + 4] == b"\0\0" == block[at + 6 : at + 8]:  # two lengths below 64 KiB
                yield at
        tried = max(tried, op_at - 3)
        op_at = block.find(_OP_FIELD, op_at + 1)


def _chunk_messages(source: Source, record: _Record, state: _State) -> Iterator[RawMessage]:
    """Yield the messages of a compressed chunk."""
    name = record.fields.get(b"compression", b"").decode(errors="replace")
    where = f"chunk at byte {record.start}"
    try:
        data, problem = unpack(name, source.read(record.start, min(record.end - record.start, MAX_CHUNK_BYTES)))
    except UnpackError as error:
        state.ledger.damage(f"chunk left out: {error}", where)
        return
    declared = int.from_bytes(record.fields.get(b"size", b"")[:4], "little")
    if problem is None and len(data) != declared:
        problem = f"the chunk declares {declared} bytes and holds {len(data)}"
    if problem:
        state.ledger.damage(f"{problem}; what can be read of the chunk is suspect", where)
    inner = Source(BytesIO(data), len(data), f"{where}, ")
    for inner_record in _records(inner, 0, state):
        for message in _take(inner, inner_record, state):
            yield message._replace(suspect=message.suspect or problem is not None)


def _take(source: Source, record: _Record, state: _State) -> Iterator[RawMessage]:
    """Yield the message, or take in the connection; other records tell nothing that is needed."""
    try:
        if record.opcode == _MESSAGE:
            yield from _message(source, record, state)
        elif record.opcode == _CONNECTION:
            _declare(source, record, state)
        elif record.opcode == _BAG:
            _check_index(source, record, state)
        elif record.opcode == _CHUNK_INFO:
            pairs = source.read(record.start, record.end - record.start)
            state.declared += sum(count for _, count in _U32_PAIR.iter_unpack(pairs[: len(pairs) // 8 * 8]))
    except (struct.error, KeyError) as error:
        state.ledger.damage(f"a record lacks a field ({error})", source.where(record.start))


def _check_index(source: Source, record: _Record, state: _State) -> None:
    index_at = _index_pos(record)
    if not index_at:
        state.ledger.warn("the bag has no index, as after a crash of the recorder; it was read from front to back")
    elif index_at >= source.size:
        state.ledger.damage("the bag is cut: it ends before its index", source.where(source.size))


def _index_pos(bag: _Record) -> int:
    return int.from_bytes(bag.fields.get(b"index_pos", b"")[:8], "little")


def _message(source: Source, record: _Record, state: _State) -> Iterator[RawMessage]:
    state.messages += 1
    data = source.read(record.start, min(record.end - record.start, MAX_CHUNK_BYTES))
    channel = _old_channel(record, state) if b"topic" in record.fields else _channel(record, state)
    if channel is not None:
        yield RawMessage(channel, _time_ns(record), data, record.suspect)
    else:
        yield from _stranger(source, record, data, state)


def _time_ns(record: _Record) -> int:
    fields = record.fields
    seconds, nanoseconds = _TIME.unpack(fields[b"time"] if b"time" in fields else fields[b"sec"] + fields[b"nsec"])
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _old_channel(record: _Record, state: _State) -> Channel:
    """Return the channel that a message of format 1.2 names itself."""
    topic, kind = (record.fields[name].decode(errors="replace") for name in (b"topic", b"type"))
    return state.ledger.declare(Channel(topic, ros_type(kind), "ros1"))


def _channel(record: _Record, state: _State) -> Channel | None:
    """Return the channel of a message's connection, as declared or by the index."""
    (number,) = _U32.unpack(record.fields[b"conn"])
    if number not in state.channels and number in state.spare:
        state.channels[number] = state.ledger.declare(state.spare[number])
    return state.channels.get(number)


def _stranger(source: Source, record: _Record, data: bytes, state: _State) -> Iterator[RawMessage]:
    """Yield a message of an undeclared connection as suspect, if it is a scan by its bytes."""
    (number,) = _U32.unpack(record.fields[b"conn"])
    channel = channel_of(data, f"/connection_{number}", state.ledger)
    if number not in state.strangers:
        state.strangers.add(number)
        fate = f"scans by their bytes, and taken for {channel.topic}" if channel else "left out"
        text = f"messages of connection {number}, which is declared nowhere before, are {fate}"
        state.ledger.damage(text, source.where(record.start))
    if channel is not None:
        yield RawMessage(channel, _time_ns(record), data, suspect=True)


def _declare(source: Source, record: _Record, state: _State) -> None:
    (number,) = _U32.unpack(record.fields[b"conn"])
    fields = _parse_fields(source.read(record.start, record.end - record.start)) or {}
    topic = record.fields[b"topic"].decode(errors="replace")
    name = fields.get(b"type", b"").decode(errors="replace")
    channel = Channel(topic, ros_type(name), "ros1", Schema(name, "ros1msg", fields.get(b"message_definition", b"")))
    if not name:
        channel = state.spare.get(number, channel)
    state.channels[number] = state.ledger.declare(channel)
