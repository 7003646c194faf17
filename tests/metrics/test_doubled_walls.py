"""Walls drawn twice by disagreeing poses are found. docs/notes/metrics-evidence.md has more."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.logs import open_log
from mavnav.metrics.doubled_walls import MOST_KEYS, doubled_walls, key_rows
from mavnav.metrics.journey import Journey, PlacedScans, placed_scans
from mavnav.pose import Pose, Trajectory
from mavnav.slam.pipeline import run_slam
from support.ghost_scenes import GHOSTS, LMS_200, REAL, Shift, ghosts_of, honest, planted, swept, with_ghost
from support.marks import slow
from support.synthetic import along, record, room

CASES = [
    (slow if offset_m in {0.3, 1.0} else pytest.param)(seed, kind, offset_m)
    for seed, (kind, offset_m) in enumerate(product(GHOSTS, (0.1, 0.3, 0.63, 1.0)), 20)
]


@pytest.mark.parametrize(("seed", "kind", "offset_m"), CASES)
def test_planted_ghosts_are_found(seed: int, kind: str, offset_m: float) -> None:
    ghosts, found_m = planted(kind, seed, offset_m)
    assert found_m > 3.0
    assert ghosts.length_m >= found_m


@pytest.mark.parametrize(("seed", "kind"), list(enumerate(REAL, 20)), ids=list(REAL))
def test_what_only_looks_doubled_is_not_reported(seed: int, kind: str) -> None:
    assert honest(kind, seed).count == 0


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("206 deg", 25),
        ("clockwise", 20),
        ("reversed", 20),
        slow("half a turn", 22),
        slow("120 deg", 25),
        slow("slow", 25),
        slow("unstated", 20),
    ],
)
def test_a_sweep_in_a_turn_is_no_second_wall(kind: str, seed: int) -> None:
    """As recorded, these scans give 1.9 to 9.9 m of ghost walls."""
    assert honest(kind, seed).count == 0


def test_fast_turns_hide_no_second_wall() -> None:
    scans = swept("206 deg", 20)
    shift = Shift(scans.poses[len(scans.poses) // 2, :2], np.array([0.3, 0.3]), 0.0)
    assert shift.found_m(ghosts_of(with_ghost(scans, shift, sudden=True))) > 3.0


@pytest.fixture(scope="module")
def two_rounds() -> PlacedScans:
    """A room twice round; the second round is mapped 0.4 m to the right."""
    corners = [(1.0, 1.0), (5.0, 1.0), (5.0, 3.0), (1.0, 3.0)]
    recording = record(room(), along([*corners, *corners, corners[0]], period_s=0.25), LMS_200, noise=0.003)
    poses = recording.world_T_laser.xyyaw.copy()
    poses[len(poses) // 2 :, 0] += 0.4
    return PlacedScans(
        LMS_200, recording.world_T_laser.stamps_ns, poses, np.array([scan.ranges_m for scan in recording.scans])
    )


def test_a_place_tells_where_how_far_and_when(two_rounds) -> None:
    scans = two_rounds
    ghosts = doubled_walls(Trajectory(scans.stamps_ns, scans.poses), scans, 0.02)
    half_s = (scans.stamps_ns[-1] - scans.stamps_ns[0]) / 2e9
    right, left = (
        max((p for p in ghosts.places if abs(p.x_m - x_m) < 0.05), key=lambda p: p.length_m) for x_m in (6.0, 0.4)
    )
    for place in (right, left):
        assert place.offset_mm == pytest.approx(400, abs=15)
        assert place.direction_deg == pytest.approx(90, abs=1)
        assert place.y_m == pytest.approx(2.0, abs=0.3)
        assert place.length_m > 2.5
        assert place.scan_pairs >= 8
    assert right.front_s < half_s < right.rear_s  # the copy in front of the other, as seen from within
    assert left.rear_s < half_s < left.front_s
    assert ghosts.worst_offset_cells == pytest.approx(20, abs=1)
    assert ghosts.length_m == pytest.approx(sum(p.length_m for p in ghosts.places))


def test_the_same_ghosts_in_another_frame(two_rounds) -> None:
    scans, turned = two_rounds, Trajectory(two_rounds.stamps_ns, two_rounds.poses).seen_from(Pose(1.0, -2.0, 0.7))
    a = doubled_walls(Trajectory(scans.stamps_ns, scans.poses), scans, 0.02)
    b = doubled_walls(turned, PlacedScans(scans.spec, scans.stamps_ns, turned.xyyaw, scans.ranges_m), 0.02)
    assert (a.count, a.worst_offset_mm) == (b.count, pytest.approx(b.worst_offset_mm))
    assert a.length_m == pytest.approx(b.length_m, abs=0.1)


@pytest.mark.parametrize("n", [1, 2])
def test_a_few_scans_have_no_ghosts(n: int, two_rounds) -> None:
    scans = PlacedScans(two_rounds.spec,
                        two_rounds.stamps_ns[:n], two_rounds.poses[:n], two_rounds.ranges_m[:n])  # fmt: skip
    ghosts = doubled_walls(Trajectory(scans.stamps_ns, scans.poses), scans, 0.02)
    assert (ghosts.count, ghosts.length_m, ghosts.places) == (0, 0.0, ())


def test_scans_of_another_geometry_are_left_out(two_rounds) -> None:
    """Only the first scans have the geometry of the first one: key scans of the rest are not among them."""
    some = PlacedScans(two_rounds.spec,
                       two_rounds.stamps_ns[:3], two_rounds.poses[:3], two_rounds.ranges_m[:3])  # fmt: skip
    assert doubled_walls(Trajectory(two_rounds.stamps_ns, two_rounds.poses), some, 0.02).count == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ccny_demo", "lego_robot4"])
def test_a_real_log_has_ghosts_only_where_they_are_planted(name: str, real_logs: Path) -> None:
    """Of the second half of the poses 0.63 m aside, all is drawn twice that was seen before."""
    log = open_log(real_logs / name / f"{name}.mcap", odom="off")
    right = run_slam(log.scans, Config(), log.period_s).trajectory
    poses = right.xyyaw.copy()
    poses[len(poses) // 2 :, :2] += 0.63 * np.array([np.cos(0.3), np.sin(0.3)])
    for trajectory, planted_m in ((right, 0.0), (Trajectory(right.stamps_ns, poses), 0.63)):
        scans = placed_scans(Journey(trajectory, log.scans, 1.0), key_rows(trajectory))
        assert scans is not None
        ghosts = doubled_walls(trajectory, scans, 0.02)
        assert (ghosts.length_m > 2.0) == (planted_m > 0)
        assert ghosts.count == 0 or 0.4 < ghosts.worst_offset_cells * 0.02 < planted_m + 0.06  # across the wall


def test_key_scans_are_apart_and_bounded() -> None:
    still, walk = np.zeros((50, 3)), np.column_stack((np.arange(200_000) * 0.05, np.zeros((200_000, 2))))
    turning = np.column_stack((np.zeros((72, 2)), np.radians(np.arange(72) * 5.0)))
    rows = [key_rows(Trajectory(np.arange(len(poses)), poses)) for poses in (still, walk[:200], turning, walk)]
    assert len(rows[0]) == 1
    assert len(rows[1]) == pytest.approx(100, abs=2)
    assert len(rows[2]) == pytest.approx(36, abs=2)
    assert len(rows[3]) == MOST_KEYS
    assert len(key_rows(Trajectory.of([], []))) == 0
