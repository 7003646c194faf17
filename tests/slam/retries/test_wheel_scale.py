"""The scale of wheels, from what matches ask for beside them."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.pose import Pose, correct_path
from mavnav.slam.findings import TrackedAgain
from mavnav.slam.matching.fusion import Evidence, longer_than_predicted
from mavnav.slam.matching.scan_matching import first_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.retries.wheel_scale import STRETCHES, Longer, longer_than_wheels, next_scale
from support.synthetic import Recording, corridor

DOORS = np.arange(3.0, 38.0, 3.1)
"""Where the doors of a corridor are, m."""


def replayed(recording: Recording, scale: float) -> SlamResult:
    wheels = correct_path(recording.map_T_laser, 0, scale, 1.0)
    return run_slam(lambda: recording.scans, Config(), 0.1, wheels)


def steps_of(longer: list[float], weights: list[float]) -> Steps:
    pairs = zip(longer, weights, strict=True)
    matches = (first_match(300)._replace(longer=some, longer_weight=weight) for some, weight in pairs)
    return Steps(Step(k, k, match, tracked=True) for k, match in enumerate(matches))


@pytest.mark.parametrize("scale", [0.8, 1.1])
def test_wheels_that_count_wrong_are_scaled_past_flat_doors(scale: float) -> None:
    recording = corridor(DOORS)
    result = replayed(recording, scale)
    ends = result.trajectory[0].between(result.trajectory[-1])
    assert ends.distance_m == pytest.approx(26.0, abs=0.15)
    assert result.odometry.distance_scale == pytest.approx(1.0 / scale, rel=0.01)
    assert TrackedAgain("scaled wheels", kept=True) in result.attempts


def test_right_wheels_are_not_scaled() -> None:
    result = replayed(corridor(DOORS), 1.0)
    assert result.odometry.distance_scale == pytest.approx(1.0, abs=0.01)
    assert "scaled wheels" not in [attempt.name for attempt in result.attempts]


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, -2.0])
def test_the_share_is_what_the_match_asks_for_along_the_motion(yaw_rad: float) -> None:
    before, along_m = Pose(3.0, -1.0, yaw_rad), np.array((np.cos(yaw_rad), np.sin(yaw_rad)))
    predicted = before @ Pose(0.2)
    matched = predicted @ Pose(0.03, 0.05, 0.01)
    hessian = 50.0 * np.eye(3)
    share, weight = longer_than_predicted(Evidence(hessian, np.zeros(3), np.eye(3)), matched, predicted, before)
    assert share == pytest.approx(0.03 / 0.2)
    pulled = Evidence(hessian, np.append(1.0 * along_m, 0.0), np.eye(3))
    assert longer_than_predicted(pulled, matched, predicted, before)[0] == pytest.approx((0.03 + 0.02) / 0.2, rel=1e-4)
    open_along = Evidence(hessian - 49.9 * np.diag((*(along_m**2), 0.0)), np.zeros(3), np.eye(3))
    assert longer_than_predicted(open_along, matched, predicted, before)[1] < weight
    assert longer_than_predicted(pulled, matched, before, before) == (0.0, 0.0)


def test_all_stretches_that_ask_for_more_decide() -> None:
    longer = longer_than_wheels(steps_of([0.1] * 100, [1.0] * 100))
    assert longer == pytest.approx(Longer(0.1, 0.1))


def test_what_moves_along_for_a_while_decides_nothing() -> None:
    share = [0.0, 0.002, -0.002, 0.001] * 25
    share[:10], weights = [-1.0] * 10, [5.0] * 10 + [1.0] * 90
    assert longer_than_wheels(steps_of(share, weights)).share == 0.0


def test_few_stretches_that_walls_show_well_do_not_hide_the_others() -> None:
    share = [0.3] * 90 + [1.0] * 5 + [0.01] * 5
    assert longer_than_wheels(steps_of(share, [1.0] * 90 + [500.0] * 10)).share == pytest.approx(0.3)


def test_a_track_without_wheels_or_with_few_scans_asks_for_nothing() -> None:
    assert longer_than_wheels(steps_of([0.0] * 50, [0.0] * 50)) == Longer()
    assert longer_than_wheels(steps_of([0.5] * (STRETCHES - 1), [1.0] * (STRETCHES - 1))) == Longer()
    assert longer_than_wheels(Steps()) == Longer()


def test_the_next_scale_is_between_one_too_small_and_one_too_large() -> None:
    assert next_scale({1.0: 0.1}) == pytest.approx(1.05)
    assert next_scale({1.0: -0.9}) == pytest.approx(0.7)
    assert next_scale({1.0: 0.1, 1.2: -0.3}) == pytest.approx(1.05)
    assert next_scale({1.0: 0.1, 1.05: 0.1}) == pytest.approx(1.05 * 1.1)
