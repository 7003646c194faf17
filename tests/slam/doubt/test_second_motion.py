"""A cart that keeps its distance ahead of the laser is taken for the walls: the scans show both motions, and doubt."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.pose import Trajectory
from mavnav.scan import LaserSpec
from mavnav.slam.doubt.second_motion import EXAMINED, SPANS_S, SPEEDS_M_S, examined_rows, rival, second_minimum
from mavnav.slam.findings import SECOND_MOTION
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.methods.registry import make_method
from mavnav.slam.pipeline import run_slam
from mavnav.slam.result import SlamResult
from mavnav.slam.track import Track
from support.marks import slow
from support.synthetic import NOTHING, along, box, corridor_with_rooms, record

SPEC = LaserSpec(-np.pi * 3 / 4, np.pi / 240, 361, 0.05, 10.0)
PERIOD_NS = 100_000_000
MIDDLE = len(SPEEDS_M_S) // 2


@cache
def behind_a_cart(width_m: float, ahead_m: float = 1.0, *, with_odometry: bool = False) -> tuple[SlamResult, float]:
    """Return the run of a laser behind a cart, and how long its path truly is, m; any odometry is right."""
    cart = box(ahead_m + 0.5, 0.0, 1.0, width_m) if width_m else NOTHING
    path = along([(2.0, 0.0), (10.0, 0.05)], speed_m_s=0.7)
    drive = record(corridor_with_rooms(), path, SPEC, noise=0.004, seed=1, carried=cart)
    run = run_slam(lambda: drive.scans, Config(), 0.1, path if with_odometry else None)
    return run, path[0].gap(path[len(path) - 1])[0]


def off_m(run: SlamResult, true_m: float) -> float:
    """Return how much the distance from the first pose to the last is wrong, m."""
    return abs(float(np.hypot(*(run.trajectory.xyyaw[-1] - run.trajectory.xyyaw[0])[:2])) - true_m)


@pytest.mark.parametrize(("width_m", "ahead_m"), [slow(1.4, 1.0), slow(0.5, 2.4), (0.3, 1.0)])
def test_the_track_behind_a_cart_is_in_doubt(width_m: float, ahead_m: float) -> None:
    run, true_m = behind_a_cart(width_m, ahead_m)
    assert off_m(run, true_m) > 3.0
    assert run.doubt is not None
    assert run.doubt.high
    assert SECOND_MOTION in {reason.name for reason in run.doubt.reasons}


@pytest.mark.parametrize(("width_m", "ahead_m"), [(0.3, 1.0), slow(0.5, 2.4)])
def test_right_odometry_shows_the_motion_behind_a_cart(width_m: float, ahead_m: float) -> None:
    """The track without it stands still; all of it was left out as a part that errs, which ended in IndexError."""
    run, true_m = behind_a_cart(width_m, ahead_m, with_odometry=True)
    assert off_m(run, true_m) < 0.1
    assert run.odometry is not None


@pytest.mark.parametrize(("width_m", "ahead_m"), [(0.0, 1.0), (0.5, 4.0)], ids=["no cart", "far ahead"])
def test_a_right_track_is_not(width_m: float, ahead_m: float) -> None:
    run, true_m = behind_a_cart(width_m, ahead_m)
    assert off_m(run, true_m) < 0.1
    assert run.doubt is not None
    assert run.doubt.probability < 0.1


@pytest.mark.parametrize(("track_m_s", "found"), [(0.0, (0.8, 0.0)), (0.8, None)], ids=["with the cart", "right"])
def test_what_moves_with_a_laser_that_moves_is_no_second_motion(
    track_m_s: float, found: tuple[float, float] | None
) -> None:
    """Half of the points are on walls, half on a cart, that moves with the laser at 0.8 m/s."""
    rng = np.random.default_rng(0)
    walls, cart = rng.uniform(-6.0, 6.0, (120, 2)), rng.uniform(1.0, 2.0, (120, 2))
    points = {k: np.vstack((walls - (0.08 * k, 0.0), cart))[rng.permutation(240)] for k in (0, 8, 12)}
    stamps_ns, xyyaw = np.arange(13) * PERIOD_NS, np.zeros((13, 3))
    xyyaw[:, 0] = 0.1 * track_m_s * np.arange(13)
    track = Track(list, Config(), Motion(0.1), make_method(Config()))
    velocity = rival((0, 8, 12), Trajectory(stamps_ns, xyyaw), points, track)
    assert velocity == (None if found is None else pytest.approx(found))


def valley(*minima: tuple[int, int, float]) -> np.ndarray:
    """Return costs over velocities: a cone of 0.1 a cell about each minimum (cells from the middle, cost), to 0.5."""
    i, j = np.indices((len(SPEEDS_M_S),) * 2) - MIDDLE
    return np.minimum.reduce([np.full(i.shape, 0.5), *(c + 0.1 * np.hypot(i - a, j - b) for a, b, c in minima)])


@pytest.mark.parametrize(
    ("other", "found"),
    [((7, 0, 0.2), (0.7, 0.0, 0.1)), ((0, -9, 0.0), (0.0, -0.9, -0.1)), ((7, 0, 0.26), None), ((2, 0, 0.1), None)],
    ids=["as good", "better", "worse", "too close"],
)
def test_a_second_motion_is_another_minimum(
    other: tuple[int, int, float], found: tuple[float, float, float] | None
) -> None:
    assert second_minimum(valley((0, 0, 0.1), other)) == (None if found is None else pytest.approx(found))


def test_a_motion_that_walls_do_not_show_is_no_second_one() -> None:
    along_m_s = np.broadcast_to(0.4 * np.abs(SPEEDS_M_S), (len(SPEEDS_M_S),) * 2)
    assert second_minimum(along_m_s + 1e-3 * np.cos(np.arange(len(SPEEDS_M_S)))[:, None]) is None


def test_scans_are_compared_with_later_ones() -> None:
    stamps_ns = np.arange(100, dtype=np.int64) * PERIOD_NS
    rows = examined_rows(stamps_ns, 0.1)
    assert len(rows) == EXAMINED - 2  # the last two have no scan 1.2 s later
    assert all((b - a, c - a) == (8, 12) for a, b, c in rows)
    assert not examined_rows(np.arange(5, dtype=np.int64) * 2 * 10**9, 2.0)  # too far apart
    assert SPANS_S == (0.8, 1.2)


def test_a_scan_without_a_later_one_in_time_is_left_out() -> None:
    stamps_ns = np.arange(100, dtype=np.int64) * PERIOD_NS
    stamps_ns[50:] += 5 * 10**9
    assert all(some[-1] < 50 or some[0] >= 50 for some in examined_rows(stamps_ns, 0.1))
