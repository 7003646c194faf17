"""Memory that is allocated when it is written to, and released early."""

from __future__ import annotations

import mmap
import sys
from ctypes import CDLL, c_size_t, c_void_p
from errno import ENOMEM
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

SMALL_BYTES = 1 << 22
"""Minimum size of an array with lazy pages: from this size on numpy allocates pages of 2 MB, each counted wholly."""

LARGE_PEAK_KB = 256 << 10
"""Peak memory from which free memory is released: allocating it again costs a replay of some 400 scans 5 ms."""

KEPT_BYTES = 1 << 23
"""Free memory that the C library keeps: a replay of some 400 scans takes 4 % longer where it returns all of it.

Four times as much makes the peak memory of a replay of 1000 scans 6 % larger, and no replay faster."""

_MAPPED = Path("/proc/self/maps")
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Numbers of glibc's malloc.h."""


def blank(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:  # noqa: ANN401
    """Return zeros whose pages are allocated when they are written to; raises MemoryError as numpy does."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    if size < SMALL_BYTES or not hasattr(mmap, "MAP_PRIVATE"):
        return np.zeros(shape, dtype)
    try:
        memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except OSError as error:
        if error.errno == ENOMEM:
            raise MemoryError(f"{size} bytes cannot be allocated") from error
        raise
    if hasattr(mmap, "MADV_NOHUGEPAGE"):
        memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, dtype).reshape(shape)


def release_rows(array: NDArray[Any], first: int, end: int) -> None:
    """Release the pages of some rows of a large `blank`; all values on these pages become zero."""
    held: Any = array
    while isinstance(held, np.ndarray):
        held = held.base
    memory = held.obj if isinstance(held, memoryview) else None
    if isinstance(memory, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        start, stop = (array[:rows].nbytes // mmap.PAGESIZE * mmap.PAGESIZE for rows in (first, end))
        memory.madvise(mmap.MADV_DONTNEED, start, stop - start)


def keep_free_memory() -> None:
    """Make the C library reuse the memory of freed arrays: else the system zeroes it anew, page by page.

    It affects the whole process, so that only commands call it. `release_free_memory` still releases all.
    """
    option = getattr(CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if option:
        option(_TRIM_THRESHOLD, KEPT_BYTES)
        option(_MMAP_THRESHOLD, SMALL_BYTES)


def release_free_memory() -> None:
    """Release free memory and the compiler's code, if the process ever used much memory."""
    if sys.platform != "linux":
        return
    from resource import RUSAGE_SELF, getrusage  # noqa: PLC0415  not everywhere

    if getrusage(RUSAGE_SELF).ru_maxrss > LARGE_PEAK_KB:
        trim()
        release_compiler_code()


def trim() -> None:
    """Make the C library release free memory between blocks in use."""
    give = getattr(CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if give:
        give(0)


def release_compiler_code() -> None:
    """Release the code pages of the compiler library: loading kernels reads many of them, running kernels none."""
    if not (hasattr(mmap, "MADV_DONTNEED") and _MAPPED.exists()):
        return
    for line in _MAPPED.read_text().splitlines():
        place, access, *_, name = line.split(maxsplit=5)
        if access == "r-xp" and name.endswith("libllvmlite.so"):  # code is never written, so nothing is lost
            first, end = (int(address, 16) for address in place.split("-"))
            CDLL(None).madvise(c_void_p(first), c_size_t(end - first), mmap.MADV_DONTNEED)
