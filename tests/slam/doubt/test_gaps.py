"""Beyond a gap in the poses the laser may be elsewhere: another place fits, too, or a standing one sees others."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory
from mavnav.slam.doubt.gaps import beside_doubtful_gaps
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import first_match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.methods.pauses import CARRIED_S
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.track import Track
from mavnav.units import NS
from support.synthetic import SHORT, TOUR, Recording, along, box, corridor, furnished_rooms, polyline, record

LAST, NEXT = 100, 150
"""Numbers of the scans beside the gap."""

SEEDS = 6, 8
"""Seeds of corridors of which another place is matched, too."""

ALIKE = tuple(np.arange(4.0, 38.0, 3.0))
"""Places of doors that look like each other: at half of the distance on the other side."""


@cache
def rooms() -> Recording:
    return record(furnished_rooms(), along(TOUR, speed_m_s=0.5), SHORT, 0.005)


@cache
def doors() -> Recording:
    return corridor(ALIKE)


def track_of(drive: Recording, off: Pose = Pose(), pause_s: float = 0.0, odometry: Trajectory | None = None) -> Track:  # noqa: B008
    """Return a track at the true poses, without those of a gap; after it they are off, and the stamps later."""
    poses, scans = drive.map_T_laser, [*drive.scans[: LAST + 1], *drive.scans[NEXT:]]
    moved = poses[LAST] @ off @ poses[LAST].inverse()
    rows = [*range(LAST + 1), *range(NEXT, len(poses))]
    at = [poses[k] if k <= LAST else moved @ poses[k] for k in rows]
    late_ns = [0 if k <= LAST else round(pause_s / NS) for k in rows]
    steps = Steps(
        Step(k, scan.stamp_ns + ns, first_match(300)._replace(map_T_laser=pose), tracked=True)
        for k, (scan, pose, ns) in enumerate(zip(scans, at, late_ns, strict=True))
    )
    motion = Motion(0.1, odometry and (lambda stamp_ns: odometry.at(stamp_ns, round(1.0 / NS))))
    return Track(lambda: iter(scans), Config(), motion, make_method(Config()), steps=steps)


def marked(track: Track) -> list[int]:
    return np.flatnonzero(beside_doubtful_gaps(track)).tolist()


def test_a_place_beyond_a_gap_that_nothing_else_looks_like_is_sure() -> None:
    assert marked(track_of(rooms())) == []


@pytest.mark.parametrize("off_m", [-3.0, 3.0])
def test_a_place_beyond_a_gap_that_looks_like_another_one_is_doubtful(off_m: float) -> None:
    assert marked(track_of(doors(), Pose(off_m))) == [LAST, LAST + 1]


def test_odometry_that_drives_on_shows_the_way() -> None:
    drive = doors()
    assert marked(track_of(drive, Pose(-3.0), odometry=drive.map_T_laser)) == []


def test_short_gaps_are_not_looked_at() -> None:
    long_s = (NEXT - LAST) * 0.1
    assert marked(track_of(doors(), Pose(-3.0), CARRIED_S - long_s)) == []


def test_a_log_that_is_lost_for_good_is_not_looked_at() -> None:
    track = track_of(doors(), Pose(-3.0))
    few = Steps(step._replace(tracked=step.index < LAST + 20) for step in track.steps)
    assert marked(replace(track, steps=few)) == []


@cache
def covered(seed: int, *, carried: bool) -> SlamResult:
    """Return the run of a vehicle that is covered for 5 s while its wheels stand, and maybe carried on by 6.5 m."""
    rng = np.random.default_rng(seed)
    goods = [
        box(x_m, side * 1.2, *rng.uniform((0.3, 0.3), (1.0, 0.9))) for side in (-1, 1) for x_m in rng.uniform(0, 22, 7)
    ]
    walls = np.vstack((polyline((0.0, -1.3), (22.0, -1.3), (22.0, 1.3), (0.0, 1.3), closed=True), *goods))
    away_m = 6.5 * carried
    out, on = along([(1.0, 0.0), (5.0, 0.1)]), along([(5.0 + away_m, 0.1), (10.0 + away_m, 0.1)])
    rest, off = np.repeat(out.xyyaw[-1:], 60, axis=0), on.xyyaw[0] - out.xyyaw[-1]
    stamps_ns = out.stamps_ns[0] + np.arange(len(out) + 60 + len(on)) * 10**8
    drive = record(walls, Trajectory(stamps_ns, np.vstack((out.xyyaw, rest, on.xyyaw))), SHORT, 0.005)
    blind = range(len(out) + 5, len(out) + 60)
    scans = [scan for k, scan in enumerate(drive.scans) if k not in blind]
    wheels = Trajectory(stamps_ns, np.vstack((out.xyyaw, rest, on.xyyaw - off)))
    return run_slam(lambda: iter(scans), Config(), 0.1, wheels)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_vehicle_at_rest_that_sees_what_it_saw_was_not_carried(seed: int) -> None:
    doubt = covered(seed, carried=False).doubt
    assert doubt is not None
    assert doubt.probability < 0.1


@pytest.mark.parametrize("seed", SEEDS)
def test_a_vehicle_at_rest_that_sees_another_place_was_carried(seed: int) -> None:
    """It was 6.5 m off at a doubt of 0.02 to 0.2."""
    doubt = covered(seed, carried=True).doubt
    assert doubt is not None
    assert doubt.high
    assert "may have been carried" in {reason.name for reason in doubt.reasons}
