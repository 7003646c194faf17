"""ROS 1 bags, format 2.0, read from front to back, so that no index is needed.

Format: http://wiki.ros.org/Bags/Format/2.0. A bag is a magic line and records of ``header length u32, header,
data length u32, data``; a header is fields of ``length u32, name=value``. A chunk's data are records again.
The records of an uncompressed chunk are read as if they stood in the file itself: so nothing depends on the chunk's
length, and memory does not grow with it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, TYPE_CHECKING, NamedTuple

from mavnav.logs.ledger import Ledger
from mavnav.logs.records import Channel, RawMessage, ros_type
from mavnav.logs.unpack import UnpackError, unpack

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MAGIC = b"#ROSBAG V2.0\n"

_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_OPCODES = frozenset({_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION})
_OP_FIELD = b"\x04\x00\x00\x00op="
_MAX_HEADER_BYTES = 1 << 16
_USUAL_HEADER_BYTES = 256
_BLOCK_BYTES = 1 << 20
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")


class _Record(NamedTuple):
    """A record whose header is sound. ``start`` is where its data begin, ``end`` where they should end."""

    opcode: int
    fields: dict[bytes, bytes]
    start: int
    end: int


@dataclass
class _Source:
    """A run of records: the bag itself, or a decompressed chunk. ``name`` says where that is."""

    file: IO[bytes]
    size: int
    name: str

    def read(self, offset: int, count: int) -> bytes:
        """Read ``count`` bytes, fewer at the end."""
        self.file.seek(offset)
        return self.file.read(min(count, max(self.size - offset, 0)))

    def where(self, offset: int) -> str:
        """Name a place for a person."""
        return f"{self.name}byte {offset}"


@dataclass
class _State:
    ledger: Ledger
    channels: dict[int, Channel] = field(default_factory=dict)
    spare: dict[int, Channel] = field(default_factory=dict)
    strangers: set[int] = field(default_factory=set)


def read_rosbag1(path: Path, ledger: Ledger) -> Iterator[RawMessage]:
    """Yield the messages of a ROS 1 bag, in the order of the file, in constant memory.

    What cannot be read is left out and noted. A message counts as whole only if a sound record, or the end,
    follows right behind it: in a bag that lost bytes, a message that spans the loss would decode to wrong values.
    """
    state = _State(ledger)
    with path.open("rb") as file:
        source = _Source(file, path.stat().st_size, "")
        if source.size == len(MAGIC):
            ledger.damage("the bag ends behind its magic line", source.where(source.size))
        state.spare = _index_connections(source)
        for record in _records(source, len(MAGIC), state):
            ledger.at(record.start)
            if record.opcode == _CHUNK and not _is_flat(record):
                yield from _chunk_messages(source, record, state)
            else:
                yield from _take(source, record, state)


def _index_connections(source: _Source) -> dict[int, Channel]:
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


def _records(source: _Source, offset: int, state: _State) -> Iterator[_Record]:
    """Yield the records that are whole; behind a loss, go on at the next sound header."""
    pending: _Record | None = None
    while offset < source.size:
        record = _parse_header(source, offset)
        if record is None:
            lost_from = pending.start if pending else offset
            state.ledger.damage("a record is cut or broken and left out", source.where(lost_from))
            pending = None
            found = _find_header(source, lost_from + 1)
            if found is None:
                return
            offset = found
            continue
        if pending:
            yield pending
        pending = record
        offset = record.start if _is_flat(record) else record.end
    if pending and offset > source.size:
        state.ledger.damage("the last record is cut by the end and left out", source.where(pending.start))
    elif pending:
        yield pending


def _parse_header(source: _Source, offset: int) -> _Record | None:
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


def _find_header(source: _Source, offset: int) -> int | None:
    """Return the offset of the next sound header; found by its ``op`` field, which every header has."""
    while offset < source.size:
        block = source.read(offset, _BLOCK_BYTES)
        at = block.find(_OP_FIELD)
        while at >= 0:
            for start in range(max(offset, offset + at - 256), offset + at - 3):
                record = _parse_header(source, start)
                if record is not None and record.start > offset + at:
                    return start
            at = block.find(_OP_FIELD, at + 1)
        if len(block) < _BLOCK_BYTES:
            return None
        offset += len(block) - 512
    return None


def _chunk_messages(source: _Source, record: _Record, state: _State) -> Iterator[RawMessage]:
    """Yield the messages of a compressed chunk."""
    name = record.fields.get(b"compression", b"").decode(errors="replace")
    where = f"chunk at byte {record.start}"
    try:
        (declared,) = _U32.unpack(record.fields.get(b"size", b""))
        data = unpack(name, source.read(record.start, record.end - record.start), declared)
    except (UnpackError, struct.error) as error:
        state.ledger.damage(f"chunk left out: {error}", where)
        return
    if len(data) != declared:
        state.ledger.damage(f"the chunk declares {declared} bytes and holds {len(data)}", where)
    inner = _Source(BytesIO(data), len(data), f"{where}, ")
    for inner_record in _records(inner, 0, state):
        yield from _take(inner, inner_record, state)


def _take(source: _Source, record: _Record, state: _State) -> Iterator[RawMessage]:
    """Yield the message, or take in the connection; other records tell nothing that is needed."""
    try:
        if record.opcode == _MESSAGE:
            yield from _message(source, record, state)
        elif record.opcode == _CONNECTION:
            _declare(source, record, state)
        elif record.opcode == _BAG:
            _check_index(source, record, state)
    except (struct.error, KeyError) as error:
        state.ledger.damage(f"a record lacks a field ({error})", source.where(record.start))


def _check_index(source: _Source, record: _Record, state: _State) -> None:
    index_at = _index_pos(record)
    if not index_at:
        state.ledger.warn("the bag has no index, as after a crash of the recorder; it was read from front to back")
    elif index_at >= source.size:
        state.ledger.damage("the bag is cut: it ends before its index", source.where(source.size))


def _index_pos(bag: _Record) -> int:
    return int.from_bytes(bag.fields.get(b"index_pos", b"")[:8], "little")


def _message(source: _Source, record: _Record, state: _State) -> Iterator[RawMessage]:
    (number,) = _U32.unpack(record.fields[b"conn"])
    seconds, nanoseconds = _TIME.unpack(record.fields[b"time"])
    channel = state.channels.get(number) or _spare_channel(number, state)
    if channel is not None:
        data = source.read(record.start, record.end - record.start)
        yield RawMessage(channel, seconds * 1_000_000_000 + nanoseconds, data)
    elif number not in state.strangers:
        state.strangers.add(number)
        text = f"messages of connection {number}, which is declared nowhere before, are left out"
        state.ledger.damage(text, source.where(record.start))


def _spare_channel(number: int, state: _State) -> Channel | None:
    channel = state.spare.get(number)
    if channel is not None:
        state.channels[number] = state.ledger.declare(channel)
    return channel


def _declare(source: _Source, record: _Record, state: _State) -> None:
    (number,) = _U32.unpack(record.fields[b"conn"])
    fields = _parse_fields(source.read(record.start, record.end - record.start)) or {}
    topic = record.fields[b"topic"].decode(errors="replace")
    kind = ros_type(fields.get(b"type", b"").decode(errors="replace"))
    state.channels[number] = state.ledger.declare(Channel(topic, kind, "ros1"))
