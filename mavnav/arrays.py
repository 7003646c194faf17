"""Memory that is allocated when it is written to, and released early; medians, quantiles and distinct values.

NumPy's own functions for the latter load its masked arrays, which takes 11 ms of processor time in every run. These
return the same to the last bit for float64 and for integers below 2**53.
"""

from __future__ import annotations

import mmap
import sys
from ctypes import CDLL, c_size_t, c_void_p
from errno import ENOMEM
from math import floor, isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

SMALL_BYTES = 1 << 22
"""Minimum size of an array with lazy pages: from this size on numpy allocates pages of 2 MB, each counted wholly."""

LARGE_PEAK_KB = 256 << 10
"""Peak memory from which free memory is released: allocating it again costs a replay of some 400 scans 5 ms."""

_MAPPED = Path("/proc/self/maps")


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


def median(values: ArrayLike) -> float:
    """Return the middle of all values, of an even number the mean of both in the middle; NaN without any value."""
    ordered = np.sort(values, axis=None)
    n = len(ordered)
    if not n or isnan(ordered[-1]):  # where NaNs are sorted to
        return nan
    low, high = float(ordered[(n - 1) // 2]), float(ordered[n // 2])
    return low if n % 2 else (low + high) / 2.0


def quantile(values: ArrayLike, share: float) -> float:
    """Return the value that a share (0 to 1) of all values does not exceed, interpolated; NaN without any value."""
    ordered = np.sort(values, axis=None)
    n = len(ordered)
    if not n or isnan(ordered[-1]):
        return nan
    place = (n - 1) * share
    below = floor(place)
    low, high = float(ordered[below]), float(ordered[min(below + 1, n - 1)])
    part = place - below
    return high - (high - low) * (1.0 - part) if part >= 0.5 else low + (high - low) * part


def distinct(values: ArrayLike) -> NDArray[Any]:
    """Return all values once, in ascending order; every NaN, at the end."""
    ordered = np.sort(values, axis=None)
    new = np.ones(len(ordered), np.bool_)
    np.not_equal(ordered[1:], ordered[:-1], out=new[1:])
    return ordered[new]


def contained(values: NDArray[Any], others: ArrayLike) -> NDArray[np.bool_]:
    """Return which values (n,) are among others."""
    ordered = np.sort(others, axis=None)
    if not len(ordered):
        return np.zeros(values.shape, np.bool_)
    found: NDArray[np.bool_] = ordered[np.searchsorted(ordered, values).clip(max=len(ordered) - 1)] == values
    return found
