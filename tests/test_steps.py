"""What a reader of the trajectory is told about gaps and jumps."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mavnav.matcher import first_match, no_match
from mavnav.pose import Pose
from mavnav.steps import LostInterval, Step, lost_intervals

MS = 1_000_000


def step(ms: int, x_m: float, yaw_rad: float = 0.0, *, tracked: bool = True) -> Step:
    pose = Pose(x_m, 0.0, yaw_rad)
    match = replace(first_match(100) if tracked else no_match(pose), map_T_laser=pose)
    return Step(ms // 100, ms * MS, pose, match, tracked, tracked)


@pytest.mark.parametrize(("x_m", "yaw_rad"), [(5.9, 0.0), (0.1, 1.5)])
def test_a_jump_between_two_scans_is_marked(x_m: float, yaw_rad: float) -> None:
    steps = [step(0, 0.0), step(100, 0.1), step(200, x_m, yaw_rad), step(300, x_m, yaw_rad)]
    assert list(lost_intervals(steps)) == [LostInterval(100 * MS, 200 * MS, 0, recovered=True)]


@pytest.mark.parametrize(("ms", "x_m"), [(100, 0.3), (400, 1.0)])
def test_a_way_that_a_vehicle_can_make_is_none(ms: int, x_m: float) -> None:
    assert list(lost_intervals([step(0, 0.0), step(ms, x_m)])) == []


def test_a_jump_over_one_scan_is_a_gap_of_one() -> None:
    steps = [step(0, 0.0), step(100, 0.0, tracked=False), step(200, 0.6)]
    assert list(lost_intervals(steps)) == [LostInterval(100 * MS, 100 * MS, 1, recovered=True)]
