"""The disk cache of machine code: one file per kernel, named by the hash of its sources, with a checksum.

It is in ``MAVNAV_CACHE_DIR``, else the user's cache directory. If that cannot be written, new entries go to a private
temporary directory, which child processes share and which is removed at the end; a cache that can only be read is still
used. Its entries are run: only those count that nobody but this user and root could write. A relative path, as of
``~`` without a home directory, names a folder of whoever made the working directory, and is never used.
"""

from __future__ import annotations

import atexit
import os
import re
import shutil
import stat
import sys
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Final, cast

from mavnav.version import installed_version

_IMPORT = re.compile(rb"\nfrom ([\w.]+) import ")  # an eighth of the time that ^ takes

PRIVATE: Final = "MAVNAV_PRIVATE_CACHE_DIR"
"""Environment variable with the private directory, for child processes."""

VERSIONS_KEPT = 4
"""Number of versions of a kernel's code that stay on disk when its source changes."""

_DIGEST_BYTES = 32
_MOST_BYTES = 1 << 26
_OF_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_ONLY_FILES = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Opening a link fails, and opening a pipe does not wait."""


@cache
def cache_key() -> str:
    """Return a key of what machine code depends on besides its source: numba, Python, the system and the processor."""
    from llvmlite import binding as llvm  # noqa: PLC0415  it loads the code later

    names = ("CPU_NAME", "CPU_FEATURES", "OPT", "ENABLE_AVX", "BOUNDSCHECK")
    chosen = [os.environ.get(f"NUMBA_{name}", "") for name in names]
    processor = [llvm.get_process_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()]
    digest = sha256(repr([*processor, *chosen]).encode()).hexdigest()[:16]
    return f"numba-{installed_version('numba')}-py{sys.version_info.major}{sys.version_info.minor}-{digest}"


def user_directory() -> Path | None:
    """Return the directory of the machine code, which may not exist; None if none is named by an absolute path."""
    named = Path(os.environ.get("MAVNAV_CACHE_DIR") or _default_directory())
    return named if named.is_absolute() else None


def _default_directory() -> str:
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or "~/AppData/Local"
    else:
        base = "~/Library/Caches" if sys.platform == "darwin" else os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return os.path.join(os.path.expanduser(base), "mavnav")  # noqa: PTH111, PTH118  Path's raises without a home


def share_private_directory() -> None:
    """Create the private directory if the user's cannot be written, for this process and its children."""
    if not is_kept():
        _private_directory()


def is_kept() -> bool:
    """Return whether the user's directory can be written, so that new entries outlast the process."""
    from tempfile import TemporaryFile  # noqa: PLC0415  runs with all kernels on disk do without

    with suppress(OSError):
        TemporaryFile(dir=_own_folder(user_directory())).close()
        return True
    return False


def _own_folder(directory: Path | None) -> Path:
    """Return the folder for entries in a directory, made if need be; raises OSError where others could write there."""
    if directory is None:
        raise NotADirectoryError("no absolute path is known")
    folder = directory / cache_key()
    folder.mkdir(parents=True, exist_ok=True)
    status = folder.stat()
    if _others_may_write(status):  # by the umask of now or of an earlier time
        folder.chmod(stat.S_IMODE(status.st_mode) & ~_OF_OTHERS)
    if not _is_trusted(folder.stat()):
        raise PermissionError(f"{folder} is of another user")
    return folder


def _others_may_write(status: os.stat_result) -> bool:
    return os.name == "posix" and bool(status.st_mode & _OF_OTHERS)


def _is_trusted(status: os.stat_result) -> bool:
    """Return whether only this user and root may write a file or folder."""
    return not _others_may_write(status) and (os.name != "posix" or status.st_uid in {0, os.geteuid()})


def _private_directory() -> Path:
    """Return the private directory; the first process that needs it creates it and removes it at exit."""
    from tempfile import mkdtemp  # noqa: PLC0415

    if not os.environ.get(PRIVATE):
        os.environ[PRIVATE] = made = mkdtemp(prefix="mavnav-")
        atexit.register(_remove, made, os.getpid())
    return Path(os.environ[PRIVATE])


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


def read_code(name: str) -> memoryview | None:
    """Return the content of an entry; None if there is none with a valid checksum."""
    private = os.environ.get(PRIVATE)
    for directory in (user_directory(), Path(private) if private else None):
        with suppress(OSError):
            content = memoryview(_read_trusted(directory, name))  # whose slices are not copied
            if sha256(content[_DIGEST_BYTES:]).digest() == content[:_DIGEST_BYTES]:
                return content[_DIGEST_BYTES:]
    return None


def _read_trusted(directory: Path | None, name: str) -> bytes:
    """Return the bytes of an entry, none where others than this user and root could have written them.

    Links, pipes and devices are no entries. Raises OSError.
    """
    if directory is None:
        return b""
    folder = directory / cache_key()
    descriptor = os.open(folder / name, os.O_RDONLY | _ONLY_FILES)
    with open(descriptor, "rb") as file:  # noqa: PTH123  Path cannot open a descriptor
        status = os.fstat(descriptor)
        regular = stat.S_ISREG(status.st_mode) and status.st_size <= _MOST_BYTES
        return file.read() if regular and _is_trusted(status) and _is_trusted(folder.stat()) else b""


def write_code(name: str, code: bytes) -> None:
    """Store an entry, if any disk allows it. Files appear complete, because two processes may write one."""
    content = sha256(code).digest() + code
    for directory in (user_directory, _private_directory):
        with suppress(OSError):
            _write(_own_folder(directory()), name, content)
            return


def _write(folder: Path, name: str, content: bytes) -> None:
    from tempfile import NamedTemporaryFile  # noqa: PLC0415

    file = NamedTemporaryFile(dir=folder, prefix=".", delete=False)  # noqa: SIM115  it is renamed below
    try:
        with file:
            file.write(content)
        mask = os.umask(0)
        os.umask(mask)
        Path(file.name).chmod(0o644 & ~mask)
        Path(file.name).replace(folder / name)
    except OSError:
        Path(file.name).unlink(missing_ok=True)
        raise
    _forget_old(folder, name.rpartition("-")[0])


def _forget_old(folder: Path, kernel: str) -> None:
    """Remove the oldest versions of a kernel's code."""
    with suppress(OSError):
        by_age = sorted(folder.glob(f"{kernel}-*"), key=lambda path: path.stat().st_mtime)
        for path in by_age[:-VERSIONS_KEPT]:
            path.unlink()


def source_stamp(module: str) -> bytes:
    """Return the hash of a module's source and of the modules it imports, at any depth, of its package and of this one.

    Imports must have the form ``from package.module import name`` at the start of a line; the modules must be loaded.
    The source of the compiler, which is imported only then, is included.
    """
    packages = {name.partition(".")[0].encode() for name in (module, __name__)}
    digests: dict[str, bytes] = {}
    left = [module]
    while left:
        name = left.pop()
        if name not in digests:
            digests[name], imported = _source(name)
            left += [other.decode() for other in imported if other.split(b".")[0] in packages]
    return sha256(_compiler() + b"".join(name.encode() + digests[name] for name in sorted(digests))).digest()


@cache
def _compiler() -> bytes:
    """Return the hash of the compiler's source."""
    return sha256(Path(__file__).with_name("compiler.py").read_bytes()).digest()


@cache
def _source(module: str) -> tuple[bytes, list[bytes]]:
    """Return the hash of a loaded module's source, and the names of the modules that it imports from."""
    source = Path(cast("str", sys.modules[module].__file__)).read_bytes()
    return sha256(source).digest(), _IMPORT.findall(b"\n" + source)
