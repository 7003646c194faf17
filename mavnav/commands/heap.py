"""How the C library of a command keeps memory that was freed."""

from __future__ import annotations

import mmap
import sys
from ctypes import CDLL, c_size_t, c_void_p

KEPT_BYTES = 1 << 25
"""Free memory that the C library keeps: a replay of some 400 scans takes 4 % longer where it returns all of it."""

LARGE_PAGES_BYTES = 24 << 20
"""First part of the free memory in pages of 2 MB, if the system has them: 2 % of a replay of some 400 scans."""

SEPARATE_BYTES = 1 << 23
"""Arrays of this size and more are returned to the system one by one, when they are freed."""

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Numbers of glibc's malloc.h."""


def keep_free_memory() -> None:
    """Make the C library reuse the memory of freed arrays: else the system zeroes it anew, page by page.

    It affects the whole process, so that only commands call it. `release_free_memory` still releases all.
    """
    library = CDLL(None) if sys.platform == "linux" else None
    option = getattr(library, "mallopt", None)
    if library and option:
        option(_TRIM_THRESHOLD, KEPT_BYTES)
        option(_MMAP_THRESHOLD, KEPT_BYTES)
        library.malloc.restype = c_void_p
        start = library.malloc(c_size_t(LARGE_PAGES_BYTES))
        if start and hasattr(mmap, "MADV_HUGEPAGE"):
            first = -(-start // mmap.PAGESIZE) * mmap.PAGESIZE
            library.madvise(c_void_p(first), c_size_t(LARGE_PAGES_BYTES - mmap.PAGESIZE), mmap.MADV_HUGEPAGE)
        library.free(c_void_p(start))
        option(_MMAP_THRESHOLD, SEPARATE_BYTES)
