"""Reader of MCAP files: reads the records in the order of the file, so that neither index nor summary is needed.

Lengths, counts and CRCs of records, chunks and the summary are checked against the data. After bytes that are no
record, reading continues at the next record.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

from mcap.opcode import Opcode as Op

from mavnav.logs.formats import mcap_content, mcap_records
from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES, TOO_MANY, Allowance, DecompressError, decompress
from mavnav.logs.formats.mcap_content import EXTRAS, McapState
from mavnav.logs.formats.mcap_records import HEAD, IN_CHUNKS, MAGIC, PRIVATE, ChunkHead, McapRecord
from mavnav.logs.formats.source import MAGIC_WITHIN_BYTES, Source
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import RawMessage

_READ = frozenset({Op.HEADER, Op.FOOTER, Op.SCHEMA, Op.CHANNEL, Op.MESSAGE, Op.CHUNK, Op.STATISTICS, Op.DATA_END})
_BLOCK_BYTES = 1 << 20
_FREE_SEARCH_BYTES = 1 << 28
_CHECKED_RECORD_COST = 4
"""Cost of a record of a chunk that is read with checks, in records that are read without them."""


def read_mcap(path: Path, report: ReadReport) -> Iterator[RawMessage]:
    """Yield the messages of an MCAP file, in the order of the file, in constant memory.

    Unreadable data are reported and left out. Messages of a chunk whose CRC does not match, or that does not
    decompress to its end, are reported and marked as suspect.
    """
    with path.open("rb") as file:
        source = Source(file, path.stat().st_size)
        state = McapState(report, Allowance(source.size))
        mcap_content.read_summary(source, state)
        for record in _records(source, _begin(source, state), state):
            report.here_bytes = record.start
            if record.opcode == Op.CHUNK:
                yield from _chunk_messages(source, record, state)
            elif record.opcode in _READ:
                yield from _outside(source, record, state)
            elif record.opcode in EXTRAS and report.take_extra:
                report.take_extra(mcap_content.read_extra(source, record))
        if not state.closed:
            report.damage("the file ends without a footer; it was cut or not closed", source.where(source.size))


def _outside(source: Source, record: McapRecord, state: McapState) -> Iterator[RawMessage]:
    """Process a record outside of the chunks; in the data section of a file with chunks it is a result of damage."""
    is_message = record.opcode == Op.MESSAGE
    outside_chunks = state.chunked and not state.sound and (is_message or not state.data_ended)
    if outside_chunks and is_message and not state.reported_outside:
        state.reported_outside = True
        text = "messages lie outside of the chunks, where no checksum guards them; they are suspect"
        state.report.damage(text, source.where(record.start))
    content = source.read(record.start, min(record.end - record.start, MAX_CHUNK_BYTES))
    state.suspect = outside_chunks
    message = mcap_content.apply_record(record.opcode, content, source, record.start, state)
    state.suspect = False
    if message is not None:
        doubtful = outside_chunks or state.sound is False or _runs_into_loss(source, record.end)
        yield message._replace(suspect=True) if doubtful else message


def _begin(source: Source, state: McapState) -> int:
    """Return the offset of the magic, which may be damaged or have other bytes before it."""
    at = source.read(0, MAGIC_WITHIN_BYTES).find(MAGIC)
    if at == 0:
        return 0
    state.report.damage("the file does not begin with the magic of MCAP", source.where(0))
    if at > 0 and mcap_records.record_at(source, at + len(MAGIC)) is not None:
        return at
    mcap_content.check_data_section(source, 0, state)
    return 0


def _records(source: Source, offset: int, state: McapState) -> Iterator[McapRecord]:
    """Yield the records; after bytes that are no record, continue at the next one.

    A record that no other record follows is yielded too, and its content is searched for records, because its length
    may be wrong. Such a chunk ends at the first record found in it, unless its CRC matches.
    """
    while offset < source.size:
        if source.read(offset, len(MAGIC)) == MAGIC:
            offset = _skip_magic(source, offset, state)
            continue
        record = mcap_records.record_at(source, offset)
        if record is None:
            offset = _report_loss(source, offset, offset + 1, state)
            continue
        if Op.DATA_END < record.opcode < PRIVATE:
            state.report.warn(f"a record of an unknown kind ({record.opcode}) was passed over")
        if record.correction:
            state.report.damage(record.correction, source.where(offset))
        followed = mcap_records.is_boundary(source, record.end)
        if not followed and record.opcode == Op.CHUNK:
            record = _clip(source, record, state)
        yield record
        if state.closed:
            offset = _skip_end_magic(source, record.end, state)
        elif followed or record.opcode == Op.CHUNK:
            offset = record.end
        else:
            offset = _report_loss(source, offset, record.start, state)


def _clip(source: Source, record: McapRecord, state: McapState) -> McapRecord:
    """End a chunk that no record follows, and whose CRC does not match, at the first record found in it.

    Many chunks of a hostile file can declare the same bytes, so the number of bytes searched is limited.
    """
    state.searched_bytes += record.end - record.start
    if state.searched_bytes > _FREE_SEARCH_BYTES + 4 * source.size or _is_verified(source, record, state):
        return record
    end = mcap_records.find_record(source, record.start + 1, outer=True)
    if end >= record.end:
        return record
    text = f"the chunk has {end - record.start} of its {record.end - record.start} bytes"
    state.report.damage(text, source.where(record.start))
    return record._replace(end=end)


def _is_verified(source: Source, record: McapRecord, state: McapState) -> bool:
    """Return whether a chunk has a CRC that matches."""
    try:
        *_, verified = _read_chunk(source, record, state.allowance)
    except (DecompressError, struct.error):
        return False
    return verified


def _runs_into_loss(source: Source, end: int) -> bool:
    """Return whether neither a record nor a cut record follows; the end of the record before may then be lost too."""
    head = source.read(end, HEAD.size)
    if len(head) < HEAD.size or mcap_records.is_boundary(source, end):
        return False
    opcode, length = HEAD.unpack(head)
    return not (0 < opcode <= Op.DATA_END and source.size - end < length < 1 << 32)


def _report_loss(source: Source, offset: int, search_from: int, state: McapState) -> int:
    """Report the bytes up to the next record as lost; return the offset of that record."""
    next_offset = mcap_records.find_record(source, search_from)
    if next_offset == offset:
        return next_offset
    empty = not any(source.read(offset, min(next_offset - offset, _BLOCK_BYTES)))
    kind = "zeros" if empty else "bytes that are no record"
    state.report.damage(f"{next_offset - offset} {kind}; what they held is lost", source.where(offset))
    return next_offset


def _skip_magic(source: Source, offset: int, state: McapState) -> int:
    """Return the offset after the magic; a magic after records begins another file."""
    if state.closed or state.messages:
        state.report.warn("several MCAP files lie one behind the other in this one; all were read")
        state.begin()
    mcap_content.check_data_section(source, offset, state)
    return offset + len(MAGIC)


def _skip_end_magic(source: Source, offset: int, state: McapState) -> int:
    """Return the offset after the magic that follows the footer; report it if it is missing."""
    if source.read(offset, len(MAGIC)) == MAGIC:
        return offset + len(MAGIC)
    state.report.damage("the magic at the end is missing", source.where(offset))
    return offset if offset == source.size else _report_loss(source, offset, offset, state)


def _chunk_messages(source: Source, record: McapRecord, state: McapState) -> Iterator[RawMessage]:
    where = f"chunk at byte {record.start}"
    try:
        records, suspect = _chunk_records(source, record, where, state)
    except (DecompressError, struct.error) as error:
        state.report.damage(f"chunk left out: {error}", where)
        return
    inner = Source(BytesIO(records), len(records), f"{where}, ")
    state.allowance.begin_chunk()
    state.suspect = suspect
    for message in _walk(inner, 0, state) if suspect else _sound_messages(records, inner, state):
        yield message._replace(suspect=True) if suspect else message
    state.suspect = False


def _chunk_records(source: Source, record: McapRecord, where: str, state: McapState) -> tuple[bytes, bool]:
    """Decompress as much of a chunk as possible and report damage; return the records and whether they are suspect."""
    head, records, problem, verified = _read_chunk(source, record, state.allowance)
    if problem is None and len(records) != head.declared_bytes:
        problem = f"the chunk declares {head.declared_bytes} bytes and holds {len(records)}"
    if head.crc and not verified:
        problem = f"{problem}, and the CRC does not match" if problem else "the CRC does not match"
    if problem:
        text = "" if verified else "; what can be read of the chunk is suspect"
        state.report.damage(problem + text, where)
    doubtful = problem is not None or (state.sound is False and not head.crc)
    return records, doubtful and not verified


def _read_chunk(source: Source, record: McapRecord, allowance: Allowance) -> tuple[ChunkHead, bytes, str | None, bool]:
    """Return the head of a chunk, the output of ``decompress``, and whether there is a CRC that matches.

    If the declared number of stored bytes is wrong, all bytes of the chunk are decompressed. Raises DecompressError and
    struct.error.
    """
    size = record.end - record.start
    if size > MAX_CHUNK_BYTES:
        raise DecompressError(f"of {size} bytes; no more than {MAX_CHUNK_BYTES} are taken into memory")
    content = source.read(record.start, size)
    head = mcap_records.chunk_head(content)
    records, problem = decompress(head.compression, content[head.start :][: head.stored_bytes], allowance)
    if problem and len(content) > head.start + head.stored_bytes:
        records, problem = decompress(head.compression, content[head.start :], allowance)
    return head, records, problem, head.crc != 0 and zlib.crc32(records) == head.crc


def _sound_messages(records: bytes, inner: Source, state: McapState) -> Iterator[RawMessage]:
    """Yield the messages of an undamaged chunk without checks; after a record that does not fit, with checks."""
    offset = 0
    for opcode, content in mcap_records.plain_records(records):
        if not state.allowance.spend_record():
            state.report.damage(TOO_MANY, inner.where(offset))
            return
        if message := _inner_message(opcode, content, inner, offset, state):
            yield message
        offset += HEAD.size + len(content)
    yield from _walk(inner, offset, state)


def _walk(inner: Source, offset: int, state: McapState) -> Iterator[RawMessage]:
    """Yield the messages of a chunk from an offset on, with checks."""
    for record in _records(inner, offset, state):
        if not state.allowance.spend_record(_CHECKED_RECORD_COST):
            state.report.damage(TOO_MANY, inner.where(record.start))
            return
        content = inner.read(record.start, record.end - record.start)
        if message := _inner_message(record.opcode, content, inner, record.start, state):
            yield message


def _inner_message(opcode: int, content: bytes, inner: Source, offset: int, state: McapState) -> RawMessage | None:
    """Return the message of a record of a chunk; others of its kinds update the state, nested chunks are reported."""
    if opcode in IN_CHUNKS:
        return mcap_content.apply_record(opcode, content, inner, offset, state)
    if opcode == Op.CHUNK:
        state.report.damage("a chunk lies within a chunk, which is not legal; it is not read", inner.where(offset))
    return None
