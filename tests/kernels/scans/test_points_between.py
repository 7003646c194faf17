"""Points on walls between beams that are far apart: equal to their twin, and on walls alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mavnav.kernels.scans.points import LONGEST_M, points_between
from mavnav.pose import Pose
from mavnav.scan import LaserSpec
from support import naive
from support.synthetic import box, furnished_rooms, room, scan_at

REACH_M, SPACING_M = 0.08, 0.06


def between(points: np.ndarray, step_rad: float) -> np.ndarray:
    """Return the points that the kernel adds."""
    out = np.empty((len(points) * int(LONGEST_M / SPACING_M), 2))
    return out[: points_between(points, step_rad, REACH_M, SPACING_M, out)]


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), beams=st.sampled_from((36, 72, 90, 180, 360)))
@example(seed=6170697, beams=36)  # a wall of 1.1 m between two beams
def test_points_between_beams_are_their_twin(seed: int, beams: int) -> None:
    rng, spec = np.random.default_rng(seed), LaserSpec(-np.pi, 2 * np.pi / beams, beams, 0.05, 20.0)
    scan = scan_at(furnished_rooms(), Pose(3.0, 2.2, rng.uniform(-3, 3)), spec, noise=0.02, rng=rng)
    points = scan.points()[rng.random(len(scan.points())) > 0.1].copy()
    expected = naive.points_between(points, spec.angle_step_rad, REACH_M, SPACING_M)
    np.testing.assert_allclose(between(points, spec.angle_step_rad), expected, atol=1e-12)


@pytest.mark.parametrize("beams", [72, 90, 180])
def test_they_lie_on_walls(beams: int) -> None:
    spec = LaserSpec(-np.pi, 2 * np.pi / beams, beams, 0.05, 20.0)
    added = between(scan_at(room(6.0, 4.0), Pose(3.0, 2.0, 0.0), spec).points(), spec.angle_step_rad)
    off_m = np.minimum(abs(abs(added[:, 0]) - 3.0), abs(abs(added[:, 1]) - 2.0))
    assert len(added) > 100
    assert off_m.max() < 0.03  # a corner is cut by no more than the noise of a wall


def test_nothing_is_added_behind_the_edge_of_a_box() -> None:
    """The wall behind a box is 1 m farther away: no points lie in the air between."""
    spec = LaserSpec(-0.6, 0.04, 31, 0.05, 20.0)
    walls = np.vstack((room(8.0, 6.0), box(4.8, 2.8, 0.4, 0.4)))
    added = between(scan_at(walls, Pose(2.0, 3.0, 0.0), spec).points(), spec.angle_step_rad)
    assert len(added)
    ahead = added[abs(added[:, 1]) < 1.0]  # of the walls beside it
    assert not np.any((ahead[:, 0] > 3.25) & (ahead[:, 0] < 5.9))


def test_dense_beams_get_none() -> None:
    spec = LaserSpec(-2.0, 0.006, 667, 0.05, 6.0)
    assert not len(between(scan_at(furnished_rooms(), Pose(3.0, 2.2, 1.0), spec).points(), spec.angle_step_rad))
