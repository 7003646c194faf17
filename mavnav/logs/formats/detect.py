"""Which format a path is, by its first bytes, and the reader of each."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from mavnav.logs.formats import mcap_file, mcap_records, rosbag1, rosbag1_records, sqlite_file, sqlite_pages
from mavnav.logs.formats.decompress import ZSTD_MAGIC, first_bytes, unpacked_file
from mavnav.logs.formats.rosbag2 import METADATA, compare_count, read_metadata, storage_files
from mavnav.logs.formats.source import Source

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from mavnav.logs.read_report import ReadReport
    from mavnav.logs.records import RawMessage

UNKNOWN = "unknown"
_HEAD_BYTES = 16
_OLD_BAG = re.compile(rb"#ROS(?:BAG|RECORD|LOG) V(1\.[01])")
_SEARCH_BYTES = 1 << 16
_HEADLESS_BYTES = 1 << 20
_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_PACKERS = {
    b"\x1f\x8b\x08": "gzip",
    b"BZh": "bzip2",
    b"\xfd7zXZ\0": "xz",
    b"\x04\x22\x4d\x18": "lz4",
    b"PK\x03\x04": "zip",
}
_STORAGES = {"rosbag2-sqlite3": "rosbag2-sqlite3", "mcap": "rosbag2-mcap"}


def sniff(path: Path) -> str:
    """Name the format of a file or folder by its content; ``UNKNOWN`` where it is no log that is read here.

    ``-zstd`` is appended where the whole file is compressed with zstd. A magic of which a quarter is wrong, or that
    stands a little further on, or at the end (MCAP), will do.
    """
    if path.is_dir():
        return _sniff_folder(path)
    name = _sniff_strictly(path)
    return _sniff_damaged(path) if name == UNKNOWN else name


def _sniff_strictly(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if head.startswith(ZSTD_MAGIC):
        inner = _sniff_head(first_bytes(path, _HEAD_BYTES))
        return UNKNOWN if inner == UNKNOWN else f"{inner}-zstd"
    return _sniff_head(head)


def _sniff_head(head: bytes) -> str:
    return next((name for magic, name in MAGICS.items() if head.startswith(magic)), UNKNOWN)


def _sniff_damaged(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(_SEARCH_BYTES)
        file.seek(max(path.stat().st_size - _HEAD_BYTES, 0))
        tail = file.read()
    if _OLD_BAG.match(head) or _packer(head):
        return UNKNOWN
    for magic, name in MAGICS.items():
        wrong = sum(a != b for a, b in zip(magic, head, strict=False)) + max(len(magic) - len(head), 0)
        further = name != "rosbag2-sqlite3" and magic in head
        if wrong <= len(magic) // 4 or further or (name == "mcap" and tail.endswith(magic)):
            return name
    return _sniff_headless(path, head)


def _sniff_headless(path: Path, head: bytes) -> str:
    """Recognise a log whose beginning is lost by what follows, where its name says what to look for."""
    with path.open("rb") as file:
        source = Source(file, min(path.stat().st_size, _HEADLESS_BYTES))
        if path.suffix == ".mcap" and mcap_records.find_record(source, 0) < source.size:
            return "mcap"
        if path.suffix in (".bag", ".active") and rosbag1_records.OP_FIELD in head:
            return "rosbag1"
        if path.suffix == ".db3" and next(sqlite_pages.rows(source), None) is not None:
            return "rosbag2-sqlite3"
    return UNKNOWN


def _sniff_folder(folder: Path) -> str:
    inner = next((sniff(file) for file in sorted(folder.iterdir()) if _is_storage(file)), UNKNOWN)
    storage, packed, _ = inner.partition("-zstd")
    if storage in _STORAGES:
        return _STORAGES[storage] + packed
    return "rosbag2" if (folder / METADATA).is_file() else UNKNOWN


def parts(path: Path, report: ReadReport) -> list[Path]:
    """Return the files of a log in their order: those of a ROS 2 bag's folder, or the file itself."""
    return storage_files(path, report, _is_storage, read_metadata(path, report)) if path.is_dir() else [path]


def _is_storage(path: Path) -> bool:
    """Tell whether a file of a folder is a log: by its content, or by its name where its beginning is broken."""
    if not path.is_file():
        return False
    named = any(path.name.endswith(suffix) for suffix in _SUFFIXES)
    return _sniff_strictly(path) != UNKNOWN or (named and sniff(path) != UNKNOWN)


def read(path: Path, report: ReadReport) -> Iterator[RawMessage]:
    """Yield the messages of a log, file after file, each by the reader of its format. Raises UsageError."""
    metadata = read_metadata(path, report) if path.is_dir() else None
    files = storage_files(path, report, _is_storage, metadata) if path.is_dir() else [path]
    report.total_bytes = sum(file.stat().st_size for file in files)
    messages = 0
    for file in files:
        for message in _read_file(file, report):
            messages += 1
            yield message
        report.next_file(file.stat().st_size)
    if metadata is not None:
        compare_count(metadata, messages, report)


def _read_file(path: Path, report: ReadReport) -> Iterator[RawMessage]:
    reader = READERS.get(sniff(path))
    if reader is None:
        report.damage(refusal(path), path.name)
        return
    yield from reader(path, report)


def _read_zstd(path: Path, report: ReadReport) -> Iterator[RawMessage]:
    with unpacked_file(path, report) as inner:
        yield from _read_file(inner, report)


def refusal(path: Path) -> str:
    """Say why a path is not read, and what to do."""
    if path.is_dir():
        return "the folder holds no ROS 2 bag (no metadata.yaml, no .db3 or .mcap)"
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if not head:
        return "the file is empty"
    if old := _OLD_BAG.match(head):
        return f"a ROS 1 bag of format {old[1].decode()}; only 1.2 and 2.0 are read, convert it with `rosbag fix`"
    if packer := _packer(head):
        return f"compressed with {packer}, which is not read (only zstd is); decompress it first"
    if head.startswith(ZSTD_MAGIC):
        return "compressed with zstd, but the start of what is inside is no log, or does not decompress"
    return "not an MCAP file, ROS 1 bag or ROS 2 bag"


def _packer(head: bytes) -> str | None:
    return next((name for magic, name in _PACKERS.items() if head.startswith(magic)), None)


MAGICS: dict[bytes, str] = {
    mcap_records.MAGIC: "mcap",
    rosbag1.MAGIC: "rosbag1",
    rosbag1.OLD_MAGIC: "rosbag1",
    sqlite_file.MAGIC: "rosbag2-sqlite3",
}
READERS: dict[str, Callable[[Path, ReadReport], Iterator[RawMessage]]] = {
    "mcap": mcap_file.read_mcap,
    "rosbag1": rosbag1.read_rosbag1,
    "rosbag2-sqlite3": sqlite_file.read_sqlite,
    "mcap-zstd": _read_zstd,
    "rosbag1-zstd": _read_zstd,
    "rosbag2-sqlite3-zstd": _read_zstd,
}
