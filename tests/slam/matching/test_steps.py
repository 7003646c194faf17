"""What a reader of the trajectory is told about gaps and jumps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavnav.pose import Pose
from mavnav.slam.matching.scan_matching import Match, first_match, no_match
from mavnav.slam.matching.steps import LostInterval, Step, Steps, lost_intervals, tracked_trajectory
from mavnav.slam.result import few_beams_warnings, scattered_warnings

if TYPE_CHECKING:
    from collections.abc import Callable

MS = 1_000_000

numbers, counts, poses = st.floats(allow_nan=False), st.integers(0, 2**62), st.builds(Pose, *3 * [st.floats(-9e9, 9e9)])
matches = st.builds(
    Match,
    poses,
    numbers,
    counts,
    numbers,
    counts,
    counts,
    st.booleans(),
    numbers,
    numbers,
    st.booleans(),
    *3 * [numbers],
)
stamps_ns = st.integers(-(2**62), 2**62)


@given(st.lists(st.builds(Step, counts, stamps_ns, matches, st.booleans()), max_size=5))
def test_packed_steps_are_the_steps(steps: list[Step]) -> None:
    packed = Steps(steps)
    assert list(packed) == list(Steps(packed)) == packed[:] == steps
    assert [packed[k - len(steps)] for k in range(len(steps))] == steps
    assert packed.column("tracked").tolist() == [s.tracked for s in steps]
    assert packed.column("evaluations").tolist() == [s.match.evaluations for s in steps]
    way = tracked_trajectory(packed)
    assert [(way.stamps_ns[k], way[k]) for k in range(len(way))] == [
        (s.stamp_ns, s.match.map_T_laser) for s in steps if s.tracked
    ]


def test_a_packed_step_gives_way_to_another() -> None:
    packed = Steps([step(0, 0.0), step(100, 0.1), step(200, 0.2)])
    packed[-2] = step(150, 0.7)
    packed.append(step(300, 0.3))
    assert list(packed) == [step(0, 0.0), step(150, 0.7), step(200, 0.2), step(300, 0.3)]
    with pytest.raises(IndexError):
        packed[4]


def step(ms: int, x_m: float, yaw_rad: float = 0.0, *, tracked: bool = True) -> Step:
    pose = Pose(x_m, 0.0, yaw_rad)
    match = (first_match(100) if tracked else no_match(pose))._replace(map_T_laser=pose)
    return Step(ms // 100, ms * MS, match, tracked)


@pytest.mark.parametrize(("x_m", "yaw_rad"), [(5.9, 0.0), (0.1, 1.5)])
def test_a_jump_between_two_scans_is_marked(x_m: float, yaw_rad: float) -> None:
    steps = [step(0, 0.0), step(100, 0.1), step(200, x_m, yaw_rad), step(300, x_m, yaw_rad)]
    assert list(lost_intervals(Steps(steps))) == [LostInterval(100 * MS, 200 * MS, 0, recovered=True)]


@pytest.mark.parametrize(("ms", "x_m"), [(100, 0.3), (400, 1.0)])
def test_a_way_that_a_vehicle_can_make_is_none(ms: int, x_m: float) -> None:
    assert list(lost_intervals(Steps([step(0, 0.0), step(ms, x_m)]))) == []


def test_a_jump_over_one_scan_is_a_gap_of_one() -> None:
    steps = [step(0, 0.0), step(100, 0.0, tracked=False), step(200, 0.6)]
    assert list(lost_intervals(Steps(steps))) == [LostInterval(100 * MS, 100 * MS, 1, recovered=True)]


@pytest.mark.parametrize(
    ("before", "lost", "after", "told"),
    [(3, 4, 2, 0), (3, 5, 2, 5), (0, 5, 2, 5), (3, 4, 0, 0), (3, 5, 0, 5), (0, 3, 0, 3)],
)
def test_five_scans_without_a_pose_are_lost_and_found_again_if_one_follows(
    before: int, lost: int, after: int, told: int
) -> None:
    steps = [step(100 * k, 0.0, tracked=not before <= k < before + lost) for k in range(before + lost + after)]
    start_ns, end_ns = 100 * MS * before, 100 * MS * (before + lost - 1)
    expected = [LostInterval(start_ns, end_ns, told, recovered=after > 0)] if told else []
    assert list(lost_intervals(Steps(steps))) == expected


def test_scans_that_match_nowhere_all_over_the_log_are_reported() -> None:
    def warnings(is_tracked: Callable[[int], bool]) -> list[str]:
        steps = Steps(Step(k, k, first_match(100)._replace(evaluations=9), is_tracked(k)) for k in range(100))
        return list(scattered_warnings(steps, list(lost_intervals(steps))))

    (text,) = warnings(lambda k: k % 2 == 0)
    assert text.startswith("50 of 100 scans, spread over the log, match nowhere: two lasers on one topic")
    assert not warnings(lambda k: k % 10 > 0)
    assert not warnings(lambda k: k < 40)  # lost, which is reported elsewhere


@pytest.mark.parametrize(("points", "few"), [(45, True), (69, True), (70, False), (500, False)])
def test_scans_of_few_points_are_reported(points: int, *, few: bool) -> None:
    steps = Steps(Step(k, k, first_match(points), tracked=True) for k in range(20))
    found = list(few_beams_warnings(steps, "record odometry"))
    assert bool(found) == few
    assert all(text.endswith("check the map, or record odometry") for text in found)
    assert all(text.endswith("check the map") for text in few_beams_warnings(steps, ""))
    missed = Steps(Step(k, k, first_match(points), tracked=False) for k in range(20))
    assert not list(few_beams_warnings(missed, ""))
