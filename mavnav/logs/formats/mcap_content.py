"""Processing of the records of an MCAP file: schemas, channels and messages, attached files and metadata.

Schemas, channels and messages are checked against earlier ones. Neither the summary of a file nor the CRC of its data
section is needed to read the messages: the summary replaces lost channels, and the CRC reveals damage.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Final

from mcap.opcode import Opcode as Op
from msgspec import field

from mavnav.logs.formats import mcap_records
from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES
from mavnav.logs.formats.mcap_records import HEAD, MAGIC, MESSAGE_HEAD, McapRecord, RecordFields
from mavnav.logs.formats.source import ReaderState, Source
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import AttachedFile, Channel, MetadataRecord, RawMessage, Schema, ros_type

EXTRAS: Final = {Op.ATTACHMENT: "attachment", Op.METADATA: "metadata record"}
"""Opcodes of what an MCAP file holds besides messages, and what these records are called."""

SCHEMA_ENCODINGS: Final = frozenset(
    {"", "ros1msg", "ros2msg", "ros2idl", "omgidl", "protobuf", "flatbuffer", "jsonschema", "cbor"}
)
"""Encodings of schemas that the specification lists; an empty one has none."""

_ENCODING_OF_SCHEMA = {"ros2msg": "cdr", "ros2idl": "cdr", "ros1msg": "ros1"}
_NO_SCHEMA = Schema()
_MESSAGE = int(Op.MESSAGE)


class McapState(ReaderState):
    """Schemas, channels and counters of the records read so far.

    The data section is ``sound`` if its CRC matches, None if it has none. In a ``suspect`` chunk, channels read before
    and those of an undamaged summary take precedence over the chunk's own. In a ``chunked`` file, messages outside of
    the chunks are suspect. ``spare`` are the channels of the summary.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    closed: bool = False
    suspect: bool = False
    sound: bool | None = None
    chunked: bool = False
    spare_is_sound: bool = False
    reported_outside: bool = False
    data_ended: bool = False
    searched_bytes: int = 0

    def begin(self) -> None:
        """Reset the state of the previous file, for several MCAP files in one."""
        self.schemas, self.channels, self.undeclared = {}, {}, set()
        self.messages, self.closed, self.reported_outside, self.data_ended = 0, False, False, False


def apply_record(opcode: int, content: bytes, source: Source, at: int, state: McapState) -> RawMessage | None:
    """Return the message of a record at an offset; a record of another kind updates the state and returns None."""
    try:
        if opcode == _MESSAGE:
            return _message(content, source, at, state)
        where = source.where(at)
        if opcode == Op.SCHEMA:
            _declare_schema(RecordFields(content), where, state)
        elif opcode == Op.CHANNEL:
            _declare_channel(RecordFields(content), where, state)
        elif opcode == Op.STATISTICS:
            _check_count(content, where, state)
        elif opcode == Op.DATA_END:
            state.data_ended = True
        elif opcode == Op.FOOTER:
            state.closed = True
    except struct.error as error:
        state.report.damage(f"a record cannot be read ({error})", source.where(at))
    return None


def _message(content: bytes, source: Source, at: int, state: McapState) -> RawMessage | None:
    number, _, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(content)
    state.messages += 1
    data = content[MESSAGE_HEAD.size :]
    channel, declared = state.channel(number, data, "channel", source, at)
    if channel is None:
        return None
    return RawMessage(channel, log_ns, data, not declared, publish_ns if declared else None)


def _declare_schema(fields: RecordFields, where: str, state: McapState) -> None:
    number, name, encoding = fields.number("H"), fields.text(), fields.text()
    schema = Schema(name, encoding, fields.block())
    if number == 0:
        state.report.warn(f"the schema of {name!r} has the number 0, which stands for none")
    if encoding not in SCHEMA_ENCODINGS:
        state.report.warn(f"the schema of {name!r} has the unknown encoding {encoding!r}; it is not used")
    if state.suspect and number in state.schemas:
        return
    if number in state.schemas and state.schemas[number] != schema:
        state.report.damage(f"schema {number} is declared twice, and differently; the later counts", where)
    state.schemas[number] = schema


def _declare_channel(fields: RecordFields, where: str, state: McapState) -> None:
    """Declare a channel. Writers repeat declarations; a channel without its schema is replaced by the summary's."""
    number, schema_number, topic, encoding = fields.number("H"), fields.number("H"), fields.text(), fields.text()
    schema = state.schemas.get(schema_number, _NO_SCHEMA)
    encoding = encoding or _ENCODING_OF_SCHEMA.get(schema.encoding, "")
    channel = Channel(topic, ros_type(schema.name), encoding, schema, _metadata(fields))
    before = state.channels.get(number)
    if state.suspect:
        spare = state.spare.get(number) if state.spare_is_sound else None
        channel = spare or before or channel
    if schema_number and not schema.name:
        channel = state.spare.get(number, channel)
    if before is not None and before != channel and before.topic != topic:
        text = f"channel {number} is declared twice, as {before.topic!r} and {topic!r}; the later counts"
        state.report.damage(text, where)
    state.channels[number] = state.report.declare(channel)


def _metadata(fields: RecordFields) -> tuple[tuple[str, str], ...]:
    """Return the metadata of a channel; none where they are cut, as the channel can be used without."""
    try:
        return tuple(fields.texts().items())
    except struct.error:
        return ()


def _check_count(content: bytes, where: str, state: McapState) -> None:
    (declared,) = struct.unpack_from("<Q", content)
    if declared > state.messages:
        missing = declared - state.messages
        state.report.damage(f"{missing} of the {declared} messages that the summary counts are not there", where)
    elif declared < state.messages:
        state.report.warn(f"the summary counts {declared} messages, {state.messages} are there")


def read_extra(source: Source, record: McapRecord) -> AttachedFile | MetadataRecord | str:
    """Return a record of ``EXTRAS``, or why it cannot be used."""
    what = f"{EXTRAS[Op(record.opcode)]} at {source.where(record.start)}"
    if record.end - record.start > MAX_CHUNK_BYTES:
        return f"the {what} is larger than {MAX_CHUNK_BYTES} bytes"
    content = source.read(record.start, record.end - record.start)
    fields = RecordFields(content)
    try:
        if record.opcode == Op.METADATA:
            return MetadataRecord(fields.text(), fields.texts())
        log_ns, created_ns, name, media_type = fields.number("Q"), fields.number("Q"), fields.text(), fields.text()
        start = fields.offset + 8
        fields.offset = start + fields.number("Q")
        data, crc = content[start : fields.offset], fields.number("I")
    except struct.error:
        return f"the {what} cannot be read"
    if crc and zlib.crc32(content[: fields.offset - 4]) != crc:
        return f"the CRC of the {what} ({name}) does not match"
    return AttachedFile(log_ns, created_ns, name, media_type, data)


_KINDS = frozenset(
    {Op.SCHEMA, Op.CHANNEL, Op.STATISTICS, Op.CHUNK_INDEX, Op.ATTACHMENT_INDEX, Op.METADATA_INDEX, Op.SUMMARY_OFFSET}
)
_FOOTER_BYTES = 20
_DATA_END_HEAD = HEAD.pack(Op.DATA_END, 4)
_BLOCK_BYTES = 1 << 20
_CHUNK_LENGTH = slice(24, 32)
_HOP_BYTES = 1 << 12


def read_summary(source: Source, state: McapState) -> None:
    """Take the channels of the summary as spare ones, needed only if the chunk that declares them is damaged.

    The state also learns whether the summary lists chunks, and whether its CRC and offset are right. If the footer is
    lost or its offset is wrong, the summary is searched for after the end of the data.
    """
    footer_at = source.size - len(MAGIC) - HEAD.size - _FOOTER_BYTES
    record = mcap_records.record_at(source, footer_at) if footer_at > 0 else None
    if record is None or record.opcode != Op.FOOTER:
        _search_summary(source, state)
        return
    start, _, crc = struct.unpack("<QQI", source.read(record.start, _FOOTER_BYTES))
    if start == 0:
        return
    first = mcap_records.record_at(source, start) if start < footer_at <= start + MAX_CHUNK_BYTES else None
    if first is None or first.opcode not in _KINDS:  # bytes were lost or gained before it
        _search_summary(source, state)
        return
    guarded = source.read(start, footer_at - start + HEAD.size + _FOOTER_BYTES - 4)
    sound = crc == 0 or zlib.crc32(guarded) == crc
    if not sound:
        state.report.damage("the CRC of the summary does not match; it is not needed", f"byte {start}")
    _parse_summary(guarded[: footer_at - start], state, sound=sound)


def _search_summary(source: Source, state: McapState) -> None:
    """Parse the summary found after the last end-of-data record, or, if there is none, in the last MiB."""
    end = _last_data_end(source, MAX_CHUNK_BYTES)
    start = max(source.size - _BLOCK_BYTES, 0) if end is None else end
    _parse_summary(source.read(start, MAX_CHUNK_BYTES), state, sound=False)


def _parse_summary(summary: bytes, state: McapState, *, sound: bool) -> None:
    own = McapState(ReadReport())
    source = Source(BytesIO(summary), len(summary))
    for opcode, content in _records(source):
        if opcode in (Op.SCHEMA, Op.CHANNEL):
            apply_record(opcode, content, source, 0, own)
        elif opcode == Op.CHUNK_INDEX:
            state.chunked |= any(content[_CHUNK_LENGTH])
    state.spare, state.spare_is_sound = own.channels, sound


def _records(source: Source) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of the records; after bytes that are no record, continue at the next one."""
    offset = 0
    while offset < source.size:
        behind = offset
        for opcode, content in mcap_records.plain_records(source.read(offset, source.size)):
            if mcap_records.record_at(source, behind) is None:
                break
            yield opcode, content
            behind += HEAD.size + len(content)
        offset = mcap_records.find_record(source, behind + 1)


def check_data_section(source: Source, start: int, state: McapState) -> None:
    """Check the CRC of the data section that begins with the magic at ``start``, and whether it has chunks.

    The state gets the results; a mismatch is reported. A data section that lost its end has no CRC.
    """
    heads = dict(_record_heads(source, start + len(MAGIC)))
    end = heads.get(Op.DATA_END) or _last_data_end(source, _BLOCK_BYTES, start)
    declared = 0 if end is None else int.from_bytes(source.read(end + HEAD.size, 4), "little")
    state.chunked |= Op.CHUNK in heads or Op.MESSAGE_INDEX in heads
    state.sound = None if end is None or declared == 0 else declared == _crc(source, start, end)
    if end is not None and state.sound is False:
        text = "the CRC of the data section does not match; which record is wrong cannot be known"
        state.report.damage(f"{text}, so all that no chunk's own CRC guards are suspect", source.where(end))


def _record_heads(source: Source, offset: int) -> Iterator[tuple[int, int]]:
    """Yield opcode and offset of records, up to the end of the data or the first invalid one.

    It is fast, because there may be millions.
    """
    block, base, opcode = b"", offset, 0
    while opcode != Op.DATA_END:
        if offset + HEAD.size > base + len(block):
            block, base = source.read(offset, _HOP_BYTES), offset
            if len(block) < HEAD.size:
                return
        opcode, length = HEAD.unpack_from(block, offset - base)
        if opcode == 0 or offset + HEAD.size + length > source.size or (opcode == Op.DATA_END and length != 4):
            return
        yield opcode, offset
        offset += HEAD.size + length


def _last_data_end(source: Source, reach_bytes: int, start: int = 0) -> int | None:
    """Return the offset of the last end-of-data record in the last ``reach_bytes`` bytes; None if there is none."""
    behind = source.size
    while behind > max(source.size - reach_bytes, start):
        tail_at = max(behind - _BLOCK_BYTES, start)
        at = source.read(tail_at, _BLOCK_BYTES + len(_DATA_END_HEAD)).rfind(_DATA_END_HEAD)
        if at >= 0:
            return tail_at + at
        behind = tail_at
    return None


def _crc(source: Source, start: int, end: int) -> int:
    crc = 0
    for offset in range(start, end, _BLOCK_BYTES):
        crc = zlib.crc32(source.read(offset, min(_BLOCK_BYTES, end - offset)), crc)
    return crc
