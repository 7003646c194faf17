"""Reader of ROS 2 sqlite3 storage (``.db3``): tables ``topics`` and ``messages``, in the order of the rows.

Layout: rosbag2_storage_sqlite3. The file is opened read-only and immutable, so that sqlite writes no file next to it.
Rows that sqlite cannot reach are read directly from the pages.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from errno import ENOSPC
from pathlib import Path
from urllib.parse import quote

from msgspec import field

from mavnav.atomic_files import temporary_folder
from mavnav.logs.formats.decompress import MAX_CHUNK_BYTES
from mavnav.logs.formats.source import SQLITE_MAGIC, ReaderState, Source, channel_of, with_known_type
from mavnav.logs.formats.sqlite_pages import page_size, rows
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import QOS, Channel, RawMessage, Schema, ros_type

_TABLES = """SELECT name FROM sqlite_master WHERE type = 'table' AND sql NOT LIKE '%VIRTUAL%'
AND name IN ('topics', 'messages', 'message_definitions')"""
_TOPICS = "SELECT id, name, type, serialization_format, {} FROM topics"
_HAS_QOS = "SELECT count(*) FROM pragma_table_info('topics') WHERE name = 'offered_qos_profiles'"
_DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
_COMPUTED = """SELECT m.name, c.name FROM sqlite_master AS m, pragma_table_xinfo(m.name) AS c
WHERE m.name IN ('topics', 'messages', 'message_definitions') AND c.hidden > 1"""
_MESSAGES = "SELECT rowid, topic_id, timestamp, data FROM messages NOT INDEXED ORDER BY rowid"
_COUNT_AT = 28
_JOURNALS = ("-wal", "-journal")
_NO_END = 1 << 63
_WAL_MAGIC = b"\x37\x7f\x06"
_WAL_HEAD_BYTES = 32
_FRAME_HEAD_BYTES = 24


class _DatabaseState(ReaderState, kw_only=True):
    """Channels read so far, and in ``missing`` the row numbers that sqlite did not return."""

    path: Path
    schemas: dict[str, Schema] = field(default_factory=dict)
    missing: list[range] = field(default_factory=list)
    last: int = 0


def read_sqlite(path: Path, report: ReadReport) -> Iterator[RawMessage]:
    """Yield the messages of a .db3 file, in the order in which they were written, in constant memory.

    Rows are read without the index on their times. If sqlite fails, or row numbers are missing, the remaining rows are
    searched for in the pages. Losses are reported.
    """
    with _readable_file(path, report) as whole:
        state = _DatabaseState(report, path=path)
        try:
            yield from _rows(whole, state)
        except (sqlite3.Error, UnicodeError) as error:
            report.damage(f"sqlite cannot read on: {error}", f"{path.name}, after {state.messages} messages")
            state.missing.append(range(state.last + 1, _NO_END))
        if state.missing:
            yield from _recover_messages(whole, state)


def _connect(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1", uri=True)
    connection.text_factory = lambda content: content.decode(errors="replace")
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
    return connection


def _rows(path: Path, state: _DatabaseState) -> Iterator[RawMessage]:
    with closing(_connect(path)) as connection:
        tables = {name for (name,) in connection.execute(_TABLES)}
        if not {"topics", "messages"} <= tables:
            raise sqlite3.DatabaseError("there are no tables of messages and topics")
        if computed := connection.execute(_COMPUTED).fetchone():
            raise sqlite3.DatabaseError(f"the column {computed[1]} of {computed[0]} is computed; recorders store it")
        if "message_definitions" in tables:
            state.schemas = _schemas(connection, state)
        (has_qos,) = connection.execute(_HAS_QOS).fetchone()
        for row in connection.execute(_TOPICS.format("offered_qos_profiles" if has_qos else "NULL")):
            _declare(row, state)
        for number, topic_id, log_ns, data in connection.execute(_MESSAGES):
            if number <= state.last:
                raise sqlite3.DatabaseError(f"row {number} comes after row {state.last}; its pages form a loop")
            if number > state.last + 1:
                state.missing.append(range(state.last + 1, number))
            state.last = number
            state.messages += 1
            yield from _message(topic_id, log_ns, data, state)


def _schemas(connection: sqlite3.Connection, state: _DatabaseState) -> dict[str, Schema]:
    """Return the definitions of message types by name; recorders before ROS 2 Iron store none."""
    try:
        definitions = connection.execute(_DEFINITIONS).fetchall()
    except sqlite3.Error as error:
        state.report.damage(f"the definitions of messages cannot be read: {error}", state.path.name)
        return {}
    return {str(name): Schema(str(name), str(encoding), str(text).encode()) for name, encoding, text in definitions}


def _declare(row: tuple[object, ...], state: _DatabaseState) -> None:
    """Declare the channel of a topic; report a topic without a name."""
    number, name, kind, encoding, qos = row
    if isinstance(number, int) and isinstance(name, str):
        kind, encoding = ("" if text is None else str(text) for text in (kind, encoding))
        metadata = ((QOS, qos),) if isinstance(qos, str) and qos else ()
        channel = Channel(name, ros_type(kind), encoding, state.schemas.get(kind, Schema(kind)), metadata)
        state.channels[number] = state.report.declare(channel)
    else:
        state.report.damage(f"topic {number} has no name", state.path.name)


def _message(topic_id: object, log_ns: object, data: object, state: _DatabaseState) -> Iterator[RawMessage]:
    """Yield the message of a row; one of an undeclared topic, marked as suspect, only if its bytes are a LaserScan."""
    number = topic_id if isinstance(topic_id, int) else -1
    channel = state.channels.get(number)
    suspect = channel is None
    if isinstance(data, bytes) and channel is None:
        channel = channel_of(data, f"/topic_{topic_id}", state.report)
    elif isinstance(data, bytes) and channel is not None:
        channel = state.channels[number] = with_known_type(channel, data, state.path.name, state.report)
    if suspect or not isinstance(log_ns, int) or not isinstance(data, bytes):
        state.report.damage("a message row is broken, or of an undeclared topic", state.path.name)
    if channel is not None and isinstance(log_ns, int) and isinstance(data, bytes):
        state.report.here_bytes += len(data)
        yield RawMessage(channel, log_ns, data, suspect)


def _recover_messages(path: Path, state: _DatabaseState) -> Iterator[RawMessage]:
    """Yield the messages of missing rows that are found in the pages, marked as suspect."""
    with path.open("rb") as file:
        source = Source(file, path.stat().st_size)
        if not state.channels:
            _recover_channels(source, state)
        count, seen = 0, set()
        for number, (_, topic_id, log_ns, data, *_) in rows(source):
            missing = any(number in gap for gap in state.missing)
            if missing and isinstance(data, bytes) and number not in seen:
                seen.add(number)
                for message in _message(topic_id, log_ns, data, state):
                    count += 1
                    yield message._replace(suspect=True)
    lost = sum(len(gap) for gap in state.missing if gap.stop != _NO_END) - count
    if count:
        state.report.damage(f"{count} messages were read from the pages themselves, and are suspect", state.path.name)
    elif lost > 0:
        state.report.warn(f"{state.path.name}: {lost} row numbers are not in use, as after rows were deleted")


def _recover_channels(source: Source, state: _DatabaseState) -> None:
    for number, (_, name, kind, encoding, *_) in rows(source):
        if isinstance(encoding, str) and "/" in str(kind):
            channel = Channel(str(name), ros_type(str(kind)), encoding, Schema(str(kind)))
            state.channels[number] = state.report.declare(channel)


@contextmanager
def _readable_file(path: Path, report: ReadReport) -> Iterator[Path]:
    """Yield the path of the file, or of a repaired temporary copy, that sqlite can open.

    sqlite refuses a cut file, because its header counts more pages than there are. In the copy the header has the
    correct number: complete pages can be read, and a row that reaches into lost pages is an error instead of zeros.
    Rows in a write-ahead log are read from a copy as well, and an unfinished transaction is rolled back.
    """
    place = path.resolve()  # of a link, journals are beside its target
    beside = [place.with_name(place.name + suffix) for suffix in _JOURNALS]
    journals = [journal for journal in beside if journal.is_file() and journal.stat().st_size > 0]
    with path.open("rb") as file:
        head = file.read(_COUNT_AT + 4)
    if not journals and head.startswith(SQLITE_MAGIC) and path.stat().st_size >= _declared_bytes(head):
        yield path
        return
    with temporary_folder() as folder:
        copy = folder / place.name
        shutil.copyfile(place, copy)
        _repair_magic(copy, report)
        for journal in journals:
            _apply_journal(copy, journal, report)
        _keep_whole_pages(copy, report)
        yield copy


def _declared_bytes(head: bytes) -> int:
    """Return the size of the file by its header, which has the number of pages (sqlite.org/fileformat.html, 1.3.8)."""
    return page_size(head) * int.from_bytes(head[_COUNT_AT : _COUNT_AT + 4], "big")


def _repair_magic(copy: Path, report: ReadReport) -> None:
    with copy.open("r+b") as file:
        if file.read(len(SQLITE_MAGIC)) != SQLITE_MAGIC:
            report.damage("the file does not begin with the magic of sqlite", copy.name)
            file.seek(0)
            file.write(SQLITE_MAGIC)


def _apply_journal(copy: Path, journal: Path, report: ReadReport) -> None:
    """Apply a write-ahead log or rollback journal, left by a recorder that did not close the file, to the copy."""
    shutil.copyfile(journal, copy.parent / journal.name)
    try:
        with closing(sqlite3.connect(copy)) as connection:
            _, taken, _ = connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        if (written := _frames(journal)) > taken >= 0:
            text = f"{written - taken} of the {written} pages in {journal.name} are broken, or of no finished write"
            report.damage(f"{text}; they are left out", copy.name)
        report.warn(f"{copy.name}: {journal.name} beside it was read too (the recorder did not close the file)")
    except sqlite3.Error as error:
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL:
            raise OSError(ENOSPC, os.strerror(ENOSPC), str(copy)) from error
        report.damage(f"{journal.name} beside it cannot be read: {error}", copy.name)
        with suppress(OSError):
            (copy.parent / journal.name).unlink()


def _frames(wal: Path) -> int:
    """Return the number of pages, complete or cut, in a write-ahead log; 0 for another file (fileformat.html, 4).

    Frames that remain from before the last reset of the log have other salts than its header, and are not counted.
    """
    with wal.open("rb") as file:
        head = file.read(_WAL_HEAD_BYTES)
        if head[:3] != _WAL_MAGIC or len(head) < _WAL_HEAD_BYTES:
            return 0
        frame_bytes = _FRAME_HEAD_BYTES + int.from_bytes(head[8:12], "big")
        count = 0
        while file.read(_FRAME_HEAD_BYTES)[8:16] == head[16:24]:
            count += 1
            file.seek(_WAL_HEAD_BYTES + count * frame_bytes)
    return count


def _keep_whole_pages(copy: Path, report: ReadReport) -> None:
    size = copy.stat().st_size
    with copy.open("r+b") as file:
        head = file.read(_COUNT_AT + 4)
        if size >= (declared := _declared_bytes(head)):
            return
        report.damage(f"the file is cut: {size} of {declared} bytes are there", copy.name)
        if whole := size // page_size(head):
            file.seek(_COUNT_AT)
            file.write(whole.to_bytes(4, "big"))
