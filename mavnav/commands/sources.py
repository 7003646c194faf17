"""Where a log comes from: a path, an address, or standard input (``-``)."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from mavnav.errors import MavnavError, UsageError

STDIN: Final = "-"


class LocalLog(NamedTuple):
    """A log as a file or folder, the address that it was fetched from, or ``-``, None for a path, and further parts."""

    path: Path
    address: str | None = None
    more: tuple[Path, ...] = ()

    @property
    def name(self) -> str:
        """What the log is called in documents and messages."""
        from mavnav.outputs.documents.addresses import public_address

        return str(self.path) if self.address is None else public_address(self.address)


@contextmanager
def local_log(sources: list[str]) -> Iterator[LocalLog]:
    """Yield a log by its path, those of its parts, or an address or ``-``, of which a copy is kept while it is needed.

    Errors contain the address in place of the temporary path. Raises UsageError if there is nothing to be read.
    """
    source, *more = sources
    if more and any(each == STDIN or "://" in each for each in sources):
        raise UsageError("parts of a log are files; fetch what lies elsewhere, or run several logs with mavnav batch")
    if source == STDIN:
        from tempfile import TemporaryDirectory

        with TemporaryDirectory(prefix="mavnav-") as made, _named(LocalLog(Path(made) / "stdin", STDIN)) as log:
            _copy_stdin(log.path)
            yield log
    elif "://" in source:
        from mavnav.batch.remote import download
        from mavnav.outputs.documents.addresses import public_address

        with download(source) as folder, _named(LocalLog(folder / public_address(source), source)) as log:
            yield log
    else:
        yield LocalLog(Path(source), more=tuple(map(Path, more)))


@contextmanager
def _named(log: LocalLog) -> Iterator[LocalLog]:
    """Replace the temporary path of a log in errors."""
    try:
        yield log
    except MavnavError as error:
        error.args = (str(error).replace(str(log.path), log.name),)
        raise


def _copy_stdin(path: Path) -> None:
    from shutil import copyfileobj

    if sys.stdin is None or sys.stdin.isatty():
        raise UsageError("-: no log on standard input; write mavnav replay - < drive.mcap, or name a log")
    with path.open("wb") as file:
        copyfileobj(sys.stdin.buffer, file)
