"""The profile of a run: seconds by stage."""

from __future__ import annotations

import time

import numpy as np
import pytest

from mavnav import profiling
from mavnav.profiling import OTHER, Stage, add_scan, as_stage, each, new_profile, peak_memory_mb, scans_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that tells, and advances by, what a test says."""
    now = [100.0]
    monkeypatch.setattr(profiling, "perf_counter", lambda: now[0])
    return now


def test_inner_stages_are_not_charged_to_outer_ones(clock: list[float]) -> None:
    spent = new_profile()
    clock[0] += 1
    with Stage("outer"):
        clock[0] += 2
        with Stage("inner"):
            clock[0] += 4
        clock[0] += 8
    clock[0] += 16
    with Stage("inner"):
        clock[0] += 32
    assert spent == {OTHER: 17, "outer": 10, "inner": 36}


def test_a_decorated_function_is_a_stage_even_when_it_fails(clock: list[float]) -> None:
    @as_stage("work")
    def work(seconds: float) -> None:
        clock[0] += seconds
        raise ValueError

    spent = new_profile()
    for _ in range(2):
        with pytest.raises(ValueError, match=r"^$"):
            work(3)
    with Stage("after"):
        clock[0] += 1
    assert spent == {OTHER: 0, "work": 6, "after": 1}


def test_making_items_is_a_stage_and_using_them_is_not(clock: list[float]) -> None:
    def items() -> object:
        for k in range(3):
            clock[0] += 1
            yield k

    spent, used = new_profile(), []
    for k in each("making", items()):
        clock[0] += 10
        used.append(k)
    with Stage("end"):
        pass
    assert used == [0, 1, 2]
    assert spent == {"making": 3, OTHER: 30, "end": 0}


def test_a_new_account_begins_empty_and_the_real_clock_runs() -> None:
    new_profile()
    spent = new_profile()
    with Stage("busy"):
        end = time.perf_counter() + 0.01
        while time.perf_counter() < end:
            pass
    assert 0.01 <= spent["busy"] < 0.5


def test_the_time_of_every_scan_is_kept_until_the_next_profile(clock: list[float]) -> None:
    new_profile()
    for seconds in (0.25, 0.5):
        began_s = clock[0]
        clock[0] += seconds
        add_scan(began_s)
    assert scans_s() == [0.25, 0.5]
    new_profile()
    assert not scans_s()


@pytest.mark.slow
def test_the_peak_memory_counts_what_was_given_back() -> None:
    before_mb = peak_memory_mb()
    if np.isnan(before_mb):
        pytest.skip("this system does not tell what a process takes")
    np.ones(int(1e6 * before_mb) // 8)
    assert peak_memory_mb() > before_mb
