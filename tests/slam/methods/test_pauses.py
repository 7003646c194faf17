"""After a pause in the scans without odometry, a place that looks like an earlier one is no evidence by itself."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory
from mavnav.scan import LaserSpec
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import first_match, no_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods.pauses import LATE_SCANS, Pauses, first_found_late, pause_warnings
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import run_slam
from mavnav.slam.recovery.parts import join_parts
from mavnav.slam.result import SlamResult
from mavnav.slam.track import Track
from mavnav.units import NS
from support.marks import slow
from support.synthetic import Recording, along, box, polyline, record, scan_at

S = 10**9
SPEC = LaserSpec(-np.pi * 2 / 3, np.pi / 180, 241, 0.05, 8.0)


def corridor(seed: int) -> np.ndarray:
    """Return a corridor of 70 m with alcoves at random, of which the part from 43 to 63 m is a copy of the first."""
    rng, walls = np.random.default_rng(seed), []
    for side, out in ((0.0, -1.0), (2.0, 1.0)):
        middles, widths = np.arange(1.5, 41.0, 2.0) + rng.uniform(-0.4, 0.4, 20), rng.uniform(0.2, 0.6, 20)
        points = [(0.0, side)]
        for middle, width in zip([*middles, *(middles[:10] + 42.0)], [*widths, *widths[:10]], strict=True):
            points += [(middle + dx * width, side + dy * out) for dx, dy in ((-1, 0), (-1, 0.3), (1, 0.3), (1, 0))]
        walls.append(polyline(*points, (70.0, side)))
    return np.vstack([*walls, polyline((0.0, 0.0), (0.0, 2.0)), polyline((70.0, 0.0), (70.0, 2.0))])


@cache
def drive(seed: int) -> Recording:
    return record(corridor(seed), along([(4.0, 1.0), (30.0, 1.1), (60.0, 1.0)], speed_m_s=1.0), SPEC, 0.002)


@cache
def drive_with_pause(seed: int, first_s: float, last_s: float, *, odometry: bool = False) -> tuple[SlamResult, float]:
    """Return the run of a drive down the corridor, and its largest error, m, with a pause in the scans."""
    full = drive(seed)
    start_ns = full.scans[0].stamp_ns
    kept = [k for k, s in enumerate(full.scans) if not first_s < (s.stamp_ns - start_ns) * NS < last_s]
    truth, scans = full.map_T_laser, [full.scans[k] for k in kept]
    run = run_slam(lambda: scans, Config(), 0.1, truth if odometry else None)
    at = np.searchsorted(truth.stamps_ns, run.trajectory.stamps_ns)
    first = truth[int(at[0])]
    true_xy = np.array([[p.x_m, p.y_m] for p in (first.between(truth[int(k)]) for k in at)])
    path = run.trajectory.seen_from(run.trajectory[0].inverse())
    return run, float(np.linalg.norm(path.xyyaw[:, :2] - true_xy, axis=1).max())


@pytest.mark.slow
def test_a_place_that_looks_like_another_is_not_taken_for_it() -> None:
    run, error_m = drive_with_pause(3, 17.0, 24.0)
    assert error_m < 0.3
    assert run.lost_for_good
    assert sorted(part.joined for part in run.parts) == [False, True]


@pytest.mark.parametrize(("seed", "first_s"), [(1, 17.0), (5, 17.0), (6, 13.0)])
def test_a_vehicle_drives_through_a_short_pause_as_fast_as_before(seed: int, first_s: float) -> None:
    """As pauses began at 2.5 s only, the laser was placed 8, 59 and 89 m away, at doubts of 0.02, 1.0 and 0.02."""
    run, error_m = drive_with_pause(seed, first_s, first_s + 2.2)
    assert error_m < 0.3
    assert not run.lost_for_good
    assert len(run.trajectory) == len(run.steps)


def test_odometry_bridges_a_pause() -> None:
    run, error_m = drive_with_pause(3, 15.0, 19.0, odometry=True)
    assert error_m < 0.3
    assert not run.lost_for_good
    assert run.trajectory.stamps_ns[-1] - run.trajectory.stamps_ns[0] > 30 * S


def motion_at(stamp_ns: int, speed_m_s: float) -> Motion:
    return Motion(0.1, stamp_ns=stamp_ns, twist=(speed_m_s, 0.0, 0.0))


def test_a_laser_moves_through_a_pause_as_fast_as_before() -> None:
    pauses = Pauses()
    for k in range(1, 6):
        pauses.note(k * S // 10, motion_at((k - 1) * S // 10, 1.0))
    before, now = motion_at(S // 2, 1.0), S // 2 + 10 * S
    assert not pauses.exclude(Pose(20.0, 0.0), before, now)  # no pause yet
    pauses.note(now, before)
    assert pauses.exclude(Pose(13.0, 0.0), before, now)
    assert not pauses.exclude(Pose(12.0, 0.0), before, now)
    assert not pauses.exclude(Pose(13.0, 0.0), motion_at(now, 0.0), now + S // 10)  # found since
    assert not pauses.exclude(Pose(13.0, 0.0), before, now - S)  # before the pause ends, as when matched backwards


@pytest.mark.parametrize(("x_m", "excluded"), [(20.0, False), (25.0, False), (27.0, True), (14.0, False), (12.0, True)])
def test_odometry_tells_where_the_laser_is_after_a_pause(x_m: float, *, excluded: bool) -> None:
    pauses, now = Pauses(), 11 * S
    before = motion_at(S, 0.5)._replace(odometry={S: Pose(), now: Pose(20.0, 0.0)}.get)
    for stamp_ns in (S, now):
        pauses.note(stamp_ns, before)
    assert pauses.exclude(Pose(x_m, 0.0), before, now) == excluded
    assert pauses.exclude(Pose(x_m, 0.0), before._replace(odometry={}.get), now)  # too far where odometry is not known


@pytest.mark.parametrize(("driven_m", "x_m", "excluded"), [(2.0, 3.0, False), (2.0, 3.2, True), (0.4, 9.0, False)])
def test_a_lost_laser_whose_wheels_drive_was_not_carried(driven_m: float, x_m: float, *, excluded: bool) -> None:
    pauses, path = Pauses(), {k * S // 10: Pose(0.1 * driven_m * k, 0.0) for k in range(11)}
    before = motion_at(0, 0.5)._replace(odometry=path.get)
    for stamp_ns in path:
        pauses.note(stamp_ns, before)
    assert pauses.exclude(Pose(x_m, 0.0), before, S) == excluded


def test_missed_scans_are_no_pause() -> None:
    pauses = Pauses()
    for k in range(1, 200):
        pauses.note(k * S // 10, motion_at(S // 10, 0.5))
    assert not pauses.exclude(Pose(30.0, 0.0), motion_at(S // 10, 0.5), 20 * S)


@pytest.mark.parametrize(
    ("missed", "pause_s", "late"), [(LATE_SCANS, 3.0, True), (LATE_SCANS - 1, 3.0, False), (40, 1.0, False)]
)
def test_a_laser_is_found_late(missed: int, pause_s: float, *, late: bool) -> None:
    def step(k: int, *, tracked: bool) -> Step:
        stamp_ns = k * S // 10 + (round(pause_s * S) if k >= 10 else 0)
        return Step(k, stamp_ns, first_match(100) if tracked else no_match(Pose()), tracked)

    steps = Steps(step(k, tracked=not 10 <= k < 10 + missed) for k in range(100))
    assert first_found_late(steps, 0.1) == (10 if late else None)
    assert first_found_late(Steps(step(k, tracked=k < 10) for k in range(100)), 0.1) is None


def test_a_pause_between_two_poses_is_reported() -> None:
    def warnings(pause_s: float, tracked: int = 100, **motion: object) -> list[str]:
        steps = Steps(
            Step(k, k * S // 10 + (round(pause_s * S) if k >= 10 else 0), first_match(100), k < tracked)
            for k in range(100)
        )
        return list(pause_warnings(steps, Motion(0.1)._replace(**motion)))

    (text,) = warnings(7.0)
    assert text.startswith("the scans pause for 7.1 s (0.9 s after the first): without odometry")
    assert not warnings(2.0)
    assert not warnings(7.0, tracked=10)
    assert not warnings(7.0, odometry=Trajectory.of([0], [Pose()]).at)


def test_scans_that_match_nowhere_for_long_are_reported() -> None:
    """A laser carried into a room like another one was found there, and nothing told of the carrying."""

    def warnings(blind: range, pause_s: float = 0.0, **motion: object) -> list[str]:
        stamps_ns = [k * S // 10 + (round(pause_s * S) if k >= 50 else 0) for k in range(100)]
        steps = Steps(Step(k, stamp_ns, first_match(100), k not in blind) for k, stamp_ns in enumerate(stamps_ns))
        return list(pause_warnings(steps, Motion(0.1)._replace(**motion)))

    (text,) = warnings(range(40, 70))
    assert text.startswith("no scan matches for 3.1 s (3.9 s after the first): without odometry")
    assert not warnings(range(40, 60))
    assert not warnings(range(70, 100))
    (text,) = warnings(range(40, 70), pause_s=3.0)
    assert text.startswith("the scans pause for 3.1 s")
    assert not warnings(range(40, 70), odometry=Trajectory.of([0], [Pose()]).at)


@pytest.mark.parametrize("first_ns", [0, slow(1_700_000_000 * S)])
def test_a_part_after_a_pause_is_joined_whatever_the_clock_says(first_ns: int) -> None:
    """The origin of the map was taken for a pose at stamp 0, and 100 of 160 scans were refused."""
    obstacles = [box(5, 0.4, 0.7, 0.5, 0.3), box(11, 5.6, 0.9, 0.5, 1.0), box(16, 0.3, 0.5, 0.8, 0.2)]
    obstacles += [box(21, 5.6, 0.8, 0.8, 0.6), box(25.5, 0.5, 0.4, 0.9, 0.1), box(28, 5.0, 0.6, 0.3, 0.9)]
    walls = np.vstack([polyline((0, 0), (30, 0), (30, 6), (0, 6), closed=True), *obstacles, box(2, 5, 0.4, 0.4, 0.1)])
    spec = LaserSpec(-np.pi, 2 * np.pi / 720, 720, 0.05, 40.0)
    along_m = [*(1 + 0.03 * k for k in range(60)), *(8 + 0.15 * k for k in range(100))]
    poses = [Pose(x_m, 3, 0.3 * np.sin(0.2 * (k if k < 60 else k - 60))) for k, x_m in enumerate(along_m)]
    stamps_ns = [first_ns + k * S // 10 + 4 * S * (k >= 60) for k in range(160)]
    scans = [
        scan_at(walls, pose, spec, stamp_ns=stamp_ns, noise=0.002, rng=np.random.default_rng(k))
        for k, (pose, stamp_ns) in enumerate(zip(poses, stamps_ns, strict=True))
    ]
    config, motion = Config(), Motion(0.1)
    track = Track(lambda: iter(scans), config, motion, make_method(config)).over(scans[:61])
    other = Track(lambda: iter(scans), config, motion, make_method(config), begin=60).over(scans)
    missed = [Step(k, stamps_ns[k], no_match(Pose(), 700), tracked=False) for k in range(60, 160)]
    whole = replace(track, steps=Steps([*track.steps[:60], *missed]))
    part = tuple(step for step in other.steps if step.tracked)
    assert join_parts(whole, [part]).steps.column("tracked").all()
