"""Measurement of the additional memory of a block of code, on Linux."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import CDLL
from pathlib import Path

import pytest

STATUS, REFS = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def in_use_mb(what: str = "VmRSS") -> float:
    """Return the memory of this process in MB: the current one (``VmRSS``) or the peak (``VmHWM``)."""
    if not STATUS.exists():
        pytest.skip("this system does not tell what a process takes")
    return next(int(line.split()[1]) / 1024 for line in STATUS.read_text().splitlines() if line.startswith(what))


@contextmanager
def taking_less_than(max_mb: float) -> Iterator[None]:
    """Fail if the peak memory of the block exceeds the memory before it by ``max_mb`` or more."""
    in_use_mb()  # skips other systems than Linux
    CDLL(None).malloc_trim(0)
    before_mb = in_use_mb()
    REFS.write_text("5")  # resets the peak
    yield
    assert in_use_mb("VmHWM") - before_mb < max_mb
