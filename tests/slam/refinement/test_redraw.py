"""The map drawn again: sharper, of the same scans, and kept only where it is."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.config.models import Config
from mavnav.pose import Trajectory
from mavnav.slam.matching.motion_model import Motion, twists
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import after
from mavnav.slam.refinement.refine import refine_and_draw
from mavnav.slam.track import Track
from support.synthetic import TOUR, Recording, along, furnished_rooms, record

PERIOD_S = 0.1


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
    drawn = after(before, (refine_and_draw,)).method.grid
    assert np.count_nonzero(drawn.hits) < 0.9 * np.count_nonzero(blur.hits)
    assert int(drawn.hits.sum()) == int(blur.hits.sum())


def test_a_map_that_gets_no_sharper_stays(tracked: Track, tour: Recording) -> None:
    track = replace(tracked, log_scans=lambda: tour.scans[:1]).over(tour.scans[:1])
    grid = track.method.grid
    assert after(track, (refine_and_draw,)).method.grid is grid


def test_nothing_is_drawn_where_scans_do_not_come(tracked: Track, tour: Recording) -> None:
    before = replace(blurred(tracked, tour, 0.015), log_scans=lambda: tour.scans[:-1])
    grid = before.method.grid
    assert after(before, (refine_and_draw,)).method.grid is grid


def test_a_map_without_a_pose_stays(tracked: Track) -> None:
    nothing = replace(tracked, log_scans=list).over([])
    assert not after(nothing, (refine_and_draw,)).method.grid.hits.any()


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
