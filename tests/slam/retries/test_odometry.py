"""When odometry is corrected, used as recorded, or left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.pose import Pose, Trajectory, correct_path
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.odometry_fit import GOOD_ODOMETRY, LogOdometry
from mavnav.slam.matching.scan_matching import first_match
from mavnav.slam.matching.steps import Step, Steps, lost_intervals
from mavnav.slam.methods.pauses import Pauses
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.retries.odometry import FIRST_CHECK, contradicts, correction, until_wrong
from mavnav.slam.track import Track
from mavnav.units import NS
from support.marks import slow
from support.synthetic import TOUR, Recording, along, drifting_odometry, furnished_rooms, record

MS, S = 10**6, 10**9
NOT_USED = "odometry contradicts the scans and is not used"


def swerving(steps: int = 300) -> Trajectory:
    poses = [Pose()]
    for k in range(steps):
        poses.append(poses[-1] @ Pose(0.05 + 0.04 * np.sin(0.5 * k), 0.0, 0.1 * np.cos(0.08 * k)))
    return Trajectory.of([S + 100 * MS * k for k in range(steps + 1)], poses)


def track_with(odometry: Trajectory, path: Trajectory) -> Track:
    matches = [first_match(300)._replace(map_T_laser=path[k]) for k in range(len(path))]
    steps = Steps(Step(k, int(path.stamps_ns[k]), match, tracked=True) for k, match in enumerate(matches))
    given = LogOdometry(odometry)
    motion = Motion(0.1, given.lookup(GOOD_ODOMETRY))
    return Track(lambda: (), Config(), motion, make_method(Config()), steps, log_odometry=given)


def mirrored(path: Trajectory) -> Trajectory:
    return Trajectory(path.stamps_ns, path.xyyaw * (1.0, -1.0, -1.0))


def test_odometry_that_fits_is_not_corrected() -> None:
    path = swerving()
    track = track_with(correct_path(path, 10 * MS, 1.01, 1.02), path)
    assert correction(track, track.steps) is None
    assert not contradicts(track, track.steps)


@pytest.mark.parametrize(("offset_ns", "scale", "turn"), [(-300 * MS, 1.0, 1.0), (0, 0.85, 1.0), (0, 100.0, 1.0)])
def test_odometry_is_corrected_where_that_makes_it_fit(offset_ns: int, scale: float, turn: float) -> None:
    path = swerving()
    track = track_with(correct_path(path, offset_ns, scale, turn), path)
    fit = correction(track, track.steps)
    assert fit is not None
    assert fit.offset_s == pytest.approx(-offset_ns * NS, abs=0.01)
    assert fit.distance_scale == pytest.approx(1.0 / scale, rel=0.02)
    done = track.with_findings(odometry=fit)
    assert correction(done, done.steps) is None
    assert not contradicts(done, done.steps)


@pytest.mark.parametrize("scale", [30.0, 0.1])
def test_no_wheels_and_no_unit_explain_some_scales(scale: float) -> None:
    path = swerving()
    track = track_with(correct_path(path, 0, scale), path)
    assert correction(track, track.steps) is None
    assert contradicts(track, track.steps)


def hairpin(turn_s: float) -> Trajectory:
    """Return a path of 10 poses a second that turns back once, within so many seconds of 60."""
    at_s = 0.1 * np.arange(600)
    yaws_rad = np.clip((at_s - 30.0) / turn_s, 0.0, 1.0) * 0.9 * np.pi
    steps = 0.04 * np.column_stack((np.cos(yaws_rad), np.sin(yaws_rad)))
    return Trajectory(S + np.arange(600) * 100 * MS, np.column_stack((np.cumsum(steps, axis=0), yaws_rad)))


@pytest.mark.parametrize("turn_s", [1.5, 4.0])
def test_a_few_turns_the_other_way_contradict(turn_s: float) -> None:
    """The windows in which they lie were among the worst, which are left out: a mirrored map was called good."""
    path = hairpin(turn_s)
    right, wrong, standing = (track_with(each, path) for each in (path, mirrored(path), hairpin(1e9)))
    assert not contradicts(right, right.steps)
    assert contradicts(wrong, wrong.steps)
    assert correction(replace(wrong, motion=wrong.motion._replace(odometry=None)), wrong.steps) is None
    assert not contradicts(standing, standing.steps)  # odometry that shows no turn is no mirror image


def test_turns_that_are_noise_contradict_nothing() -> None:
    rng, path = np.random.default_rng(0), hairpin(1e9)
    noisy = path.xyyaw + 0.02 * rng.standard_normal((600, 1)) * (0.0, 0.0, 1.0)
    track = track_with(Trajectory(path.stamps_ns, noisy), Trajectory(path.stamps_ns, 2.0 * path.xyyaw - noisy))
    assert not contradicts(track, track.steps)


@pytest.mark.parametrize(("wrong", "ends"), [(False, False), (True, True)])
def test_a_track_ends_early_where_its_odometry_is_wrong(*, wrong: bool, ends: bool) -> None:
    path = swerving()
    track = track_with(mirrored(path) if wrong else path, path)
    passed = list(until_wrong(track.steps, track))
    assert len(passed) == (FIRST_CHECK if ends else len(path))


def test_odometry_that_drives_contradicts_a_track_that_stands() -> None:
    driven = swerving()
    standing = Trajectory(driven.stamps_ns, np.zeros((len(driven), 3)))  # as behind something carried along
    stuck, still = track_with(driven, standing), track_with(standing, standing)
    assert contradicts(stuck, stuck.steps)
    assert not contradicts(still, still.steps)


def test_odometry_faster_than_any_vehicle_predicts_nothing() -> None:
    poses = {S: Pose(), 2 * S: Pose(2.0)}
    motion = Motion(1.0, poses.get, stamp_ns=S, fastest=(3.0, 1.0))
    assert motion.by_odometry(2 * S) == Pose(2.0)
    assert motion._replace(fastest=(1.9, 1.0)).by_odometry(2 * S) is None
    turning = {S: Pose(), 2 * S: Pose(0.0, 0.0, 1.2)}
    assert motion._replace(odometry=turning.get).by_odometry(2 * S) is None


@pytest.fixture(scope="module")
def tour() -> Recording:
    return record(furnished_rooms(), along(TOUR[:8], period_s=0.2), noise=0.01)


def replayed(recording: Recording, odometry: Trajectory) -> SlamResult:
    return run_slam(lambda: recording.scans, Config(), 0.2, odometry)


def test_a_clock_that_is_late_is_corrected(tour: Recording) -> None:
    run = replayed(tour, correct_path(drifting_odometry(tour.world_T_laser), -400 * MS, 1.15))
    assert run.odometry is not None
    assert run.odometry.offset_s == pytest.approx(0.4, abs=0.05)
    assert run.odometry.distance_scale == pytest.approx(1 / (1.15 * 1.03), rel=0.05)
    assert run.warnings == ()
    assert [attempt.name for attempt in run.attempts if attempt.kept] == ["corrected odometry"]
    assert np.abs(run.trajectory.xyyaw - tour.map_T_laser.xyyaw)[:, :2].max() < 0.06


@pytest.mark.parametrize("kind", ["mirrored", slow("at rest")])
def test_odometry_of_something_else_is_left_out(kind: str, tour: Recording) -> None:
    path = tour.world_T_laser
    wrong = mirrored(path) if kind == "mirrored" else Trajectory(path.stamps_ns, 0.0 * path.xyyaw)
    run = replayed(tour, wrong)
    assert run.odometry is None
    assert any(text.startswith(NOT_USED) for text in run.warnings)
    assert np.abs(run.trajectory.xyyaw - tour.map_T_laser.xyyaw)[:, :2].max() < 0.06


@pytest.mark.slow
def test_odometry_in_centimeters_is_scaled(tour: Recording) -> None:
    path = tour.world_T_laser
    run = replayed(tour, Trajectory(path.stamps_ns, path.xyyaw * (100.0, 100.0, 1.0)))
    assert run.odometry is not None
    assert run.odometry.distance_scale == pytest.approx(0.01, rel=0.02)
    assert run.steps.column("tracked").all()


@pytest.mark.slow
@pytest.mark.parametrize(("first", "pause_s"), [(0.35, 2.0), (0.58, 7.0)])
def test_late_odometry_bridges_a_pause(real_logs: Path, first: float, pause_s: float) -> None:
    log = open_log(real_logs / "urg_exp1" / "urg_exp1.bag")
    all_scans, odometry = list(log.scans()), log.odometry.odom_T_laser
    start_ns = all_scans[int(first * len(all_scans))].stamp_ns
    scans = [s for s in all_scans if -7.5 < (s.stamp_ns - start_ns) * NS < pause_s + 7.5]
    kept = [s for s in scans if not start_ns <= s.stamp_ns < start_ns + pause_s / NS]
    whole, paused = (run_slam(lambda some=some: some, Config(), log.period_s, odometry) for some in (scans, kept))
    common = np.isin(whole.trajectory.stamps_ns, paused.trajectory.stamps_ns)
    off = whole.trajectory.xyyaw[common, :2] - paused.trajectory.xyyaw[:, :2]
    inside = (whole.trajectory.stamps_ns >= start_ns) & ~common
    driven_m = np.linalg.norm(np.diff(whole.trajectory.xyyaw[inside, :2], axis=0), axis=1).sum()
    assert whole.odometry is not None
    assert np.linalg.norm(off, axis=1).max() < 2.0 * np.hypot(*whole.odometry[3:5]) * driven_m
    assert len(paused.trajectory) == len(paused.steps)
    assert not list(lost_intervals(whole.steps))
    for run in (whole, paused):
        assert run.odometry is not None
        assert 0.1 < run.odometry.offset_s < 0.2
        assert not any(NOT_USED in text for text in run.warnings)


@pytest.mark.parametrize(("x_m", "excluded"), [(2.0, False), (2.5, False), (3.5, True)])
def test_with_odometry_a_short_pause_limits_the_pose(x_m: float, *, excluded: bool) -> None:
    now = S + 1000 * MS
    before = Motion(0.1, stamp_ns=S, twist=(1.0, 0.0, 0.0), odometry={S: Pose(), now: Pose(2.0, 0.0)}.get)
    with_odometry, without = Pauses(), Pauses()
    for pauses, motion in ((with_odometry, before), (without, before._replace(odometry=None))):
        pauses.note(S, motion)
        pauses.note(now, motion)
        assert pauses.exclude(Pose(x_m, 0.0), motion, now) == (excluded and pauses is with_odometry)
