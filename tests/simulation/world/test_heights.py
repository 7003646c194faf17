"""Walls with heights: rays in space against a slow twin, tops and bottoms, the slice at flight height."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec import convert

from mavnav.pose import Pose
from mavnav.scan import Attitude, level_scan
from mavnav.simulation.vehicle import Body
from mavnav.simulation.world.laser import LASERS, LaserModel, take_scan, tilted_directions
from mavnav.simulation.world.scenario import FlightConfig
from mavnav.simulation.world.scenario_file import load_scenario
from mavnav.simulation.world.shapes import WallEntry, world_of
from mavnav.units import DEG

CEILING_M = 2.4
WALLS = tuple(
    convert(wall, WallEntry)
    for wall in (
        {"polyline": {"closed": True, "points_m": [[-3, -2], [3, -2], [3, 2], [-3, 2]]}},
        {"polyline": {"points_m": [[-1, -1.5], [1, -1.2]], "height_m": [0, 0.6]}},
        {"box": {"center_m": [1.5, 0.8], "size_m": [0.8, 0.5], "yaw_deg": 30, "height_m": [0.3, 1.1]}},
        {"circle": {"center_m": [-1.5, 0.5], "radius_m": 0.4, "height_m": [0, 0.8]}},
        {"arc": {"center_m": [0, 0.5], "radius_m": 1, "start_deg": 30, "sweep_deg": 100, "height_m": [1.2, 2]}},
        {"table": {"center_m": [-1, -0.8], "size_m": [1, 0.6], "yaw_deg": -20}},
        {"opening": {"points_m": [[2, -2], [2, 0]], "open_m": [0.9, 1.8]}},
    )
)
WORLD = world_of(WALLS, spatial=True, ceiling_m=CEILING_M)


# ---- a slow twin: one ray, one wall at a time ------------------------------------------------------------------------


def meets_wall(origin, direction, x1, y1, x2, y2, band):
    """Intersect the ray with the upright plane of a wall, then look whether the point is on the wall."""
    a, b = np.array([x1, y1, 0.0]), np.array([x2, y2, 0.0])
    normal = np.cross(b - a, [0.0, 0.0, 1.0])
    normal /= np.linalg.norm(normal)
    speed = normal @ direction
    r = normal @ (a - origin) / speed if speed else math.inf
    point = origin + r * direction if math.isfinite(r) else origin
    share = (point - a) @ (b - a) / ((b - a) @ (b - a))
    met = 0 < r < math.inf and 0 <= share <= 1 and band[0] <= point[2] <= band[1]
    return (r, math.acos(min(1.0, abs(speed)))) if met else (math.inf, math.nan)


def meets_plate(origin, direction, height_m, contains):
    r = (height_m - origin[2]) / direction[2] if direction[2] else math.inf
    point = origin + r * direction if math.isfinite(r) else origin
    met = 0 < r < math.inf and contains(tuple(point[:2]))
    return (r, math.acos(min(1.0, abs(direction[2])))) if met else (math.inf, math.nan)


def chords(arc):
    """Return many short walls instead of a round one."""
    cx, cy, radius, start, sweep = arc
    angle = start + sweep * np.linspace(0, 1, 120)
    xy = np.column_stack((cx + radius * np.cos(angle), cy + radius * np.sin(angle)))
    return np.column_stack((xy[:-1], xy[1:]))


def slow_cast(origin, direction):
    found = [meets_plate(origin, direction, height_m, lambda _: True) for height_m in (0.0, CEILING_M)]
    for part in (part for wall in WALLS for part in wall.parts):
        band = part.height_m or (0.0, math.inf)
        walls = np.vstack([part.segments(), *[chords(arc) for arc in part.arcs()]])
        found += [meets_wall(origin, direction, *wall, band) for wall in walls]
        found += [meets_plate(origin, direction, z, part.contains) for z in band] if part.plate() else []
    return min(found, key=lambda hit: hit[0])


@pytest.mark.parametrize("height_m", [0.2, 0.9, 1.5, 2.2])
def test_rays_in_space_equal_their_slow_twin(height_m: float) -> None:
    rng = np.random.default_rng(round(100 * height_m))
    bearing, slope = rng.uniform(-math.pi, math.pi, 12), rng.uniform(-0.7, 0.7, 12)
    directions = np.column_stack((np.cos(bearing) * np.cos(slope), np.sin(bearing) * np.cos(slope), np.sin(slope)))
    ranges, incidence = WORLD.cast_tilted((0.3, -0.2), height_m, directions)
    slow = np.array([slow_cast(np.array([0.3, -0.2, height_m]), direction) for direction in directions])
    np.testing.assert_allclose(ranges, slow[:, 0], atol=2e-3)  # the chords of an arc are within its circle
    np.testing.assert_allclose(incidence, slow[:, 1], atol=4e-2)


def test_level_rays_in_a_world_without_heights_meet_what_they_did() -> None:
    world = world_of(WALLS[:1])
    bearings = np.linspace(-3, 3, 200)
    level = np.column_stack((np.cos(bearings), np.sin(bearings), np.zeros(200)))
    for tilted, plain in zip(world.cast_tilted((1, 1), 1.0, level), world.cast((1, 1), bearings), strict=True):
        np.testing.assert_allclose(tilted, plain, atol=1e-7)


def test_directions_of_a_tilted_laser_follow_the_axes_of_rep_103() -> None:
    ahead, left = np.array([0.0]), np.array([math.pi / 2])
    nose_down = tilted_directions(ahead, 0.0, 10 * DEG, 0.5)[0]
    assert nose_down == pytest.approx(
        [np.cos(0.5) * np.cos(10 * DEG), np.sin(0.5) * np.cos(10 * DEG), -np.sin(10 * DEG)]
    )
    left_up = tilted_directions(left, 10 * DEG, 0.0, 0.0)[0]
    assert left_up == pytest.approx([0, np.cos(10 * DEG), np.sin(10 * DEG)])


def test_a_levelled_scan_shows_the_walls_in_the_plane_and_their_heights() -> None:
    attitude, spec = Attitude(6 * DEG, -5 * DEG, 1.0), LASERS["urg-04lx"]
    tilts = np.repeat(np.array(attitude)[:, None], spec.beams, axis=1)
    room = world_of(WALLS[:1], spatial=True)
    tilted = take_scan(room, Pose(0.2, 0.1, 0.3), LaserModel(spec), np.random.default_rng(0), 0, tilts)
    flat = level_scan(tilted, *attitude)
    level = take_scan(room, Pose(0.2, 0.1, 0.3), LaserModel(spec), np.random.default_rng(0), 0)
    off = np.abs(flat.ranges_m - level.ranges_m)
    assert np.nanquantile(off, 0.98) < 1e-3  # all but the corners
    assert np.isfinite(off).mean() > 0.95
    assert flat.heights_m is not None
    assert np.nanmin(flat.heights_m) < 0.8
    assert np.nanmax(flat.heights_m) > 1.2


def test_the_slice_at_flight_height_has_what_reaches_into_it() -> None:
    assert len(WORLD.slice(1.3, 1.7).segments) == 4
    assert len(WORLD.slice(1.3, 1.7).arcs) == 1
    assert len(WORLD.slice(0.5, 0.6).segments) == 4 + 1 + 4 + 4 * 4 + 1  # room, low wall, box, legs, below the window
    assert len(WORLD.slice(0.7, 0.75).segments) == 4 + 4 + 4 + 1  # room, box, top of the table, below the window
    here = np.array([(-1.0, -0.8)])
    assert WORLD.slice(0.7, 0.75).clearance_m(here)[0] == pytest.approx(0.3)
    assert WORLD.distance_m(here)[0] == 0.0  # on the table
    moved = WORLD.seen_from(Pose(0.4, 0.2, 1.0))
    assert moved.distance_m(np.array([[*(Pose(0.4, 0.2, 1.0).inverse() @ Pose(-1.0, -0.8))[:2]]]))[0] == 0.0


# ---- the vehicle -----------------------------------------------------------------------------------------------------


def test_tilt_and_height_have_the_configured_noise() -> None:
    config = FlightConfig(height_m=1.5, tilt_noise_deg=4, height_noise_mm=30, sensor_tilt_deg=1, sensor_height_mm=5)
    body = Body(config, 0.1, 0.1, seed=1)
    for _ in range(6000):
        body.step()
    true, measured = np.array(body.true), np.array(body.measured)
    assert true.mean(axis=0) == pytest.approx([0, 0, 1.5], abs=0.01)
    assert true.std(axis=0) == pytest.approx([4 * DEG, 4 * DEG, 0.03], rel=0.08)
    assert (measured - true).std(axis=0) == pytest.approx([DEG, DEG, 0.005], rel=0.05)
    follows = np.corrcoef(true[1:, 0], true[:-1, 0])[0, 1]
    assert follows == pytest.approx(math.exp(-100 / 300), abs=0.03)
    assert Body(config, 0.1, 0.1, seed=1).true == body.true[:1]


def test_the_vehicle_tilts_towards_where_it_accelerates() -> None:
    still = FlightConfig(tilt_noise_deg=0, height_noise_mm=0, response_ms=50)
    body = Body(still, 0.1, 0.1, seed=0)
    for dx, dy in ((0.1, 0.0), (0.1, 0.0), (0.1, 0.05), (0.1, 0.05), (0.0, 0.05)):
        body.command(dx, dy)
        body.step()
    pitch, roll = np.array(body.true)[1:, 1] / DEG, np.array(body.true)[1:, 0] / DEG
    assert pitch[0] == pytest.approx(5, abs=1)  # the nose goes down to fly forward, by max_tilt_deg
    assert abs(pitch[1]) < 1
    assert roll[2] == pytest.approx(-5, abs=1)  # the left side goes down to fly to the left
    assert pitch[4] < -4  # it brakes


# ---- scenarios -------------------------------------------------------------------------------------------------------


def test_hover_keeps_free_of_what_is_at_its_height_alone() -> None:
    scenario = load_scenario("hover")
    assert len(scenario.obstacles.segments) < len(scenario.world.segments)
    above_table = np.array([scenario.via_m[0]])
    assert scenario.obstacles.clearance_m(above_table)[0] > 0.5
    assert scenario.world.distance_m(above_table)[0] == 0.0
