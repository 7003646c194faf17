"""The summary of an MCAP file and the CRC of its data section.

Neither is needed to read the messages. The summary replaces lost channels, and the CRC reveals damage.
"""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from typing import TYPE_CHECKING, NamedTuple

from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES
from mavnav.logs.formats.mcap_content import McapState, apply_record
from mavnav.logs.formats.mcap_records import HEAD, MAGIC, Op, find_record, plain_records, record_at
from mavnav.logs.formats.source import Source
from mavnav.logs.read_report import ReadReport

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavnav.logs.records import Channel

_KINDS = frozenset(
    {Op.SCHEMA, Op.CHANNEL, Op.STATISTICS, Op.CHUNK_INDEX, Op.ATTACHMENT_INDEX, Op.METADATA_INDEX, Op.SUMMARY_OFFSET}
)
_FOOTER_BYTES = 20
_DATA_END_HEAD = HEAD.pack(Op.DATA_END, 4)
_BLOCK_BYTES = 1 << 20
_CHUNK_LENGTH = slice(24, 32)
_HOP_BYTES = 1 << 12


class McapSummary(NamedTuple):
    """Channels of the summary, and whether it lists chunks; ``sound`` unless its CRC or its offset is wrong."""

    channels: dict[int, Channel]
    chunked: bool = False
    sound: bool = False


def read_summary(source: Source, report: ReadReport) -> McapSummary:
    """Return the content of the summary, which is needed only if the chunk that declares the channels is damaged.

    If the footer is lost or its offset is wrong, the summary is searched for after the end of the data.
    """
    footer_at = source.size - len(MAGIC) - HEAD.size - _FOOTER_BYTES
    record = record_at(source, footer_at) if footer_at > 0 else None
    if record is None or record.opcode != Op.FOOTER:
        return _search_summary(source)
    footer = source.read(record.start, _FOOTER_BYTES)
    start, _, crc = struct.unpack("<QQI", footer)
    if start == 0:
        return McapSummary({})
    first = record_at(source, start) if start < footer_at <= start + MAX_CHUNK_BYTES else None
    if first is None or first.opcode not in _KINDS:  # bytes were lost or gained before it
        return _search_summary(source)
    summary = source.read(start, footer_at - start)
    guarded = summary + source.read(footer_at, HEAD.size + _FOOTER_BYTES - 4)
    if crc and zlib.crc32(guarded) != crc:
        report.damage("the CRC of the summary does not match; it is not needed", f"byte {start}")
        return _parse_summary(summary)._replace(sound=False)
    return _parse_summary(summary)


def _search_summary(source: Source) -> McapSummary:
    """Return the summary found after the last end-of-data record, or, if there is none, in the last MiB."""
    end = _last_data_end(source, MAX_CHUNK_BYTES)
    start = max(source.size - _BLOCK_BYTES, 0) if end is None else end
    return _parse_summary(source.read(start, MAX_CHUNK_BYTES))._replace(sound=False)


def _parse_summary(summary: bytes) -> McapSummary:
    state = McapState(ReadReport())
    for opcode, content in _records(summary):
        if opcode in (Op.SCHEMA, Op.CHANNEL):
            apply_record(opcode, content, "summary", state)
        elif opcode == Op.CHUNK_INDEX:
            state.chunked |= any(content[_CHUNK_LENGTH])
    return McapSummary(state.channels, state.chunked, sound=True)


def _records(summary: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of the records; after bytes that are no record, continue at the next one."""
    source, offset = Source(BytesIO(summary), len(summary)), 0
    while offset < source.size:
        behind = offset
        for opcode, content in plain_records(summary[offset:]):
            if record_at(source, behind) is None:
                break
            yield opcode, content
            behind += HEAD.size + len(content)
        offset = find_record(source, behind + 1)


class DataSection(NamedTuple):
    """Whether the data section has chunks, and whether its CRC matches; None if it has no CRC."""

    chunked: bool
    crc_matches: bool | None


def read_data_section(source: Source, start: int, report: ReadReport) -> DataSection:
    """Check the CRC of the data section that begins with the magic at ``start``; report a mismatch.

    A data section that lost its end has no CRC.
    """
    opcodes, end = set[int](), None
    for opcode, offset in _record_heads(source, start + len(MAGIC)):
        opcodes.add(opcode)
        if opcode == Op.DATA_END:
            end = offset
            break
    end = _last_data_end(source, _BLOCK_BYTES, start) if end is None else end
    declared = 0 if end is None else int.from_bytes(source.read(end + HEAD.size, 4), "little")
    chunked = Op.CHUNK in opcodes or Op.MESSAGE_INDEX in opcodes
    if end is None or declared == 0:
        return DataSection(chunked, None)
    if declared == _crc(source, start, end):
        return DataSection(chunked, True)
    text = "the CRC of the data section does not match; which record is wrong cannot be known"
    report.damage(f"{text}, so all that no chunk's own CRC guards are suspect", source.where(end))
    return DataSection(chunked, False)


def _record_heads(source: Source, offset: int) -> Iterator[tuple[int, int]]:
    """Yield opcode and offset of records, up to the first invalid one; fast, because there may be millions."""
    block, base = b"", offset
    while True:
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
