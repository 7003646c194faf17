"""The laser's errors: their size, their bounds, and that each can be turned off."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from mavnav.pose import Pose
from mavnav.simulation.world.geometry import World
from mavnav.simulation.world.laser import LASERS, LaserModel, take_scan
from mavnav.units import DEG

NO_ARCS = np.empty((0, 5))
ROUND_ROOM = World(np.empty((0, 4)), np.array([(0.0, 0.0, 2.0, 0.0, 2 * math.pi)]))
SQUARE = World(np.array([(-2, -2, 2, -2), (2, -2, 2, 2), (2, 2, -2, 2), (-2, 2, -2, -2)], dtype=float), NO_ARCS)
WALL_AHEAD = World(np.array([(1.0, -50.0, 1.0, 50.0)]), NO_ARCS)
STEP = World(np.array([(1.0, -50.0, 1.0, 0.0), (3.0, -50.0, 3.0, 50.0)]), NO_ARCS)
URG = LASERS["urg-04lx"]
HOME = Pose()


def ranges(world: World, laser: LaserModel, seed: int = 0, pose: Pose = HOME) -> np.ndarray:
    return take_scan(world, pose, laser, np.random.default_rng(seed), 0).ranges_m


def many(world: World, laser: LaserModel, scans: int = 40) -> np.ndarray:
    return np.array([ranges(world, laser, seed) for seed in range(scans)])


@pytest.mark.parametrize(
    ("name", "field_of_view_deg", "step_deg", "far_m", "period_s"),
    [
        ("urg-04lx", 239.06, 360 / 1024, 5.0, 0.1),
        ("utm-30lx", 270, 0.25, 30.0, 0.025),
        ("ust-10lx", 270, 0.25, 10.0, 0.025),
        ("lds-01", 359, 1.0, 3.5, 0.2),
    ],
)
def test_sensors(name: str, field_of_view_deg: float, step_deg: float, far_m: float, period_s: float) -> None:
    spec = LASERS[name]
    assert spec.field_of_view_rad == pytest.approx(field_of_view_deg * DEG, abs=1e-4)
    assert (spec.angle_step_rad, spec.range_max_m, spec.scan_time_s) == (pytest.approx(step_deg * DEG), far_m, period_s)
    assert 0 < spec.time_increment_s * spec.beams <= spec.scan_time_s * 1.0001


def test_without_errors_a_scan_is_the_truth() -> None:
    read = ranges(SQUARE, LaserModel(URG), pose=Pose(0.3, -0.4, 0.2))
    true, _ = SQUARE.cast((0.3, -0.4), URG.angles_rad + 0.2)
    np.testing.assert_array_equal(read, true)


def test_noise_is_a_share_of_the_distance() -> None:
    read = many(ROUND_ROOM, LaserModel(URG, noise=0.015))
    assert read.mean() == pytest.approx(2.0, abs=4 * 0.03 / math.sqrt(read.size))
    assert read.std() == pytest.approx(0.03, rel=0.02)
    far = replace(ROUND_ROOM, arcs=ROUND_ROOM.arcs * (1, 1, 2, 1, 1))
    assert many(far, LaserModel(URG, noise=0.015)).std() == pytest.approx(0.06, rel=0.02)


def test_bias_is_a_factor() -> None:
    np.testing.assert_allclose(ranges(SQUARE, LaserModel(URG, bias=-0.03)), 0.97 * ranges(SQUARE, LaserModel(URG)))


def test_mixed_pixels_lie_between_near_and_far_and_only_at_edges() -> None:
    clean, mixed = ranges(STEP, LaserModel(URG)), many(STEP, LaserModel(URG, mixed_pixels=0.4), 400)
    edge = int(np.flatnonzero(np.diff(clean) > 1.0)[0])
    changed = (mixed != clean) & np.isfinite(clean)
    ahead = np.abs(URG.angles_rad) < 60 * DEG  # farther out neighbouring beams are far from each other on one wall
    assert set(np.flatnonzero(changed.any(axis=0) & ahead)) == {edge, edge + 1}
    pair = mixed[:, [edge, edge + 1]]
    assert pair.min() >= clean[edge]
    assert pair.max() <= clean[edge + 1]
    assert changed[:, edge].mean() == pytest.approx(0.4, abs=0.1)


def test_nothing_returns_beyond_the_greatest_incidence() -> None:
    sharp = LaserModel(URG, incidence_sure_rad=60 * DEG, incidence_max_rad=60 * DEG)
    seen = np.isfinite(ranges(WALL_AHEAD, sharp))
    np.testing.assert_array_equal(seen, np.abs(URG.angles_rad) < 60 * DEG)


def test_returns_grow_fewer_on_the_ramp() -> None:
    ramp = LaserModel(URG, incidence_sure_rad=40 * DEG, incidence_max_rad=60 * DEG)
    seen = np.isfinite(many(WALL_AHEAD, ramp, 300)).mean(axis=0)
    angle = np.abs(URG.angles_rad) / DEG
    assert (seen[angle < 39.9] == 1).all()
    assert (seen[angle > 60.1] == 0).all()
    between = (angle > 40) & (angle < 60)
    assert np.abs(seen - (60 - angle) / 20)[between].max() < 0.12


def test_readings_at_the_limits_are_no_returns() -> None:
    odd = many(ROUND_ROOM, LaserModel(URG, min_readings=0.1, max_readings=0.05))
    assert np.isnan(odd).mean() == pytest.approx(0.15, abs=0.01)
    np.testing.assert_allclose(odd[np.isfinite(odd)], 2.0)


def test_ranges_out_of_limits_are_no_returns() -> None:
    short = replace(URG, range_max_m=1.9)
    assert np.isnan(ranges(ROUND_ROOM, LaserModel(short))).all()
    assert np.isnan(ranges(ROUND_ROOM, LaserModel(replace(URG, range_min_m=2.1)))).all()
    assert np.isnan(ranges(WALL_AHEAD, LaserModel(URG, mixed_pixels=1.0))[np.abs(URG.angles_rad) > 91 * DEG]).all()


@given(st.integers(0, 1000), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-4, 4))
def test_a_scan_holds_valid_ranges_or_nan(seed: int, x: float, y: float, yaw: float) -> None:
    laser = LaserModel(URG, 0.1, 0.03, 0.5, 0.05, 0.05, 50 * DEG, 60 * DEG)
    read = ranges(SQUARE, laser, seed, Pose(x, y, yaw))
    good = read[np.isfinite(read)]
    assert not np.isinf(read).any()
    assert ((good > URG.range_min_m) & (good < URG.range_max_m)).all()


def test_a_moving_scan_at_rest_is_a_static_one() -> None:
    laser, pose = LaserModel(URG, 0.015, 0.0, 0.3, 0.01, 0.01, 50 * DEG, 60 * DEG), Pose(0.4, 0.2, 0.7)
    static, moving = (take_scan(SQUARE, m, laser, np.random.default_rng(5), 3) for m in (pose, lambda _: pose))
    np.testing.assert_array_equal(static.ranges_m, moving.ranges_m)
    assert moving.stamp_ns == 3


def test_every_beam_sees_from_where_the_laser_is_by_then() -> None:
    def motion(seconds: float) -> Pose:
        return Pose(0.5 * seconds, 0.2, 2.0 * seconds)

    laser = LaserModel(URG)
    moving = take_scan(SQUARE, motion, laser, np.random.default_rng(0), 0).ranges_m
    for beam in (0, 300, 680):
        pose = motion(beam * URG.time_increment_s)
        assert moving[beam] == ranges(SQUARE, laser, pose=pose)[beam]
    assert not np.array_equal(moving, ranges(SQUARE, laser, pose=motion(0.0)))


def test_a_seed_gives_one_scan_and_every_scan_takes_as_many_numbers() -> None:
    laser = LaserModel(URG, 0.015, mixed_pixels=0.3, min_readings=0.01)
    np.testing.assert_array_equal(ranges(SQUARE, laser, 4), ranges(SQUARE, laser, 4))
    assert not np.array_equal(ranges(SQUARE, laser, 4), ranges(SQUARE, laser, 5))
    ahead = []
    for world in (SQUARE, STEP):
        rng = np.random.default_rng(0)
        take_scan(world, HOME, laser, rng, 0)
        ahead.append(rng.random())
    assert ahead[0] == ahead[1]
