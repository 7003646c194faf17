"""Time: order, windows, and stamps that cannot be believed."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_files import PERIOD_NS, START_NS, Message, laser, write_mcap

from mavnav.errors import NoScansError, UsageError
from mavnav.logs import open_log
from mavnav.logs.stamps import StampGate, period_and_gaps

if TYPE_CHECKING:
    from pathlib import Path


def at(k: int, stamp_ns: int, log_ns: int | None = None) -> Message:
    scan = laser(k)
    return Message(scan.topic, scan.type, stamp_ns, scan.fields, log_ns)


@given(st.lists(st.integers(-2, 50), max_size=60))
def test_what_passes_ascends_strictly_and_nothing_else_is_refused(stamps: list[int]) -> None:
    gate = StampGate()
    passed: list[int] = []
    for stamp in stamps:
        late = stamp >= 0 and (not passed or stamp > passed[-1])
        assert (gate.refusal(stamp) is None) == late
        if late:
            passed.append(stamp)


def test_duplicate_and_backward_stamps_are_skipped_and_counted(tmp_path: Path) -> None:
    order = [0, 1, 1, 3, 2, 4, 5]
    log = open_log(write_mcap(tmp_path / "a", [at(k, START_NS + n * PERIOD_NS) for k, n in enumerate(order)]))
    assert (log.counts.total, log.counts.usable) == (7, 5)
    assert log.counts.skipped == {"backward_stamp": 1, "duplicate_stamp": 1}
    assert [(s.stamp_ns - START_NS) // PERIOD_NS for s in log.scans()] == [0, 1, 3, 4, 5]
    assert sum(log.cleaning.values()) == 5 * 16


@pytest.mark.parametrize("first_ns", [0, 77, START_NS + 10**15], ids=["zero", "constant", "from the future"])
def test_unusable_stamps_give_way_to_the_times_of_recording(first_ns: int, tmp_path: Path) -> None:
    stamps = [first_ns] * 6 if first_ns < START_NS else [first_ns, *(START_NS + k for k in range(5))]
    messages = [at(k, stamp, START_NS + k * PERIOD_NS) for k, stamp in enumerate(stamps)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert log.stamp_source == "log"
    assert [s.stamp_ns for s in log.scans()] == [START_NS + k * PERIOD_NS for k in range(6)]
    assert any("stamps are unusable" in w for w in log.warnings)


def test_sound_stamps_are_believed_over_the_times_of_recording(tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", [at(k, START_NS + k, 5) for k in range(6)]))
    assert (log.stamp_source, log.counts.usable, log.first_ns) == ("header", 6, START_NS)


def test_window_counts_from_the_first_usable_scan(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(k) for k in range(20)])
    log = open_log(path, start_s=0.5, end_s=1.0)
    assert [(s.stamp_ns - START_NS) // PERIOD_NS for s in log.scans()] == [5, 6, 7, 8, 9, 10]
    assert (log.counts.usable, log.counts.skipped) == (6, {"outside_window": 14})
    assert log.first_ns == START_NS + 5 * PERIOD_NS


def test_windows_that_hold_nothing_are_refused(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(k) for k in range(3)])
    with pytest.raises(UsageError, match="--end must be later"):
        open_log(path, start_s=2.0, end_s=1.0)
    with pytest.raises(NoScansError, match="check --start and --end"):
        open_log(path, start_s=60.0)


def test_gaps_are_pauses_longer_than_three_periods() -> None:
    stamps = array("q", np.cumsum([10, 10, 10, 30, 10, 31, 10]) * 10**6)
    period_s, gaps = period_and_gaps(stamps)
    assert period_s == pytest.approx(0.01)
    assert [(g.start_ns, round(g.duration_s, 6)) for g in gaps] == [(stamps[4], 0.031)]
    assert period_and_gaps(stamps[:1]) == (0.0, ())
