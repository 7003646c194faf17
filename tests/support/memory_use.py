"""How much memory something takes on top of what is in use; Linux alone tells."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mavnav.memory import trim

STATUS, REFS = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def in_use_mb(what: str = "VmRSS") -> float:
    """Return the memory of this process: ``VmRSS`` now, ``VmHWM`` at most."""
    if not STATUS.exists():
        pytest.skip("this system does not tell what a process takes")
    return next(int(line.split()[1]) / 1024 for line in STATUS.read_text().splitlines() if line.startswith(what))


@contextmanager
def taking_less_than(most_mb: float) -> Iterator[None]:
    """Fail where the block takes more at any time."""
    trim()
    before_mb = in_use_mb()
    REFS.write_text("5")  # the most is counted from here on
    yield
    assert in_use_mb("VmHWM") - before_mb < most_mb
