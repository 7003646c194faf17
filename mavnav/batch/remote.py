"""Logs by their address: anything that fsspec can open, copied to a temporary folder while it is needed."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from mavnav.errors import UsageError
from mavnav.outputs.addresses import public_address, public_text

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def fetched(address: str) -> Iterator[Path]:
    """Give a folder in which the log lies under its address, taken as a path: that is how people know it.

    User name, password and query of the address are left out of that path, and of errors. Raises UsageError for what
    cannot be opened, and without fsspec.
    """
    path = Path(public_address(address))
    if ".." in path.parts:
        raise UsageError(f"{public_address(address)}: an address with '..'; write it out")
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
    except FileNotFoundError:
        raise UsageError(f"{public_address(address)}: there is no such file; check the address") from None
    except Exception as error:  # every protocol has errors of its own
        reason = public_text(str(error), address) or type(error).__name__
        advice = "check the address and the permissions"
        raise UsageError(f"{public_address(address)}: cannot be read ({reason}); {advice}") from None


def _fsspec() -> Any:  # noqa: ANN401  a module
    try:
        import fsspec  # noqa: PLC0415  an extra
    except ImportError as error:
        raise UsageError("logs by address need fsspec; install mavnav[cluster]") from error
    return fsspec
