"""Odometry whose stamps jitter or have an offset contradicts the steps between scans, but helps after gaps."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.pose import Pose, Trajectory
from mavnav.slam.matching.motion_model import GAP_S, Motion
from mavnav.slam.matching.scan_matching import MatchVerdict
from mavnav.slam.matching.steps import lost_intervals
from mavnav.slam.methods.pauses import Pauses
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.retries.odometry import JITTER_WARNING, at_offset, fitting_offset_s, most_moving, rms_error
from mavnav.slam.tracker import TrackState
from mavnav.units import NS

if TYPE_CHECKING:
    from pathlib import Path

    from mavnav.slam.matching.motion_model import Odometry

MS, S = 10**6, 10**9


def swerving(steps: int = 300) -> Trajectory:
    """Return a path of 10 poses a second whose speed and turns change all the time."""
    poses = [Pose()]
    for k in range(steps):
        poses.append(poses[-1] @ Pose(0.05 + 0.04 * np.sin(0.5 * k), 0.0, 0.1 * np.cos(0.08 * k)))
    return Trajectory.of([S + 100 * MS * k for k in range(steps + 1)], poses)


def wheels(
    path: Trajectory, offset_s: float = 0.0, scale: float = 1.0, side: float = 1.0, jitter_s: float = 0.0
) -> Odometry:
    """Return the odometry of a path: ``offset_s`` added to its stamps makes it right."""
    jitter = np.random.default_rng(1).uniform(-jitter_s, jitter_s, len(path))
    stamps_ns = np.sort(path.stamps_ns + np.round((jitter - offset_s) / NS).astype(np.int64))
    moved = Trajectory(stamps_ns, path.xyyaw * np.array([scale, scale * side, side]))
    return partial(moved.at, max_gap_ns=S)


@pytest.mark.parametrize("offset_s", [-0.62, -0.1, 0.0, 0.16, 0.44])
@pytest.mark.parametrize("jitter_s", [0.0, 0.04])
def test_an_offset_of_the_stamps_is_found(offset_s: float, jitter_s: float) -> None:
    path = swerving()
    found = fitting_offset_s(wheels(path, offset_s, jitter_s=jitter_s), path)
    assert found == pytest.approx(offset_s, abs=0.021 + jitter_s / 2)


@pytest.mark.parametrize(
    "fault", [{"side": -1.0}, {"scale": 0.0, "side": 0.0}, {"scale": 4.0}, {"offset_s": 3.0}], ids=str
)
def test_no_offset_makes_wrong_odometry_fit(fault: dict[str, float]) -> None:
    path = swerving()
    assert fitting_offset_s(wheels(path, **fault), path) is None


def test_too_short_or_uncovered_paths_tell_nothing_of_an_offset() -> None:
    path = swerving(25)
    assert fitting_offset_s(wheels(path), path) is None
    assert fitting_offset_s(lambda _: None, swerving()) is None
    assert fitting_offset_s(lambda _: None, Trajectory.of([], [])) is None


def test_windows_have_most_motion_and_span_no_gap() -> None:
    path = swerving(400)
    rested = Trajectory(path.stamps_ns, np.where(np.arange(401)[:, None] < 200, path.xyyaw[0], path.xyyaw))
    kept = np.r_[0:300, 350:401]
    windows = most_moving(Trajectory(rested.stamps_ns[kept], rested.xyyaw[kept]))
    assert len(windows) == 100
    assert windows == sorted(windows)
    assert all(1.0 <= (w.end_ns - w.start_ns) * NS < 2.0 for w in windows)
    moved = [w.moved for w in windows]
    assert min(np.hypot(m.x_m, m.y_m) + abs(m.yaw_rad) for m in moved) > 0.1


def test_the_error_of_odometry_is_that_of_its_motions() -> None:
    path = swerving()
    windows, odometry = most_moving(path), wheels(path, 0.3)
    late, squares = at_offset(odometry, 0.1), []
    for start_ns, end_ns, moved in windows:
        a, b = odometry(start_ns - 100 * MS), odometry(end_ns - 100 * MS)
        assert (late(start_ns), late(end_ns)) == (a, b)
        if a and b:
            x, y, yaw = a.between(b).between(moved)
            squares.append(x * x + y * y + yaw * yaw)
    assert rms_error(odometry, windows, 0.1) == pytest.approx(np.sqrt(np.mean(squares)))
    assert rms_error(odometry, windows, 0.3) == pytest.approx(0.0, abs=1e-6)


def test_gap_odometry_predicts_only_after_a_gap() -> None:
    path = swerving()
    motion = Motion(0.1, gap_odometry=wheels(path)).started_at(path[9], int(path.stamps_ns[9]))
    motion = motion.moved_to(path[10], int(path.stamps_ns[10]))
    near, far = (int(path.stamps_ns[10] + round(s / NS)) for s in (GAP_S, GAP_S + 0.1))
    assert motion.before(near).odometry is None
    assert motion.before(near).predict(near) == motion.predict(near)
    after_gap = motion.before(far)
    assert after_gap.predict(far).gap(path[16])[0] < 1e-9
    again = after_gap.moved_to(path[16], far)
    assert again.before(far + 100 * MS).odometry is None
    assert again.has_odometry
    plain = Motion(0.1)
    assert plain.before(far) is plain


def test_a_pose_on_trial_has_gap_odometry_too() -> None:
    path = swerving()
    motion = Motion(0.1, gap_odometry=wheels(path)).started_at(path[0], int(path.stamps_ns[0]))
    stamp_ns = int(path.stamps_ns[20])
    state = TrackState(motion).before(stamp_ns)
    assert state.motion.odometry is not None
    state = state.after(MatchVerdict.PROBABLE, path[20], stamp_ns).before(stamp_ns + 100 * MS)
    assert state.motion.odometry is not None
    assert state.here.odometry is None
    assert state.here.has_odometry


def urg_exp1_without(real_logs: Path, first: float, pause_s: float) -> tuple[SlamResult, SlamResult, float]:
    """Return the runs of urg_exp1, and without the scans of a pause, and how far both differ at most, m."""
    log = open_log(real_logs / "urg_exp1" / "urg_exp1.bag")
    scans, odometry = list(log.scans()), log.odometry.odom_T_laser
    start_ns = scans[int(first * len(scans))].stamp_ns
    kept = [s for s in scans if not start_ns <= s.stamp_ns < start_ns + pause_s / NS]
    whole, paused = (run_slam(lambda some=some: some, Config(), log.period_s, odometry) for some in (scans, kept))
    common = np.isin(whole.trajectory.stamps_ns, paused.trajectory.stamps_ns)
    off = whole.trajectory.xyyaw[common, :2] - paused.trajectory.xyyaw[:, :2]
    return whole, paused, float(np.linalg.norm(off, axis=1).max())


@pytest.mark.parametrize(("first", "pause_s", "most_m"), [(0.35, 2.0, 0.3), (0.58, 7.0, 0.6)])
def test_jittering_odometry_bridges_a_pause(real_logs: Path, first: float, pause_s: float, most_m: float) -> None:
    whole, paused, off_m = urg_exp1_without(real_logs, first, pause_s)
    assert off_m < most_m
    assert len(paused.trajectory) == len(paused.steps)
    assert not list(lost_intervals(whole.steps))
    (text,) = (w for w in whole.warnings if w.startswith(JITTER_WARNING))
    assert "is not used" in text
    (text,) = (w for w in paused.warnings if w.startswith(JITTER_WARNING))
    assert "only after gaps" in text


@pytest.mark.parametrize(("x_m", "excluded"), [(2.0, False), (2.5, False), (3.5, True)])
def test_with_odometry_a_short_pause_limits_the_pose(x_m: float, *, excluded: bool) -> None:
    now = S + 1000 * MS
    before = Motion(0.1, stamp_ns=S, twist=(1.0, 0.0, 0.0), odometry={S: Pose(), now: Pose(2.0, 0.0)}.get)
    with_odometry, without = Pauses(), Pauses()
    for pauses, motion in ((with_odometry, before), (without, before._replace(odometry=None))):
        pauses.note(S, motion)
        pauses.note(now, motion)
        assert pauses.exclude(Pose(x_m, 0.0), motion, now) == (excluded and pauses is with_odometry)
