"""Reading of files named by a user or by another file: only regular files of a bounded size."""

from __future__ import annotations

import errno
import stat
from pathlib import Path
from typing import Any, Final

MAX_JSON_BYTES: Final = 1 << 28


def read_named(path: Path, max_bytes: int) -> bytes:
    """Return the content of a file.

    Raises OSError, with the reason in ``strerror``: the name is invalid, or the file is not readable, not a regular
    file, or larger than ``max_bytes``.
    """
    try:
        status = path.stat()
    except ValueError as error:  # a null byte or a lone surrogate in the name
        raise OSError(errno.EINVAL, "it is no name of a file") from error
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file")
    if status.st_size > max_bytes:
        raise OSError(errno.EFBIG, f"it is larger than {max_bytes} bytes")
    with path.open("rb") as file:
        return file.read(max_bytes)


def read_json(path: Path) -> Any:  # noqa: ANN401  any document
    """Return a JSON document; raises OSError as `read_named`, and ValueError for invalid or too deeply nested JSON."""
    from json import loads  # noqa: PLC0415  not every command reads JSON

    try:
        return loads(read_named(path, MAX_JSON_BYTES))
    except RecursionError:
        raise ValueError("it is nested too deep") from None


def what_is_wrong(error: Exception, otherwise: str) -> str:
    """Say of a document that it is no JSON, if that was the error of `read_json`, else the other text."""
    from json import JSONDecodeError  # noqa: PLC0415  not every command reads JSON

    return "is no JSON, or cut off" if isinstance(error, JSONDecodeError | UnicodeDecodeError) else otherwise
