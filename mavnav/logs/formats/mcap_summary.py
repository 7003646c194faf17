"""What stands behind the data of an MCAP file: the summary's channels, and the data section's CRC.

Neither is needed to read the messages. The one stands in for what is lost, the other tells that something is wrong.
"""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES
from mavnav.logs.formats.mcap_content import State, take
from mavnav.logs.formats.mcap_records import HEAD, MAGIC, Op, plain_records, record_at
from mavnav.logs.read_report import ReadReport

if TYPE_CHECKING:
    from mavnav.logs.formats.source import Source
    from mavnav.logs.records import Channel

_KINDS = frozenset(
    {Op.SCHEMA, Op.CHANNEL, Op.STATISTICS, Op.CHUNK_INDEX, Op.ATTACHMENT_INDEX, Op.METADATA_INDEX, Op.SUMMARY_OFFSET}
)
_FOOTER_BYTES = 20
_DATA_END_HEAD = HEAD.pack(Op.DATA_END, 4)
_BLOCK_BYTES = 1 << 20


def summary_channels(source: Source, report: ReadReport) -> dict[int, Channel]:
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
    if first is None or first.opcode not in _KINDS:  # of a file that lies behind other bytes
        return {}
    summary = source.read(start, footer_at - start)
    guarded = summary + source.read(footer_at, HEAD.size + _FOOTER_BYTES - 4)
    if crc and zlib.crc32(guarded) != crc:
        report.damage("the CRC of the summary does not match; it is not needed", f"byte {start}")
    return _channels(summary)


def _channels(summary: bytes) -> dict[int, Channel]:
    state = State(ReadReport())
    for opcode, content in plain_records(summary):
        if opcode in (Op.SCHEMA, Op.CHANNEL):
            take(opcode, content, "summary", state)
    return state.channels


def data_crc_fails(source: Source, start: int, report: ReadReport) -> bool:
    """Tell, and note, whether the data section that begins with the magic at ``start`` has a CRC that does not match.

    False where it has none, or lost its end.
    """
    end = _data_end(source, start)
    declared = 0 if end is None else int.from_bytes(source.read(end + HEAD.size, 4), "little")
    if end is None or declared in (0, _crc(source, start, end)):
        return False
    text = "the CRC of the data section does not match; which record is wrong cannot be known"
    report.damage(f"{text}, so all that no chunk's own CRC guards are suspect", source.where(end))
    return True


def _data_end(source: Source, start: int) -> int | None:
    """Return where the record stands that ends the data: behind the others, else the last that looks like it."""
    offset = start + len(MAGIC)
    while (record := record_at(source, offset, mend=False)) is not None:
        if record.opcode == Op.DATA_END:
            return offset
        offset = record.end
    tail_at = max(source.size - _BLOCK_BYTES, start)
    at = source.read(tail_at, _BLOCK_BYTES).rfind(_DATA_END_HEAD)
    return tail_at + at if at >= 0 else None


def _crc(source: Source, start: int, end: int) -> int:
    crc = 0
    for offset in range(start, end, _BLOCK_BYTES):
        crc = zlib.crc32(source.read(offset, min(_BLOCK_BYTES, end - offset)), crc)
    return crc
