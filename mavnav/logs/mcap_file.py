"""MCAP: the records in the order of the file, so that neither index nor summary is needed.

Whatever a record, chunk or summary claims is compared with what is there; where bytes are no record, reading goes on at
the next that is.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO
from typing import TYPE_CHECKING

from mavnav.logs.guess import LASER, channel_of, laser_encoding
from mavnav.logs.ledger import Ledger
from mavnav.logs.mcap_records import (
    HEAD,
    MAGIC,
    MESSAGE_HEAD,
    PRIVATE,
    Fields,
    Op,
    Record,
    chunk_head,
    find_record,
    is_boundary,
    record_at,
)
from mavnav.logs.records import Channel, RawMessage, Schema, ros_type
from mavnav.logs.source import Source
from mavnav.logs.unpack import MAX_CHUNK_BYTES, UnpackError, unpack

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_READ = frozenset({Op.HEADER, Op.FOOTER, Op.SCHEMA, Op.CHANNEL, Op.MESSAGE, Op.CHUNK, Op.STATISTICS, Op.DATA_END})
_IN_CHUNKS = frozenset({Op.SCHEMA, Op.CHANNEL, Op.MESSAGE})
_IN_SUMMARIES = frozenset(
    {Op.SCHEMA, Op.CHANNEL, Op.STATISTICS, Op.CHUNK_INDEX, Op.ATTACHMENT_INDEX, Op.METADATA_INDEX, Op.SUMMARY_OFFSET}
)
_BLOCK_BYTES = 1 << 20
_SEARCH_BYTES = 1 << 16
_FOOTER_BYTES = 20
_ENCODING_OF_SCHEMA = {"ros2msg": "cdr", "ros2idl": "cdr", "ros1msg": "ros1"}
_NO_SCHEMA = Schema()


@dataclass
class _State:
    """What the records read so far have told.

    ``crc`` is the data section's, None once bytes were lost. In a ``suspect`` chunk the summary's channels are believed
    over the chunk's own.
    """

    ledger: Ledger
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    spare: dict[int, Channel] = field(default_factory=dict)
    strangers: set[int] = field(default_factory=set)
    messages: int = 0
    crc: int | None = 0
    closed: bool = False
    suspect: bool = False

    def begin(self) -> None:
        """Forget what belongs to the file before, where several lie one behind the other."""
        self.schemas, self.channels, self.strangers = {}, {}, set()
        self.messages, self.crc, self.closed = 0, None, False


def read_mcap(path: Path, ledger: Ledger) -> Iterator[RawMessage]:
    """Yield the messages of an MCAP file, in the order of the file, in constant memory.

    What cannot be read is left out and noted. What is read from a chunk whose CRC does not match, or that does not
    decompress to its end, is suspect, and noted as well.
    """
    state = _State(ledger)
    with path.open("rb") as file:
        source = Source(file, path.stat().st_size)
        state.spare = _summary_channels(source, ledger)
        start = max(source.read(0, _SEARCH_BYTES).find(MAGIC), 0)
        if start or source.read(0, len(MAGIC)) != MAGIC:
            ledger.damage("the file does not begin with the magic of MCAP", source.where(0))
        for record in _records(source, start, state):
            ledger.at(record.start)
            if record.opcode == Op.CHUNK:
                yield from _chunk_messages(source, record, state)
            elif record.opcode in _READ:
                content = source.read(record.start, min(record.end - record.start, MAX_CHUNK_BYTES))
                for message in _take(record.opcode, content, source.where(record.start), state):
                    yield message._replace(suspect=True) if _runs_into_loss(source, record.end) else message
        if not state.closed:
            ledger.damage("the file ends without a footer; it was cut or not closed", source.where(source.size))


def _summary_channels(source: Source, ledger: Ledger) -> dict[int, Channel]:
    """Return the channels that the summary repeats: needed only where the chunk that declares them is damaged."""
    footer_at = source.size - len(MAGIC) - HEAD.size - _FOOTER_BYTES
    record = record_at(source, footer_at) if footer_at > 0 else None
    if record is None or record.opcode != Op.FOOTER:
        return {}
    footer = source.read(record.start, _FOOTER_BYTES)
    start, _, crc = struct.unpack("<QQI", footer)
    if not 0 < start < footer_at or footer_at - start > MAX_CHUNK_BYTES:
        return {}
    first = record_at(source, start)
    if first is None or first.opcode not in _IN_SUMMARIES:  # of a file that lies behind other bytes
        return {}
    summary = source.read(start, footer_at - start)
    guarded = summary + source.read(footer_at, HEAD.size + _FOOTER_BYTES - 4)
    if crc and zlib.crc32(guarded) != crc:
        ledger.damage("the CRC of the summary does not match; it is not needed", f"byte {start}")
    spare = _State(Ledger())
    for opcode, content in _plain_records(summary):
        if opcode in (Op.SCHEMA, Op.CHANNEL):
            for _ in _take(opcode, content, "summary", spare):
                pass
    return spare.channels


def _plain_records(records: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of records in memory, up to the first that is cut."""
    offset = 0
    while len(records) - offset >= HEAD.size:
        opcode, length = HEAD.unpack_from(records, offset)
        start = offset + HEAD.size
        if length > len(records) - start:
            return
        yield opcode, records[start : start + length]
        offset = start + length


def _records(source: Source, offset: int, state: _State) -> Iterator[Record]:
    """Yield the sound records; behind a loss, go on at the next one.

    A record that is not followed by another is yielded all the same, unless it is a chunk, and what it claims to hold
    is searched for records: its length may lie.
    """
    while offset < source.size:
        if source.read(offset, len(MAGIC)) == MAGIC:
            offset = _pass_magic(offset, state)
            continue
        record = record_at(source, offset)
        if record is None:
            offset = _lose(source, offset, offset + 1, state)
            continue
        if Op.DATA_END < record.opcode < PRIVATE:
            state.ledger.warn(f"a record of an unknown kind ({record.opcode}) was passed over")
        if record.odd:
            state.ledger.damage(record.odd, source.where(offset))
            state.crc = None
        _check_crc(source, offset, record, state)
        followed = record.opcode == Op.CHUNK or is_boundary(source, record.end)
        yield record
        if state.closed:
            offset = _pass_end(source, record.end, state)
        elif followed:
            offset = record.end
        else:
            offset = _lose(source, offset, record.start, state)


def _runs_into_loss(source: Source, end: int) -> bool:
    """Tell whether what follows a record is none, not even one that is cut: then its own end may be lost, too."""
    head = source.read(end, HEAD.size)
    if len(head) < HEAD.size or is_boundary(source, end):
        return False
    opcode, length = HEAD.unpack(head)
    return not (0 < opcode <= Op.DATA_END and source.size - end < length < 1 << 32)


def _lose(source: Source, offset: int, search_from: int, state: _State) -> int:
    """Return the offset of the next record, having told of the bytes before it."""
    found = find_record(source, search_from)
    state.crc = None
    empty = not any(source.read(offset, min(found - offset, _BLOCK_BYTES)))
    kind = "zeros" if empty else "bytes that are no record"
    state.ledger.damage(f"{found - offset} {kind}; what they held is lost", source.where(offset))
    return found


def _pass_magic(offset: int, state: _State) -> int:
    """Pass the magic at the beginning; one further on begins another file."""
    if state.closed or state.messages:
        state.ledger.warn("several MCAP files lie one behind the other in this one; all were read")
        state.begin()
    else:
        state.crc = zlib.crc32(MAGIC)
    return offset + len(MAGIC)


def _pass_end(source: Source, offset: int, state: _State) -> int:
    """Pass the magic behind the footer."""
    if source.read(offset, len(MAGIC)) == MAGIC:
        return offset + len(MAGIC)
    state.ledger.damage("the magic at the end is missing", source.where(offset))
    return offset if offset == source.size else _lose(source, offset, offset, state)


def _check_crc(source: Source, offset: int, record: Record, state: _State) -> None:
    """Carry the data section's CRC on, and compare it where the section ends."""
    if record.opcode == Op.DATA_END and state.crc is not None:
        declared = int.from_bytes(source.read(record.start, 4), "little")
        if declared not in (0, state.crc):
            text = "the CRC of the data section does not match; which record is wrong cannot be known"
            state.ledger.damage(text, source.where(offset))
        state.crc = None
    while state.crc is not None and offset < record.end:
        block = source.read(offset, min(record.end - offset, _BLOCK_BYTES))
        if not block:
            return
        state.crc = zlib.crc32(block, state.crc)
        offset += len(block)


def _chunk_messages(source: Source, record: Record, state: _State) -> Iterator[RawMessage]:
    where = f"chunk at byte {record.start}"
    try:
        records, suspect = _chunk_records(source, record, where, state)
    except (UnpackError, struct.error) as error:
        state.ledger.damage(f"chunk left out: {error}", where)
        return
    inner = Source(BytesIO(records), len(records), f"{where}, ")
    if not suspect:
        yield from _sound_messages(records, inner, state)
        return
    state.suspect = True
    for message in _walk(inner, 0, state):
        yield message._replace(suspect=True)
    state.suspect = False


def _chunk_records(source: Source, record: Record, where: str, state: _State) -> tuple[bytes, bool]:
    """Decompress a chunk as far as that goes; tell what is wrong, and return whether it is suspect."""
    if record.end - record.start > MAX_CHUNK_BYTES:
        raise UnpackError(f"of {record.end - record.start} bytes; no more than {MAX_CHUNK_BYTES} are taken into memory")
    content = source.read(record.start, record.end - record.start)
    head = chunk_head(content)
    records, problem = unpack(head.compression, content[head.start :])
    if problem is None and len(records) != head.declared_bytes:
        problem = f"the chunk declares {head.declared_bytes} bytes and holds {len(records)}"
    verified = head.crc != 0 and zlib.crc32(records) == head.crc
    if head.crc and not verified:
        problem = f"{problem}, and the CRC does not match" if problem else "the CRC does not match"
    if problem:
        text = "" if verified else "; what can be read of the chunk is suspect"
        state.ledger.damage(problem + text, where)
    return records, problem is not None and not verified


def _sound_messages(records: bytes, inner: Source, state: _State) -> Iterator[RawMessage]:
    """Yield the messages of a chunk that is as it was written; walk on with care where its records still lie."""
    offset = 0
    for opcode, content in _plain_records(records):
        if opcode in _IN_CHUNKS:
            yield from _take(opcode, content, inner.where(offset), state)
        offset += HEAD.size + len(content)
    yield from _walk(inner, offset, state)


def _walk(inner: Source, offset: int, state: _State) -> Iterator[RawMessage]:
    for record in _records(inner, offset, state):
        if record.opcode in _IN_CHUNKS:
            content = inner.read(record.start, record.end - record.start)
            yield from _take(record.opcode, content, inner.where(record.start), state)


def _take(opcode: int, content: bytes, where: str, state: _State) -> Iterator[RawMessage]:
    """Yield the message, or take in what the record tells about others."""
    try:
        if opcode == Op.MESSAGE:
            yield from _message(content, where, state)
        elif opcode == Op.SCHEMA:
            _declare_schema(Fields(content), where, state)
        elif opcode == Op.CHANNEL:
            _declare_channel(Fields(content), where, state)
        elif opcode == Op.STATISTICS:
            _check_count(content, where, state)
        elif opcode == Op.FOOTER:
            state.closed = True
    except struct.error as error:
        state.ledger.damage(f"a record cannot be read ({error})", where)


def _message(content: bytes, where: str, state: _State) -> Iterator[RawMessage]:
    number, _, log_ns, _ = MESSAGE_HEAD.unpack_from(content)
    state.messages += 1
    data = content[MESSAGE_HEAD.size :]
    channel = state.channels.get(number) or _spare_channel(number, state)
    if channel is not None and not channel.type and (encoding := laser_encoding(data)):
        channel = _typed_channel(number, channel, encoding, where, state)
    if channel is not None:
        yield RawMessage(channel, log_ns, data)
    else:
        yield from _stranger(number, log_ns, data, where, state)


def _spare_channel(number: int, state: _State) -> Channel | None:
    channel = state.spare.get(number)
    if channel is not None:
        state.channels[number] = state.ledger.declare(channel)
    return channel


def _stranger(number: int, log_ns: int, data: bytes, where: str, state: _State) -> Iterator[RawMessage]:
    """Yield a message of an undeclared channel as suspect, if it is a scan by its bytes."""
    channel = channel_of(data, f"/channel_{number}", state.ledger)
    if number not in state.strangers:
        state.strangers.add(number)
        fate = f"scans by their bytes, and taken for {channel.topic}" if channel else "left out"
        state.ledger.damage(f"messages of channel {number}, which is declared nowhere before, are {fate}", where)
    if channel is not None:
        yield RawMessage(channel, log_ns, data, suspect=True)


def _typed_channel(number: int, channel: Channel, encoding: str, where: str, state: _State) -> Channel:
    """Give a channel the type that its messages turn out to have."""
    typed = Channel(channel.topic, LASER, encoding)
    state.channels[number] = state.ledger.declare(typed)
    state.ledger.damage(f"the type of {channel.topic} is told nowhere; its messages are scans by their bytes", where)
    return typed


def _declare_schema(fields: Fields, where: str, state: _State) -> None:
    number, name, encoding = fields.number("H"), fields.text(), fields.text()
    schema = Schema(name, encoding, fields.block())
    if number in state.schemas and state.schemas[number] != schema:
        state.ledger.damage(f"schema {number} is declared twice, and differently; the later counts", where)
    state.schemas[number] = schema


def _declare_channel(fields: Fields, where: str, state: _State) -> None:
    """Take in a channel; equal repetitions are usual. One without its schema is made up for by the summary."""
    number, schema_number, topic, encoding = fields.number("H"), fields.number("H"), fields.text(), fields.text()
    schema = state.schemas.get(schema_number, _NO_SCHEMA)
    encoding = encoding or _ENCODING_OF_SCHEMA.get(schema.encoding, "")
    channel = Channel(topic, ros_type(schema.name), encoding, schema)
    if state.suspect or (schema_number and not schema.name):
        channel = state.spare.get(number, channel)
    before = state.channels.get(number)
    if before is not None and before != channel and before.topic != topic:
        text = f"channel {number} is declared twice, as {before.topic!r} and {topic!r}; the later counts"
        state.ledger.damage(text, where)
    state.channels[number] = state.ledger.declare(channel)


def _check_count(content: bytes, where: str, state: _State) -> None:
    (declared,) = struct.unpack_from("<Q", content)
    if declared > state.messages:
        missing = declared - state.messages
        state.ledger.damage(f"{missing} of the {declared} messages that the summary counts are not there", where)
    elif declared < state.messages:
        state.ledger.warn(f"the summary counts {declared} messages, {state.messages} are there")
