"""A part of a log that shows nothing of the map is placed by odometry, if that can be relied on."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory
from mavnav.scan import LaserSpec, Scan
from mavnav.slam.pipeline import run_slam
from mavnav.slam.recovery.part_by_odometry import odometry_path
from mavnav.slam.result import SlamResult
from mavnav.units import NS
from support.synthetic import Recording, along, box, drifting_odometry, polyline, record

SPEC = LaserSpec(-np.pi * 3 / 4, np.pi / 180, 271, 0.05, 4.0)
PLACED = "placed by odometry alone"


@cache
def drive() -> Recording:
    """Return a drive of 25 m between two furnished places, with nothing in the laser's range on the way."""
    walls = [
        polyline((6.0, -2.5), (-3.0, -2.5), (-3.0, 2.2), (1.0, 2.2), (1.0, 3.4), (2.6, 3.4), (2.6, 2.2), (6.0, 2.2)),
        box(3.5, -1.6, 0.7, 0.5, 0.3),
        box(-1.0, 1.4, 0.4, 0.6, -0.2),
        polyline(
            (18.0, -1.4), (21.0, -1.4), (22.0, -3.0), (28.0, -3.0), (28.0, 1.3), (24.0, 1.6), (23.0, 3.2), (18.0, 3.2)
        ),
        box(20.0, 1.6, 0.5, 0.5, 0.5),
        box(25.5, -1.8, 0.3, 0.8, 0.7),
    ]
    return record(np.vstack(walls), along([(0.0, 0.0), (12.0, 0.3), (25.0, 0.0)], speed_m_s=0.8), SPEC, 0.003)


def seen(scans: list[Scan]) -> list[Scan]:
    return [scan for scan in scans if np.isfinite(scan.ranges_m).any()]


def replayed(odometry: Trajectory | None, scans: list[Scan] | None = None) -> SlamResult:
    kept = seen(drive().scans if scans is None else scans)
    return run_slam(lambda: kept, Config(), 0.1, odometry)


@pytest.mark.slow
def test_odometry_leads_across_a_hall() -> None:
    truth = drive().map_T_laser
    run = replayed(drifting_odometry(truth, 1))
    assert not run.lost_for_good
    assert sum(PLACED in text for text in run.warnings) == 1
    assert all(part.joined for part in run.parts)
    assert run.doubt is not None
    (reason,) = (reason for reason in run.doubt.reasons if PLACED in reason.name)
    assert reason.start_ns in {part.start_ns for part in run.parts}
    assert run.doubt.high
    rows = np.searchsorted(truth.stamps_ns, run.trajectory.stamps_ns)
    last = len(rows) - 1
    found, true = (path[a].between(path[b]) for path, a, b in ((run.trajectory, 0, last), (truth, rows[0], rows[-1])))
    assert last > 0.8 * len(seen(drive().scans))
    assert found.gap(true)[0] < 0.05 * 25.0


@pytest.mark.slow
def test_without_odometry_nothing_leads_across() -> None:
    run = replayed(None)
    assert run.lost_for_good
    assert not any(PLACED in text for text in run.warnings)


def test_a_laser_that_was_carried_is_not_where_its_odometry_stayed() -> None:
    truth = drive().world_T_laser
    at_s = (truth.stamps_ns - truth.stamps_ns[0]) * NS
    kept = [scan for scan, s in zip(drive().scans, at_s, strict=True) if not 5.0 < s < 26.0]
    xyyaw = truth.xyyaw.copy()
    xyyaw[at_s > 5.0] += xyyaw[at_s <= 5.0][-1] - xyyaw[at_s >= 26.0][0]
    xyyaw[(at_s > 5.0) & (at_s < 26.0)] = xyyaw[at_s <= 5.0][-1]
    run = replayed(Trajectory(truth.stamps_ns, xyyaw), kept)
    later = run.trajectory.stamps_ns > kept[0].stamp_ns + 20 / NS
    assert run.lost_for_good
    assert later.all() or not later.any()
    assert not any(PLACED in text for text in run.warnings)


def test_the_path_of_odometry_needs_both_ends() -> None:
    known = {0: Pose(), 250_000_000: Pose(1.0), 500_000_000: None, 750_000_000: Pose(3.0)}
    assert odometry_path(known.get, 0, 750_000_000) == [Pose(), Pose(1.0), Pose(3.0)]
    assert odometry_path(known.get, 750_000_000, 250_000_000) == [Pose(3.0), Pose(1.0)]
    assert odometry_path(known.get, 0, 500_000_000) is None
    assert odometry_path(known.get, 0, 0) == [Pose()]
