"""The summary of an MCAP file and the CRC of its data section.

Neither is needed to read the messages. The summary replaces lost channels, and the CRC reveals damage.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO

from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES
from mavnav.logs.formats.mcap_content import McapState, apply_record
from mavnav.logs.formats.mcap_records import HEAD, MAGIC, Op, find_record, plain_records, record_at
from mavnav.logs.formats.source import Source
from mavnav.logs.read_report import ReadReport

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
    record = record_at(source, footer_at) if footer_at > 0 else None
    if record is None or record.opcode != Op.FOOTER:
        _search_summary(source, state)
        return
    start, _, crc = struct.unpack("<QQI", source.read(record.start, _FOOTER_BYTES))
    if start == 0:
        return
    first = record_at(source, start) if start < footer_at <= start + MAX_CHUNK_BYTES else None
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
    for opcode, content in _records(summary):
        if opcode in (Op.SCHEMA, Op.CHANNEL):
            apply_record(opcode, content, "summary", own)
        elif opcode == Op.CHUNK_INDEX:
            state.chunked |= any(content[_CHUNK_LENGTH])
    state.spare, state.spare_is_sound = own.channels, sound


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


def check_data_section(source: Source, start: int, state: McapState) -> None:
    """Check the CRC of the data section that begins with the magic at ``start``, and whether it has chunks.

    The state gets the results; a mismatch is reported. A data section that lost its end has no CRC.
    """
    opcodes, end = set[int](), None
    for opcode, offset in _record_heads(source, start + len(MAGIC)):
        opcodes.add(opcode)
        if opcode == Op.DATA_END:
            end = offset
            break
    end = _last_data_end(source, _BLOCK_BYTES, start) if end is None else end
    declared = 0 if end is None else int.from_bytes(source.read(end + HEAD.size, 4), "little")
    state.chunked |= Op.CHUNK in opcodes or Op.MESSAGE_INDEX in opcodes
    if end is None or declared == 0:
        state.verified = state.unsound = False
        return
    state.verified = declared == _crc(source, start, end)
    state.unsound = not state.verified
    if state.unsound:
        text = "the CRC of the data section does not match; which record is wrong cannot be known"
        state.report.damage(f"{text}, so all that no chunk's own CRC guards are suspect", source.where(end))


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
