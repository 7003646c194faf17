"""What must not matter: which way round the world is, where it lies, and how the laser is turned on its carrier."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.pose import Pose, Trajectory, wrap_angle
from mavnav.scan import Scan
from mavnav.slam.matching.scan_matching import Match, first_match
from mavnav.slam.methods import robust
from mavnav.slam.pipeline import run_slam
from mavnav.units import DEG

NAMES = ("ccny_demo", "lego_robot4")
SCANS = 60

pytestmark = pytest.mark.real_logs


@pytest.fixture(scope="module", params=NAMES)
def drive(request: pytest.FixtureRequest, real_logs: Path) -> tuple[list[Scan], float, Trajectory]:
    """Return the first scans of a log, their period, and the way as it is recorded."""
    log = open_log(real_logs / request.param / f"{request.param}.mcap", odom="off")
    scans = [scan for scan, _ in zip(log.scans(), range(SCANS), strict=False)]
    return scans, log.period_s, way(scans, log.period_s)


def way(scans: list[Scan], period_s: float) -> Trajectory:
    outcome = run_slam(lambda: scans, Config(), period_s)
    assert len(outcome.trajectory) == SCANS
    return outcome.trajectory


def mirrored(scan: Scan) -> Scan:
    """Swap left and right; the beams that were fired last stand first in the list then."""
    spec = scan.spec
    last_rad = spec.angle_min_rad + (spec.beams - 1) * spec.angle_step_rad
    spec = replace(spec, angle_min_rad=-last_rad, time_increment_s=-spec.time_increment_s)
    return replace(scan, ranges_m=scan.ranges_m[::-1].copy(), spec=spec)


def same(one: Trajectory, other: list[Pose]) -> None:
    """Assert that two ways agree within the noise that moving every point off its cell makes."""
    off = [one[k].between(pose) for k, pose in enumerate(other)]
    assert np.sqrt(np.mean([p.distance_m**2 for p in off])) <= 0.005
    assert max(p.distance_m for p in off) <= 0.015
    assert max(abs(p.yaw_rad) for p in off) <= 1.0 * DEG


def test_a_mirrored_log_gives_the_mirrored_way(drive: tuple[list[Scan], float, Trajectory]) -> None:
    scans, period_s, straight = drive
    found = way([mirrored(scan) for scan in scans], period_s)
    same(straight, [Pose(x, -y, -yaw) for x, y, yaw in found.xyyaw.tolist()])


def test_another_start_shifts_and_turns_the_way(
    drive: tuple[list[Scan], float, Trajectory], monkeypatch: pytest.MonkeyPatch
) -> None:
    scans, period_s, straight = drive
    start = Pose(1.307, -0.713, 0.9)

    def elsewhere(beams: int) -> Match:
        return first_match(beams)._replace(map_T_laser=start)

    monkeypatch.setattr(robust, "first_match", elsewhere)
    found = way(scans, period_s)
    same(straight, [start.inverse() @ found[k] for k in range(SCANS)])


def test_a_laser_turned_on_its_carrier_goes_the_same_way(drive: tuple[list[Scan], float, Trajectory]) -> None:
    scans, period_s, straight = drive
    turn = 0.7
    turned = [replace(s, spec=replace(s.spec, angle_min_rad=s.spec.angle_min_rad + turn)) for s in scans]
    laser_T_turned = Pose(0.0, 0.0, -turn)
    found = way(turned, period_s)
    back = [laser_T_turned @ found[k] @ laser_T_turned.inverse() for k in range(SCANS)]
    same(straight, [pose._replace(yaw_rad=wrap_angle(pose.yaw_rad)) for pose in back])
