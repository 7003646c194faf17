"""ROS 2 sqlite3 storage (``.db3``): tables ``topics`` and ``messages``, read in the order of the rows.

Layout: rosbag2_storage_sqlite3. The file is opened read-only and immutable, so that nothing is written beside it.
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from mavnav.logs.records import Channel, RawMessage, ros_type

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavnav.logs.ledger import Ledger

MAGIC = b"SQLite format 3\x00"

_TOPICS = "SELECT id, name, type, serialization_format FROM topics"
_MESSAGES = "SELECT topic_id, timestamp, data FROM messages NOT INDEXED ORDER BY rowid"
_COUNT_AT = 28


def read_sqlite(path: Path, ledger: Ledger) -> Iterator[RawMessage]:
    """Yield the messages of a .db3 file, in the order in which they were written, in constant memory.

    Rows are read without the index on their times. Where the file is cut or broken, the rows before are read and
    the rest is noted.
    """
    rows = 0
    try:
        with _whole(path, ledger) as whole, closing(_connect(whole)) as connection:
            channels = _channels(connection, ledger)
            for topic_id, log_ns, data in connection.execute(_MESSAGES):
                rows += 1
                channel = channels.get(topic_id)
                if channel is None or not isinstance(log_ns, int) or not isinstance(data, bytes):
                    ledger.damage("a message row is broken, or of an undeclared topic, and left out", path.name)
                    continue
                ledger.at(ledger.here_bytes + len(data))
                yield RawMessage(channel, log_ns, data)
    except sqlite3.Error as error:
        ledger.damage(f"sqlite cannot read on: {error}", f"{path.name}, after {rows} messages")


def _connect(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1", uri=True)


def _channels(connection: sqlite3.Connection, ledger: Ledger) -> dict[int, Channel]:
    return {
        number: ledger.declare(Channel(str(name), ros_type(str(kind)), str(encoding)))
        for number, name, kind, encoding in connection.execute(_TOPICS)
    }


@contextmanager
def _whole(path: Path, ledger: Ledger) -> Iterator[Path]:
    """Yield a path that sqlite agrees to open.

    It refuses a cut file as a whole, because the header tells more pages than there are: a copy whose header tells
    the truth lets the whole pages be read, and a row that reaches into the lost ones is an error, not zeros.
    Rows still in a write-ahead log are read from a copy as well.
    """
    page_bytes, pages = _page_size_and_count(path)
    size = path.stat().st_size
    cut = size < page_bytes * pages
    journal = path.with_name(path.name + "-wal")
    if not cut and not (journal.is_file() and journal.stat().st_size):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="mavnav-") as folder:
        copy = Path(folder) / path.name
        shutil.copyfile(path, copy)
        if cut:
            ledger.damage(f"the file is cut: {size} of {page_bytes * pages} bytes are there", path.name)
            _keep_whole_pages(copy, page_bytes, size // page_bytes)
        else:
            _merge_journal(copy, journal)
            ledger.warn(f"{path.name}: rows in its write-ahead log were read too (the recorder did not close the file)")
        yield copy


def _page_size_and_count(path: Path) -> tuple[int, int]:
    """Return what the header tells (https://sqlite.org/fileformat.html, 1.3): bytes 16 to 17 and 28 to 31."""
    with path.open("rb") as file:
        head = file.read(100)
    page = int.from_bytes(head[16:18], "big")
    return (65536 if page == 1 else page), int.from_bytes(head[_COUNT_AT : _COUNT_AT + 4], "big")


def _keep_whole_pages(copy: Path, page_bytes: int, pages: int) -> None:
    with copy.open("r+b") as file:
        file.truncate(page_bytes * pages)
        if pages:
            file.seek(_COUNT_AT)
            file.write(pages.to_bytes(4, "big"))


def _merge_journal(copy: Path, journal: Path) -> None:
    shutil.copyfile(journal, copy.with_name(copy.name + "-wal"))
    with closing(sqlite3.connect(copy)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
