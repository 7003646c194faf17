"""Random access to the bytes of a container: the file itself, or a decompressed chunk of it."""

from __future__ import annotations

import errno
import os
from typing import IO, Final

from msgspec import Struct, field

from mavnav.logs.formats.decompress import Allowance

MAGIC_WITHIN_BYTES: Final = 1 << 16
"""The magic of a format is searched in so many bytes: others may lie before it."""

BAG_MAGIC: Final = b"#ROSBAG V2.0\n"
OLD_BAG_MAGIC: Final = b"#ROSRECORD V1.2\n"
SQLITE_MAGIC: Final = b"SQLite format 3\x00"


class Source(Struct, frozen=True):
    """A sequence of records in a file or in memory.

    ``name`` is the prefix of positions in messages; the ``allowance`` limits the search for records.
    """

    file: IO[bytes]
    size: int
    name: str = ""
    allowance: Allowance = field(default_factory=Allowance)

    def read(self, offset: int, count: int) -> bytes:
        """Read ``count`` bytes, fewer at the end."""
        self.file.seek(offset)
        return self.file.read(min(count, max(self.size - offset, 0)))

    def next_data(self, offset: int) -> int:
        """Return the offset of the next data after a hole of a sparse file; ``offset`` itself if not in a hole."""
        try:
            descriptor = self.file.fileno()
        except OSError:
            return offset
        here = os.lseek(descriptor, 0, os.SEEK_CUR)
        try:
            return os.lseek(descriptor, offset, os.SEEK_DATA)
        except OSError as error:
            return self.size if error.errno == errno.ENXIO else offset
        finally:
            os.lseek(descriptor, here, os.SEEK_SET)  # the buffered file expects its old position

    def where(self, offset: int) -> str:
        """Return the text of a position for messages."""
        return f"{self.name}byte {offset}"
