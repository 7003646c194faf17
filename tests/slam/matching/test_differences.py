"""What makes given poses differ from a track is found again; what is usual in the log, or one scan alone, is not."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.pose import Trajectory
from mavnav.slam.matching.differences import Differences, differences, jumps
from support.synthetic import along

CORNERS = [(1.0, 0.8), (4.9, 0.8), (4.6, 2.9), (1.2, 2.6), (1.0, 0.8), (4.9, 0.8), (4.6, 2.9)]
PATH = along(CORNERS, 0.1, 0.8, 1.5, 10**9)
HALF = len(PATH) // 2


def noisy(noise_m: float, noise_rad: float, seed: int = 0) -> np.ndarray:
    """Return the poses of the path with noise."""
    return PATH.xyyaw + np.random.default_rng(seed).normal(size=(len(PATH), 3)) * (noise_m, noise_m, noise_rad)


@pytest.mark.parametrize("seed", range(5))
def test_the_noise_of_matching_is_no_difference(seed: int) -> None:
    assert differences(Trajectory(PATH.stamps_ns, noisy(0.005, 0.003, seed)), PATH) == Differences()


@pytest.mark.parametrize("seed", range(5))
def test_every_kind_of_error_is_found_beside_the_others(seed: int) -> None:
    poses = noisy(0.005, 0.003, seed)
    poses[HALF:, 2] += np.radians(-3.0)
    poses[HALF // 2 :, 1] += 0.1
    poses[:, :2] *= 0.97
    seen = differences(Trajectory(PATH.stamps_ns + 150_000_000, poses), PATH)
    assert seen.late_s == pytest.approx(0.15, abs=0.03)
    assert seen.distance_scale == pytest.approx(0.97, abs=0.01)
    slip, bend = seen.jumps
    assert slip.moved_m == pytest.approx(0.1, abs=0.03)
    assert slip.stamp_ns == pytest.approx(PATH.stamps_ns[HALF // 2], abs=0.2e9)
    assert bend.turned_rad == pytest.approx(np.radians(3.0), abs=0.01)
    assert bend.stamp_ns == pytest.approx(PATH.stamps_ns[HALF], abs=0.2e9)


def test_one_scan_beside_the_path_is_no_jump() -> None:
    poses = PATH.xyyaw.copy()
    poses[HALF] += (0.3, 0.3, 0.2)
    assert jumps(Trajectory(PATH.stamps_ns, poses), PATH) == ()


def test_a_jump_counts_beside_what_is_usual() -> None:
    wandering = PATH.xyyaw.copy()
    wandering[:, 1] += 0.2 * np.sin(PATH.stamps_ns / 1e9)
    assert jumps(Trajectory(PATH.stamps_ns, wandering.copy()), PATH) == ()
    wandering[HALF:, 1] += 0.1
    assert jumps(Trajectory(PATH.stamps_ns, wandering), PATH) == ()


def test_poses_that_share_no_motion_show_nothing() -> None:
    still = Trajectory(PATH.stamps_ns, np.zeros((len(PATH), 3)))
    assert differences(still, still) == Differences()
    assert differences(Trajectory(PATH.stamps_ns + 10**12, PATH.xyyaw), PATH) == Differences()
    assert differences(PATH, Trajectory(PATH.stamps_ns[:1], PATH.xyyaw[:1])) == Differences()
    empty = Trajectory(PATH.stamps_ns[:0], PATH.xyyaw[:0])
    assert differences(empty, PATH) == differences(PATH, empty) == Differences()
    assert jumps(PATH, Trajectory(PATH.stamps_ns[:1], PATH.xyyaw[:1])) == ()
