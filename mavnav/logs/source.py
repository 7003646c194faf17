"""Random access to the bytes of a container: the file itself, or a decompressed chunk of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import IO


@dataclass(frozen=True, slots=True)
class Source:
    """A run of records. ``name`` goes before a place when a person is told of it."""

    file: IO[bytes]
    size: int
    name: str = ""

    def read(self, offset: int, count: int) -> bytes:
        """Read ``count`` bytes, fewer at the end."""
        self.file.seek(offset)
        return self.file.read(min(count, max(self.size - offset, 0)))

    def where(self, offset: int) -> str:
        """Name a place for a person."""
        return f"{self.name}byte {offset}"
