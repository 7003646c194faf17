"""Files and folders that appear complete or not at all: written beside their place, renamed at the end."""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def beside(target: Path) -> Iterator[Path]:
    """Give a path for a file or folder that takes the place of ``target`` when the block ends well.

    The path has the target's own name, in a temporary folder next to it that is removed in any case. What was at
    ``target`` before is replaced, or stays if the block fails. Parents are made. Raises OSError where the disk says no.
    """
    final = target.resolve()
    final.parent.mkdir(parents=True, exist_ok=True)
    folder = _folder(final, os.getpid())
    shutil.rmtree(folder, ignore_errors=True)  # left by a killed process of the same number
    folder.mkdir()
    try:
        partial = folder / final.name
        yield partial
        sync(partial)
        _swap(partial, final)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def discard(target: Path, pid: int) -> None:
    """Remove what a process that was killed has left unfinished beside ``target``."""
    shutil.rmtree(_folder(target.resolve(), pid), ignore_errors=True)


def _folder(final: Path, pid: int) -> Path:
    return final.with_name(f".{final.name}.partial-{pid}")


def _swap(partial: Path, final: Path) -> None:
    """Put the new one in place of the old; an old folder comes back if that fails."""
    if not final.is_dir():
        partial.replace(final)
    else:
        old = final.with_name(f".{final.name}.replaced-{os.getpid()}")
        final.rename(old)
        try:
            partial.rename(final)
        except BaseException:
            with suppress(OSError):
                old.rename(final)
            raise
        shutil.rmtree(old, ignore_errors=True)
    sync(final.parent)


def sync(path: Path) -> None:
    """Bring a file, or the names in a directory, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
