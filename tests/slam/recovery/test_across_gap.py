"""A part of a log is placed by what was seen on either side of the gap beside it, or not at all."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose
from mavnav.scan import LaserSpec, Scan
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import first_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods.pauses import LEAST_SPEED_M_S, highest_speeds
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import run_slam
from mavnav.slam.recovery import across_gap, parts
from mavnav.slam.recovery.across_gap import LONGEST_GAP_S, motion_across, pose_across_gap, reach_across
from mavnav.slam.recovery.parts import is_reached, join_parts
from mavnav.slam.track import Track
from mavnav.units import DEG, NS
from support.synthetic import TOUR, Recording, along, box, furnished_rooms, polyline, record, room

SPEC = LaserSpec(-2 * np.pi / 3, np.pi / 180, 241, 0.05, 5.0)
MAP, PART = Pose(), Pose(3.0, -2.0, 1.0)
FAST = (0.6, 1.5)
FIRST, LAST = 70, 95
"""Numbers of the scans beside the gap: the laser moves by a meter and turns by 90 deg across a corner."""


@cache
def drive() -> Recording:
    return record(furnished_rooms(), along(TOUR[:4], speed_m_s=0.6), SPEC, 0.003)


def side(numbers: range, frame: Pose = MAP) -> list[Step]:
    """Return steps at the true poses, in the frame of a map."""
    poses, scans = drive().map_T_laser, drive().scans
    at = (first_match(241)._replace(map_T_laser=frame @ poses[k]) for k in numbers)
    return [Step(k, scans[k].stamp_ns, match, tracked=True) for k, match in zip(numbers, at, strict=True)]


def track(motion: Motion = Motion(0.1)) -> Track:  # noqa: B008
    return Track(lambda: (), Config(), motion, make_method(Config()))


def placed(here: list[Step], beyond: list[Step], fastest: tuple[float, float] = FAST) -> Pose | None:
    return pose_across_gap(here, beyond, dict(enumerate(drive().scans)), track(), fastest)


@pytest.mark.parametrize("backwards", [False, True])
def test_what_both_sides_see_places_a_part(*, backwards: bool) -> None:
    before, after = range(FIRST, FIRST - 20, -1), range(LAST, LAST + 20)
    here, beyond = (after, before) if backwards else (before, after)
    pose = placed(side(here), side(beyond, PART))
    assert pose is not None
    off_m, off_rad = PART.inverse().gap(pose)
    assert off_m < 0.03
    assert off_rad < 1.0 * DEG


def test_a_part_is_not_placed_where_the_laser_cannot_be() -> None:
    before, after = side(range(FIRST, FIRST - 20, -1)), side(range(LAST, LAST + 20), PART)
    assert placed(before, after, (0.02, 1.5)) is None
    assert placed(before, after, (0.6, 0.02)) is None


def test_after_a_long_gap_the_laser_can_be_anywhere() -> None:
    before, after = side(range(FIRST, FIRST - 20, -1)), side(range(LAST, LAST + 20), PART)
    late_ns = round(LONGEST_GAP_S / NS)
    assert placed(before, [step._replace(stamp_ns=step.stamp_ns + late_ns) for step in after]) is None


def test_another_room_is_not_placed() -> None:
    walls = np.vstack((room(3.0, 2.2), box(1.0, 1.4, 0.4, 0.3), box(2.4, 0.3, 0.3, 0.5, 0.4)))
    other = record(walls, along([(0.6, 0.6), (2.2, 0.8)], speed_m_s=0.6), SPEC, 0.003)
    scans: dict[int, Scan] = dict(enumerate(drive().scans))
    scans |= {1000 + k: scan for k, scan in enumerate(other.scans)}
    beyond = [
        Step(1000 + k, scans[LAST + k].stamp_ns, first_match(241)._replace(map_T_laser=other.map_T_laser[k]), True)
        for k in range(20)
    ]
    assert pose_across_gap(side(range(FIRST, FIRST - 20, -1)), beyond, scans, track(), FAST) is None


def steps_along(poses: list[Pose], times_s: list[float]) -> list[Step]:
    at = (first_match(9)._replace(map_T_laser=pose) for pose in poses)
    return [Step(k, round(t / NS), match, True) for k, (t, match) in enumerate(zip(times_s, at, strict=True))]


@pytest.mark.parametrize("turn_rad_s", [0.0, 0.4])
def test_the_likely_motion_goes_on_as_before_and_then_as_after(turn_rad_s: float) -> None:
    def ahead(speed_m_s: float, time_s: float) -> Pose:
        half = Pose(yaw_rad=0.5 * turn_rad_s * time_s)
        return half @ Pose(speed_m_s * time_s) @ half

    before = steps_along([ahead(1.0, 0.4).inverse(), Pose()], [0.6, 1.0])
    after = steps_along([PART, PART @ ahead(0.2, 0.4)], [3.0, 3.4])
    moved = motion_across(before[::-1], after)
    assert moved == pytest.approx(ahead(1.0, 1.0) @ ahead(0.2, 1.0))
    assert motion_across(after, before[::-1]) == pytest.approx(moved.inverse())


def test_the_likely_motion_beside_one_pose_is_rest_there() -> None:
    before, after = steps_along([Pose(-0.4), Pose()], [0.6, 1.0]), steps_along([PART], [3.0])
    assert motion_across(before[::-1], after) == pytest.approx(Pose(1.0))
    assert motion_across(after, after) == Pose()


def test_the_velocity_tells_places_apart_that_look_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns stand every meter along a corridor: a part was joined a meter away."""
    walls = [polyline((0.0, -0.8), (14.0, -0.8)), polyline((0.0, 0.8), (14.0, 0.8))]
    walls += [box(x_m, side * 0.7, 0.2, 0.2) for x_m in np.arange(0.5, 14.0) for side in (-1.0, 1.0)]
    spec = replace(SPEC, range_max_m=2.5)
    log = record(np.vstack(walls), along([(4.0, 0.0), (10.0, 0.0)], speed_m_s=0.6), spec, 0.003)
    scans, at = dict(enumerate(log.scans)), log.map_T_laser
    steps = steps_along([at[k] for k in range(len(at))], (at.stamps_ns * NS).tolist())
    beyond = [s._replace(match=s.match._replace(map_T_laser=PART @ s.match.map_T_laser)) for s in steps[40:80]]

    def off_m() -> float:
        pose = pose_across_gap(steps[36::-1], beyond, scans, track(), FAST)
        assert pose is not None
        return PART.inverse().gap(pose)[0]

    assert off_m() < 0.05
    monkeypatch.setattr(across_gap, "MOTION_WEIGHT", 0.0)
    assert off_m() == pytest.approx(1.0, abs=0.05)


def test_a_part_with_one_possible_pose_is_placed_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without another pose to compare it with, the run ended with an error."""
    here, beyond = side(range(FIRST, FIRST - 20, -1)), side(range(LAST, LAST + 20), PART)
    pose = placed(here, beyond)
    monkeypatch.setattr(across_gap, "apart", lambda *_: False)
    assert placed(here, beyond) == pose
    assert pose is not None


def test_odometry_says_where_the_laser_can_be() -> None:
    here, beyond = side(range(FIRST, FIRST + 1))[0], side(range(LAST, LAST + 1))[0]
    moved = {here.stamp_ns: Pose(), beyond.stamp_ns: Pose(4.0, 0.0, 1.0)}
    reach = reach_across(here, beyond, track(Motion(0.1, moved.get)), FAST)
    assert reach.includes(here.match.map_T_laser @ Pose(4.9, 0.0, 1.0))
    assert not reach.includes(here.match.map_T_laser @ Pose(5.8, 0.0, 1.0))
    assert not reach.includes(here.match.map_T_laser @ Pose(4.0, 0.0, 2.0))
    assert not reach.includes(here.match.map_T_laser)


@pytest.mark.parametrize(("x_m", "reached"), [(1.0, True), (21.8, False)])
def test_no_vehicle_leaps(x_m: float, *, reached: bool) -> None:
    """A part 0.5 s later was joined 21.8 m away, on another corridor that looks the same."""
    here, later = (first_match(241)._replace(map_T_laser=Pose()) for _ in range(2))
    steps = Steps((Step(0, 0, here, True), Step(1, 500_000_000, later, False)))
    fast = replace(track(Motion(0.1, fastest=(3.0, 5.0))), steps=steps)
    assert is_reached([steps[1]], Pose(x_m), steps, fast) == reached


def test_a_part_whose_scans_have_poses_already_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The beginning of a log was a part, and matched backwards since: placed by odometry, it ended the run."""
    steps = side(range(5))
    monkeypatch.setattr(parts, "_next_placed", lambda waiting, *_: (waiting[0], Pose(), 0.1) if waiting else None)
    whole = replace(track(), log_scans=lambda: iter(drive().scans), steps=Steps(steps))
    joined = join_parts(whole, [tuple(steps[:3])])
    assert list(joined.steps) == steps
    assert not joined.findings.warnings


def test_a_cut_at_a_door_loses_no_log() -> None:
    """Few walls of one side are seen from the other: the parts before and after the door were not joined."""
    full = record(furnished_rooms(), along(TOUR[:7], speed_m_s=0.8), replace(SPEC, range_max_m=4.0), 0.003)
    kept = [scan for k, scan in enumerate(full.scans) if not 70 < k < 92]
    run, truth = run_slam(lambda: iter(kept), Config(), 0.1), full.map_T_laser
    assert run.tracked_share == 1.0
    moved = run.trajectory[0].between(run.trajectory[len(run.trajectory) - 1])
    off_m, off_rad = moved.gap(truth[0].between(truth[len(truth) - 1]))
    assert off_m < 0.05
    assert off_rad < 1.0 * DEG


def test_the_highest_speed_is_that_over_a_second() -> None:
    rng = np.random.default_rng(0)
    stamps_ns = np.cumsum(rng.integers(50_000_000, 150_000_000, 200)).tolist()
    poses = [Pose(*xyyaw) for xyyaw in np.cumsum(rng.normal(0.0, 0.1, (200, 3)), axis=0).tolist()]
    steps = [Step(k, ns, first_match(9)._replace(map_T_laser=poses[k]), True) for k, ns in enumerate(stamps_ns)]
    speeds = []
    for a in steps:
        b = next((b for b in steps if b.stamp_ns - a.stamp_ns >= 10**9), None)
        if b:
            moved = a.match.map_T_laser.between(b.match.map_T_laser)
            elapsed_s = (b.stamp_ns - a.stamp_ns) * NS
            speeds.append((np.hypot(moved.x_m, moved.y_m) / elapsed_s, abs(moved.yaw_rad) / elapsed_s))
    assert highest_speeds(steps) == pytest.approx(np.quantile(speeds, 0.99, axis=0))
    still = [step._replace(match=first_match(9)) for step in steps]
    assert highest_speeds(still) == (LEAST_SPEED_M_S, LEAST_SPEED_M_S)
    assert highest_speeds([]) == (LEAST_SPEED_M_S, LEAST_SPEED_M_S)
