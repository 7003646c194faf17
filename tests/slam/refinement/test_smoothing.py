"""The trajectory without the scans' jitter: the banded solution against a dense one, and what must not be smoothed."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.kernels.scans.rts_smoother import smooth
from mavnav.pose import Pose
from mavnav.slam.matching.scan_matching import Match
from mavnav.slam.matching.steps import Step, Steps
from mavnav.slam.refinement.refine import FEWEST, rests, smooth_positions
from support import naive

PERIOD_S = 0.1
NS = 1_000_000_000


def steps_of(xy_m: np.ndarray, cost_m2: float = 0.02**2, untracked: tuple[int, ...] = ()) -> list[Step]:
    def step(k: int) -> Step:
        pose = Pose(float(xy_m[k, 0]), float(xy_m[k, 1]), 0.01 * k)
        match = Match(pose, cost_m2, 100, 1.0, 1, 1, converged=True)
        return Step(k, k * NS // 10, match, k not in untracked)

    return [step(k) for k in range(len(xy_m))]


def steadied(steps: Iterable[Step]) -> Steps:
    out = Steps(steps)
    smooth_positions(out, PERIOD_S)
    return out


def positions(steps: Iterable[Step]) -> np.ndarray:
    return np.array([(s.match.map_T_laser.x_m, s.match.map_T_laser.y_m) for s in steps])


def length_m(xy_m: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(xy_m, axis=0), axis=1).sum())


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(3, 30), stiffness=st.floats(1e-3, 1e6))
def test_smooth_positions_are_those_of_the_dense_system(seed: int, n: int, stiffness: float) -> None:
    rng = np.random.default_rng(seed)
    xy, elapsed, out = rng.normal(size=(n, 2)), rng.integers(1, 4, n - 1).astype(float), np.empty((n, 2))
    likely = smooth(xy, elapsed, stiffness, out)
    slow, density = naive.smooth(xy, elapsed, stiffness)
    np.testing.assert_allclose(out, slow, atol=1e-6)
    assert likely == pytest.approx(density, rel=1e-6, abs=1e-6)


def test_jitter_on_a_steady_way_is_taken_out() -> None:
    rng = np.random.default_rng(3)
    truth = np.column_stack((0.03 * np.arange(200), 0.5 * np.sin(0.02 * np.arange(200))))
    steps = steps_of(truth + rng.normal(0, 0.003, truth.shape))
    smoothed = positions(steadied(steps))
    off = [np.linalg.norm(xy - truth, axis=1).mean() for xy in (positions(steps), smoothed)]
    assert off[1] < 0.6 * off[0]
    assert abs(length_m(smoothed) / length_m(truth) - 1) < 0.002
    assert [s.match.map_T_laser.yaw_rad for s in steadied(steps)] == [0.01 * k for k in range(200)]


def test_where_scans_are_missing_the_way_goes_on_for_longer() -> None:
    missing = tuple(range(5, 195, 7))
    truth = np.column_stack((0.1 * np.arange(200), np.zeros(200)))
    steps = steps_of(truth + np.random.default_rng(3).normal(0, 0.003, truth.shape), untracked=missing)
    there = np.delete(np.arange(200), missing)
    off = [np.linalg.norm(positions(some)[there] - truth[there], axis=1).mean() for some in (steps, steadied(steps))]
    assert off[1] < 0.6 * off[0]


def test_a_laser_at_rest_stays_where_it_is() -> None:
    rng = np.random.default_rng(4)
    drive = np.column_stack((np.linspace(0.03, 3, 100), np.zeros(100)))
    truth = np.vstack((np.zeros((60, 2)), drive, np.tile(drive[-1], (60, 1))))
    seen = truth + rng.normal(0, 0.002, truth.shape)
    smoothed = positions(steadied(steps_of(seen)))
    for rest in (slice(5, 50), slice(170, 220)):
        assert length_m(smoothed[rest]) < 0.03 * length_m(seen[rest])
    assert abs(length_m(smoothed) / 3.0 - 1) < 0.01


def test_what_scans_tell_surely_is_left() -> None:
    """A rough way that crisp scans saw: what looks like jitter is motion."""
    rough = np.random.default_rng(5).normal(0, 0.004, (80, 2)) + np.column_stack((0.03 * np.arange(80), np.zeros(80)))
    for rms_m in (0.02, 0.005):
        moved = np.linalg.norm(positions(steadied(steps_of(rough, rms_m**2))) - rough, axis=1)
        assert np.median(moved) <= rms_m / 7


def test_gaps_leaps_and_short_stretches_are_not_smoothed_over() -> None:
    rng = np.random.default_rng(6)
    way = np.column_stack((0.02 * np.arange(60), np.zeros(60))) + rng.normal(0, 0.002, (60, 2))
    way[30:] += (2.0, 1.0)  # found again elsewhere
    gap = tuple(range(40, 60 - FEWEST // 2))  # 1.5 s
    steps = steps_of(way, untracked=gap)
    smoothed = steadied(steps)
    assert np.linalg.norm(positions(smoothed) - way, axis=1).max() < 0.02
    assert smoothed[60 - FEWEST // 2 :] == steps[60 - FEWEST // 2 :]
    assert [smoothed[k] for k in gap] == [steps[k] for k in gap]


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_rest_stays_in_its_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = np.cumsum(rng.normal(0, 1, (200, 2)) * rng.choice((0.0, 0.001, 0.1), (200, 1), p=(0.6, 0.3, 0.1)), axis=0)
    for rest in rests(xy, 0.004):
        assert rest.stop - rest.start >= FEWEST
        assert np.linalg.norm(np.ptp(xy[rest], axis=0)) <= 0.008
