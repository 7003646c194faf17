"""Files that a person, or another file, names: regular ones of a bounded size, never a device or a pipe."""

from __future__ import annotations

import errno
import stat
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def read_named(path: Path, most_bytes: int) -> bytes:
    """Return the content of a file.

    Raises OSError, whose ``strerror`` says why: not readable, not a regular file, or larger than ``most_bytes``.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file")
    with path.open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"it is larger than {most_bytes} bytes")
    return content
