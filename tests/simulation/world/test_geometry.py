"""The world's geometry: rays and clearances against slow twins, symmetries, and arcs against fine polylines."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavnav.pose import Pose, transform_points
from mavnav.simulation.world.geometry import World
from mavnav.simulation.world.shapes import Box, Circle, Polyline, WallEntry, world_of

BEARINGS = np.linspace(-math.pi, math.pi, 181)


def scattered(seed: int, segments: int = 12, arcs: int = 6) -> World:
    rng = np.random.default_rng(seed)
    round_walls = np.column_stack(
        (
            rng.uniform(-4, 4, (arcs, 2)),
            rng.uniform(0.1, 3, arcs),
            rng.uniform(-7, 7, arcs),
            rng.uniform(-2 * math.pi, 2 * math.pi, arcs),
        )
    )
    return World(rng.uniform(-4, 4, (segments, 4)), round_walls)


def moved(world: World, pose: Pose) -> World:
    ends = transform_points(pose, world.segments.reshape(-1, 2)).reshape(-1, 4)
    arcs = world.arcs.copy()
    arcs[:, :2] = transform_points(pose, arcs[:, :2])
    arcs[:, 3] += pose.yaw_rad
    return World(ends, arcs)


def straightened(world: World, pieces: int) -> World:
    """Replace every arc by chords between points on it."""
    chords = [world.segments]
    for cx, cy, radius, start, sweep in world.arcs:
        angle = start + sweep * np.linspace(0, 1, pieces + 1)
        xy = np.column_stack((cx + radius * np.cos(angle), cy + radius * np.sin(angle)))
        chords.append(np.column_stack((xy[:-1], xy[1:])))
    return World(np.vstack(chords), np.empty((0, 5)))


# ---- slow twins: one ray and one wall at a time ----------------------------------------------------------------------


def ray_on_segment(x, y, bearing, x1, y1, x2, y2):
    """Turn the ray onto the x axis, then interpolate where the wall crosses it."""
    turn = Pose(x, y, bearing).inverse()
    a, b = turn @ Pose(x1, y1), turn @ Pose(x2, y2)
    if (a.y_m > 0) == (b.y_m > 0):
        return math.inf, math.nan
    share = a.y_m / (a.y_m - b.y_m)
    r = a.x_m + share * (b.x_m - a.x_m)
    wall = math.atan2(abs(b.y_m - a.y_m), abs(b.x_m - a.x_m))
    return (r, math.pi / 2 - wall) if r > 0 else (math.inf, math.nan)


def ray_on_arc(x, y, bearing, cx, cy, radius, start, sweep):
    """Solve |p + r d - c| = radius by the quadratic formula."""
    dx, dy, px, py = math.cos(bearing), math.sin(bearing), x - cx, y - cy
    b, c = px * dx + py * dy, px * px + py * py - radius * radius
    if b * b < c:
        return math.inf, math.nan
    for r in (-b - math.sqrt(b * b - c), -b + math.sqrt(b * b - c)):
        hx, hy = px + r * dx, py + r * dy
        turned = math.atan2(hy, hx) - start
        on_it = turned % (2 * math.pi) <= sweep if sweep >= 0 else -turned % (2 * math.pi) <= -sweep
        if r > 0 and on_it:
            return r, math.acos(min(1.0, abs(hx * dx + hy * dy) / radius))
    return math.inf, math.nan


def naive_cast(world, xy, bearings):
    out = []
    for bearing in bearings:
        hits = [ray_on_segment(*xy, bearing, *wall) for wall in world.segments]
        hits += [ray_on_arc(*xy, bearing, *wall) for wall in world.arcs]
        out.append(min(hits, key=lambda hit: hit[0]))
    return np.array(out).T


def naive_clearance(world, xy):
    """Look at many points of every wall."""
    fine = straightened(world, 4000).segments
    share = np.linspace(0, 1, 2000)[:, None]
    long = np.vstack([s[:2] + share * (s[2:] - s[:2]) for s in world.segments])
    points = np.vstack((long, fine[len(world.segments) :, :2], fine[len(world.segments) :, 2:]))
    return np.hypot(*(points - xy).T).min()


# ---- properties ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_cast_equals_its_slow_twin(seed: int) -> None:
    world = scattered(seed)
    ranges, incidence = world.cast((0.3, -0.2), BEARINGS)
    slow_ranges, slow_incidence = naive_cast(world, (0.3, -0.2), BEARINGS)
    assert np.isfinite(ranges).sum() > 90
    np.testing.assert_allclose(ranges, slow_ranges, atol=1e-9)
    np.testing.assert_allclose(incidence, slow_incidence, atol=1e-5)


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-4, 4), st.integers(0, 50))
def test_cast_moves_with_the_world(x: float, y: float, yaw: float, seed: int) -> None:
    world, pose, at = scattered(seed), Pose(x, y, yaw), Pose(0.5, 0.1, 0.2)
    there = pose @ at
    here, incidence = world.cast((at.x_m, at.y_m), BEARINGS[::6] + at.yaw_rad)
    moved_here, moved_incidence = moved(world, pose).cast(
        (there.x_m, there.y_m), BEARINGS[::6] + at.yaw_rad + pose.yaw_rad
    )
    # A ray that just touches an end may pass it after rounding: at most one in this many.
    same = np.isclose(here, moved_here, atol=1e-6) | (~np.isfinite(here) & ~np.isfinite(moved_here))
    assert (~same).sum() <= 1
    close = same & np.isfinite(here) & (incidence < 1.5)
    np.testing.assert_allclose(incidence[close], moved_incidence[close], atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_arcs_equal_fine_polylines(seed: int) -> None:
    world = scattered(seed, segments=1, arcs=5)
    exact, incidence = world.cast((0.0, 0.0), BEARINGS)
    chords, chord_incidence = straightened(world, 3000).cast((0.0, 0.0), BEARINGS)
    steep = np.isfinite(exact) & np.isfinite(chords) & (incidence < 1.3)
    assert steep.sum() > 20
    assert (np.isfinite(exact) != np.isfinite(chords)).sum() <= 1
    close = np.isclose(exact, chords, rtol=0, atol=1e-4)
    assert (~close[steep]).sum() <= 1  # a grazed end
    assert np.abs(incidence - chord_incidence)[steep & close].max() < 5e-3


def test_clearance_equals_its_slow_twin() -> None:
    world = scattered(7)
    points = np.random.default_rng(1).uniform(-5, 5, (40, 2))
    slow = [naive_clearance(world, xy) for xy in points]
    np.testing.assert_allclose(world.clearance_m(points), slow, atol=3e-3)


@pytest.mark.parametrize("seed", range(4))
def test_least_clearance_of_a_way_equals_that_of_its_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    touched = 0
    for _ in range(40):
        world, a, b = scattered(int(rng.integers(1000)), 2, 2), *rng.uniform(-5, 5, (2, 2))
        fine = world.clearance_m(a + np.linspace(0, 1, 2001)[:, None] * (b - a)).min()
        least = world.least_clearance_m(a, b)
        assert least == pytest.approx(fine, abs=np.hypot(*(b - a)) / 4000 + 1e-9)
        assert least <= fine
        touched += least == 0.0
    assert 5 < touched < 35


def test_least_clearance_of_a_way_without_length_or_walls() -> None:
    a = np.array((1.0, 2.0))
    assert World(np.empty((0, 4)), np.empty((0, 5))).least_clearance_m(a, -a) == np.inf
    assert World(np.array([(0.0, 0.0, 0.0, 9.0)]), np.empty((0, 5))).least_clearance_m(a, a) == 1.0


def test_no_ray_is_shorter_than_the_clearance() -> None:
    world = scattered(3)
    for xy in np.random.default_rng(2).uniform(-3, 3, (20, 2)):
        shortest = world.cast(xy, np.linspace(-math.pi, math.pi, 721))[0].min()
        clearance = world.clearance_m(xy[None, :])[0]
        assert clearance <= shortest + 1e-9
        assert shortest < clearance + 0.2


def test_no_ray_slips_through_a_joint() -> None:
    box = Polyline(points_m=((0.1, 0.1), (3.3, 0.7), (2.9, 2.3), (0.2, 1.9)), closed=True)
    corners = np.array(box.points_m) - (1.0, 1.0)
    ranges, _ = world_of([WallEntry(polyline=box)]).cast((1.0, 1.0), np.arctan2(corners[:, 1], corners[:, 0]))
    np.testing.assert_allclose(ranges, np.hypot(*corners.T), atol=1e-8)
    halves = World(np.empty((0, 4)), np.array([(0, 0, 1, 0.3, math.pi), (0, 0, 1, 0.3, -math.pi)]))
    assert np.isfinite(halves.cast((0.0, 0.0), np.array([0.3, 0.3 + math.pi, 0.3 - math.pi]))[0]).all()


def test_every_ray_may_begin_elsewhere() -> None:
    world = scattered(1)
    xy = np.random.default_rng(0).uniform(-1, 1, (9, 2))
    bearings = BEARINGS[:9]
    singly = [world.cast(tuple(p), bearings[k : k + 1])[0][0] for k, p in enumerate(xy)]
    np.testing.assert_array_equal(world.cast(xy, bearings)[0], singly)


def test_known_hits() -> None:
    wall = World(np.array([(2.0, -5.0, 2.0, 5.0)]), np.array([(-3.0, 0.0, 1.0, 0.0, 2 * math.pi)]))
    ranges, incidence = wall.cast((0.0, 0.0), np.array([0.0, math.pi / 3, math.pi, math.pi / 2]))
    np.testing.assert_allclose(ranges, [2.0, 4.0, 2.0, math.inf])
    np.testing.assert_allclose(incidence, [0.0, math.pi / 3, 0.0, math.nan], atol=1e-7)
    np.testing.assert_allclose(wall.clearance_m(np.array([(0.0, 0.0), (-3.0, 0.0), (2.0, 6.0)])), [2.0, 1.0, 1.0])


@pytest.mark.parametrize("seed", range(6))
def test_bounds_hold_every_wall_and_no_more(seed: int) -> None:
    world = scattered(seed, segments=1, arcs=2)
    ends = straightened(world, 4000).segments.reshape(-1, 2)
    np.testing.assert_allclose(world.bounds_m, (*ends.min(axis=0), *ends.max(axis=0)), atol=1e-5)


def test_only_closed_shapes_hold_something() -> None:
    box = Box(center_m=(1, 1), size_m=(2, 0.2), yaw_deg=90)
    assert box.contains((1, 1.9))
    assert not box.contains((1.9, 1))
    assert Circle(center_m=(1, 1), radius_m=0.5).contains((1.3, 1.3))
    assert not Circle(center_m=(1, 1), radius_m=0.5).contains((1.4, 1.4))
    u = ((0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (2.0, 3.0), (2.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0))
    assert Polyline(points_m=u, closed=True).contains((0.5, 2.0))
    assert not Polyline(points_m=u, closed=True).contains((1.5, 2.0))
    assert not Polyline(points_m=u).contains((0.5, 2.0))


def test_a_world_has_walls_of_four_and_arcs_of_five_numbers() -> None:
    with pytest.raises(ValueError, match="no world"):
        World(np.zeros((2, 5)), np.zeros((0, 5)))
    with pytest.raises(ValueError, match="read-only"):
        scattered(0).segments[0, 0] = 1.0
