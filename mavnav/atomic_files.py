"""Files and folders that appear complete or not at all: written beside their place, renamed at the end."""

from __future__ import annotations

import ctypes
import glob
import os
import shutil
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


@contextmanager
def beside(target: Path) -> Iterator[Path]:
    """Give a path for a file or folder that takes the place of ``target`` when the block ends well.

    The path has the target's own name, in a temporary folder next to it that is removed in any case; one that a killed
    process left is removed by the next. What was at ``target`` before is replaced in one step, or stays if the block
    fails; a file never takes the place of a folder. Parents are made. Raises OSError where the disk refuses.
    """
    final = target.resolve()
    final.parent.mkdir(parents=True, exist_ok=True)
    _clear_leftovers(final)
    folder = _folder(final, os.getpid())
    folder.mkdir()
    try:
        partial = folder / final.name
        yield partial
        sync_all(partial)
        if final.is_dir() and partial.is_dir():
            _exchange(partial, final)
        else:
            partial.replace(final)
        sync(final.parent)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def discard(target: Path, pid: int) -> None:
    """Remove what a process that was killed has left unfinished beside ``target``."""
    shutil.rmtree(_folder(target.resolve(), pid), ignore_errors=True)


def _folder(final: Path, pid: int) -> Path:
    return final.with_name(f".{final.name}.partial-{pid}")


def _clear_leftovers(final: Path) -> None:
    """Remove what processes that are no more have left, as after kill -9; bring back a target that one had set aside.

    The same number as this process's is that of a dead one.
    """
    for folder in final.parent.glob(f".{glob.escape(final.name)}.*-*"):
        kind, _, number = folder.name.rpartition("-")
        if not number.isdecimal() or (int(number) != os.getpid() and _is_alive(int(number))):
            continue
        if kind.endswith(".replaced") and not final.exists():
            folder.rename(final)
        elif kind.endswith((".partial", ".replaced")):
            shutil.rmtree(folder, ignore_errors=True)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _exchange(partial: Path, final: Path) -> None:
    """Let two folders swap their names, at once where the system can, so that the name is never without a folder."""
    if _swapped(partial, final):
        return
    old = final.with_name(f".{final.name}.replaced-{os.getpid()}")
    final.rename(old)
    try:
        partial.rename(final)
    except BaseException:
        with suppress(OSError):
            old.rename(final)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _swapped(one: Path, other: Path) -> bool:
    """Swap two names by Linux's renameat2; return whether that was possible."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    return int(rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE)) == 0


def sync_all(path: Path) -> None:
    """Bring a file, or a folder with all that is in it, to the disk."""
    for inner in sorted(path.iterdir()) if path.is_dir() else ():
        sync_all(inner)
    sync(path)


def sync(path: Path) -> None:
    """Bring a file, or the names in a directory, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
