"""Scans of a tilted laser, levelled."""

from __future__ import annotations

from math import inf, nan, pi

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from mavnav.pose import Pose
from mavnav.scan import Attitude, LaserSpec, Scan, level_scan
from support.synthetic import DEG, LDS_01, cast, room
from support.tilted import FLOOR, directions_3d, tilted_scan

WALLS = room(6.0, 4.0)
TOPS_M = np.full(4, 3.0)
FINE = LaserSpec(-2.0, 4.0 / 400, 401, 0.05, 10.0)
tilts_rad = st.integers(-200, 200).map(lambda tenths: 0.1 * tenths * DEG)
yaws_rad = st.integers(-30, 30).map(lambda tenths: 0.1 * tenths)


def near_corner(spec: LaserSpec, pose: Pose, walls: np.ndarray) -> np.ndarray:
    """Return the beams within two steps of a corner, where neighbors are of two walls."""
    corner_rad = np.arctan2(walls[:, 1] - pose.y_m, walls[:, 0] - pose.x_m) - pose.yaw_rad
    off_rad = (spec.angles_rad[:, None] - corner_rad + pi) % (2 * pi) - pi
    return np.abs(off_rad).min(axis=1) < 2.5 * abs(spec.angle_step_rad)


@settings(max_examples=25, deadline=None)
@example(0.0, 0.1 * 195 * DEG, 1.5, 0.7, LDS_01, False)  # the last beam has its neighbor beyond the end of the turn
@given(tilts_rad, tilts_rad, st.floats(1.0, 2.0), yaws_rad, st.sampled_from([FINE, LDS_01]), st.booleans())
def test_a_levelled_scan_is_that_of_a_level_laser(
    roll_rad: float, pitch_rad: float, height_m: float, yaw_rad: float, spec: LaserSpec, turned: bool
) -> None:
    spec = replace(spec, range_max_m=20.0)
    spec = spec.turned_over() if turned else spec
    pose, attitude = Pose(2.1, 1.7, yaw_rad), Attitude(roll_rad, pitch_rad, height_m)
    scan, hits = tilted_scan(WALLS, TOPS_M, pose, attitude, spec)
    flat = level_scan(scan, *attitude)
    seen = np.isfinite(flat.ranges_m)
    expected = cast(WALLS, (pose.x_m, pose.y_m), spec.angles_rad + yaw_rad)
    compared = seen & ~near_corner(spec, pose, WALLS)
    np.testing.assert_allclose(flat.ranges_m[compared], expected[compared], atol=5e-4)  # SAME_RAD at grazing incidence
    above_m = height_m + scan.ranges_m * directions_3d(spec, yaw_rad, attitude)[:, 2]
    assert seen.sum() >= 0.85 * ((hits >= 0) & (above_m > 0.3)).sum() - 4  # bearings are stretched by 1 / cos at most
    assert flat.heights_m is not None
    assert np.array_equal(np.isfinite(flat.heights_m), seen)


def test_heights_of_the_returns() -> None:
    attitude = Attitude(0.0, 10 * DEG, 1.0)  # the nose points down
    scan, _ = tilted_scan(WALLS, TOPS_M, Pose(3.0, 2.0, 0.0), attitude, LDS_01)
    flat = level_scan(scan, *attitude)
    assert flat.heights_m is not None
    assert flat.ranges_m[[0, 90, 180]] == pytest.approx([3.0, 2.0, 3.0])
    assert flat.heights_m[[0, 90, 180]] == pytest.approx([1 - 3 * np.tan(10 * DEG), 1.0, 1 + 3 * np.tan(10 * DEG)])


def test_returns_on_floor_and_ceiling_are_no_walls() -> None:
    attitude = Attitude(0.0, 15 * DEG, 0.5)
    scan, hits = tilted_scan(WALLS, TOPS_M, Pose(3.0, 2.0, 0.0), attitude, LDS_01)
    flat = level_scan(scan, *attitude)
    expected = cast(WALLS, (3.0, 2.0), LDS_01.angles_rad)
    assert (hits == FLOOR).sum() > 20
    assert np.nanmax(np.abs(flat.ranges_m - expected)) < 0.05  # at the corners; the floor lies 1.1 m before the wall
    assert np.isnan(flat.ranges_m[np.abs(LDS_01.angles_rad) < 0.3]).all()
    below = level_scan(scan, *attitude, ceiling_m=1.3)
    assert np.isnan(below.ranges_m[180])
    assert np.isfinite(flat.ranges_m[180])


@pytest.mark.parametrize("height_m", [0.05, 1.0, nan])
def test_a_level_scan_keeps_its_ranges(height_m: float) -> None:
    ranges_m = np.random.default_rng(1).uniform(0.1, 9.0, 360)
    ranges_m[::7] = nan
    flat = level_scan(Scan(5, ranges_m, LDS_01), *Attitude(0.0, 0.0, height_m), inf)
    np.testing.assert_array_equal(flat.ranges_m, ranges_m)
    if np.isnan(height_m):
        assert flat.heights_m is None
    else:
        assert flat.heights_m is not None
        np.testing.assert_array_equal(flat.heights_m, np.where(np.isnan(ranges_m), nan, height_m))


def test_beams_keep_their_times() -> None:
    times_s = np.linspace(0.0, 0.1, 360)
    flat = level_scan(Scan(0, np.full(360, 2.0), LDS_01, times_s), *Attitude(0.2, 0.1, 1.0))
    assert flat.times_s is not None
    np.testing.assert_allclose(flat.times_s, times_s, atol=0.01)
