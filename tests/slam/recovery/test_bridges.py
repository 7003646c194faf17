"""A lost laser goes on by odometry: its poses are right, marked as not tracked, and their covariances grow."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory
from mavnav.scan import LaserSpec
from mavnav.slam.pipeline import run_slam
from mavnav.slam.recovery.bridges import Bridges
from mavnav.slam.result import SlamResult
from support.synthetic import TOUR, Recording, along, furnished_rooms, record

SPEC = LaserSpec(-2 * np.pi / 3, np.pi / 180, 241, 0.01, 5.0)
BLOCKED = range(40, 90)


@cache
def drive() -> Recording:
    return record(furnished_rooms(), along(TOUR[:5], speed_m_s=0.6), SPEC, 0.003)


@cache
def blocked(within: range = BLOCKED, wheels: float = 1.02) -> SlamResult:
    """Track a drive on which something blocks the laser; its odometry counts the path too long."""
    scans = [replace(s, ranges_m=np.full(241, 0.05)) if k in within else s for k, s in enumerate(drive().scans)]
    stamps_ns, poses = drive().map_T_laser.stamps_ns, drive().map_T_laser.xyyaw * (wheels, wheels, 1.0)
    return run_slam(lambda: iter(scans), Config(), 0.1, Trajectory(stamps_ns, poses))


def errors(run: SlamResult) -> np.ndarray:
    path, true = run.path, drive().map_T_laser
    first = true[0].inverse()
    rows = np.searchsorted(true.stamps_ns, path.stamps_ns)
    return np.array([path[k].gap(first @ true[int(row)])[0] for k, row in enumerate(rows)])


def test_a_blocked_laser_goes_on_by_odometry() -> None:
    run = blocked()
    assert not run.lost_for_good
    assert run.bridges.numbers == tuple(BLOCKED)
    assert len(run.path) == len(drive().scans)
    assert errors(run).max() < 0.1
    assert [(lost.scans, lost.recovered) for lost in run.lost] == [(len(BLOCKED), True)]  # marked
    (warning,) = [text for text in run.warnings if "match nowhere" in text]
    assert warning.startswith(f"{len(BLOCKED)} scans match nowhere, the first after 4.0 s")
    expected = f"expected to be off by about {run.bridges.errors_m.max():.2f} m farthest from a match"
    assert warning.endswith(f"by odometry alone, {expected}, unless the laser was carried")


def test_the_covariance_grows_from_either_side() -> None:
    covariances = blocked().covariances
    assert covariances is not None
    variances = covariances[BLOCKED.start - 1 : BLOCKED.stop + 1, 0]
    assert np.argmax(variances) in range(15, 36)
    assert variances.max() > 4 * variances[0]
    assert (np.diff(variances[1:15]) >= 0.0).all()


def test_a_log_may_end_blocked() -> None:
    rest = range(len(drive().scans) - 30, len(drive().scans))
    run = blocked(rest)
    assert not run.lost_for_good
    assert run.bridges.numbers == tuple(rest)
    assert errors(run).max() < 0.15
    assert (np.diff(run.bridges.errors_m) >= 0.0).all()


def test_odometry_that_leads_elsewhere_is_no_bridge() -> None:
    stamps_ns, xyyaw = drive().map_T_laser.stamps_ns, drive().map_T_laser.xyyaw.copy()
    xyyaw[60:, 0] += 3.0
    scans = [replace(s, ranges_m=np.full(241, 0.05)) if k in BLOCKED else s for k, s in enumerate(drive().scans)]
    run = run_slam(lambda: iter(scans), Config(), 0.1, Trajectory(stamps_ns, xyyaw))
    assert run.bridges.numbers == ()
    assert len(run.path) == len(run.trajectory)


def test_a_causal_track_has_no_bridges() -> None:
    scans = [replace(s, ranges_m=np.full(241, 0.05)) if k in range(20, 30) else s for k, s in enumerate(drive().scans)]
    run = run_slam(lambda: iter(scans[:40]), Config(final_pass=False), 0.1, drive().map_T_laser)
    assert any(lost.scans == 10 for lost in run.lost)
    assert run.bridges.numbers == ()


@pytest.mark.parametrize("numbers", [(3, 4, 6), (1,)])
def test_covariances_grow_from_those_before(numbers: tuple[int, ...]) -> None:
    covariances = np.arange(48.0).reshape(8, 6)
    expected, errors_m = covariances.copy(), np.arange(1.0, len(numbers) + 1)
    for k, error_m in zip(numbers, errors_m, strict=True):
        before = next(row for row in range(k, -1, -1) if row not in numbers)
        expected[k] = covariances[before] + error_m**2 * np.array((1, 0, 1, 0, 0, 1))
    Bridges(Trajectory.of([0] * 0, [Pose()] * 0), numbers, errors_m).grow(covariances)
    assert covariances == pytest.approx(expected)
