"""A log before its messages are read: whether it can be one at all, and by what its content is known."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from numbers import Real
from pathlib import Path
from typing import Final

from mavnav.errors import NoScansError, UsageError, lacks_memory, missing
from mavnav.logs.formats import detect
from mavnav.logs.formats.rosbag2 import METADATA, name_stem, part_number
from mavnav.logs.formats.source import Source
from mavnav.logs.read_report import ReadReport

_MOST_HOLES_BYTES: Final = 4 << 30
"""Holes take no space on the disk, but must be hashed as zeros; no recorder leaves any."""

_SEE: Final = "look at it with 'mavnav view', or measure it with 'mavnav metrics'"
FINISHED: Final = {
    "merge.json": f"merge; {_SEE}",
    "run.json": f"run; {_SEE}; 'mavnav replay --again' repeats it",
    "comparison.json": "comparison; look at it with 'mavnav view'",
    "batch.json": "batch; look at it with 'mavnav view'",
}
"""Documents of results, whose folders hold recordings that are no logs -> what they are of, and what to do."""

_MOST_EXTENTS: Final = 10_000
_MOST_NAMED: Final = 4
_ZEROS: Final = memoryview(bytes(1 << 16))


def check_log(
    path: Path, start_s: float | None = None, end_s: float | None = None, more: tuple[Path, ...] = ()
) -> None:
    """Raise UsageError or NoScansError for what shows at a glance: no such log, no log at all, an empty window."""
    check_files(path, more)
    check_window(start_s, end_s)
    with reading(path):
        if detect.sniff(path) == detect.UNKNOWN:
            raise NoScansError(f"{path}: no usable scans; {detect.refusal(path)}")


def check_files(path: Path, more: tuple[Path, ...]) -> None:
    """Raise what `check_file` does, and UsageError for files that are not named as the parts of one bag are."""
    files = path, *more
    for file in files:
        check_file(file)
    numbers = {None if file.is_dir() else part_number(file) for file in files}
    if more and (None in numbers or len({*map(name_stem, files)}) > 1 or len(numbers) < len(files)):
        named = f"{', '.join(file.name for file in files[:_MOST_NAMED])}{', ...' * (len(files) > _MOST_NAMED)}"
        advice = "run several logs with 'mavnav batch LOG ...', or name parts drive_0.mcap, drive_1.mcap and so on"
        raise UsageError(f"{named}: no parts of one bag by their names; {advice}")


def check_file(path: Path) -> None:
    """Raise UsageError where there is no file or folder, NoScansError where a file is hardly more than holes."""
    if not path.exists():
        raise UsageError(missing(path, "give the path of a log"))
    made = next((what for name, what in FINISHED.items() if (path / name).is_file()), None)
    if made and not (path / METADATA).is_file():
        raise UsageError(f"{path} is no log, but a finished {made}")
    if not (path.is_file() or path.is_dir()):
        raise UsageError(f"{path}: neither a file nor a folder; name a log, or pipe one into 'mavnav replay -'")
    if path.is_file() and (holes_bytes := _holes(path)) > _MOST_HOLES_BYTES:
        text = f"{holes_bytes / 1e9:.0f} GB of the file are holes that no recorder wrote"
        raise NoScansError(f"{path}: no usable scans; {text}; get a whole copy, or cut it with truncate")


def check_window(start_s: float | None, end_s: float | None) -> None:
    """Raise UsageError for ends of a window, s from the first usable scan, that are no times or out of order."""
    for name, value in (("--start", start_s), ("--end", end_s)):
        if value is not None and not (isinstance(value, Real) and isfinite(value) and value >= 0.0):
            raise UsageError(f"{name} {value!r} is no time; it counts in seconds from the first usable scan, 0 or more")
    if start_s is not None and end_s is not None and end_s <= start_s:
        raise UsageError(f"the window from {start_s:g} s to {end_s:g} s is empty; --end must be later than --start")


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise UsageError where the system cannot read a log, MemoryError where it lacks memory."""
    try:
        yield
    except OSError as error:
        if lacks_memory(error):
            raise MemoryError(str(error)) from error
        raise UsageError(f"{path}: cannot be read ({error.strerror}); check the file and its permissions") from error


def content_sha256(path: Path, more: tuple[Path, ...] = ()) -> str:
    """Return the SHA-256 by which a survey knows a log's content, without reading its messages; raises UsageError."""
    check_files(path, more)
    with reading(path):
        return size_and_sha256(path, more)[1]


def size_and_sha256(path: Path, more: tuple[Path, ...] = ()) -> tuple[int, str]:
    """Return size and SHA-256: of a file; of the parts of a bag, over the lines ``<sha256>  <name>`` of its files."""
    if path.is_file() and not more:
        return path.stat().st_size, _sha256(path)
    parts, _ = detect.parts(path, ReadReport(), more)
    files = sorted({*parts, *[f for f in [path / METADATA] if f.is_file()]}, key=lambda file: file.name)
    names = (file.name if more else file.relative_to(path) for file in files)
    lines = "".join(f"{_sha256(file)}  {name}\n" for file, name in zip(files, names, strict=True))
    return sum(file.stat().st_size for file in files), hashlib.sha256(lines.encode()).hexdigest()


def _sha256(path: Path) -> str:
    """Return the SHA-256 of a file; the zeros of its holes are not read, which would take longer than to count them."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        source = Source(file, path.stat().st_size)
        offset = 0
        while offset < source.size:
            data_at = min(source.next_data(offset), source.size)
            for at in range(offset, data_at, len(_ZEROS)):
                digest.update(_ZEROS[: data_at - at])
            digest.update(source.read(data_at, len(_ZEROS)))
            offset = data_at + len(_ZEROS)
    return digest.hexdigest()


def _holes(path: Path) -> int:
    """Count the bytes of a file before its end that the file system does not keep; 0 where few can be missing."""
    status = path.stat()
    if status.st_size - getattr(status, "st_blocks", status.st_size) * 512 <= _MOST_HOLES_BYTES:
        return 0
    holes_bytes, end = 0, 0
    with path.open("rb") as file:
        for _ in range(_MOST_EXTENTS):
            start = os.lseek(file.fileno(), end, os.SEEK_HOLE)
            end = Source(file, status.st_size).next_data(start)
            holes_bytes += end - start
            if end >= status.st_size:
                break
    return holes_bytes
