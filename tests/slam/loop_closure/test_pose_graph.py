"""Pose graphs: exact where nothing contradicts, a fair share where something does, steady against a wrong edge."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavnav.pose import Pose, blend
from mavnav.slam.findings import Edge
from mavnav.slam.loop_closure.pose_graph import OUTLIER_SIGMAS, _EdgeErrors, optimize

RING = [Pose(2 * cos(a), 2 * sin(a), a + pi / 2) for a in np.linspace(0, 2 * pi, 25)[:-1]]


def edge(start: int, end: int, start_T_end: Pose, sigma_m: float = 0.01, sigma_rad: float = 0.01) -> Edge:
    return Edge(start, end, start_T_end, np.diag([1 / sigma_m, 1 / sigma_m, 1 / sigma_rad]))


def path(poses: list[Pose], sigma_m: float = 0.01, sigma_rad: float = 0.01) -> list[Edge]:
    return [edge(k, k + 1, a.between(b), sigma_m, sigma_rad) for k, (a, b) in enumerate(pairwise(poses))]


def drifted(poses: list[Pose], step: Pose) -> list[Pose]:
    """Dead reckoning in which every step is off by the same motion."""
    out = [poses[0]]
    for a, b in pairwise(poses):
        out.append(out[-1] @ a.between(b) @ step)
    return out


def off_m(a: list[Pose], b: list[Pose]) -> float:
    return max(p.between(q).distance_m for p, q in zip(a, b, strict=True))


def test_poses_that_fit_stay() -> None:
    edges = [*path(RING), edge(0, 23, RING[0].between(RING[23]), 0.01, 0.01)]
    assert off_m(optimize(RING, edges), RING) < 1e-9


def test_true_edges_are_found_from_a_bad_start() -> None:
    edges = [*path(RING), edge(0, 23, RING[0].between(RING[23]), 0.01, 0.01)]
    assert off_m(drifted(RING, Pose(0.02, 0.01, 0.05)), RING) > 1.5
    assert off_m(optimize(drifted(RING, Pose(0.02, 0.01, 0.05)), edges), RING) < 1e-6


def test_a_closed_loop_spreads_the_drift() -> None:
    off = drifted(RING, Pose(0.0, 0.0, 0.01))
    closed = optimize(off, [*path(off), edge(0, 23, RING[0].between(RING[23]), 0.001, 0.001)])
    assert closed[0] == RING[0]
    assert RING[23].between(closed[23]).distance_m < 0.01
    assert off_m(closed, RING) < 0.3 * off_m(off, RING)


def test_one_wrong_edge_among_true_ones_is_outweighed() -> None:
    true = [edge(k, k + 12, RING[k].between(RING[k + 12]), 0.01, 0.01) for k in range(0, 12, 2)]
    wrong = edge(3, 15, Pose(3.0, 0.0, 0.0), 0.01, 0.01)
    assert off_m(optimize(RING, [*path(RING), *true, wrong]), RING) < 0.15  # 0.7 by least squares


def test_an_edge_without_information_along_a_direction_leaves_it_to_the_others() -> None:
    direction = 0.6
    across = np.zeros((3, 3))
    across[1, :2] = -100 * sin(direction), 100 * cos(direction)
    line = [Pose(float(k), 0.0, 0.0) for k in range(6)]
    measured = Pose(5.0 + 2.0 * cos(direction) - 0.3 * sin(direction), 2.0 * sin(direction) + 0.3 * cos(direction), 1.0)
    closed = optimize(line, [*path(line, 0.1, 0.1), Edge(0, 5, measured, across)])
    off = line[5].between(closed[5])
    moved_along_m = closed[5].x_m * cos(direction) + closed[5].y_m * sin(direction) - 5.0 * cos(direction)
    assert -closed[5].x_m * sin(direction) + closed[5].y_m * cos(direction) == pytest.approx(
        0.3 - 5.0 * sin(direction), abs=0.02
    )
    assert abs(moved_along_m) < 0.3
    assert off.distance_m < 0.5


def test_yaw_errors_wrap() -> None:
    poses = [Pose(0, 0, pi - 0.01), Pose(1, 0, -pi + 0.01)]
    edges = [edge(0, 1, poses[0].between(poses[1]), 0.1, 0.1)]
    assert off_m(optimize(poses, edges), poses) < 1e-9


def test_two_poses_without_a_loop_follow_their_edge() -> None:
    moved = optimize([Pose(), Pose(5.0, 5.0, 1.0)], [edge(0, 1, Pose(1.0, 0.0, 0.2), 0.1, 0.1)])
    assert Pose(1.0, 0.0, 0.2).between(moved[1]).distance_m < 1e-6


def test_one_pose_stays() -> None:
    assert optimize([Pose(1, 2, 3)], []) == [Pose(1, 2, 3)]


numbers = st.floats(-3, 3, allow_nan=False)
anywhere = st.builds(Pose, numbers, numbers, numbers)


@settings(max_examples=50)
@given(st.lists(anywhere, min_size=4, max_size=4), anywhere)
def test_jacobian_is_the_slope_of_the_errors(poses: list[Pose], measured: Pose) -> None:
    graph = _EdgeErrors([*path(poses, 0.1, 0.2), edge(0, 3, measured, 0.3, 0.4)], len(poses))
    here = np.array([p.as_array() for p in poses])
    slopes = graph.jacobian(here).toarray()
    for column in range(9):
        ahead = here.copy()
        ahead[1 + column // 3, column % 3] += 1e-6
        change = graph.errors(ahead) - graph.errors(here)
        change[:, 2] = (change[:, 2] + 5 * pi) % (10 * pi) - 5 * pi  # yaw errors over a sigma of 0.2 wrap at 10 pi
        np.testing.assert_allclose(change.ravel()[:9] / 1e-6, slopes[:9, column], atol=1e-3, rtol=1e-3)


def test_the_loss_is_smooth_where_outliers_begin() -> None:
    def loss(sigmas: float) -> float:
        return _EdgeErrors([edge(0, 1, Pose(), 1.0, 1.0)], 2).cost(np.array([(0, 0, 0), (sigmas, 0, 0)], float))

    assert loss(1.0) == pytest.approx(1.0)
    assert loss(OUTLIER_SIGMAS) == pytest.approx(OUTLIER_SIGMAS**2)
    assert loss(10.0) == pytest.approx(OUTLIER_SIGMAS * (20.0 - OUTLIER_SIGMAS))


@given(anywhere, anywhere)
def test_blend_goes_from_one_pose_to_the_other(a: Pose, b: Pose) -> None:
    assert a.between(blend(a, b, 0.0)).distance_m < 1e-9
    assert b.between(blend(a, b, 1.0)).distance_m < 1e-9
    middle = blend(a, b, 0.5)
    assert abs(a.between(middle).yaw_rad) <= abs(a.between(b).yaw_rad) + 1e-9
