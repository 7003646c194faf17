"""Compile kernels that are not on disk, in separate processes on all cores."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Final

from mavnav.kernels.machine.cache import share_private_directory
from mavnav.kernels.machine.jit import DISABLED, KERNELS, Kernel
from mavnav.kernels.machine.loader import check_executable

Progress = Callable[[str, int, int | None], None]

LONG: Final = (
    "line_search.search",
    "polar_search.search",
    "scans.lowest_poses",
    "polar_search.cost",
    "walls.scan_pairs",
    "maps.hits",
    "walls.thickness",
    "maps.linemap",
    "planning.wavefront",
)
"""The modules that take longest to compile, which are compiled first: otherwise the last of them delays the end."""

_FASTER: Final = {"NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING": "1"}
"""No coloured error messages: numba makes one for each of many overloads that do not fit."""

_SERVE = "from mavnav.kernels.machine.building import serve; serve()"


def prepare(progress: Progress, unused: Collection[str] = ()) -> None:
    """Compile the kernels of the loaded modules whose machine code is not on disk.

    ``progress`` is called while kernels are compiled, and not at all otherwise. Kernels of the modules in ``unused``
    (names within ``mavnav.kernels``) are left out. A kernel that could not be compiled here is compiled at its first
    call.
    """
    missing = [] if DISABLED else not_on_disk(unused)
    if not missing:
        return
    check_executable()
    share_private_directory()
    for done, _ in enumerate(_compile(sorted(missing, key=_rank))):
        progress(f"compiling kernels (first run only): {done} of {len(missing)}", 0, None)
    for made in missing:
        made.recheck_disk()


def not_on_disk(unused: Collection[str] = ()) -> list[Kernel]:
    """Return the kernels of the loaded modules, but those in ``unused``, whose machine code is not on disk."""
    return [made for made in KERNELS if not made.loaded and _file(made) not in unused and made.code is None]


def _file(made: Kernel) -> str:
    return made.module.removeprefix("mavnav.kernels.")


def _rank(made: Kernel) -> int:
    """Return the position of a kernel in the order of compilation."""
    return LONG.index(_file(made)) if _file(made) in LONG else len(LONG)


def _compile(kernels: Sequence[Kernel]) -> Iterator[None]:
    """Compile kernels into the cache; yield at the start, and after each kernel."""
    paths = os.pathsep.join(map(os.path.abspath, sys.path))
    environment = os.environ | {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"} | _FASTER
    command = [sys.executable, "-P", "-c", _SERVE, *(f"{made.module}:{made.name}" for made in kernels)]
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
    """Kill a process and those that it forked, unless they have ended already."""
    with suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(child.pid, signal.SIGKILL)
        else:
            child.kill()


def serve() -> None:
    """Compile the kernels ``module:function`` of the command line, and print a line after each.

    The process forks to one per core; each takes the number of the next kernel from a pipe.
    """
    from mavnav.kernels.machine.compiler import load_typing_tables  # noqa: PLC0415  it imports numba

    gc.disable()
    names = sys.argv[1:256]
    for name in names:
        import_module(name.partition(":")[0])
    by_name = {f"{made.module}:{made.name}": made for made in KERNELS}
    load_typing_tables()
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
    """Fork this process until there are ``processes``; each child ends with the first process."""
    for _ in range(processes - 1 if hasattr(os, "fork") else 0):
        if os.fork() == 0:
            return


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
