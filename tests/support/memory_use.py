"""Measurement of the additional memory of a call, on Linux."""

from __future__ import annotations

import gc
from collections.abc import Callable
from ctypes import CDLL
from pathlib import Path

import pytest

STATUS, REFS = Path("/proc/self/status"), Path("/proc/self/clear_refs")
M_MMAP_THRESHOLD = -3  # of <malloc.h>


def in_use_mb(what: str = "VmRSS") -> float:
    """Return the memory of this process in MB: the current one (``VmRSS``) or the peak (``VmHWM``)."""
    if not STATUS.exists():
        pytest.skip("this system does not tell what a process takes")
    return next(int(line.split()[1]) / 1024 for line in STATUS.read_text().splitlines() if line.startswith(what))


def added_mb(call: Callable[[], object]) -> float:
    """Return by how many MB a call raises the peak memory: the least, as a first one may load code."""
    return min(_added_mb(call) for _ in range(2))


def _added_mb(call: Callable[[], object]) -> float:
    in_use_mb()  # skips other systems than Linux
    gc.collect()
    # Arrays in pages of their own: in a heap in pieces the same call took 42 to 57 MB.
    CDLL(None).mallopt(M_MMAP_THRESHOLD, 1 << 17)
    CDLL(None).malloc_trim(0)
    before_mb = in_use_mb()
    REFS.write_text("5")  # resets the peak
    call()
    return in_use_mb("VmHWM") - before_mb
