"""MCAP: the records in the order of the file, so that neither index nor summary is needed.

Format: https://mcap.dev/spec. A file is magic, records of ``opcode u8, length u64, content``, magic.
Everything is little-endian; a chunk's content is records again, compressed as a whole, guarded by a CRC-32.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, TYPE_CHECKING

from mavnav.logs.ledger import Ledger
from mavnav.logs.records import Channel, RawMessage, ros_type
from mavnav.logs.unpack import MAX_CHUNK_BYTES, UnpackError, unpack

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MAGIC = b"\x89MCAP0\r\n"

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _STATISTICS, _DATA_END = 1, 2, 3, 4, 5, 6, 0x0B, 0x0F
_WANTED = frozenset({_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _STATISTICS, _DATA_END})
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_FOOTER_HEAD = struct.Struct("<BQQ")
_FOOTER_BYTES = 20
_CHUNK_HEAD = struct.Struct("<QQQI")
_BLOCK_BYTES = 1 << 20
_ENCODING_OF_SCHEMA = {"ros2msg": "cdr", "ros2idl": "cdr", "ros1msg": "ros1"}


@dataclass
class _State:
    """What the records read so far have told."""

    ledger: Ledger
    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    spare: dict[int, Channel] = field(default_factory=dict)
    strangers: set[int] = field(default_factory=set)
    messages: int = 0
    ended: bool = False


def read_mcap(path: Path, ledger: Ledger) -> Iterator[RawMessage]:
    """Yield the messages of an MCAP file, in the order of the file, in constant memory.

    What cannot be read (a cut record, a chunk that does not decompress or whose CRC does not match, a message of
    an undeclared channel) is left out and noted.
    """
    state = _State(ledger)
    with path.open("rb") as file:
        size = path.stat().st_size
        state.spare = _summary_channels(file, size)
        file.seek(len(MAGIC))
        for opcode, content, offset in _file_records(file, size, state):
            if opcode == _CHUNK:
                yield from _chunk_messages(content, f"chunk at byte {offset}", state)
            else:
                yield from _take(opcode, content, f"byte {offset}", state)


def _summary_channels(file: IO[bytes], size: int) -> dict[int, Channel]:
    """Return the channels that the summary repeats: needed only where the chunk that declares them is damaged."""
    spare = _State(Ledger())
    footer_at = size - len(MAGIC) - _RECORD.size - _FOOTER_BYTES
    file.seek(max(footer_at, 0))
    opcode, length, start = _FOOTER_HEAD.unpack(file.read(_FOOTER_HEAD.size).ljust(_FOOTER_HEAD.size, b"\0"))
    if opcode != _FOOTER or length != _FOOTER_BYTES or not 0 < start < footer_at:
        return {}
    file.seek(start)
    summary = file.read(min(footer_at - start, MAX_CHUNK_BYTES))
    for record, content in _split(summary, "summary", spare):
        if record in (_SCHEMA, _CHANNEL):
            for _ in _take(record, content, "summary", spare):
                pass
    return spare.channels


def _file_records(file: IO[bytes], size: int, state: _State) -> Iterator[tuple[int, bytes, int]]:
    """Yield opcode, content and offset of the wanted records, checking the data section's CRC on the way."""
    crc = zlib.crc32(MAGIC)
    offset = len(MAGIC)
    while not state.ended:
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            state.ledger.damage("the file ends without a footer; it was cut or not closed", f"byte {offset}")
            return
        opcode, length = _RECORD.unpack(head)
        if length > size - offset - _RECORD.size:
            state.ledger.damage(f"a record of {length} bytes is cut by the end of the file", f"byte {offset}")
            return
        wanted = opcode in _WANTED
        before = crc
        content, crc = _content(file, head, length, wanted, crc)
        if opcode == _DATA_END:
            _check_data_crc(content, before, offset, state)
        state.ledger.at(offset)
        if wanted:
            yield opcode, content, offset
        offset += _RECORD.size + length
    if file.read(len(MAGIC)) != MAGIC:
        state.ledger.damage("the magic at the end is missing", f"byte {offset}")


def _content(file: IO[bytes], head: bytes, length: int, wanted: bool, crc: int) -> tuple[bytes, int]:
    """Read a record's content, or only pass over it block by block; return it and the running CRC."""
    crc = zlib.crc32(head, crc)
    if wanted:
        content = file.read(length)
        return content, zlib.crc32(content, crc)
    while length > 0 and (block := file.read(min(length, _BLOCK_BYTES))):
        crc = zlib.crc32(block, crc)
        length -= len(block)
    return b"", crc


def _check_data_crc(content: bytes, crc: int, offset: int, state: _State) -> None:
    declared = int.from_bytes(content[:4], "little")
    if declared not in (0, crc):
        state.ledger.damage("the CRC of the data section does not match", f"byte {offset}")


def _chunk_messages(content: bytes, where: str, state: _State) -> Iterator[RawMessage]:
    try:
        records = _chunk_records(content, where, state)
    except (UnpackError, struct.error, UnicodeDecodeError) as error:
        state.ledger.damage(f"chunk left out: {error}", where)
        return
    for opcode, record in _split(records, where, state):
        if opcode in (_MESSAGE, _CHANNEL, _SCHEMA):
            yield from _take(opcode, record, where, state)


def _split(records: bytes, where: str, state: _State) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of records that lie one behind the other in memory."""
    offset = 0
    while offset < len(records):
        opcode, length = _RECORD.unpack_from(records, offset) if len(records) - offset >= _RECORD.size else (0, 1 << 64)
        start = offset + _RECORD.size
        if length > len(records) - start:
            state.ledger.damage("a record inside is longer than what it lies in; the rest is left out", where)
            return
        yield opcode, records[start : start + length]
        offset = start + length


def _chunk_records(content: bytes, where: str, state: _State) -> bytes:
    """Decompress a chunk; a wrong size is told, a wrong CRC drops the chunk."""
    _, _, declared, crc = _CHUNK_HEAD.unpack_from(content)
    compression, offset = _string(content, _CHUNK_HEAD.size)
    (stored,) = struct.unpack_from("<Q", content, offset)
    data = content[offset + 8 :]
    if stored != len(data):
        raise UnpackError(f"declares {stored} bytes of data and holds {len(data)}")
    records = unpack(compression, data, declared)
    if crc and zlib.crc32(records) != crc:
        raise UnpackError("the CRC does not match")
    if len(records) != declared:
        state.ledger.damage(f"the chunk declares {declared} bytes and holds {len(records)}", where)
    return records


def _string(content: bytes, offset: int) -> tuple[str, int]:
    """Read a string with its length before it; return it and the offset behind it. Raises struct.error if cut."""
    (length,) = struct.unpack_from("<I", content, offset)
    end = offset + 4 + length
    if end > len(content):
        raise struct.error("a string is longer than its record")
    return content[offset + 4 : end].decode(), end


def _take(opcode: int, content: bytes, where: str, state: _State) -> Iterator[RawMessage]:
    """Yield the message, or take in what the record tells about others."""
    try:
        if opcode == _MESSAGE:
            yield from _message(content, where, state)
        elif opcode in (_SCHEMA, _CHANNEL):
            _declare(opcode, content, state)
        elif opcode == _STATISTICS:
            _check_count(content, where, state)
        elif opcode == _FOOTER:
            state.ended = True
    except (struct.error, UnicodeDecodeError) as error:
        state.ledger.damage(f"a record cannot be read ({error})", where)


def _message(content: bytes, where: str, state: _State) -> Iterator[RawMessage]:
    number, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(content)
    state.messages += 1
    channel = state.channels.get(number) or _spare_channel(number, state)
    if channel is not None:
        yield RawMessage(channel, log_ns, content[_MESSAGE_HEAD.size :])
    elif number not in state.strangers:
        state.strangers.add(number)
        state.ledger.damage(f"messages of channel {number}, which is declared nowhere before, are left out", where)


def _spare_channel(number: int, state: _State) -> Channel | None:
    channel = state.spare.get(number)
    if channel is not None:
        state.channels[number] = state.ledger.declare(channel)
    return channel


def _declare(opcode: int, content: bytes, state: _State) -> None:
    """Take in a Schema or Channel record; equal repetitions are usual."""
    from mcap.data_stream import ReadDataStream  # noqa: PLC0415
    from mcap.exceptions import EndOfFile  # noqa: PLC0415
    from mcap.records import Channel as ChannelRecord  # noqa: PLC0415
    from mcap.records import Schema  # noqa: PLC0415

    stream = ReadDataStream(BytesIO(content))
    try:
        if opcode == _SCHEMA:
            schema = Schema.read(stream)
            state.schemas[schema.id] = (schema.name, schema.encoding, schema.data)
            return
        channel = ChannelRecord.read(stream)
    except EndOfFile as error:
        raise struct.error("it is shorter than its fields") from error
    name, schema_encoding, data = state.schemas.get(channel.schema_id, ("", "", b""))
    encoding = channel.message_encoding or _ENCODING_OF_SCHEMA.get(schema_encoding, "")
    declared = Channel(channel.topic, ros_type(name), encoding, data if encoding == "protobuf" else b"")
    state.channels[channel.id] = state.ledger.declare(declared)


def _check_count(content: bytes, where: str, state: _State) -> None:
    (declared,) = struct.unpack_from("<Q", content)
    if declared > state.messages:
        missing = declared - state.messages
        state.ledger.damage(f"{missing} of the {declared} messages that the summary counts are not there", where)
