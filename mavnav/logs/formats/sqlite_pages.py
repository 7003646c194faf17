"""Rows of a sqlite file read from its leaf pages, without the tree above them: for files that sqlite cannot read.

Format: https://sqlite.org/fileformat.html, 1.6 (b-tree pages) and 2.1 (records). The tables of a ROS 2 bag are
recognized by the types of their columns: a message is (NULL, integer, integer, blob), a topic (NULL, text, text, text,
...), because a column that is the row number is stored as NULL.
"""

from __future__ import annotations

from collections.abc import Iterator

from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES
from mavnav.logs.formats.source import Source

_LEAF = 0x0D
_FILE_HEADER_BYTES = 100
_INTEGER_BYTES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
_MAX_COLUMNS = 16

Value = int | bytes | str | None

Row = tuple[int, tuple[Value, ...]]
"""The number of a row, and the values of its columns."""


def rows(source: Source) -> Iterator[Row]:
    """Yield the rows of messages and topics, in the order of the pages; rows that reach into lost pages are left out.

    Of the file header only the page layout is used; a page size that sqlite does not allow is replaced by 4096 bytes.
    """
    head = source.read(0, _FILE_HEADER_BYTES)
    page_bytes = page_size(head)
    usable = page_bytes - (head[20] if len(head) > 20 and head[20] < 64 else 0)
    for page in range(-(-source.size // page_bytes)):
        content = source.read(page * page_bytes, page_bytes)
        yield from _rows_of(source, content, _FILE_HEADER_BYTES if page == 0 else 0, usable)


def page_size(head: bytes) -> int:
    """Return the page size in a file's header (1.3.2), in bytes; 4096 if it is invalid."""
    size = int.from_bytes(head[16:18], "big")
    size = 65536 if size == 1 else size
    return size if size >= 512 and size.bit_count() == 1 else 4096


def _rows_of(source: Source, page: bytes, start: int, usable: int) -> Iterator[Row]:
    if len(page) < start + 8 or page[start] != _LEAF:
        return
    cells = int.from_bytes(page[start + 3 : start + 5], "big")
    for at in range(start + 8, min(start + 8 + 2 * cells, usable - 1), 2):
        row = _cell(source, page, int.from_bytes(page[at : at + 2], "big"), usable)
        if row is not None:
            yield row


def _cell(source: Source, page: bytes, offset: int, usable: int) -> Row | None:
    """Read the cell at an offset; None if it is cut, not valid, or belongs to another table."""
    try:
        length, offset = _varint(page, offset)
        number, offset = _varint(page, offset)
        behind = offset + _local_bytes(length, usable)
        payload = page[offset:behind]
        if not 4 <= length <= MAX_CHUNK_BYTES or behind > len(page) or not _is_known(payload):
            return None
        if len(payload) < length:
            payload = _overflow(source, page, behind, payload, length, usable)
        return (number, _record(payload)) if len(payload) == length else None
    except (IndexError, ValueError):
        return None


def _varint(data: bytes, offset: int) -> tuple[int, int]:
    """Read a big-endian number of 7 bits per byte, 8 in the ninth; return it and the offset after it."""
    value = 0
    for at in range(offset, offset + 8):
        value = (value << 7) | (data[at] & 0x7F)
        if data[at] < 0x80:
            return value, at + 1
    return (value << 8) | data[offset + 8], offset + 9


def _local_bytes(length: int, usable: int) -> int:
    """Return the number of bytes of a payload that are stored in the leaf itself (1.6)."""
    if length <= usable - 35:
        return length
    least = (usable - 12) * 32 // 255 - 23
    local = least + (length - least) % (usable - 4)
    return local if local <= usable - 35 else least


def _overflow(source: Source, page: bytes, pointer: int, payload: bytes, length: int, usable: int) -> bytes:
    """Return the payload with its overflow pages; shorter than ``length`` if the chain of pages breaks."""
    pieces, missing = [payload], length - len(payload)
    following = int.from_bytes(page[pointer : pointer + 4], "big")
    while missing > 0 and following > 0:
        block = source.read((following - 1) * len(page), usable)
        piece = block[4 : 4 + missing]
        if not piece:
            break
        pieces.append(piece)
        missing -= len(piece)
        following = int.from_bytes(block[:4], "big")
    return b"".join(pieces)


def _types(payload: bytes) -> tuple[list[int], int]:
    """Return the serial types of a record's columns and the offset of their values.

    Raises IndexError where they are cut, ValueError where they do not end at that offset or are too many.
    """
    end, offset = _varint(payload, 0)
    types: list[int] = []
    while offset < end and len(types) <= _MAX_COLUMNS:
        kind, offset = _varint(payload, offset)
        types.append(kind)
    if offset != end:
        raise ValueError("the types of the columns do not fill their header")
    return types, end


def _is_known(payload: bytes) -> bool:
    """Return whether a record is a message or a topic by the types of its columns."""
    types, _ = _types(payload)
    if len(types) < 4 or types[0] != 0:
        return False
    _, topic, time, data, *more = types
    is_blob = data >= 12 and data % 2 == 0
    is_message = topic in _INTEGER_BYTES and time in _INTEGER_BYTES and is_blob and not more
    return is_message or all(kind >= 13 and kind % 2 for kind in types[1:4])


def _record(payload: bytes) -> tuple[Value, ...]:
    """Read the columns of a record; raises ValueError if their lengths do not add up to the length of the record."""
    types, offset = _types(payload)
    values: list[Value] = []
    for kind in types:
        size = (kind - 12) // 2 if kind >= 12 else _INTEGER_BYTES.get(kind, 8 if kind == 7 else 0)
        values.append(_value(kind, payload[offset : offset + size]))
        offset += size
    if offset != len(payload):
        raise ValueError("the columns do not fill the record")
    return tuple(values)


def _value(kind: int, content: bytes) -> Value:
    if kind in (8, 9):
        return kind - 8
    if kind in _INTEGER_BYTES:
        return int.from_bytes(content, "big", signed=True)
    if kind >= 12:
        return content if kind % 2 == 0 else content.decode(errors="replace")
    return None
