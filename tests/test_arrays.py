"""Memory is taken when it is written to, and given back when it is done with; what is found by sorting is NumPy's."""

from __future__ import annotations

import errno
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numba import njit

from mavnav import arrays as memory
from mavnav.arrays import (
    SMALL_BYTES,
    blank,
    contained,
    distinct,
    median,
    quantile,
    release_compiler_code,
    release_free_memory,
    release_rows,
)
from mavnav.commands.heap import keep_free_memory
from mavnav.kernels.maps.layout import WIDE
from mavnav.mapping.tiled_arrays import blank_strips, moved
from support.memory_use import in_use_mb, taking_less_than

MB = 1 << 20


@pytest.mark.parametrize("strips", [False, True], ids=["plain", "strips"])
def test_a_full_lattice_moves_without_room_for_two(*, strips: bool) -> None:
    rows, cols = 4096, 128 * WIDE
    array = blank_strips((rows, cols), np.uint16) if strips else blank((rows, cols), np.uint16)
    array[...] = 7
    with taking_less_than(0.5 * array.nbytes / MB):
        grown = moved(array, (rows + 64, cols + 2 * WIDE), 64, WIDE)
    assert np.count_nonzero(grown) == rows * cols
    assert not array.any()


def test_only_released_rows_are_lost() -> None:
    array = blank((100, 50_000), np.uint16)
    array[...] = 7
    release_rows(array, 0, 40)
    release_rows(array, 40, 60)
    assert not array[:58].any()
    assert (array[60:] == 7).all()


def test_an_array_that_does_not_fit_is_out_of_memory() -> None:
    with pytest.raises(MemoryError, match=f"{1 << 60} bytes"):
        blank((1 << 30, 1 << 30), np.uint8)


@pytest.mark.parametrize(("number", "error"), [(errno.ENOMEM, MemoryError), (errno.EINVAL, OSError)])
def test_only_a_lack_of_memory_is_one(monkeypatch: pytest.MonkeyPatch, number: int, error: type[Exception]) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(memory.mmap, "mmap", refuse)
    with pytest.raises(error):
        blank((SMALL_BYTES,), np.uint8)


@pytest.mark.parametrize("array", [np.ones(SMALL_BYTES, np.uint8), np.frombuffer(b"1234", np.uint8)])
def test_rows_of_other_arrays_are_not_released(array: np.ndarray) -> None:
    release_rows(array, 0, len(array))
    assert array.all()


def test_free_memory_is_released_after_a_large_peak(monkeypatch: pytest.MonkeyPatch) -> None:
    before_mb = in_use_mb()
    blocks = [bytearray(5_000) for _ in range(20_000)]
    kept = blocks[::500]
    del blocks
    monkeypatch.setattr(memory, "LARGE_PEAK_KB", 1 << 40)
    release_free_memory()
    assert in_use_mb() - before_mb > 60
    monkeypatch.setattr(memory, "LARGE_PEAK_KB", 0)
    release_free_memory()
    assert in_use_mb() - before_mb < 20
    assert len(kept) == 40


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc has the option")
def test_the_memory_of_freed_arrays_is_reused() -> None:
    from resource import RUSAGE_SELF, getrusage

    keep_free_memory()
    np.ones(1 << 18)
    before = getrusage(RUSAGE_SELF).ru_minflt
    for _ in range(10):
        np.ones(1 << 18)
    assert getrusage(RUSAGE_SELF).ru_minflt - before < 1000  # of 10 x 512 pages


@pytest.mark.skipif(not Path("/proc/self/smaps").exists(), reason="only Linux tells which pages lie in memory")
def test_released_compiler_code_still_runs() -> None:
    twice = njit(lambda x: 2 * x)
    assert twice(3) == 6
    before_kb = code_kb("libllvmlite.so")
    release_compiler_code()
    assert code_kb("libllvmlite.so") < 0.1 * before_kb
    assert twice(1.5) == 3.0


def code_kb(library: str) -> int:
    """Return what the code of a library takes, by its pages that are mapped."""
    text = Path("/proc/self/smaps").read_text()
    areas = re.split(r"^(?=[0-9a-f]+-[0-9a-f]+ )", text, flags=re.MULTILINE)
    codes = [area for area in areas if " r-xp " in area and library in area]
    return sum(int(kb) for area in codes for kb in re.findall(r"^Rss: +(\d+) kB", area, flags=re.MULTILINE))


VALUES = st.one_of(
    arrays(np.float64, st.integers(1, 40), elements=st.floats(-1e6, 1e6)),
    arrays(np.int64, st.integers(1, 40), elements=st.integers(-(2**52), 2**52)),
    arrays(np.uint16, st.integers(1, 40)),
    st.lists(st.floats(-10, 10), min_size=1),
)


@given(VALUES, st.floats(0.0, 1.0))
def test_medians_and_quantiles_equal_numpys_to_the_last_bit(values, share) -> None:
    assert median(values) == np.median(values)
    assert quantile(values, share) == np.quantile(values, share)


@given(VALUES, VALUES)
def test_distinct_and_contained_values_are_those_of_numpy(values, others) -> None:
    assert np.array_equal(distinct(values), np.unique(values))
    assert np.array_equal(contained(np.asarray(values), others), np.isin(values, others))


def test_what_no_value_decides_is_nan() -> None:
    for nothing in ([], [1.0, np.nan]):
        assert np.isnan(median(nothing))
        assert np.isnan(quantile(nothing, 0.3))
    assert len(distinct([])) == 0
    assert not contained(np.ones(2), []).any()
