"""Files that a person, or another file, names: regular ones of a bounded size, never a device or a pipe."""

from __future__ import annotations

import errno
import stat
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from pathlib import Path

MAX_JSON_BYTES: Final = 1 << 28


def read_named(path: Path, most_bytes: int) -> bytes:
    """Return the content of a file.

    Raises OSError, whose ``strerror`` says why: no name of a file, not readable, not a regular file, or
    larger than ``most_bytes``.
    """
    try:
        status = path.stat()
    except ValueError as error:  # a zero or half a character in the name
        raise OSError(errno.EINVAL, "it is no name of a file") from error
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file")
    if status.st_size > most_bytes:
        raise OSError(errno.EFBIG, f"it is larger than {most_bytes} bytes")
    with path.open("rb") as file:
        return file.read(most_bytes)


def read_json(path: Path) -> Any:  # noqa: ANN401  any document
    """Return a JSON document; raises OSError as `read_named`, and ValueError for what is none, or nested too deep."""
    from json import loads  # noqa: PLC0415  not every command reads one

    try:
        return loads(read_named(path, MAX_JSON_BYTES))
    except RecursionError:
        raise ValueError("it is nested too deep") from None
