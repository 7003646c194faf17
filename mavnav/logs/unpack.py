"""Decompression that never yields more than it is allowed to, whatever the data claim."""

from __future__ import annotations

import bz2
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mavnav.logs.ledger import Ledger

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAX_CHUNK_BYTES = 256 << 20
"""Largest chunk or message taken into memory; writers make chunks of 1 to 8 MiB."""

_BLOCK_BYTES = 1 << 20
_MAX_WINDOW_BYTES = 1 << 27
_MAX_FILE_RATIO = 200


class UnpackError(Exception):
    """Data cannot be decompressed, or are more than they declare."""


class _Incremental(Protocol):
    @property
    def eof(self) -> bool: ...
    @property
    def needs_input(self) -> bool: ...
    def decompress(self, data: bytes, max_length: int) -> bytes: ...


def unpack(compression: str, data: bytes, limit_bytes: int) -> bytes:
    """Decompress a chunk.

    Parameters
    ----------
    compression
        A key of ``CODECS``.
    data
        The compressed bytes, a whole number of frames.
    limit_bytes
        The size that the container declares; the result may be shorter, never longer.

    Raises
    ------
    UnpackError
        Unknown compression, broken data, or more data than ``min(limit_bytes, MAX_CHUNK_BYTES)``.
    """
    codec = CODECS.get(compression)
    if codec is None:
        raise UnpackError(f"unknown compression {compression!r}")
    limit = min(limit_bytes, MAX_CHUNK_BYTES)
    unpacked = codec(data, limit)
    if len(unpacked) > limit:
        raise UnpackError(f"decompresses to more than {limit} bytes")
    return unpacked


def _plain(data: bytes, _limit: int) -> bytes:
    return data


def _zstd(data: bytes, limit: int) -> bytes:
    import zstandard  # noqa: PLC0415

    try:
        with zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES).stream_reader(
            data, read_across_frames=True
        ) as stream:
            return _gather(stream.read, limit)
    except (zstandard.ZstdError, MemoryError) as error:
        raise UnpackError(f"zstd data cannot be decompressed ({error})") from error


def _gather(read: Callable[[int], bytes], limit: int) -> bytes:
    """Read blocks until the end, or until more than ``limit`` is there."""
    blocks, size = [], 0
    while size <= limit and (block := read(min(_BLOCK_BYTES, limit + 1 - size))):
        blocks.append(block)
        size += len(block)
    return blocks[0] if len(blocks) == 1 else b"".join(blocks)


def _lz4(data: bytes, limit: int) -> bytes:
    import lz4.frame  # noqa: PLC0415

    try:
        return _incremental(lz4.frame.LZ4FrameDecompressor(), data, limit)
    except (RuntimeError, EOFError, MemoryError) as error:
        raise UnpackError(f"lz4 data cannot be decompressed ({error})") from error


def _bz2(data: bytes, limit: int) -> bytes:
    try:
        return _incremental(bz2.BZ2Decompressor(), data, limit)
    except (OSError, EOFError) as error:
        raise UnpackError(f"bz2 data cannot be decompressed ({error})") from error


def _incremental(decompressor: _Incremental, data: bytes, limit: int) -> bytes:
    source = data

    def read(size: int) -> bytes:
        nonlocal source
        while not decompressor.eof:
            if decompressor.needs_input and not source:
                raise EOFError("the data end before the stream does")
            block = decompressor.decompress(source, max_length=size)
            source = b""
            if block:
                return block
        return b""

    return _gather(read, limit)


CODECS: dict[str, Callable[[bytes, int], bytes]] = {
    "": _plain,
    "none": _plain,
    "zstd": _zstd,
    "lz4": _lz4,
    "bz2": _bz2,
}


def unpack_message(data: bytes) -> bytes:
    """Decompress a message that its recorder compressed by itself (rosbag2, ``compression_mode: message``).

    No CDR message begins like a zstd frame: its first byte is 0. Raises UnpackError.
    """
    return unpack("zstd", data, MAX_CHUNK_BYTES) if data[:4] == ZSTD_MAGIC else data


def first_bytes(path: Path, count: int) -> bytes:
    """Return the first decompressed bytes of a file compressed with zstd, none where it is broken."""
    import zstandard  # noqa: PLC0415

    with path.open("rb") as file:
        try:
            with _file_stream(file) as stream:
                return bytes(stream.read(count))
        except (zstandard.ZstdError, MemoryError):
            return b""


@contextmanager
def unpacked_file(path: Path, ledger: Ledger) -> Iterator[Path]:
    """Decompress a file into a temporary one, deleted at the end; what is broken is noted and left out."""
    import zstandard  # noqa: PLC0415

    limit = _MAX_FILE_RATIO * path.stat().st_size + MAX_CHUNK_BYTES
    with tempfile.TemporaryDirectory(prefix="mavnav-") as folder, path.open("rb") as packed:
        target = Path(folder) / path.stem
        size = 0
        with target.open("wb") as file, _file_stream(packed) as stream:
            try:
                while size <= limit and (block := stream.read(_BLOCK_BYTES)):
                    size += file.write(block)
            except (zstandard.ZstdError, MemoryError) as error:
                ledger.damage(f"zstd data cannot be decompressed ({error})", f"{path.name}, after {size} bytes")
        if size > limit:
            ledger.damage(f"decompresses to more than {limit} bytes; the rest is not read", path.name)
        yield target


def _file_stream(file: IO[bytes]) -> Any:  # noqa: ANN401  (zstandard is untyped here)
    import zstandard  # noqa: PLC0415

    decompressor = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
    return decompressor.stream_reader(file, read_across_frames=True, closefd=False)
