"""Decompression that never yields more than it is allowed to, whatever the data claim."""

from __future__ import annotations

import bz2
import gzip
import tempfile
import zlib
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mavnav.logs.read_report import ReadReport

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAX_CHUNK_BYTES = 128 << 20
"""Largest chunk or message taken into memory; writers make chunks of 1 to 8 MiB."""

_MAX_RATIO = 1000
_FREE_LOG_BYTES = 2 << 30
_FREE_RECORDS = 1_000_000
_LEAST_RECORD_BYTES = 2
_FREE_BYTES = 1 << 20
_BLOCK_BYTES = 1 << 20
_PIECE_BYTES = 1 << 8
_MAX_WINDOW_BYTES = 1 << 27
_MAX_FILE_RATIO = 200


TOO_MANY = "the chunk has more records than a log of this size can hold; the rest is left out"


class DecompressError(Exception):
    """Data cannot be decompressed, or to far more than any log would."""


class _Decompressor(Protocol):
    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes | None: ...
    def decompress(self, data: bytes) -> bytes: ...


class Allowance:
    """What the chunks of a log may yield in all: a megabyte can hold terabytes of zeros, or millions of records.

    Blank pictures compress ten thousandfold, so no single chunk has a bound of that kind. A chunk may have half of the
    records that are left, so that a hostile one does not cost the others.
    """

    def __init__(self, log_bytes: int = 0) -> None:
        self.bytes_left = _FREE_LOG_BYTES + _MAX_RATIO * log_bytes
        self._records_left = _FREE_RECORDS + log_bytes // _LEAST_RECORD_BYTES
        self._keep_records = 0

    def begin_chunk(self) -> None:
        """Let the records from here on be those of another chunk."""
        self._keep_records = self._records_left // 2

    def takes_record(self, cost: int = 1) -> bool:
        """Count a record of some cost; return whether it may be read."""
        self._records_left -= cost
        return self._records_left >= self._keep_records


def decompress(compression: str, data: bytes, allowance: Allowance | None = None) -> tuple[bytes, str | None]:
    """Decompress as much as there is.

    Parameters
    ----------
    compression
        A key of ``CODECS``.
    data
        The compressed bytes, a whole number of frames.
    allowance
        What the log may still yield; None for bytes by themselves.

    Returns
    -------
    unpacked, problem
        What came before the data end or break, and in words why they do; None where they end well. A zstd frame that
        is cut between two blocks ends well. Bytes behind a frame that are no other are passed over.

    Raises
    ------
    DecompressError
        Unknown compression, or a bomb: more than ``MAX_CHUNK_BYTES``, than the allowance, or, without one, than a MiB
        and a thousand times the data.
    """
    if compression not in CODECS:
        raise DecompressError(f"unknown compression {compression!r}")
    if compression not in FRAMES:
        return data, None
    most_bytes = allowance.bytes_left if allowance else _FREE_BYTES + _MAX_RATIO * len(data)
    limit = min(MAX_CHUNK_BYTES, most_bytes)
    try:
        unpacked, problem = _gather(compression, data, limit), None
    except (*_ERRORS, _zstd_error()):
        unpacked, problem = _carefully(compression, data, limit)
    if allowance:
        allowance.bytes_left -= len(unpacked)
    return unpacked, problem


def _gather(compression: str, data: bytes, limit: int) -> bytes:
    """Decompress sound data of one frame, in large blocks."""
    blocks: list[bytes] = []
    size = 0
    for block in CODECS[compression](data):
        blocks.append(block)
        size += len(block)
        if size > limit:
            raise DecompressError(f"{len(data)} bytes of {compression} decompress to more than {limit}")
    return blocks[0] if len(blocks) == 1 else b"".join(blocks)


def _carefully(compression: str, data: bytes, limit: int) -> tuple[bytes, str | None]:
    """Decompress data of several frames, or broken ones: byte by byte where they break, so that nothing before is lost.

    A decompressor that is given more at a time keeps to itself what came before the break.
    """
    unpacked, broken_at, problem = _in_pieces(compression, data, limit, len(data))
    if problem and broken_at < len(data):
        unpacked, _, problem = _in_pieces(compression, data, limit, broken_at)
    return unpacked, problem and f"{compression} data cannot be decompressed to their end ({problem})"


def _in_pieces(compression: str, data: bytes, limit: int, fine_from: int) -> tuple[bytes, int, str | None]:
    """Return what the data hold, and the offset of the piece that breaks and why; single bytes from ``fine_from``."""
    magics, make = FRAMES[compression]
    decompressor, blocks, size, offset = make(), list[bytes](), 0, 0
    try:
        while offset < len(data):
            if decompressor.eof:
                if not data.startswith(magics, offset):
                    break
                decompressor = make()
            piece = data[offset : offset + (_PIECE_BYTES if offset < fine_from else 1)]
            blocks.append(decompressor.decompress(piece))
            size += len(blocks[-1])
            if size > limit:
                raise DecompressError(f"{len(data)} bytes of {compression} decompress to more than {limit}")
            offset += len(piece) - len(decompressor.unused_data or b"")
    except (*_ERRORS, _zstd_error()) as error:
        return b"".join(blocks), offset, str(error)
    return b"".join(blocks), offset, None if decompressor.eof else "the data end before the stream does"


_ERRORS = (OSError, EOFError, RuntimeError, MemoryError)


def _zstd_error() -> type[Exception]:
    import zstandard  # noqa: PLC0415

    error: type[Exception] = zstandard.ZstdError
    return error


def _plain(data: bytes) -> Iterator[bytes]:
    yield data


def _zstd(data: bytes) -> Iterator[bytes]:
    import zstandard  # noqa: PLC0415

    decompressor = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
    with decompressor.stream_reader(BytesIO(data), read_size=_BLOCK_BYTES, read_across_frames=True) as stream:
        while block := stream.read(_BLOCK_BYTES):
            yield block


def _zstd_frame() -> _Decompressor:
    import zstandard  # noqa: PLC0415

    decompressor: _Decompressor = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES).decompressobj()
    return decompressor


def _lz4(data: bytes) -> Iterator[bytes]:
    return _incremental(_lz4_frame(), data)


def _lz4_frame() -> Any:  # noqa: ANN401  (lz4 is untyped here)
    import lz4.frame  # noqa: PLC0415

    return lz4.frame.LZ4FrameDecompressor()


def _bz2(data: bytes) -> Iterator[bytes]:
    return _incremental(bz2.BZ2Decompressor(), data)


def _incremental(decompressor: Any, data: bytes) -> Iterator[bytes]:  # noqa: ANN401
    """Yield blocks of one frame; raises EOFError where it is cut, or another follows."""
    piece = data
    while not decompressor.eof:
        if decompressor.needs_input and not piece:
            raise EOFError("the data end before the stream does")
        if block := decompressor.decompress(piece, max_length=_BLOCK_BYTES):
            yield block
        piece = b""
    if decompressor.unused_data:
        raise EOFError("more follows")


CODECS: dict[str, Callable[[bytes], Iterator[bytes]]] = {
    "": _plain,
    "none": _plain,
    "zstd": _zstd,
    "lz4": _lz4,
    "bz2": _bz2,
}
"""Name of a compression -> the function from sound data to blocks."""

_SKIPPABLE = tuple(bytes([kind]) + b"\x2a\x4d\x18" for kind in range(0x50, 0x60))
FRAMES: dict[str, tuple[tuple[bytes, ...], Callable[[], Any]]] = {
    "zstd": ((ZSTD_MAGIC, *_SKIPPABLE), _zstd_frame),
    "lz4": ((b"\x04\x22\x4d\x18", *_SKIPPABLE), _lz4_frame),
    "bz2": ((b"BZh",), bz2.BZ2Decompressor),
}
"""Name of a compression -> how its frames begin, and a new decompressor of one."""


def unpack_message(data: bytes) -> bytes:
    """Decompress a message that its recorder compressed by itself (rosbag2, ``compression_mode: message``).

    No CDR message begins like a zstd frame: its first byte is 0. Raises DecompressError.
    """
    if data[:4] != ZSTD_MAGIC:
        return data
    unpacked, problem = decompress("zstd", data)
    if problem:
        raise DecompressError(problem)
    return unpacked


def first_bytes(path: Path, packer: str, count: int) -> bytes:
    """Return the first decompressed bytes of a file, as far as it is sound; ``packer`` is a key of ``PACKERS``."""
    found = b""
    with path.open("rb") as file, suppress(*_file_errors(packer)), PACKERS[packer][1](file) as stream:
        while len(found) < count and (block := stream.read(_PIECE_BYTES)):
            found += block
    return found[:count]


@contextmanager
def unpacked_file(path: Path, packer: str, report: ReadReport) -> Iterator[Path]:
    """Decompress a file into a temporary one, deleted at the end; what is broken is noted and left out."""
    limit = _MAX_FILE_RATIO * path.stat().st_size + MAX_CHUNK_BYTES
    with tempfile.TemporaryDirectory(prefix="mavnav-") as folder, path.open("rb") as packed:
        target = Path(folder) / path.stem
        size = 0
        with target.open("wb") as file, PACKERS[packer][1](packed) as stream:
            try:
                while size <= limit and (block := stream.read(_PIECE_BYTES)):
                    size += file.write(block)
            except _file_errors(packer) as error:
                report.damage(f"{packer} data cannot be decompressed ({error})", f"{path.name}, after {size} bytes")
        if size > limit:
            report.damage(f"decompresses to more than {limit} bytes; the rest is not read", path.name)
        yield target


def _zstd_stream(file: IO[bytes]) -> Any:  # noqa: ANN401  (zstandard is untyped here)
    import zstandard  # noqa: PLC0415

    decompressor = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
    return decompressor.stream_reader(file, read_across_frames=True, closefd=False)


def _gzip_stream(file: IO[bytes]) -> gzip.GzipFile:
    return gzip.open(file)


def _bzip2_stream(file: IO[bytes]) -> bz2.BZ2File:
    return bz2.open(file)


def _file_errors(packer: str) -> tuple[type[BaseException], ...]:
    """Return what broken data raise; of zstd the library is loaded only where it is used."""
    others = (zlib.error, EOFError, OSError, MemoryError)
    return (_zstd_error(), *others) if packer == "zstd" else others


PACKERS: dict[str, tuple[bytes, Callable[[IO[bytes]], Any]]] = {
    "zstd": (ZSTD_MAGIC, _zstd_stream),
    "gzip": (b"\x1f\x8b\x08", _gzip_stream),
    "bzip2": (b"BZh", _bzip2_stream),
}
"""Name of a program that compresses whole files -> how they begin, and the stream of their content."""
