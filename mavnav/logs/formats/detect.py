"""Detection of the format of a log by its first bytes, and the reader of each format."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from mavnav.atomic_files import short_name
from mavnav.logs.formats import rosbag2
from mavnav.logs.formats.decompress import PACKERS, first_bytes, unpack_file
from mavnav.logs.formats.mcap_records import MAGIC, find_record
from mavnav.logs.formats.source import BAG_MAGIC, MAGIC_WITHIN_BYTES, OLD_BAG_MAGIC, SQLITE_MAGIC, Source
from mavnav.logs.read_report import ReadReport
from mavnav.logs.records import RawMessage

UNKNOWN = "unknown"
SUFFIXES = (".mcap", ".bag", ".active", ".db3", ".clf", ".log", ".zst", ".zstd", ".gz", ".bz2")
"""Suffixes of log files; the content decides the format."""

_MOST_NAMED = 4
_AMBIGUOUS = (".log", ".gz", ".bz2")
_TAIL_BYTES = 16
_OLD_BAG = re.compile(rb"#ROS(?:BAG|RECORD|LOG) V(1\.[01])")
_HEADLESS_BYTES = 1 << 20
_STORAGE_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_PACKED = {magic: name for name, (magic, _) in PACKERS.items()}
_REFUSED = {b"\xfd7zXZ\0": "xz", b"\x04\x22\x4d\x18": "lz4", b"PK\x03\x04": "zip"}


def sniff(path: Path) -> str:
    """Return the name of the format of a file or folder by its content; ``UNKNOWN`` if no reader supports it.

    ``-zstd``, ``-gzip`` or ``-bzip2`` is appended if the whole file is compressed. A magic is accepted with a quarter
    of its bytes wrong, in the first 64 KiB, or at the end (MCAP). A CARMEN log is recognized by its first lines.
    """
    if path.is_dir():
        return _sniff_folder(path)
    name = _sniff_strictly(path)
    return _sniff_damaged(path) if name == UNKNOWN else name


def _sniff_strictly(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(MAGIC_WITHIN_BYTES)
    if packer := _name_of(head, _PACKED):
        inner = _sniff_head(first_bytes(path, packer, MAGIC_WITHIN_BYTES))
        return UNKNOWN if inner == UNKNOWN else f"{inner}-{packer}"
    return _sniff_head(head)


def _sniff_head(head: bytes) -> str:
    return _name_of(head, MAGICS) or ("carmen" if _module("carmen").is_carmen(head) else UNKNOWN)


def _sniff_damaged(path: Path) -> str:
    with path.open("rb") as file:
        source = Source(file, path.stat().st_size)
        head = source.read(0, MAGIC_WITHIN_BYTES)
        tail = source.read(max(source.size - _TAIL_BYTES, 0), _TAIL_BYTES)
        if _OLD_BAG.match(head) or _name_of(head, _PACKED | _REFUSED):
            return UNKNOWN
        for magic, name in MAGICS.items():
            wrong = sum(a != b for a, b in zip(magic, head, strict=False)) + max(len(magic) - len(head), 0)
            further = name != "rosbag2-sqlite3" and magic in head
            if wrong <= len(magic) // 4 or further or (name == "mcap" and tail.endswith(magic)):
                return name
        return _sniff_headless(path.suffix, Source(file, min(source.size, _HEADLESS_BYTES)), head)


def _sniff_headless(suffix: str, source: Source, head: bytes) -> str:
    """Recognize a log without its beginning by a later record; the suffix decides the kind of record."""
    if suffix == ".mcap" and find_record(source, 0) < source.size:
        return "mcap"
    if suffix in (".bag", ".active") and _module("rosbag1").OP_FIELD in head:
        return "rosbag1"
    if suffix == ".db3" and next(_module("sqlite_pages").rows(source), None) is not None:
        return "rosbag2-sqlite3"
    return UNKNOWN


def _sniff_folder(folder: Path) -> str:
    inner = next((sniff(file) for file in sorted(folder.iterdir()) if _is_storage(file)), UNKNOWN)
    if split_name(inner)[0] in ("rosbag2-sqlite3", "mcap"):
        return f"rosbag2-{inner.removeprefix('rosbag2-')}"
    if _is_split_bag1(folder):
        return "rosbag1"
    return "rosbag2" if (folder / rosbag2.METADATA).is_file() else UNKNOWN


def _is_split_bag1(folder: Path) -> bool:
    """Return whether a folder has parts of one ROS 1 bag, as ``rosbag record --split`` names them, and no other log."""
    files = [file for file in folder.iterdir() if _is_storage(file)]
    numbered = len({rosbag2.name_stem(file) for file in files}) == 1 and all(
        rosbag2.part_number(file) is not None for file in files
    )
    return len(files) > 1 and numbered and all(split_name(sniff(file))[0] == "rosbag1" for file in files)


def log_name(log: Path) -> str:
    """Return what a log is called in the names of directories: a folder as it is, a file without its suffixes.

    A link has its own name, not that of its target. Long names are cut, because more is added to them.
    """
    name = log.name if log.name not in ("", "..") else log.resolve().name
    if not log.is_dir():
        for suffix in reversed(SUFFIXES):
            name = name.removesuffix(suffix) or name
    return short_name(name)


def is_named_like_a_log(path: Path) -> bool:
    """Return whether a file has the suffix of a log; for an ambiguous suffix the content must be a log too."""
    return path.name.endswith(SUFFIXES) and (not path.name.endswith(_AMBIGUOUS) or sniff(path) != UNKNOWN)


def parts(path: Path, report: ReadReport, more: tuple[Path, ...] = ()) -> tuple[list[Path], rosbag2.Metadata | None]:
    """Return the files of a log in their order, and the metadata of a ROS 2 bag's folder.

    They are those of a folder, or the file itself and ``more`` parts of the same bag.
    """
    if not path.is_dir():
        return sorted({path, *more}, key=rosbag2.natural_key), None
    metadata = None if sniff(path) == "rosbag1" else rosbag2.read_metadata(path, report)
    return rosbag2.storage_files(path, report, _is_storage, metadata), metadata


def _is_storage(path: Path) -> bool:
    """Return whether a file of a folder is a log: by its content, or, if its beginning is damaged, also by its name."""
    if not path.is_file():
        return False
    return _sniff_strictly(path) != UNKNOWN or (path.name.endswith(_STORAGE_SUFFIXES) and sniff(path) != UNKNOWN)


def read(path: Path, report: ReadReport, more: tuple[Path, ...] = ()) -> Iterator[RawMessage]:
    """Yield the messages of a log and ``more`` parts of it, each file by its format's reader; raises UsageError."""
    files, metadata = parts(path, report, more)
    report.total_bytes = sum(file.stat().st_size for file in files)
    messages = 0
    for file in files:
        for message in _read_file(file, report):
            messages += 1
            yield message
        report.next_file(file.stat().st_size)
    if metadata is not None:
        rosbag2.compare(metadata, messages, {split_name(sniff(file))[0] for file in files}, report)


def _read_file(path: Path, report: ReadReport) -> Iterator[RawMessage]:
    name, packer = split_name(sniff(path))
    if packer:
        with unpack_file(path, packer, report) as inner:
            yield from _read_file(inner, report)
    elif name in READERS:
        module, reader = READERS[name]
        yield from getattr(_module(module), reader)(path, report)
    else:
        report.damage(refusal(path), path.name)


def _module(name: str) -> Any:  # noqa: ANN401
    """Import a module of a format, when a log needs it: most runs read one format."""
    return import_module(f"{__package__}.{name}")


def split_name(name: str) -> tuple[str, str]:
    """Split the name of a format into the format and the compression program, which is empty if there is none."""
    inner, _, packer = name.rpartition("-")
    return (inner, packer) if packer in PACKERS else (name, "")


def refusal(path: Path) -> str:
    """Return the message why a path is not read, and what to do."""
    if path.is_dir():
        return _folder_refusal(path)
    with path.open("rb") as file:
        head = file.read(MAGIC_WITHIN_BYTES)
    if not head:
        return "the file is empty"
    if old := _OLD_BAG.match(head):
        return f"a ROS 1 bag of format {old[1].decode()}; only 1.2 and 2.0 are read, convert it with `rosbag fix`"
    if packer := _name_of(head, _REFUSED):
        return f"compressed with {packer}, which is not read ({', '.join(PACKERS)} are); decompress it first"
    packer = _name_of(head, _PACKED)
    inside = first_bytes(path, packer, MAGIC_WITHIN_BYTES) if packer else head
    if known := next((text for pattern, text in OTHERS.items() if re.search(pattern, inside)), None):
        return known
    if packer:
        return f"compressed with {packer}, but the start of what is inside is no log, or does not decompress"
    return "not an MCAP file, ROS 1 bag, ROS 2 bag or CARMEN log"


def _folder_refusal(folder: Path) -> str:
    names = [file.name for file in sorted(folder.iterdir()) if _is_storage(file)]
    if not names:
        return "the folder holds no ROS 2 bag (no metadata.yaml, no .db3 or .mcap)"
    if len(names) > _MOST_NAMED:
        names[_MOST_NAMED - 1 :] = [f"{len(names) - _MOST_NAMED + 1} other logs"]
    *others, last = names
    listed = f"{', '.join(others)} and {last}; name one" if others else f"{last}; name it"
    return f"the folder holds {listed}, or use 'mavnav batch FOLDER'"


def _name_of(head: bytes, magics: Mapping[bytes, str]) -> str | None:
    """Return the name of the magic that the first bytes of a file are; None if they are none of these."""
    return next((name for magic, name in magics.items() if head.startswith(magic)), None)


MAGICS: dict[bytes, str] = {
    MAGIC: "mcap",
    BAG_MAGIC: "rosbag1",
    OLD_BAG_MAGIC: "rosbag1",
    SQLITE_MAGIC: "rosbag2-sqlite3",
}
READERS: dict[str, tuple[str, str]] = {
    "mcap": ("mcap_file", "read_mcap"),
    "rosbag1": ("rosbag1", "read_rosbag1"),
    "rosbag2-sqlite3": ("sqlite_file", "read_sqlite"),
    "carmen": ("carmen", "read_carmen"),
}
"""Format -> module and function of its reader, ``(Path, ReadReport) -> Iterator[RawMessage]``."""

_DRIVER = "replay it into the driver of the laser, and record its scans with `ros2 bag record`"
_RECORD = "record the LaserScan topic with `ros2 bag record`"
OTHERS: dict[bytes, str] = {
    rb"\A(?:\xd4\xc3\xb2\xa1|\xa1\xb2\xc3\xd4|\x4d\x3c\xb2\xa1)": f"a capture of network packets (pcap); {_DRIVER}",
    rb"\A\x0a\x0d\x0d\x0a": f"a capture of network packets (pcapng); {_DRIVER}",
    rb"\ARRF[0-9]": "a Rerun recording (.rrd), which is not read; replay the log that it was made of",
    rb"\AULog\x01\x12\x35": f"a flight log of PX4 (ULog), which has no laser scans; {_RECORD}",
    rb"\A(?:# )?\.PCD |\Aply\r?\n|\ALASF": f"a single cloud of points (PCD, PLY or LAS), not a log of scans; {_RECORD}",
    rb"\Arosbag2_bagfile_information:": "the description of a ROS 2 bag; name its folder",
    rb"\A\x89HDF\r\n\x1a\n": f"an HDF5 file, which is not read; {_RECORD}",
    rb"CObservation2DRangeScan|CSensoryFrame|CActionCollection": (
        "a rawlog of MRPT, which is not read; export it as CARMEN log with `rawlog-edit --export-2d-scans-txt`"
    ),
}
"""Patterns of the beginnings of unsupported files -> what they are, and what to do."""
