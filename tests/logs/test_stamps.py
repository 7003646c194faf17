"""Time: order, windows, and stamps that cannot be believed."""

from __future__ import annotations

from itertools import combinations, pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavnav.errors import NoScansError, UsageError
from mavnav.logs import open_log
from mavnav.logs.stamps import ascending, comes_in_bursts, period_and_gaps
from support.log_files import ODOM, PERIOD_NS, START_NS, Message, laser, write_mcap

if TYPE_CHECKING:
    from pathlib import Path


def at(k: int, stamp_ns: int, log_ns: int | None = None) -> Message:
    scan = laser(k)
    return Message(scan.topic, scan.type, stamp_ns, scan.fields, log_ns)


@given(st.lists(st.integers(-2, 12), max_size=9))
def test_the_most_that_ascend_are_chosen(stamps: list[int]) -> None:
    chosen = ascending(np.array(stamps, dtype=np.int64)).tolist()
    kept = [stamps[k] for k in chosen]
    assert chosen == sorted(set(chosen))
    assert kept == sorted(set(kept))
    subsets = (c for n in range(len(stamps) + 1) for c in combinations(stamps, n))
    assert len(kept) == max(len(c) for c in subsets if all(x < y for x, y in pairwise(c)))


def test_duplicate_and_backward_stamps_are_skipped_and_counted(tmp_path: Path) -> None:
    order = [0, 1, 1, 3, 2, 4, 5]
    messages = [at(n, START_NS + n * PERIOD_NS, START_NS + k * PERIOD_NS) for k, n in enumerate(order)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert (log.counts.total, log.counts.usable) == (7, 5)
    assert log.counts.skipped == {"backward_stamp": 1, "duplicate_stamp": 1}
    assert [(s.stamp_ns - START_NS) // PERIOD_NS for s in log.scans()] == [0, 1, 3, 4, 5]
    assert sum(log.cleaning.values()) == 5 * 16


@pytest.mark.parametrize("first_ns", [0, 77], ids=["zero", "constant"])
def test_unusable_stamps_give_way_to_the_times_of_recording(first_ns: int, tmp_path: Path) -> None:
    messages = [at(k, first_ns, START_NS + k * PERIOD_NS) for k in range(6)]
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
    assert log.start_s == pytest.approx(0.5)
    assert [(s.stamp_ns - START_NS) // PERIOD_NS for s in log.scans()] == [5, 6, 7, 8, 9, 10]
    assert (log.counts.usable, log.counts.skipped) == (6, {"outside_window": 14})
    assert log.first_ns == START_NS + 5 * PERIOD_NS


@pytest.mark.parametrize("last", range(2, 20))
def test_both_ends_of_a_window_are_inclusive(last: int, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(k) for k in range(20)])
    log = open_log(path, start_s=(last - 1) / 10, end_s=last / 10)
    assert [(s.stamp_ns - START_NS) // PERIOD_NS for s in log.scans()] == [last - 1, last]


def test_windows_that_hold_nothing_are_refused(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(k) for k in range(3)])
    with pytest.raises(UsageError, match="--end must be later"):
        open_log(path, start_s=2.0, end_s=1.0)
    with pytest.raises(NoScansError, match=r"the scans last 0\.2 s: check --start and --end"):
        open_log(path, start_s=60.0)


def test_gaps_are_pauses_longer_than_three_periods() -> None:
    stamps = np.cumsum([10, 10, 10, 30, 10, 31, 10]) * 10**6
    period_s, gaps = period_and_gaps(stamps)
    assert period_s == pytest.approx(0.01)
    assert [(g.start_ns, round(g.duration_s, 6)) for g in gaps] == [(stamps[4], 0.031)]
    assert period_and_gaps(stamps[:1]) == (0.0, ())


@pytest.mark.parametrize("first", [20, 50, 80])
def test_a_clock_that_is_set_back_costs_no_scans(first: int, tmp_path: Path) -> None:
    hour_ns = 3600 * 10**9
    times_ns = [START_NS + k * PERIOD_NS for k in range(100)]
    messages = [at(k, t if k < first else t - hour_ns, t) for k, t in enumerate(times_ns)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert (log.counts.usable, log.stamp_source) == (100, "log")
    assert any("times of recording" in text for text in log.warnings)


@pytest.mark.parametrize("again", [100, 60, 12], ids=["whole", "half", "little"])
def test_a_clock_that_is_set_back_onto_its_own_grid_costs_no_scans(again: int, tmp_path: Path) -> None:
    stamps_ns = [START_NS + (k % 100) * PERIOD_NS for k in range(100 + again)]
    messages = [at(k, stamp_ns, START_NS + k * PERIOD_NS) for k, stamp_ns in enumerate(stamps_ns)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert (log.counts.usable, log.counts.skipped, log.stamp_source) == (100 + again, {}, "log")
    assert any("the clock was set back once 10.0 s after the first scan" in text for text in log.warnings)


@pytest.mark.parametrize("grid_ms", [150, 200, 1000])
def test_stamps_truncated_to_a_grid_give_way_to_the_times_of_recording(grid_ms: int, tmp_path: Path) -> None:
    grid_ns = grid_ms * 10**6
    times_ns = [START_NS + k * PERIOD_NS for k in range(100)]
    log = open_log(write_mcap(tmp_path / "a", [at(k, t // grid_ns * grid_ns, t) for k, t in enumerate(times_ns)]))
    assert (log.counts.usable, log.stamp_source) == (100, "log")
    assert any("several share one stamp" in text for text in log.warnings)


def test_scans_of_two_drivers_with_the_same_stamps_are_not_used_together(tmp_path: Path) -> None:
    messages = [at(k, t := START_NS + k // 2 * PERIOD_NS, t + k % 2 * 1_000_000) for k in range(100)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert (log.counts.usable, log.counts.skipped) == (50, {"duplicate_stamp": 50})
    assert any("50 of 100 scans skipped: duplicate stamp" in text for text in log.warnings)


@pytest.mark.parametrize(("rate", "source"), [(1, "log"), (10, "header")], ids=["as recorded", "played at ten times"])
def test_a_clock_that_is_set_forward_is_told_from_a_pause_by_the_times_of_recording(
    rate: int, source: str, tmp_path: Path
) -> None:
    hour_ns = 3600 * 10**9
    messages = [
        at(k, START_NS + k * PERIOD_NS + hour_ns * (k >= 20), START_NS + k * PERIOD_NS // rate) for k in range(60)
    ]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert (log.counts.usable, log.stamp_source, len(log.gaps)) == (60, source, int(source == "header"))
    assert any("set forward 1 time, by 3600 s at 1.9 s" in text for text in log.warnings) == (source == "log")


@pytest.mark.parametrize("recorded_ns", [PERIOD_NS, 0, 20], ids=["as scanned", "all at once", "copied at once"])
@pytest.mark.parametrize("per_unit", [1, 1000, 10**6, 0.001], ids=["ns", "us", "ms", "ms read as s"])
def test_stamps_in_another_unit_give_way_to_the_times_of_recording(
    per_unit: float, recorded_ns: int, tmp_path: Path
) -> None:
    start_ns = START_NS if per_unit >= 1 else 10**9
    times_ns = [start_ns + k * PERIOD_NS for k in range(60)]
    messages = [at(k, round(t / per_unit), START_NS + k * recorded_ns) for k, t in enumerate(times_ns)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    wrong = per_unit != 1 and recorded_ns == PERIOD_NS
    assert (log.counts.usable, log.stamp_source) == (60, "log" if wrong else "header")
    assert any("recording 5.9 s: they are in another unit" in text for text in log.warnings) == wrong


@pytest.mark.parametrize("off_s", [-60.0, -16.0, 1.5, 20.0])
def test_odometry_of_another_clock_is_brought_to_that_of_the_scans(off_s: float, tmp_path: Path) -> None:
    times_ns = [START_NS + k * PERIOD_NS for k in range(100)]
    off_ns = round(off_s * 1e9)
    messages = [at(k, t, t + 30_000_000) for k, t in enumerate(times_ns)]
    drive = [
        Message("/odom", ODOM, t + off_ns, {"x": 0.01 * k, "y": 0.0, "yaw": 0.0}, t) for k, t in enumerate(times_ns)
    ]
    log = open_log(write_mcap(tmp_path / "a", [*messages, *drive]))
    assert log.odometry is not None
    assert log.odometry.clock_s == pytest.approx(-off_s - 0.03)
    assert log.odometry.odom_T_base.stamps_ns[0] == pytest.approx(START_NS, abs=31e6)
    side = "ahead of" if off_s > 0 else "behind"
    assert any(f"{side} those of the scans, by the times of recording" in text for text in log.warnings)


def test_odometry_that_is_late_but_stamped_right_keeps_its_stamps(tmp_path: Path) -> None:
    times_ns = [START_NS + k * PERIOD_NS for k in range(100)]
    drive = [
        Message("/odom", ODOM, t, {"x": 0.01 * k, "y": 0.0, "yaw": 0.0}, t + k // 50 * 5 * 10**9)
        for k, t in enumerate(times_ns)
    ]
    log = open_log(write_mcap(tmp_path / "a", [*(at(k, t) for k, t in enumerate(times_ns)), *drive]))
    assert log.odometry is not None
    assert log.odometry.clock_s == 0.0
    assert np.array_equal(log.odometry.odom_T_base.stamps_ns, times_ns)


@pytest.mark.parametrize("stamp_ns", [0, START_NS])
def test_odometry_whose_stamps_never_change_is_dated_by_its_recording(stamp_ns: int, tmp_path: Path) -> None:
    times_ns = [START_NS + k * PERIOD_NS for k in range(30)]
    drive = [Message("/odom", ODOM, stamp_ns, {"x": 0.01 * k, "y": 0.0, "yaw": 0.0}, t) for k, t in enumerate(times_ns)]
    log = open_log(write_mcap(tmp_path / "a", [*(at(k, t, t + 7) for k, t in enumerate(times_ns)), *drive]))
    assert log.odometry is not None
    assert log.odometry.odom_T_base.stamps_ns.tolist() == pytest.approx(times_ns, abs=10)
    assert any("/odom: its stamps never change" in text for text in log.warnings)


def test_scans_of_one_time_are_no_log(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [at(k, START_NS, START_NS) for k in range(20)])
    with pytest.raises(NoScansError, match="all 20 scans on /scan have one stamp"):
        open_log(path)
    assert open_log(write_mcap(tmp_path / "b", [laser(0)])).counts.usable == 1


def test_a_log_that_repeats_itself_is_read_once(tmp_path: Path) -> None:
    times_ns = [START_NS + k * PERIOD_NS for k in range(100)]
    messages = [at(k, t, t + again * 60 * 10**9) for again in (0, 1) for k, t in enumerate(times_ns)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert (log.counts.usable, log.stamp_source) == (100, "header")


@pytest.mark.parametrize("size", [2, 3, 5, 10])
def test_the_period_of_scans_in_bursts_is_that_of_the_laser(size: int) -> None:
    times_ms = np.arange(400) // size * size * 100.0 + np.arange(400) % size * 0.8
    times_ms[200:] += 7000.0
    stamps_ns = (times_ms * 1e6).astype(np.int64)
    period_s, gaps = period_and_gaps(stamps_ns)
    assert comes_in_bursts(stamps_ns)
    assert period_s == pytest.approx(0.1, rel=0.08)
    assert [gap.duration_s > 7.0 for gap in gaps] == [True]


@pytest.mark.parametrize("steps_ms", [[10.0, 10.0], [100.0, 100.0], [100.0, 2000.0], [25.0, 3.0, 25.0, 25.0]])
def test_scans_one_by_one_are_no_bursts(steps_ms: list[float]) -> None:
    stamps_ns = (np.cumsum(np.resize(steps_ms, 200)) * 1e6).astype(np.int64)
    assert not comes_in_bursts(stamps_ns)
    assert period_and_gaps(stamps_ns)[0] == np.median(np.diff(stamps_ns)) * 1e-9


def test_a_log_with_stamps_in_bursts_says_so(tmp_path: Path) -> None:
    stamps_ns = [START_NS + k // 4 * 4 * PERIOD_NS + k % 4 * 800_000 for k in range(60)]
    messages = [at(k, stamp_ns) for k, stamp_ns in enumerate(stamps_ns)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert log.period_s == pytest.approx(0.1, rel=0.1)
    assert log.counts.usable == 60
    assert any("come in bursts" in text for text in log.warnings)


def test_a_stamp_of_zero_is_no_time_where_the_others_tell_the_date(tmp_path: Path) -> None:
    told = [0 if k in (0, 3) else START_NS + k * PERIOD_NS for k in range(6)]
    log = open_log(write_mcap(tmp_path / "a", [at(k, stamp, START_NS + k * PERIOD_NS) for k, stamp in enumerate(told)]))
    assert log.counts.skipped == {"impossible_stamp": 2}
    assert log.duration_s == pytest.approx(4 * PERIOD_NS * 1e-9)


def test_a_clock_may_count_from_zero(tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", [at(k, k * PERIOD_NS, START_NS + k * PERIOD_NS) for k in range(6)]))
    assert (log.counts.usable, log.first_ns, log.stamp_source) == (6, 0, "header")


def stamps_of(path: Path) -> list[int]:
    return [(s.stamp_ns - START_NS) // PERIOD_NS for s in open_log(path).scans()]


def test_one_stamp_from_the_future_costs_one_scan(tmp_path: Path) -> None:
    stamps = [START_NS + k * PERIOD_NS for k in range(6)]
    messages = [at(k, stamps[k] if k != 2 else stamps[k] + 10**15, stamps[k]) for k in range(6)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert (log.stamp_source, log.counts.usable, log.counts.skipped) == ("header", 5, {"backward_stamp": 1})


def test_scans_that_lie_in_the_file_out_of_order_come_in_the_order_of_recording(tmp_path: Path) -> None:
    """Chunks and files may be swapped; what was recorded in order is used in order, each with its own ranges."""
    order = [5, 6, 7, 0, 1, 2, 4, 3, 9, 8]
    path = write_mcap(tmp_path / "a", [laser(k) for k in order])
    assert stamps_of(path) == list(range(10))
    sound = write_mcap(tmp_path / "b", [laser(k) for k in range(10)])
    both = [[s.ranges_m.tobytes() for s in open_log(p).scans()] for p in (path, sound)]
    assert both[0] == both[1]


def test_the_order_of_the_file_wins_where_that_of_recording_keeps_as_many(tmp_path: Path) -> None:
    stamps, recorded = (0, 2, 1), (1, 0, 2)
    messages = [
        at(k, START_NS + n * PERIOD_NS, START_NS + m * PERIOD_NS)
        for k, (n, m) in enumerate(zip(stamps, recorded, strict=True))
    ]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert [(s.stamp_ns - START_NS) // PERIOD_NS for s in log.scans()] == [0, 2]


def test_a_file_far_out_of_order_is_read_several_times_in_bounded_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavnav.logs.log._MOST_WAITING", 3)
    monkeypatch.setattr("mavnav.logs.log._WAITING_BYTES", 0)
    assert stamps_of(write_mcap(tmp_path / "a", [laser(k) for k in reversed(range(20))])) == list(range(20))


def test_a_step_back_of_the_clock_is_no_disorder(tmp_path: Path) -> None:
    """The recorder's order is right here: the scans' own stamps repeat a stretch, which is skipped."""
    stamps = [*range(10), *range(7, 15)]
    messages = [at(k, START_NS + s * PERIOD_NS, START_NS + k * PERIOD_NS) for k, s in enumerate(stamps)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert log.counts.skipped == {"backward_stamp": 3}
    assert [s.stamp_ns for s in log.scans()] == [START_NS + k * PERIOD_NS for k in range(15)]


@pytest.mark.parametrize(("frozen", "told"), [((), False), ((5,), True), ((5, 6, 7), True)])
def test_scans_that_repeat_the_one_before_are_told(frozen: tuple[int, ...], told: bool, tmp_path: Path) -> None:
    scans = [laser(4 if k in frozen else k) for k in range(50)]
    messages = [Message(m.topic, m.type, START_NS + k * PERIOD_NS, m.fields) for k, m in enumerate(scans)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert log.counts.repeated == len(frozen)
    assert any(f"{len(frozen)} of 50 scans repeat the one before" in w for w in log.warnings) == told
    assert len(list(log.scans())) == 50


def test_that_a_slow_sweep_is_no_other_clock(tmp_path: Path) -> None:
    """A scan is recorded when its sweep ends, and odometry at once."""
    sweep_ns = 2 * 10**9
    messages = [
        Message("/odom", ODOM, START_NS + k * 10**8, {"x": 0.01 * k, "y": 0.0, "yaw": 0.0}, START_NS + k * 10**8)
        for k in range(400)
    ]
    for k in range(15):
        stamp_ns = START_NS + k * sweep_ns
        scan = laser(k, beams=360, time_increment=2 / 360, scan_time=2.0, angle_increment=0.01745, angle_max=6.266)
        messages.append(Message(scan.topic, scan.type, stamp_ns, scan.fields, stamp_ns + sweep_ns))
    log = open_log(write_mcap(tmp_path / "a", sorted(messages, key=lambda message: message.time_ns)))
    assert log.odometry is not None
    assert not [text for text in log.warnings if "synchronize" in text]
    assert log.odometry.odom_T_base.stamps_ns[0] == START_NS
