"""Wheels that err where walls show the motion, beside a track without them."""

from __future__ import annotations

from unittest.mock import Mock

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory
from mavnav.slam.doubt import without_wheels
from mavnav.slam.doubt.without_wheels import count_without, differs
from mavnav.slam.findings import TrackedAgain
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.odometry_fit import GOOD_ODOMETRY, LogOdometry
from mavnav.slam.matching.scan_matching import first_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.pipeline import run_slam
from mavnav.slam.retries.odometry import ERRING_WHEELS, largest_error
from mavnav.slam.track import Track
from mavnav.units import NS
from support.synthetic import Recording, corridor, past_cupboards


def wheels_of(recording: Recording, factors: list[float]) -> Trajectory:
    """Return the true path with each step as many times as long as the factor of its part of the drive."""
    path, poses = recording.map_T_laser, [Pose()]
    for factor, part in zip(factors, np.array_split(np.arange(1, len(path)), len(factors)), strict=True):
        for k in part.tolist():
            x_m, y_m, yaw_rad = path[k - 1].between(path[k])
            poses.append(poses[-1] @ Pose(x_m * factor, y_m * factor, yaw_rad))
    return Trajectory(path.stamps_ns, Trajectory.of(path.stamps_ns.tolist(), poses).xyyaw)


@pytest.mark.parametrize(
    ("factors", "kept"),
    [([1.0], False), ([1.0] * 10 + [2.0] + [1.0] * 9, True), ([1.0, 0.0, 1.0], True), ([1.0, 1.4], True)],
    ids=["right", "slip", "frozen", "scale that changes"],
)
def test_wheels_that_err_are_left_out_where_walls_show_the_motion(
    factors: list[float], kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With them the path was up to 8 m off, and hardly doubted; where some scans agree, no whole track is made."""
    recording, whole = past_cupboards(), Mock(wraps=without_wheels.with_odometry)
    monkeypatch.setattr(without_wheels, "with_odometry", whole)
    result = run_slam(lambda: recording.scans, Config(), 0.1, wheels_of(recording, factors))
    off_m = np.hypot(*(result.trajectory.xyyaw - recording.map_T_laser.xyyaw)[:, :2].T)
    assert off_m.max() < 0.1
    assert TrackedAgain(ERRING_WHEELS, kept) in result.attempts
    assert any("see what the wheels did there" in warning for warning in result.warnings) == kept
    assert (result.odometry is None) == kept
    assert whole.called == kept


@pytest.mark.parametrize(
    "factors",
    [[1.0] * 3 + [2.0] + [1.0] * 16, [1.0] * 3 + [0.0, 0.0] + [1.0] * 15, [1.0] * 3 + [0.8] * 4 + [1.0] * 13],
    ids=["slip", "frozen", "scale that changes"],
)
def test_wheels_are_left_out_where_they_err_and_used_along_bare_walls(factors: list[float]) -> None:
    """A track without them stands still along the bare walls; with all of them the path was up to 5 m off."""
    recording = past_cupboards(bare_m=24.0)
    result = run_slam(lambda: recording.scans, Config(), 0.1, wheels_of(recording, factors))
    off_m = np.hypot(*(result.trajectory.xyyaw - recording.map_T_laser.xyyaw)[:, :2].T)
    assert off_m.max() < 0.15
    assert result.odometry is not None
    assert TrackedAgain(ERRING_WHEELS, kept=True) in result.attempts
    warning, *_ = result.warnings
    assert warning.startswith("odometry is left out for ")
    assert warning.endswith("; see what the wheels did there")


@pytest.mark.parametrize(("seconds", "without"), [(0.3, 0), (2.0, 20)])
def test_odometry_over_a_short_gap_is_that_with_its_poses(seconds: float, without: int) -> None:
    """The log is not tracked again without poses that the others bridge."""
    x_m = np.arange(60.0) / 20.0
    stamps_ns = np.round(x_m / NS).astype(np.int64)
    wheels = LogOdometry(Trajectory(stamps_ns, np.column_stack((x_m, x_m * 0.0, x_m * 0.0))))
    track = track_along(x_m[::2], period_s=0.1)
    track = replace(track, motion=Motion(0.1, wheels.lookup(GOOD_ODOMETRY)), log_odometry=wheels)
    part = wheels.without(np.array([(0.5, 0.5 + seconds)]) / NS, GOOD_ODOMETRY)
    assert count_without(part, track) == pytest.approx(without, abs=1)


def test_wheels_are_kept_where_walls_show_nothing() -> None:
    recording = corridor()
    result = run_slam(lambda: recording.scans, Config(), 0.1, wheels_of(recording, [1.0]))
    assert result.odometry is not None
    assert TrackedAgain(ERRING_WHEELS, kept=True) not in result.attempts
    assert np.hypot(*(result.trajectory.xyyaw - recording.map_T_laser.xyyaw)[:, :2].T).max() < 0.1


def track_along(x_m: np.ndarray, tracked: bool = True, period_s: float = 1.0) -> Track:
    """Return a track with a pose a period along the x axis."""
    match = first_match(300)
    steps = (
        Step(k, round(k * period_s / NS), match._replace(map_T_laser=Pose(x)), tracked=tracked)
        for k, x in enumerate(x_m.tolist())
    )
    return Track(lambda: (), Config(), None, None, Steps(steps))  # type: ignore[arg-type]


@pytest.mark.parametrize(("apart_m", "differing"), [(0.0, False), (0.15, False), (0.3, True)])
def test_tracks_differ_by_their_motion_not_by_where_they_are(apart_m: float, differing: bool) -> None:
    x_m = np.arange(30.0)
    later = x_m + 5.0 + apart_m * (x_m > 15.0)
    assert differs(track_along(later), track_along(x_m)).any() == differing
    assert not differs(track_along(later, tracked=False), track_along(x_m)).any()


@pytest.mark.parametrize("seconds", [3, 30])
def test_the_largest_error_of_wheels_is_named_with_its_time(seconds: int) -> None:
    x_m = np.arange(float(seconds))
    path = Trajectory.of([round(k / NS) for k in range(seconds)], [Pose(x) for x in x_m.tolist()])
    wheels = Trajectory(path.stamps_ns, path.xyyaw + np.column_stack((2.0 * (x_m > 1.0), x_m * 0.0, x_m * 0.0)))
    track = track_along(x_m)
    given = Track(track.log_scans, track.config, None, None, log_odometry=LogOdometry(wheels, Pose()))  # type: ignore[arg-type]
    off_m, at_ns = largest_error(given, path)
    assert off_m == pytest.approx(2.0)
    assert at_ns in path.stamps_ns[:2]
