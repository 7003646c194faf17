"""What an MCAP file holds besides messages: attached files and metadata records."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, Final

from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES
from mavnav.logs.formats.mcap_records import Op, RecordFields
from mavnav.logs.records import AttachedFile, MetadataRecord

if TYPE_CHECKING:
    from mavnav.logs.formats.mcap_records import McapRecord
    from mavnav.logs.formats.source import Source

EXTRAS: Final = {Op.ATTACHMENT: "attachment", Op.METADATA: "metadata record"}
"""Opcodes of such records, and what they are called."""


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
