"""Logs known by the SHA-256 of their file: one of a folder of copies, or fetched once into the cache and checked."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from msgspec import Struct

from mavnav.atomic_files import writing
from mavnav.batch.remote import fetch
from mavnav.errors import OutputError, UsageError
from mavnav.kernels.machine.cache import user_directory
from mavnav.outputs.directory import file_sha256
from mavnav.outputs.documents.addresses import public_address
from mavnav.profiling import Progress


class Pin(Struct, frozen=True):
    """The content of the file at an address: its SHA-256, in hexadecimal digits, and its size."""

    sha256: str
    size_bytes: int


def pinned_file(address: str, pin: Pin, copies: Path | None, progress: Progress) -> Path:
    """Return a file with the pinned content: one below the folder ``copies``, or that in the cache, fetched if need be.

    An interrupted download goes on at the next call. Raises UsageError for an address that cannot be read, or has
    other content, and OutputError if the cache cannot be written.
    """
    for path in _files_below(copies):
        if _has(path, pin):
            return path
    path = _cached(address, pin)
    if not _has(path, pin):
        _fetch_checked(address, pin, path, progress)
    return path


def _files_below(folder: Path | None) -> Iterator[Path]:
    if folder and not folder.is_dir():
        raise UsageError(f"{folder} is no folder; name that of your copies with --copies")
    yield from sorted(path for path in folder.rglob("*") if path.is_file()) if folder else ()


def _has(path: Path, pin: Pin) -> bool:
    return path.is_file() and path.stat().st_size == pin.size_bytes and file_sha256(path) == pin.sha256


def _cached(address: str, pin: Pin) -> Path:
    if (cache := user_directory()) is None:
        raise OutputError("no cache for logs is known; set MAVNAV_CACHE_DIR to an absolute path")
    return cache / "logs" / pin.sha256[:16] / Path(public_address(address)).name


def _fetch_checked(address: str, pin: Pin, path: Path, progress: Progress) -> None:
    """Download a file into the cache; one with other content is removed, one that is cut off is kept to go on with."""
    shown, part = public_address(address), path.with_name(f"{path.name}.part")
    phase, total_kb = f"fetching {path.name}, kB", pin.size_bytes // 1000
    with writing(part, "make room, or set MAVNAV_CACHE_DIR to another directory"):
        part.parent.mkdir(parents=True, exist_ok=True)
        progress(phase, 0, total_kb)
        fetch(address, part, pin.size_bytes, lambda there: progress(phase, there // 1000, total_kb))
        if (size := part.stat().st_size) < pin.size_bytes:
            what = f"it ended after {size} of {pin.size_bytes} bytes"
            raise UsageError(f"{shown}: {what}; the same call goes on from there")
        if (sha256 := file_sha256(part)) != pin.sha256:
            part.unlink()
            advice = "the file there was changed, or damaged on the way: try again, or give a copy with --copies"
            raise UsageError(f"{shown}: its SHA-256 is {sha256}, not {pin.sha256}; {advice}")
        part.replace(path)
