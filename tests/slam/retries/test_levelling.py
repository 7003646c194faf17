"""A measured tilt levels the scans of a log only where the walls get sharper by it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Trajectory
from mavnav.scan import Attitude, LaserSpec, Scan, level_scan
from mavnav.slam.findings import TrackedAgain
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.retries.levelling import AS_RECORDED, WARNING
from support.synthetic import DEG, along, record, room
from support.tilted import tilted_scan

WALLS = room(7.0, 5.0)
LASER = LaserSpec(-135 * DEG, 0.75 * DEG, 361, 0.05, 12.0)
LEAN_RAD = 14 * DEG
NO_HEIGHT = float("nan")


@cache
def way() -> Trajectory:
    return along([(1.5, 1.5), (5.5, 1.5), (5.5, 3.5), (1.5, 3.5)], period_s=0.2)


@cache
def leans() -> tuple[Attitude, ...]:
    """Return a tilt that swings, as a turning sensor takes its acceleration for one."""
    return tuple(Attitude(LEAN_RAD * np.sin(0.5 * k), 0.0, NO_HEIGHT) for k in range(len(way())))


def levelled(scans: list[Scan]) -> list[Scan]:
    return [level_scan(scan, *lean) for scan, lean in zip(scans, leans(), strict=True)]


def tracked(recorded: list[Scan]) -> SlamResult:
    some = levelled(recorded)
    return run_slam(lambda: some, Config(), 0.2, recorded=lambda: recorded)


def worst_m(outcome: SlamResult, truth: Trajectory) -> float:
    assert len(outcome.trajectory) == len(truth)
    return float(np.hypot(*(outcome.trajectory.xyyaw - truth.xyyaw)[:, :2].T).max())


@pytest.mark.slow
def test_a_false_tilt_of_a_level_laser_is_not_used_and_named() -> None:
    recording = record(WALLS, way(), LASER, noise=0.005)
    recorded = recording.scans
    spoilt = levelled(recorded)
    outcome, before = tracked(recorded), run_slam(lambda: spoilt, Config(), 0.2)
    assert TrackedAgain(AS_RECORDED, kept=True) in outcome.attempts
    assert WARNING in outcome.warnings
    assert worst_m(outcome, recording.map_T_laser) < 0.03
    assert np.count_nonzero(before.grid.hits) > 1.1 * np.count_nonzero(outcome.grid.hits)


@pytest.mark.slow
def test_the_tilt_of_a_leaning_laser_is_used() -> None:
    stamps_ns = way().stamps_ns
    high = [Attitude(lean.roll_rad, lean.pitch_rad, 4.0) for lean in leans()]
    seen = [tilted_scan(WALLS, np.full(4, 9.0), way()[k], lean, LASER)[0] for k, lean in enumerate(high)]
    recorded = [replace(scan, stamp_ns=int(stamps_ns[k])) for k, scan in enumerate(seen)]
    outcome = tracked(recorded)
    assert TrackedAgain(AS_RECORDED, kept=False) in outcome.attempts
    assert WARNING not in outcome.warnings
