"""Files and folders that appear complete or not at all: written next to their target, and renamed at the end.

Hosts and containers may share the folder. Unfinished files of a process are named by its machine and its process
number. Only processes of the same machine decide by the number whether that process is alive.
"""

from __future__ import annotations

import ctypes
import glob
import os
import platform
import shutil
import stat
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from errno import EDQUOT, EEXIST, ENOSPC, ENOTEMPTY
from functools import cache
from hashlib import sha256
from pathlib import Path
from time import time
from typing import Final

from mavnav.errors import OutputError

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2

LONGEST_NAME = 150
"""Longest name, in bytes, to which more is added: file systems allow 255."""

_OPEN: Final[set[Path]] = set()
"""The folders of unfinished files of this process, each of one thread."""

FOREIGN_S = 7 * 86400.0
"""Age of the last change after which unfinished files of another machine are removed."""


@contextmanager
def beside(target: Path, *, exclusive: bool = False) -> Iterator[Path]:
    """Yield a path for a file or folder that replaces ``target`` when the block ends without an error.

    The path has the target's own name, in a temporary folder next to it that is removed in any case. The folder that a
    killed process left is removed by the next call. The old content of ``target`` is replaced in one step, or kept if
    the block fails; a file never replaces a folder. Parent folders are created, and removed again if they stay empty.
    Raises OSError for errors of the disk, that of a full one with the name of a file, and FileExistsError with
    ``exclusive`` if another process has written the target in the meantime. A device, a FIFO or a stream of this
    process is written into at the end, not replaced.
    """
    if is_stream(target):
        with temporary_folder() as folder:
            yield folder / target.name
            _write_into(target, folder / target.name)
        return
    final = target.resolve()
    missing = [parent for parent in final.parents if not parent.exists()]
    thread = threading.current_thread()
    folder = _folder(final, os.getpid(), "" if thread is threading.main_thread() else f".{thread.ident}")
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        _clear_leftovers(final)
        _OPEN.add(folder)
        folder.mkdir()
        partial = folder / final.name
        yield partial
        sync_all(partial)
        if exclusive:
            _rename_unless_taken(partial, final)
        else:
            _put(partial, final)
        sync(final.parent)
    except OSError as error:
        if no_space(error) and error.filename is None:
            error.filename = str(final)
        raise
    finally:
        _remove(folder)
        _OPEN.discard(folder)
        for parent in missing:
            with suppress(OSError):  # not empty
                parent.rmdir()


def _put(partial: Path, final: Path) -> None:
    """Move a file or folder to its place; a folder that is there already, or comes in the meantime, is exchanged."""
    try:
        partial.replace(final)
    except OSError as error:
        if error.errno not in (ENOTEMPTY, EEXIST) or not partial.is_dir():
            raise
        _exchange(partial, final)


def is_stream(path: Path) -> bool:
    """Return whether a path is a character device, a FIFO, or stdout or stderr of this process (``/dev/stdout``)."""
    try:
        status = path.stat()
    except OSError:
        return False
    kind = status.st_mode
    return stat.S_ISCHR(kind) or stat.S_ISFIFO(kind) or _own_stream(status) is not None


def _own_stream(status: os.stat_result) -> int | None:
    """Return the number of the stream of this process that a file is; None if it is none."""
    for number in (1, 2):
        with suppress(OSError):  # a closed stream
            if os.path.samestat(status, os.fstat(number)):
                return number
    return None


def _write_into(stream: Path, content: Path) -> None:
    """Write a file into a stream; an own one is not opened again, which would write from its beginning."""
    own = _own_stream(stream.stat())
    try:
        for buffered in filter(None, (sys.stdout, sys.stderr)):
            buffered.flush()
        with content.open("rb") as file, stream.open("wb") if own is None else os.fdopen(os.dup(own), "wb") as sink:
            shutil.copyfileobj(file, sink)
    except OSError as error:
        error.filename = str(stream)
        raise


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a folder that is removed at the end; raises OutputError if it cannot be made, or its disk is full."""
    from tempfile import TemporaryDirectory  # noqa: PLC0415  few runs need it

    try:
        made = TemporaryDirectory(prefix="mavnav-", ignore_cleanup_errors=True)
    except OSError as error:
        raise OutputError(f"no temporary folder can be made: {error.strerror}; set TMPDIR to one with room") from error
    with made as name, naming_full_disk(Path(name)):
        yield Path(name)


@contextmanager
def naming_full_disk(folder: Path) -> Iterator[None]:
    """Raise OutputError that names the folder of temporary folders if the disk of ``folder``, one of them, is full."""
    try:
        yield
    except Exception as error:
        if _is_full(error, folder.resolve()):
            raise OutputError(f"the temporary folder {folder.parent} is full; set TMPDIR to another") from error
        raise


@contextmanager
def writing(path: Path, advice: str = "make room or name another") -> Iterator[None]:
    """Raise OutputError, with advice, where what is done within cannot write ``path``."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}; {advice}") from error


def check_name(path: Path) -> None:
    """Raise OutputError for a name that the system refuses, as one that is too long, or in a closed folder."""
    with writing(path, "choose a shorter name, or another folder"), suppress(FileNotFoundError, NotADirectoryError):
        path.lstat()


@contextmanager
def replacing(target: Path, *, force: bool, another: str, room: str) -> Iterator[Path]:
    """Yield a path as `beside` does; raises OutputError that says what to choose if ``target`` is there, or no room."""
    with writing(target, f"make room or choose {room}"):
        try:
            with beside(target, exclusive=not force) as partial:
                yield partial
        except FileExistsError as error:
            raise OutputError(f"{target} exists; choose {another}, or --force to replace it") from error


def no_space(error: BaseException) -> bool:
    """Return whether an error is that a disk is full, or a quota used up."""
    return isinstance(error, OSError) and error.errno in {ENOSPC, EDQUOT}


def _is_full(error: BaseException | None, folder: Path) -> bool:
    """Return whether an error or its cause is that a disk is full, and of no file outside of a folder."""
    while error is not None and not no_space(error):
        error = error.__cause__
    if not isinstance(error, OSError):
        return False
    names = [Path(os.fsdecode(name)) for name in (error.filename, error.filename2) if isinstance(name, str | bytes)]
    return not names or any(name.is_relative_to(folder) for name in names)


def _remove(folder: Path) -> None:
    """Remove a folder, even if signals interrupt that; the last exception of these is raised at the end."""
    stopped: BaseException | None = None
    for _ in range(5):
        try:
            shutil.rmtree(folder, ignore_errors=True)
            break
        except BaseException as error:  # Ctrl-C, again
            stopped = error
    if stopped is not None:
        raise stopped


def _rename_unless_taken(partial: Path, final: Path) -> None:
    """Rename a file or folder to its final name, unless that exists."""
    is_folder = partial.is_dir()
    try:
        if is_folder:
            partial.rename(final)  # an empty folder may be there
        else:
            final.hardlink_to(partial)
    except OSError as error:
        if error.errno in {EEXIST, ENOTEMPTY} or (not is_folder and os.path.lexists(final)):
            raise FileExistsError(EEXIST, "another process has written it meanwhile", str(final)) from error
        if is_folder:
            raise
        partial.replace(final)  # a file system without links


def discard(target: Path, pid: int) -> None:
    """Remove the unfinished files of a killed process next to ``target``."""
    shutil.rmtree(_folder(target.resolve(), pid), ignore_errors=True)


@contextmanager
def claim(target: Path) -> Iterator[bool]:
    """Reserve a name for a folder of this process; yields False where another process that runs has reserved it.

    The mark is a link beside the target. Where none can be made, the name is not reserved.
    """
    mark, owner = target.with_name(f".{_label(target)}.claim"), f"{machine()}-{os.getpid()}"
    missing = [parent for parent in target.parents if not parent.exists()]
    try:
        yield _mark(mark, owner)
    finally:
        with suppress(OSError):
            if mark.readlink() == Path(owner):
                mark.unlink()
        for parent in missing:
            with suppress(OSError):  # not empty, or not there
                parent.rmdir()


def _mark(mark: Path, owner: str) -> bool:
    """Make a link to the name of its owner; returns False where one of a process that may run is there."""
    with suppress(OSError):
        mark.parent.mkdir(parents=True, exist_ok=True)
        if mark.is_symlink():
            other, _, process = str(mark.readlink()).rpartition("-")
            if other == machine() and not (process.isdecimal() and _is_alive(int(process))):
                mark.unlink(missing_ok=True)
        try:
            mark.symlink_to(owner)
        except FileExistsError:
            return False
    return True


def short_name(name: str) -> str:
    """Return the beginning of a name to which more is added, at most ``LONGEST_NAME`` bytes."""
    while len(os.fsencode(name)) > LONGEST_NAME:
        name = name[:-1]
    return name


def _folder(final: Path, pid: int, thread: str = "") -> Path:
    return final.with_name(f".{_label(final)}{thread}.partial-{machine()}-{pid}")


def _label(final: Path) -> str:
    """Return the name of a target in the names of its unfinished files; a long name is replaced by its hash."""
    name = final.name
    return name if short_name(name) == name else sha256(os.fsencode(name)).hexdigest()


@cache
def machine() -> str:
    """Return a name of this machine among others that share the folder: hash of host, boot and container."""
    parts = [platform.node()]
    with suppress(OSError):
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
    with suppress(OSError):
        parts.append(str(Path("/proc/self/ns/pid").stat().st_ino))
    return sha256(" ".join(parts).encode()).hexdigest()[:12]


def _clear_leftovers(final: Path) -> None:
    """Remove the unfinished files of dead processes; restore a target that one of them had moved aside."""
    for folder in final.parent.glob(f".{glob.escape(_label(final))}.*-*-*"):
        kind, owner, number = folder.name.rsplit("-", 2)
        if not number.isdecimal() or not _is_left(folder, owner, int(number)):
            continue
        if kind.endswith(".replaced") and not final.exists():
            with suppress(OSError):  # another process was faster
                folder.rename(final)
        elif kind.endswith((".partial", ".replaced")):
            shutil.rmtree(folder, ignore_errors=True)


def _is_left(folder: Path, owner: str, process: int) -> bool:
    """Return whether the process of a folder is dead; one of this number that is not ours is left by a dead one."""
    if owner == machine():
        return folder not in _OPEN if process == os.getpid() else not _is_alive(process)
    with suppress(OSError):
        return time() - max(path.lstat().st_mtime for path in (folder, *folder.rglob("*"))) > FOREIGN_S
    return False


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _exchange(partial: Path, final: Path) -> None:
    """Replace a folder by another one, atomically where the system can, so that the name always exists."""
    if _swap_names(partial, final):
        return
    old = final.with_name(f".{_label(final)}.replaced-{machine()}-{os.getpid()}")
    final.rename(old)
    try:
        partial.rename(final)
    except BaseException:
        with suppress(OSError):
            old.rename(final)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _swap_names(one: Path, other: Path) -> bool:
    """Swap two names by Linux's renameat2; return whether that is possible."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    return int(rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE)) == 0


def sync_all(path: Path) -> None:
    """Write a file, or a folder with all its content, through to the disk."""
    for inner in sorted(path.iterdir()) if path.is_dir() else ():
        sync_all(inner)
    sync(path)


def sync(path: Path) -> None:
    """Write a file, or the entries of a directory, through to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
