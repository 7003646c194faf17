"""Processing of the records of an MCAP file: schemas, channels and messages, attached files and metadata.

Schemas, channels and messages are checked against earlier ones.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final

from msgspec import field

from mavnav.logs.formats.channels import ReaderState
from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES
from mavnav.logs.formats.mcap_records import MESSAGE_HEAD, McapRecord, Op, RecordFields
from mavnav.logs.formats.source import Source
from mavnav.logs.records import AttachedFile, Channel, MetadataRecord, RawMessage, Schema, ros_type

EXTRAS: Final = {Op.ATTACHMENT: "attachment", Op.METADATA: "metadata record"}
"""Opcodes of what an MCAP file holds besides messages, and what these records are called."""

SCHEMA_ENCODINGS: Final = frozenset(
    {"", "ros1msg", "ros2msg", "ros2idl", "omgidl", "protobuf", "flatbuffer", "jsonschema", "cbor"}
)
"""Encodings of schemas that the specification lists; an empty one has none."""

_ENCODING_OF_SCHEMA = {"ros2msg": "cdr", "ros2idl": "cdr", "ros1msg": "ros1"}
_NO_SCHEMA = Schema()


class McapState(ReaderState):
    """Schemas, channels and counters of the records read so far.

    The data section is ``unsound`` if its CRC does not match, and ``verified`` if it does. In a ``suspect`` chunk,
    channels read before and those of an undamaged summary take precedence over the chunk's own. In a ``chunked`` file,
    messages outside of the chunks are suspect. ``spare`` are the channels of the summary.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    closed: bool = False
    suspect: bool = False
    unsound: bool = False
    verified: bool = False
    chunked: bool = False
    spare_is_sound: bool = False
    reported_outside: bool = False
    data_ended: bool = False
    searched_bytes: int = 0

    def begin(self) -> None:
        """Reset the state of the previous file, for several MCAP files in one."""
        self.schemas, self.channels, self.undeclared = {}, {}, set()
        self.messages, self.closed, self.reported_outside, self.data_ended = 0, False, False, False


def plain_message(content: bytes, state: McapState) -> RawMessage | None:
    """Return the message of a record on a usual channel."""
    if len(content) < MESSAGE_HEAD.size:
        return None
    number, _, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(content)
    if (channel := state.usual_channel(number)) is None:
        return None
    state.messages += 1
    return RawMessage(channel, log_ns, content[MESSAGE_HEAD.size :], publish_ns=publish_ns)


def apply_record(opcode: int, content: bytes, where: str, state: McapState) -> RawMessage | None:
    """Return the message of a record; a record of another kind updates the state and returns None."""
    try:
        if opcode == Op.MESSAGE:
            return _message(content, where, state)
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
        state.report.damage(f"a record cannot be read ({error})", where)
    return None


def _message(content: bytes, where: str, state: McapState) -> RawMessage | None:
    number, _, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(content)
    state.messages += 1
    data = content[MESSAGE_HEAD.size :]
    channel, declared = state.channel(number, data, "channel", where)
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
