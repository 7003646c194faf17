"""Decompression with a limit on the output size that does not depend on sizes declared in the data."""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

from mavnav.atomic_files import no_space, temporary_folder
from mavnav.logs.read_report import ReadReport

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAX_CHUNK_BYTES = 128 << 20
"""Maximum size of a chunk or message read into memory, in bytes; writers make chunks of 1 to 8 MiB."""

_MAX_RATIO = 1000
"""Maximum ratio of decompressed to compressed bytes of data outside of a log, besides the bytes that are free."""
_MAX_FILE_RATIO = 200
"""Maximum ratio of a whole log, or of a whole file, besides the bytes that every one may have."""
_SCANS_RATIO = 50
"""Maximum ratio of a chunk once these are used up; scans and poses compress by 2 to 20."""
_FREE_LOG_BYTES = 1 << 29
_FREE_RECORDS = 1_000_000
"""Decompressed bytes and records that every log may have, whatever its size."""
_MIN_RECORD_BYTES = 2
_FREE_BYTES = 1 << 20
_BLOCK_BYTES = 1 << 20
_PIECE_BYTES = 1 << 8
_MAX_WINDOW_BYTES = 1 << 27


TOO_MANY = "the chunk has more records than a log of this size can hold; the rest is left out"


class DecompressError(Exception):
    """Data cannot be decompressed, or they exceed the size limit."""


class Allowance:
    """Limits on the bytes and records of all chunks of a log: a MB can contain TB of zeros or millions of records.

    The limit holds for the whole log, because blank images compress by a factor of 10,000 and a limit per chunk would
    reject them. A chunk may use half of the records that are left, so that a hostile chunk does not use up all of them.
    """

    def __init__(self, log_bytes: int = 0) -> None:
        self.bytes_left = _FREE_LOG_BYTES + _MAX_FILE_RATIO * log_bytes
        self._records_left = _FREE_RECORDS + log_bytes // _MIN_RECORD_BYTES
        self._keep_records = 0

    def chunk_bytes(self, packed_bytes: int) -> int:
        """Return how many bytes a chunk may have: as many as are left, or what a chunk of scans has in any case."""
        return max(self.bytes_left, _SCANS_RATIO * packed_bytes)

    def begin_chunk(self) -> None:
        """Start a new chunk, which may use half of the records that are left."""
        self._keep_records = self._records_left // 2

    def spend_record(self, cost: int = 1) -> bool:
        """Subtract the cost of a record; return whether the record may be read."""
        self._records_left -= cost
        return self._records_left >= self._keep_records


def decompress(compression: str, data: bytes, allowance: Allowance | None = None) -> tuple[bytes, str | None]:
    """Decompress as much of the data as possible.

    Parameters
    ----------
    compression
        One of ``COMPRESSIONS``.
    data
        The compressed bytes, a whole number of frames.
    allowance
        Remaining limits of the log; None for data outside of a log.

    Returns
    -------
    unpacked, problem
        The bytes up to the end of the data or the first error, and the description of the error, None if there is
        none. A zstd frame that is cut between two blocks gives no error. Bytes after a frame that begin no other frame
        are skipped.

    Raises
    ------
    DecompressError
        Unknown compression, or a decompression bomb: over ``MAX_CHUNK_BYTES`` or the allowance, or, without an
        allowance, over 1 MiB plus 1000 times the size of the data.
    """
    if compression not in COMPRESSIONS:
        raise DecompressError(f"unknown compression {compression!r}")
    if compression not in FRAMES:
        return data, None
    most_bytes = allowance.chunk_bytes(len(data)) if allowance else _FREE_BYTES + _MAX_RATIO * len(data)
    limit = spent = min(MAX_CHUNK_BYTES, most_bytes)
    try:
        try:
            unpacked, problem = _decompress_sound(compression, data, limit), None
        except _errors_of_damage():
            unpacked, problem = _decompress_damaged(compression, data, limit)
        spent = len(unpacked)
    finally:
        if allowance:
            allowance.bytes_left -= spent
    return unpacked, problem


def _decompress_sound(compression: str, data: bytes, limit: int) -> bytes:
    """Decompress undamaged data, in large blocks; raises one of `_errors_of_damage` for others, as far as they show."""
    blocks: list[bytes] = []
    size = 0
    with FRAMES[compression].open_stream(BytesIO(data)) as stream:
        while block := stream.read(_BLOCK_BYTES):
            blocks.append(block)
            size += len(block)
            if size > limit:
                raise DecompressError(f"{len(data)} bytes of {compression} decompress to more than {limit}")
    return blocks[0] if len(blocks) == 1 else b"".join(blocks)


def _decompress_damaged(compression: str, data: bytes, limit: int) -> tuple[bytes, str | None]:
    """Decompress several frames or damaged data; byte by byte at the damage, so that all bytes before it are returned.

    A decompressor that fails on a longer piece does not return the bytes that it decompressed before the error.
    """
    unpacked, broken_at, problem = _decompress_pieces(compression, data, limit, len(data))
    if problem and broken_at < len(data):
        unpacked, _, problem = _decompress_pieces(compression, data, limit, broken_at)
    return unpacked, problem and f"{compression} data cannot be decompressed to their end ({problem})"


def _decompress_pieces(compression: str, data: bytes, limit: int, single_from: int) -> tuple[bytes, int, str | None]:
    """Return the decompressed bytes, the offset of the piece that fails, and the error; None if none fails.

    From offset ``single_from`` on the pieces are single bytes.
    """
    magics, make, _ = FRAMES[compression]
    decompressor, blocks, size, offset = make(), list[bytes](), 0, 0
    try:
        while offset < len(data):
            if decompressor.eof:
                if not data.startswith(magics, offset):
                    break
                decompressor = make()
            piece = data[offset : offset + (_PIECE_BYTES if offset < single_from else 1)]
            blocks.append(decompressor.decompress(piece))
            size += len(blocks[-1])
            if size > limit:
                raise DecompressError(f"{len(data)} bytes of {compression} decompress to more than {limit}")
            offset += len(piece) - len(decompressor.unused_data or b"")
    except _errors_of_damage() as error:
        return b"".join(blocks), offset, str(error)
    return b"".join(blocks), offset, None if decompressor.eof else "the data end before the stream does"


def _errors_of_damage() -> tuple[type[Exception], ...]:
    """Return the exceptions that damaged data raise; evaluated only after one, because few logs need zstandard."""
    import zstandard  # noqa: PLC0415

    return OSError, EOFError, RuntimeError, MemoryError, zlib.error, zstandard.ZstdError


def _zstd() -> Any:  # noqa: ANN401  (zstandard and lz4 are untyped here)
    import zstandard  # noqa: PLC0415

    return zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)


def _zstd_stream(file: IO[bytes]) -> Any:  # noqa: ANN401
    return _zstd().stream_reader(file, read_across_frames=True, closefd=False)


def _lz4() -> Any:  # noqa: ANN401
    import lz4.frame  # noqa: PLC0415

    return lz4.frame


class _Frames(NamedTuple):
    """The magic numbers of frames, and what makes a decompressor of one frame, or opens the content of a file."""

    magics: tuple[bytes, ...]
    make: Callable[[], Any]
    open_stream: Callable[[IO[bytes]], Any]


_SKIPPABLE = tuple(bytes([kind]) + b"\x2a\x4d\x18" for kind in range(0x50, 0x60))
FRAMES: Final[dict[str, _Frames]] = {
    "zstd": _Frames((ZSTD_MAGIC, *_SKIPPABLE), lambda: _zstd().decompressobj(), _zstd_stream),
    "lz4": _Frames(
        (b"\x04\x22\x4d\x18", *_SKIPPABLE), lambda: _lz4().LZ4FrameDecompressor(), lambda file: _lz4().open(file)
    ),
    "bz2": _Frames((b"BZh",), bz2.BZ2Decompressor, bz2.open),
}
"""Name of a compression -> its frames."""

COMPRESSIONS: Final = frozenset({"", "none", *FRAMES})
"""Names of the compressions of chunks; data of the first two are stored as they are."""


def unpack_message(data: bytes) -> bytes:
    """Decompress a message that was compressed individually (rosbag2, ``compression_mode: message``).

    No CDR message begins with the magic of zstd: its first byte is 0. Raises DecompressError.
    """
    if data[:4] != ZSTD_MAGIC:
        return data
    unpacked, problem = decompress("zstd", data)
    if problem:
        raise DecompressError(problem)
    return unpacked


def first_bytes(path: Path, packer: str, count: int) -> bytes:
    """Return the first ``count`` decompressed bytes of a file, fewer if it is damaged; ``packer`` is in ``PACKERS``."""
    head = b""
    with path.open("rb") as file:
        try:
            with PACKERS[packer][1](file) as stream:
                while len(head) < count and (block := stream.read1(_PIECE_BYTES)):
                    head += block
        except _errors_of_damage():
            pass
    return head[:count]


@contextmanager
def unpack_file(path: Path, packer: str, report: ReadReport) -> Iterator[Path]:
    """Decompress a file into a temporary one, deleted at the end; damaged data are reported and left out.

    Raises OutputError if the temporary folder is full.
    """
    limit = _MAX_FILE_RATIO * path.stat().st_size + MAX_CHUNK_BYTES
    with temporary_folder() as folder, path.open("rb") as packed:
        target = folder / path.stem
        size = 0
        with target.open("wb") as file, PACKERS[packer][1](packed) as stream:
            try:
                while size <= limit and (block := stream.read1(_PIECE_BYTES)):
                    size += file.write(block)
            except _errors_of_damage() as error:
                if no_space(error):
                    raise
                report.damage(f"{packer} data cannot be decompressed ({error})", f"{path.name}, after {size} bytes")
        if size > limit:
            report.damage(f"decompresses to more than {limit} bytes; the rest is not read", path.name)
        yield target


PACKERS: dict[str, tuple[bytes, Callable[[IO[bytes]], Any]]] = {
    "zstd": (ZSTD_MAGIC, _zstd_stream),
    "gzip": (b"\x1f\x8b\x08", gzip.open),
    "bzip2": (b"BZh", bz2.open),
}
"""Name of a program that compresses whole files -> the magic of its files, and a function that opens the content."""
