"""The map drawn again, of the scans at their final poses, and the poses of the scans as recorded."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.kernels.scans.sweep_shift import sweep_shift
from mavnav.mapping.occupancy_grid import Grid, occupied_xy_m
from mavnav.pose import Pose, Trajectory
from mavnav.scan import LaserSpec, Scan
from mavnav.slam.given_poses import draw_at_poses
from mavnav.slam.matching.motion_model import Motion, twists
from mavnav.slam.methods.registry import make_method
from mavnav.slam.methods.robust import Robust
from mavnav.slam.pipeline import after, run_slam
from mavnav.slam.refinement.refine import draw_map, refine_poses
from mavnav.slam.track import Track
from support.naive import naive_sweep_shift
from support.synthetic import TOUR, Recording, along, cast, furnished_rooms, record

PERIOD_S = 0.1
BEAMS = 270
SPEC = LaserSpec(-0.75 * pi, 1.5 * pi / BEAMS, BEAMS, 0.05, 12.0, time_increment_s=0.075 / BEAMS)
LIMITS_M = np.array((0.05, 12.0, 0.03))


@pytest.fixture(scope="module")
def tour() -> Recording:
    return record(furnished_rooms(), along(TOUR, period_s=0.3), noise=0.005)


@pytest.fixture(scope="module")
def tracked(tour: Recording) -> Track:
    track = Track(lambda: tour.scans, Config(), Motion(0.3), make_method(Config()))
    return track.over(tour.scans)


def blurred(track: Track, tour: Recording, spread_m: float) -> Track:
    """Return the track with every scan inserted beside its pose."""
    rng, method, steps = np.random.default_rng(0), make_method(track.config), list(track.steps)
    for step, scan in zip(steps, tour.scans, strict=True):
        pose = step.match.map_T_laser
        x_m, y_m = rng.normal(0.0, spread_m, 2)
        method.insert(scan, pose._replace(x_m=pose.x_m + x_m, y_m=pose.y_m + y_m), track.motion)
    return replace(track, method=method)


def test_a_blurred_map_gets_sharper(tracked: Track, tour: Recording) -> None:
    before = blurred(tracked, tour, 0.015)
    blur = before.method.grid
    drawn = after(before, (refine_poses, draw_map)).method.grid
    assert np.count_nonzero(drawn.hits) < 0.9 * np.count_nonzero(blur.hits)
    assert int(drawn.hits.sum()) == int(blur.hits.sum())


def test_nothing_is_drawn_where_scans_do_not_come(tracked: Track, tour: Recording) -> None:
    before = replace(blurred(tracked, tour, 0.015), log_scans=lambda: tour.scans[:-1])
    grid, poses = before.method.grid, before.steps.column("map_T_laser")
    stopped = after(before, (draw_map,))
    assert stopped.method.grid is grid
    np.testing.assert_array_equal(stopped.steps.column("map_T_laser"), poses)


def test_a_map_without_a_pose_stays_empty(tracked: Track) -> None:
    nothing = replace(tracked, log_scans=list).over([])
    assert not after(nothing, (refine_poses, draw_map)).method.grid.hits.any()


def swept(turn_rad_s: float, scans: int = 60) -> list[Scan]:
    """Return the sweeps of a laser that swings its heading while it moves ahead, every beam cast at its own pose."""
    rng, recorded, walls = np.random.default_rng(3), list[Scan](), furnished_rooms()
    for k in range(scans):
        time_s = k * PERIOD_S + np.arange(BEAMS) * SPEC.time_increment_s
        yaw_rad = turn_rad_s * (1.0 - np.cos(1.5 * time_s)) / 1.5
        beams = zip(time_s, SPEC.angles_rad + yaw_rad, strict=True)
        ranges_m = np.array([cast(walls, (1.2 + 0.3 * t, 0.9), np.array([a]))[0] for t, a in beams])
        ranges_m += rng.normal(0.0, 0.004, BEAMS)
        recorded.append(Scan(int(k * PERIOD_S * 1e9), np.where(ranges_m < SPEC.range_max_m, ranges_m, np.nan), SPEC))
    return recorded


def spread_cells(a: Grid, b: Grid) -> float:
    """Return the share of the occupied cells of two maps that only one of them has."""
    both = [{tuple(cell) for cell in np.round(occupied_xy_m(grid) / grid.cell_m - 0.5).tolist()} for grid in (a, b)]
    return len(both[0] ^ both[1]) / len(both[0] | both[1])


def test_a_map_drawn_at_the_poses_of_a_run_is_that_of_the_run() -> None:
    scans = swept(1.2)
    run = run_slam(lambda: scans, Config(), PERIOD_S)
    stamps_ns = np.array([scan.stamp_ns for scan in scans])
    shown = {
        whole: draw_at_poses(lambda: scans, Config(), PERIOD_S, run.trajectory, stamps_ns, whole=whole, of_run=True)[0]
        for whole in (True, False)
    }
    apart = {whole: spread_cells(run.grid, outcome.grid) for whole, outcome in shown.items()}
    assert apart[True] < 0.02
    assert apart[False] > 0.1  # scans as recorded are elsewhere


def test_the_shift_of_a_sweep_is_that_of_a_least_squares_fit() -> None:
    scan, twist, out = swept(0.0, 1)[0], np.array((0.5, -0.2, 1.5)), np.empty((3, 4))
    sweep_shift(scan.ranges_m, SPEC.directions, scan.late_s, twist, LIMITS_M, out)
    np.testing.assert_allclose(np.linalg.solve(out[:, :3], out[:, 3]), naive_sweep_shift(scan, twist), atol=1e-9)


def test_a_laser_at_rest_has_one_pose() -> None:
    scan, method = swept(0.0, 1)[0], Robust(Config())
    assert method.sweep_T_mid(scan, Motion(PERIOD_S)) == Pose()
    moved = method.sweep_T_mid(scan, Motion(PERIOD_S, twist=(0.5, 0.0, 1.0)))
    assert 0.001 < np.hypot(*moved[:2]) < 0.05


def test_velocities_are_those_of_the_path_before_and_after() -> None:
    rng = np.random.default_rng(1)
    steps = rng.normal(0.0, (0.05, 0.05, 0.3), (30, 3))
    stamps_ns = np.cumsum(rng.integers(1, 4, 30)) * 100_000_000
    stamps_ns[20:] += 3_000_000_000
    path = Trajectory(stamps_ns + rng.integers(-9_000_000, 9_000_000, 30), np.cumsum(steps, axis=0))
    found = twists(path, PERIOD_S)
    for k in range(30):
        moved, elapsed_s = np.zeros(3), 0.0
        for i in (k - 1, k):
            if 0 <= i < 29 and i != 19:
                moved += path.xyyaw[i + 1] - path.xyyaw[i]
                elapsed_s += (stamps_ns[i + 1] - stamps_ns[i]) / 1e9
        yaw = path.xyyaw[k, 2]
        forward = (moved[0] + 1j * moved[1]) * np.exp(-1j * yaw) / elapsed_s
        assert found[k] == pytest.approx((forward.real, forward.imag, moved[2] / elapsed_s))


def test_no_velocity_leads_over_a_wrapped_heading() -> None:
    path = Trajectory(np.arange(2) * 100_000_000, np.array(((0.0, 0.0, pi - 0.01), (0.0, 0.0, 0.01 - pi))))
    assert twists(path, PERIOD_S)[:, 2] == pytest.approx(0.2)
