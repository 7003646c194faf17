"""The scan filter: every kind of odd range, and scans that cannot be used."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavnav.logs.messages.definitions import LaserMessage
from mavnav.logs.preprocessing import FARTHEST_M, KINDS, ScanFilter, clean

NAN, INF = math.nan, math.inf


def kind_of(r: float, low: float, high: float) -> str:
    """The slow obvious twin: one range after the other, in the order of REP-117."""
    if low <= r <= min(high, FARTHEST_M) and r != 0:
        return "valid"
    if math.isinf(r):
        return "minus_inf" if r < 0 else "plus_inf"
    if math.isnan(r):
        return "nan"
    if r == 0:
        return "zero"
    if r < 0:
        return "negative"
    return "below_min" if r < low else "above_max"


any_range = st.one_of(
    st.floats(width=32), st.sampled_from([0.0, -0.0, INF, -INF, NAN, 0.02, 5.6, 0.015, 81.83, -1.0]), st.floats(0, 10)
)


@given(
    ranges=st.lists(any_range, max_size=40),
    low=st.floats(0.0, 1.0),
    high=st.one_of(st.just(INF), st.floats(1.5, 100.0)),
)
def test_clean_agrees_with_its_twin(ranges: list[float], low: float, high: float) -> None:
    array = np.array(ranges, dtype=np.float64)
    before = array.copy()
    cleaned, counts = clean(array, low, high)
    kinds = [kind_of(r, low, high) for r in ranges]
    assert dict(zip(KINDS, counts, strict=True)) == {kind: kinds.count(kind) for kind in KINDS}
    np.testing.assert_array_equal(cleaned, [r if k == "valid" else NAN for r, k in zip(ranges, kinds, strict=True)])
    np.testing.assert_array_equal(array, before)


def test_limits_are_inclusive_in_the_precision_of_the_message() -> None:
    limits = np.array([0.02, 5.6], dtype=np.float32)
    _, counts = clean(limits, float(limits[0]), float(limits[1]))
    assert counts[KINDS.index("valid")] == 2


def message(**changes: object) -> LaserMessage:
    ranges = np.array([1.0, 2.0, 3.0], dtype=np.float32)
    return LaserMessage(0, "laser", -1.0, 1.0, 1.0, 0.1, 10.0, 0.0, 0.1, ranges)._replace(**changes)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"ranges_m": np.array([])}, "empty"),
        ({"angle_min_rad": NAN}, "non_finite_angle"),
        ({"angle_step_rad": INF}, "non_finite_angle"),
        ({"angle_step_rad": 0.0, "last_angle_rad": None}, "zero_angle_increment"),
        ({"angle_step_rad": 0.0, "last_angle_rad": -1.0}, "zero_angle_increment"),
        ({"angle_step_rad": 0.0, "last_angle_rad": NAN}, "zero_angle_increment"),
        ({"angle_step_rad": 4.0, "last_angle_rad": 7.0}, "impossible_geometry"),
        ({"angle_min_rad": 180.0}, "impossible_geometry"),
        ({"ranges_m": np.array([0.0, NAN, 99.0])}, "no_valid_beam"),
    ],
)
def test_unusable_scans_are_refused_with_the_reason(changes: dict[str, object], reason: str) -> None:
    assert ScanFilter("/scan", [].append).admit(message(**changes)) == reason


@pytest.mark.parametrize("limits", [(0.0, 0.0), (5.0, 1.0), (NAN, 10.0), (0.1, NAN), (-INF, INF)])
def test_unusable_limits_let_every_positive_range_pass_with_a_warning(limits: tuple[float, float]) -> None:
    warnings: list[str] = []
    ranges = np.array([0.0, 1e-3, 99.0, -1.0, INF])
    scan_filter = ScanFilter("/scan", warnings.append)
    spec, cleaned, _ = scan_filter.admit(message(ranges_m=ranges, range_min_m=limits[0], range_max_m=limits[1]))
    np.testing.assert_array_equal(cleaned, [NAN, 1e-3, 99.0, NAN, NAN])
    assert (spec.range_min_m, spec.range_max_m) == (0.0, INF)
    assert any("range limits" in w for w in warnings)


def test_a_maximum_that_stands_for_no_return_is_none_from_then_on() -> None:
    warnings: list[str] = []
    scan_filter = ScanFilter("/scan", warnings.append)
    few, many = np.full(600, 2.0), np.full(600, 2.0)
    few[:12] = many[:13] = 10.0
    counts = [
        dict(zip(KINDS, scan_filter.admit(message(ranges_m=r, angle_step_rad=0.001))[2], strict=True))
        for r in (few, many, few)
    ]
    assert [c["above_max"] for c in counts] == [0, 13, 12]
    assert [c["valid"] for c in counts] == [600, 587, 588]
    assert [w for w in warnings if "range_max" in w] == [
        "/scan: many ranges are range_max itself (10 m); from there on they are taken for no return"
    ]


def test_readings_of_a_sensor_without_a_limit_are_none_of_its_maximum() -> None:
    warnings: list[str] = []
    _, _, counts = ScanFilter("/scan", warnings.append).admit(
        message(ranges_m=np.repeat((INF, 1.0), 20), range_max_m=INF, angle_step_rad=0.01)
    )
    assert counts[KINDS.index("plus_inf")] == 20
    assert not [w for w in warnings if "range_max" in w]


def test_infinite_maximum_is_a_sensor_without_one() -> None:
    warnings: list[str] = []
    spec, _, _ = ScanFilter("/scan", warnings.append).admit(message(range_max_m=INF))
    assert (spec.range_min_m, spec.range_max_m, warnings) == (0.1, INF, [])


def test_number_of_beams_and_increment_are_believed_over_angle_max() -> None:
    warnings: list[str] = []
    spec, _, _ = ScanFilter("/scan", warnings.append).admit(message(last_angle_rad=3.0))
    assert (spec.beams, spec.angle_step_rad) == (3, 1.0)
    assert "angle_max" in warnings[0]


def test_one_beam_too_many_in_angle_max_is_no_news() -> None:
    warnings: list[str] = []
    ScanFilter("/scan", warnings.append).admit(message(last_angle_rad=2.0))
    assert warnings == []


def test_geometry_may_change_and_equal_ones_are_shared() -> None:
    warnings: list[str] = []
    scan_filter = ScanFilter("/scan", warnings.append)
    first, again = scan_filter.admit(message())[0], scan_filter.admit(message(stamp_ns=5))[0]
    other = scan_filter.admit(message(angle_step_rad=-0.5, last_angle_rad=-2.0))[0]
    assert first is again
    assert other.angle_step_rad == -0.5
    assert len(warnings) == 1
    assert "geometry" in warnings[0]


@pytest.mark.parametrize(
    ("ranges", "doubted"),
    [
        ([900, 1200, 2500, 3100, 4000], True),
        ([1, 300, 400, 500, 999], True),
        ([1, 300, 400, 999], False),  # half of them: the farthest may be a word for no return
        ([1, 999, 999, 999], False),
        ([0, -1, INF, NAN, 2], False),
    ],
)
def test_a_topic_in_millimetres_is_doubted(ranges: list[float], doubted: bool) -> None:
    scan_filter = ScanFilter("/scan", [].append)
    scan_filter.admit(message(ranges_m=np.array(ranges, float), range_max_m=5600.0))
    assert scan_filter.doubt.startswith("more than half of the ranges lie beyond 250 m") is doubted
    assert bool(scan_filter.doubt) is doubted


@pytest.mark.parametrize("step_rad", [0.0, 57.3, 4.0])
def test_an_increment_that_cannot_be_follows_from_the_first_and_the_last_angle(step_rad: float) -> None:
    warnings: list[str] = []
    admitted = ScanFilter("/scan", warnings.append).admit(message(angle_step_rad=step_rad, last_angle_rad=1.4))
    assert isinstance(admitted, tuple)
    assert admitted[0].angle_step_rad == pytest.approx(1.2)
    assert [text for text in warnings if "by angle_min, angle_max and 3 beams it is 1.2 rad" in text] == warnings


@pytest.mark.parametrize(
    ("factor", "limits", "units"),
    [
        (100, (10.0, 1200.0), "centimeters"),
        (100, (0.1, 12.0), "centimeters"),
        (1000, (100.0, 12_000.0), "millimeters"),
        (1000, (20.0, 5600.0), "centimeters or millimeters"),
        (1000, (0.1, 12.0), "millimeters"),
        (1000, (10.0, 12_000.0), "centimeters or millimeters"),
        (1000, (0.0, 65_535.0), "millimeters"),
        (1, (0.1, 12.0), ""),
        (1, (0.0, INF), ""),
        (1, (0.02, 65.0), ""),
        (1, (0.1, 1000.0), ""),
        (1, (0.9, 120.0), ""),
        (100, (20.0, 800.0), "centimeters"),  # of a room so small that few ranges are beyond 250
    ],
)
def test_the_unit_of_ranges_is_that_of_a_possible_laser(factor: int, limits: tuple[float, float], units: str) -> None:
    walls_m = np.linspace(0.6, 8.0 if limits[1] != 800.0 else 2.0, 50)
    scan_filter = ScanFilter("/scan", [].append)
    turn = message(ranges_m=factor * walls_m, angle_step_rad=0.1, last_angle_rad=3.9)
    scan_filter.admit(turn._replace(range_min_m=limits[0], range_max_m=limits[1]))
    assert f"they look like {units}, not meters" in scan_filter.doubt if units else scan_filter.doubt == ""


@pytest.mark.parametrize(
    ("limits", "warned"),
    [((1.0, 120.0), True), ((1.5, 56.0), True), ((0.9, 120.0), False), ((0.1, 12.0), False), ((10.0, 1200.0), False)],
)
def test_limits_that_may_be_in_decimeters_are_named(limits: tuple[float, float], warned: bool) -> None:
    warnings: list[str] = []
    turn = message(ranges_m=np.linspace(6.0, 30.0, 50), angle_step_rad=0.1, last_angle_rad=3.9)
    ScanFilter("/scan", warnings.append).admit(turn._replace(range_min_m=limits[0], range_max_m=limits[1]))
    assert any("are in decimeters; divide them by 10" in text for text in warnings) is warned


def test_a_topic_in_degrees_is_doubted_until_a_scan_is_sound() -> None:
    scan_filter, degrees = (
        ScanFilter("/scan", [].append),
        message(ranges_m=np.ones(241), angle_step_rad=1.0, last_angle_rad=120.0),
    )
    assert (scan_filter.admit(degrees), "look like degrees" in scan_filter.doubt) == ("impossible_geometry", True)
    scan_filter.admit(message())
    assert scan_filter.doubt == ""


@pytest.mark.parametrize(("turns", "sound"), [(1.05, True), (1.15, False), (2.0, False), (80.0, False)])
def test_a_scan_may_overlap_itself_a_little(turns: float, sound: bool) -> None:
    scan_filter = ScanFilter("/scan", [].append)
    turning = message(angle_step_rad=turns * math.tau / 2, last_angle_rad=None)
    assert isinstance(scan_filter.admit(turning), tuple) is sound
    assert scan_filter.doubt == ""


def test_a_scan_of_a_million_beams_is_thinned() -> None:
    warnings: list[str] = []
    ranges = np.linspace(1.0, 9.0, 1_000_000, dtype=np.float32)
    told = {"angle_step_rad": 2e-6, "time_increment_s": 1e-7, "last_angle_rad": 1.0, "ranges_m": ranges}
    spec, thinned, counts = ScanFilter("/scan", warnings.append).admit(message(**told))
    assert (spec.beams, sum(counts)) == (32259, 32259)
    assert thinned.tolist() == ranges[::31].astype(float).tolist()
    assert (spec.angle_step_rad, spec.time_increment_s) == pytest.approx((31 * 2e-6, 31e-7))
    assert warnings == ["/scan: a scan has more than 32768 beams; one of 31 is used"]
