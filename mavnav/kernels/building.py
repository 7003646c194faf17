"""Compiling what the disk does not have, in processes of its own over all cores."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Final

from mavnav.kernels._cache import share_private_directory
from mavnav.kernels._jit import DISABLED, KERNELS, Kernel
from mavnav.kernels._loader import cache_key

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence

    Progress = Callable[[str, int, int | None], None]

LONG: Final = (
    "line_search.search",
    "polar_search.search",
    "polar_search.cost",
    "scan_pairs",
    "hits",
    "thickness",
    "linemap",
    "wavefront",
)
"""The modules that take longest to compile, which are begun first: the last one begun decides when all are done."""

_FASTER: Final = {"NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1"}
"""numba tries many overloads, and colours the message of each that does not fit."""

_SERVE = "from mavnav.kernels.building import serve; serve()"


def prepare(progress: Progress, unused: Collection[str] = ()) -> None:
    """See to it that the disk has the machine code of all kernels whose modules are loaded.

    ``progress`` hears of what is compiled, and of nothing otherwise. Kernels of the modules in ``unused`` (names within
    ``mavnav.kernels``) are left out. What could not be compiled here is compiled when it is first called.
    """
    if DISABLED:
        return
    skipped = {_full(name) for name in unused}
    missing = [made for made in KERNELS if not made.loaded and made.module not in skipped and made.code is None]
    if not missing:
        return
    share_private_directory(cache_key())
    for done, _ in enumerate(_compiled(sorted(missing, key=_rank))):
        progress(f"compiling kernels (first run only): {done} of {len(missing)}", 0, None)
    for made in missing:
        made.look_again()


def _full(name: str) -> str:
    return f"{__package__}.{name}"


def _rank(made: Kernel) -> int:
    """Return the place of a kernel in the order of compiling."""
    return LONG.index(made.module[len(_full("")) :]) if made.module in map(_full, LONG) else len(LONG)


def _compiled(kernels: Sequence[Kernel]) -> Iterator[None]:
    """Compile kernels into the cache; yields at the start, and whenever one is done."""
    paths = os.pathsep.join(map(os.path.abspath, sys.path))
    environment = os.environ | {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"} | _FASTER
    names = [f"{made.module}:{made.name}" for made in kernels]
    command = [sys.executable, "-P", "-c", _SERVE, *names]
    yield
    null, group = subprocess.DEVNULL, 0 if hasattr(os, "killpg") else None
    with (
        suppress(OSError),
        subprocess.Popen(  # noqa: S603  our own interpreter
            command, env=environment, stdin=null, stdout=subprocess.PIPE, stderr=null, process_group=group
        ) as child,
    ):
        try:
            for _ in child.stdout or ():
                yield
        finally:
            _end(child)


def _end(child: subprocess.Popen[bytes]) -> None:
    """End a process and those that it forked, where they have not ended by themselves."""
    with suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(child.pid, signal.SIGKILL)
        else:
            child.kill()


def serve() -> None:
    """Compile the kernels ``module:function`` of the command line, one after another, and print a line after each.

    The process forks to as many as there are cores; they take the next kernel from a pipe, which holds its number.
    """
    from mavnav.kernels._compiler import learn  # noqa: PLC0415  it imports numba

    gc.disable()
    names = sys.argv[1:256]
    for name in names:
        import_module(name.partition(":")[0])
    by_name = {f"{made.module}:{made.name}": made for made in KERNELS}
    learn()
    numbers, entrance = os.pipe()
    os.write(entrance, bytes(range(len(names))))
    os.close(entrance)
    _fork(min(_cores(), len(names)))
    while number := os.read(numbers, 1):
        by_name[names[number[0]]].load()
        os.write(1, b"\n")
    while True:
        try:
            os.wait()
        except (OSError, AttributeError):
            return


def _fork(processes: int) -> None:
    """Make this process so many, each of which ends with the first one."""
    for _ in range(processes - 1 if hasattr(os, "fork") else 0):
        if os.fork() == 0:
            return


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
