"""The order in which beams are fired: found out by the turns, kept where nothing speaks against it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config, RobustConfig
from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.slam.doubt import judge
from mavnav.slam.matching.scan_matching import Match, no_match
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.retries import beam_order
from mavnav.slam.retries.beam_order import STRETCH_SCANS, cost_ratio, reversed_scan, turning_stretch
from mavnav.slam.track import Track
from support.robots import cast_from
from support.synthetic import URG_04LX, along, furnished_rooms

SLOW = replace(URG_04LX, beams=171, angle_step_rad=4 * URG_04LX.angle_step_rad, time_increment_s=0.095 / 171)
"""A sweep that takes all the time between two scans, so that a turn shears it."""


def at(cost_m2: float, yaw_rad: float = 0.0) -> Match:
    return no_match(Pose(0.0, 0.0, yaw_rad))._replace(cost_m2=cost_m2)


def _counted(function: Callable[..., Any], calls: list[object]) -> Callable[..., Any]:
    def counting(*args: Any, **options: Any) -> Any:
        calls.append(args)
        return function(*args, **options)

    return counting


@pytest.fixture(scope="module")
def sweeps() -> list[Scan]:
    """Return sweeps of a laser that turns on its way: every beam is cast from where the laser is by then."""
    path = along([(1.0, 0.8), (4.9, 0.8), (4.6, 2.9), (4.6, 1.2)], speed_m_s=0.6, turn_rad_s=2.0)
    rng = np.random.default_rng(0)
    scans = []
    for k in range(1, len(path)):
        step = path[k - 1].between(path[k])
        late = (np.arange(SLOW.beams) - (SLOW.beams - 1) / 2) * SLOW.time_increment_s / 0.1
        moved = np.array([path[k] @ Pose(*(share * np.array(step)).tolist()) for share in late])
        ranges = cast_from(furnished_rooms(), moved[:, :2], SLOW.angles_rad + moved[:, 2])
        ranges[(ranges < SLOW.range_min_m) | (ranges > SLOW.range_max_m)] = np.nan
        ranges *= 1.0 + 0.005 * rng.standard_normal(len(ranges))
        scans.append(Scan(int(path.stamps_ns[k]), ranges, SLOW))
    return scans


@pytest.fixture(scope="module")
def right(sweeps: list[Scan]) -> tuple[SlamResult, int]:
    """Return the run of the sweeps as they are, and how many tracks it took."""
    return run_of(sweeps)


@pytest.fixture(scope="module")
def wrong(sweeps: list[Scan]) -> tuple[SlamResult, int]:
    """Return the run of the sweeps in the wrong order, and how many tracks it took."""
    return run_of([reversed_scan(scan) for scan in sweeps])


def run_of(scans: list[Scan]) -> tuple[SlamResult, int]:
    tracks: list[object] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Track, "over", _counted(Track.over, tracks))
        patch.setattr(judge, "UNDECIDED", (1.0, 1.0))
        return run_slam(lambda: scans, Config(), 0.1), len(tracks)


def test_the_right_order_is_kept(right: tuple[SlamResult, int]) -> None:
    assert right[0].warnings == ()


def test_a_wrong_order_is_found_out_and_said(right: tuple[SlamResult, int], wrong: tuple[SlamResult, int]) -> None:
    (warning,) = wrong[0].warnings
    assert "reverse" in warning
    np.testing.assert_array_equal(wrong[0].trajectory.xyyaw, right[0].trajectory.xyyaw)


def test_the_map_decides_with_odometry_too(
    sweeps: list[Scan], right: tuple[SlamResult, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(beam_order, "cost_ratios", lambda *_: pytest.fail("both orders were tracked"))
    outcome = run_slam(lambda: sweeps, Config(loop_closure="off"), 0.1, right[0].trajectory)
    assert outcome.odometry is not None
    assert outcome.warnings == ()


@pytest.mark.parametrize(
    "config",
    [Config(robust=RobustConfig(deskew="on")), Config(robust=RobustConfig(deskew="off")), Config(method="paper")],
)
def test_only_auto_tries_both_orders(sweeps: list[Scan], config: Config, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beam_order, "turning_stretch", lambda _: pytest.fail("it was looked for"))
    run_slam(lambda: sweeps[:9], config, 0.1)


def test_the_stretch_is_where_the_laser_turns() -> None:
    turning = 0.1 * np.arange(STRETCH_SCANS)
    stretch = turning_stretch(np.pad(turning, (100, 50), "edge"))
    assert len(stretch) == STRETCH_SCANS
    assert set(range(102, 175)) <= set(stretch)


@pytest.mark.parametrize("yaws", [[], [0.0], [0.0] * 200, [0.01 * k for k in range(100)]], ids=len)
def test_a_laser_that_hardly_turns_tells_nothing(yaws: list[float]) -> None:
    assert len(turning_stretch(np.array(yaws))) == 0


def test_only_scans_that_match_in_both_orders_are_compared() -> None:
    assert cost_ratio([(at(1.0), at(2.0)), (at(3.0), at(4.0)), (at(np.inf), at(0.1))]) == 1.5
    assert np.isnan(cost_ratio([(at(np.inf), at(0.8))] * 5))


def test_no_turn_across_a_gap_is_compared() -> None:
    apart_s = np.full(99, 0.1)
    yaws = 0.02 * np.arange(100)
    yaws[60:] += 2.0
    assert 59 in turning_stretch(yaws, 20, 0.0)
    apart_s[59] = 0.6
    assert list(turning_stretch(yaws, 20, 0.0, apart_s)) == list(range(20))
    apart_s[[9, 59]] = 2.0
    assert list(turning_stretch(yaws, 20, 0.0, apart_s)) == list(range(10, 30))


def test_the_right_order_is_tracked_once_and_a_wrong_one_tried(
    right: tuple[SlamResult, int], wrong: tuple[SlamResult, int]
) -> None:
    assert right[1] == 1
    assert wrong[1] == 4  # as listed, both in a trial, and the whole log again
