"""Logs by their address: anything that fsspec can open, copied to a temporary folder while it is needed."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from mavnav.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def fetched(address: str) -> Iterator[Path]:
    """Give a folder in which the log lies under its address, taken as a path: that is how people know it.

    Raises UsageError for what cannot be opened, and without fsspec.
    """
    path = Path(address)
    if ".." in path.parts:
        raise UsageError(f"{address}: an address with '..'; write it out")
    with TemporaryDirectory(prefix="mavnav-") as name:
        folder = Path(name)
        (folder / path).parent.mkdir(parents=True)
        _copy(address, folder / path)
        yield folder


def _copy(address: str, file: Path) -> None:
    """Copy what an address stands for, piece by piece."""
    try:
        with _fsspec().open(address, "rb") as source, file.open("wb") as copy:
            shutil.copyfileobj(source, copy, 2**20)
    except UsageError:
        raise
    except FileNotFoundError as error:
        raise UsageError(f"{address}: there is no such file; check the address") from error
    except Exception as error:  # every protocol has errors of its own
        reason = str(error) or type(error).__name__
        raise UsageError(f"{address}: cannot be read ({reason}); check the address and the permissions") from error


def _fsspec() -> Any:  # noqa: ANN401  a module
    try:
        import fsspec  # noqa: PLC0415  an extra
    except ImportError as error:
        raise UsageError("logs by address need fsspec; install mavnav[cluster]") from error
    return fsspec
