"""Decompression that never yields more than it is allowed to, whatever the data claim."""

from __future__ import annotations

import bz2
import tempfile
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mavnav.logs.ledger import Ledger

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAX_CHUNK_BYTES = 128 << 20
"""Largest chunk or message taken into memory; writers make chunks of 1 to 8 MiB."""

_MAX_RATIO = 1000
_FREE_BYTES = 1 << 20
_BLOCK_BYTES = 1 << 20
_CAREFUL_BYTES = 1 << 8
_MAX_WINDOW_BYTES = 1 << 27
_MAX_FILE_RATIO = 200


class UnpackError(Exception):
    """Data cannot be decompressed, or to far more than any log would."""


class _Incremental(Protocol):
    @property
    def eof(self) -> bool: ...
    @property
    def needs_input(self) -> bool: ...
    def decompress(self, data: bytes, max_length: int) -> bytes: ...


def unpack(compression: str, data: bytes) -> tuple[bytes, str | None]:
    """Decompress as much as there is.

    Parameters
    ----------
    compression
        A key of ``CODECS``.
    data
        The compressed bytes, a whole number of frames.

    Returns
    -------
    unpacked, problem
        What came before the data end or break, and in words why they do; None where they end well. A zstd frame that
        is cut between two blocks ends well.

    Raises
    ------
    UnpackError
        Unknown compression, or a bomb: more than a thousand times the data (and a MiB), or ``MAX_CHUNK_BYTES``.
    """
    if compression not in CODECS:
        raise UnpackError(f"unknown compression {compression!r}")
    unpacked, problem = _gather(compression, data, _BLOCK_BYTES)
    # What a broken block held before its break is got only by asking for less at a time.
    return (unpacked, None) if problem is None else _gather(compression, data, _CAREFUL_BYTES)


def _gather(compression: str, data: bytes, block_bytes: int) -> tuple[bytes, str | None]:
    limit = min(MAX_CHUNK_BYTES, _FREE_BYTES + _MAX_RATIO * len(data))
    blocks: list[bytes] = []
    size, problem = 0, None
    try:
        for block in CODECS[compression](data, block_bytes):
            blocks.append(block)
            size += len(block)
            if size > limit:
                raise UnpackError(f"{len(data)} bytes of {compression} decompress to more than {limit}")
    except (OSError, EOFError, RuntimeError, MemoryError, _zstd_error()) as error:
        problem = f"{compression} data cannot be decompressed to their end ({error})"
    return (blocks[0] if len(blocks) == 1 else b"".join(blocks)), problem


def _zstd_error() -> type[Exception]:
    import zstandard  # noqa: PLC0415

    error: type[Exception] = zstandard.ZstdError
    return error


def _plain(data: bytes, _block_bytes: int) -> Iterator[bytes]:
    yield data


def _zstd(data: bytes, block_bytes: int) -> Iterator[bytes]:
    import zstandard  # noqa: PLC0415

    decompressor = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
    with decompressor.stream_reader(BytesIO(data), read_size=block_bytes, read_across_frames=True) as stream:
        while block := stream.read(block_bytes):
            yield block


def _lz4(data: bytes, block_bytes: int) -> Iterator[bytes]:
    import lz4.frame  # noqa: PLC0415

    return _incremental(lz4.frame.LZ4FrameDecompressor(), data, block_bytes)


def _bz2(data: bytes, block_bytes: int) -> Iterator[bytes]:
    return _incremental(bz2.BZ2Decompressor(), data, block_bytes)


def _incremental(decompressor: _Incremental, data: bytes, block_bytes: int) -> Iterator[bytes]:
    offset = 0
    while not decompressor.eof:
        piece = b""
        if decompressor.needs_input:
            piece = data[offset : offset + block_bytes]
            offset += len(piece)
            if not piece:
                raise EOFError("the data end before the stream does")
        if block := decompressor.decompress(piece, max_length=block_bytes):
            yield block


CODECS: dict[str, Callable[[bytes, int], Iterator[bytes]]] = {
    "": _plain,
    "none": _plain,
    "zstd": _zstd,
    "lz4": _lz4,
    "bz2": _bz2,
}
"""Name of a compression -> the function from the data, and a number of bytes to ask for at a time, to blocks."""


def unpack_message(data: bytes) -> bytes:
    """Decompress a message that its recorder compressed by itself (rosbag2, ``compression_mode: message``).

    No CDR message begins like a zstd frame: its first byte is 0. Raises UnpackError.
    """
    if data[:4] != ZSTD_MAGIC:
        return data
    unpacked, problem = unpack("zstd", data)
    if problem:
        raise UnpackError(problem)
    return unpacked


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
                while size <= limit and (block := stream.read(_CAREFUL_BYTES)):
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
