"""Memory that is taken when it is written to, and given back when it is done with."""

from __future__ import annotations

import mmap
import sys
from ctypes import CDLL, c_size_t, c_void_p
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

SMALL_BYTES = 1 << 22
"""Smaller arrays are not worth the care; from this size numpy allocates pages of 2 MB, each counted as a whole."""

MUCH_KB = 256 << 10
"""A process that took less keeps what is free: to take it once more would cost a replay of some 400 scans 5 ms."""

_MAPPED = Path("/proc/self/maps")


def blank(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:  # noqa: ANN401
    """Return zeros whose pages take memory once they are written to."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    if size < SMALL_BYTES or not hasattr(mmap, "MAP_PRIVATE"):
        return np.zeros(shape, dtype)
    memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    if hasattr(mmap, "MADV_NOHUGEPAGE"):
        memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, dtype).reshape(shape)


def forget(array: NDArray[Any], first: int, end: int) -> None:
    """Give back what some rows of a large `blank` take: they, and the rest of the pages that they lie on, are zero."""
    held: Any = array
    while isinstance(held, np.ndarray):
        held = held.base
    memory = held.obj if isinstance(held, memoryview) else None
    if isinstance(memory, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        start, stop = (array[:rows].nbytes // mmap.PAGESIZE * mmap.PAGESIZE for rows in (first, end))
        memory.madvise(mmap.MADV_DONTNEED, start, stop - start)


def give_back() -> None:
    """Give back what is free between blocks in use, and what was only read, if the process ever took much."""
    if sys.platform != "linux":
        return
    from resource import RUSAGE_SELF, getrusage  # noqa: PLC0415  not everywhere

    if getrusage(RUSAGE_SELF).ru_maxrss > MUCH_KB:
        trim()
        drop_compiler()


def trim() -> None:
    """Have the C library give back what is free between blocks in use."""
    give = getattr(CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if give:
        give(0)


def drop_compiler() -> None:
    """Give back the code of the library that compiles: loading kernels reads much of it, running them reads none."""
    if not (hasattr(mmap, "MADV_DONTNEED") and _MAPPED.exists()):
        return
    for line in _MAPPED.read_text().splitlines():
        place, access, *_, name = line.split(maxsplit=5)
        if access == "r-xp" and name.endswith("libllvmlite.so"):  # nobody writes to code, so nothing is lost
            first, end = (int(address, 16) for address in place.split("-"))
            CDLL(None).madvise(c_void_p(first), c_size_t(end - first), mmap.MADV_DONTNEED)
