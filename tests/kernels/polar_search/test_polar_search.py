"""The paper's cost against its twin, and its claim on ideal data."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mavnav.config.models import Config, GridSize, PaperConfig, PaperExpert
from mavnav.kernels.polar_search import search as polar_search
from mavnav.kernels.polar_search.cost import good_beams, polar_cost
from mavnav.pose import Pose, transform_points
from mavnav.scan import LaserSpec
from mavnav.slam.matching.scan_matching import Match
from mavnav.slam.methods.paper import GIVE_UP_RATIO, match_polar, polar_points
from support import matches, naive
from support.matches import polar_problem
from support.synthetic import furnished_rooms, room, scan_at

LASERS = pytest.mark.parametrize("spec", matches.LASERS, ids=["part", "full turn", "clockwise"])


@LASERS
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), counted=st.booleans())
def test_cost_is_its_twin(spec: LaserSpec, seed: int, counted: bool) -> None:
    virtual, points, limits, rng = polar_problem(seed, spec, counted=counted)
    move = rng.uniform(-0.2, 0.2, 3) * rng.choice((1.0, 10.0))  # the farther one is beyond the series
    fast = polar_cost(virtual, np.ascontiguousarray(points.T), *move, limits)
    slow = naive.polar_cost(virtual, points, *move, limits)
    assert fast[1] == slow[1]
    assert fast[0] == pytest.approx(slow[0], rel=1e-9)


@LASERS
@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    grid=st.sampled_from((2, 5, 10)),
    half_m=st.sampled_from((0.3, 0.05, 0.005, 0.0005)),
    half_rad=st.sampled_from((0.3, 0.02, 0.002, 0.0002)),
    useless_m2=st.sampled_from((1e-3, np.inf)),
    reading=st.sampled_from(((1.0, 0.1, 0.0, 0.0), (0.7, 0.06, 1.0, 1.0), (0.5, 0.1, 0.0, 1.0))),
    counted=st.booleans(),
)
@example(
    seed=170, grid=5, half_m=3.0, half_rad=0.02, useless_m2=np.inf, reading=(1.0, 0.1, 0.0, 0.0), counted=False
)  # moves a point straight behind the laser
def test_pruned_search_is_the_exhaustive_one(
    spec: LaserSpec,
    seed: int,
    grid: int,
    half_m: float,
    half_rad: float,
    useless_m2: float,
    reading: tuple[float, ...],
    counted: bool,
) -> None:
    """The same pose, cost, beams, evaluations and iterations, to the bit."""
    virtual, points, limits, _ = polar_problem(seed, spec, counted=counted)
    schedule = np.array([half_m, half_rad, 0.3, 1.0, 1e-5, 1e-4, useless_m2, *reading])
    pruned, exhaustive = (
        polar_search.search(virtual, points, np.array([2.0 * grid, grid, grid, 2, prune]), schedule, limits)
        for prune in (1.0, 0.0)
    )
    np.testing.assert_array_equal(pruned, exhaustive)


@LASERS
@given(seed=st.integers(0, 2**32 - 1))
def test_good_beams_are_their_twins(spec: LaserSpec, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = rng.choice((0.5, 1.0, 1.05, 2.0, np.nan), spec.beams)
    told = ranges, spec.directions, spec.angle_min_rad, spec.angle_step_rad, 0.1
    np.testing.assert_array_equal(good_beams(*told), naive.good_beams(*told))


def test_beams_differing_from_both_neighbours_are_left_out() -> None:
    ranges = np.array([1.0, 1.0, 2.0, 1.0, 1.0, np.nan, 3.0, 3.0, 1.0])
    good = polar_points(ranges, LaserSpec(0.0, 0.1, 9, 0.02, 5.0), 0.1)[:, 2]
    assert good.tolist() == [0, 1, 3, 4, 6, 7, 8]


@pytest.mark.parametrize("grid", ["5x5", "10x10", "20x20"])
@pytest.mark.parametrize(("walls", "at"), [(room(), Pose(2.2, 1.7, 0.4)), (furnished_rooms(), Pose(3.0, 2.2, 1.0))])
def test_identical_shifted_scans_converge_to_the_motion(walls: np.ndarray, at: Pose, grid: str) -> None:
    """The paper: cost below 0.01 mm2; on average about 1000 evaluations on the usual grid."""
    scan = scan_at(walls, at)
    points = polar_points(scan.ranges_m, scan.spec, 0.1)
    config = Config(method="paper", grid=GridSize.parse(grid))
    rng = np.random.default_rng(0)
    evaluations = []
    for _ in range(8):
        motion = Pose(*rng.uniform(-0.1, 0.1, 2), math.radians(rng.uniform(-8, 8)))
        moved = points.copy()
        moved[:, :2] = transform_points(motion.inverse(), points[:, :2])
        moved[:, 4] = np.arctan2(moved[:, 1], moved[:, 0])
        match = match_polar(scan.ranges_m, moved, scan.spec, Pose(), config)
        error = motion.between(match.map_T_laser)
        assert match.cost_m2 < 0.01e-6
        assert error.distance_m < 0.01e-3
        assert abs(math.degrees(error.yaw_rad)) < 0.01
        assert match.converged
        evaluations.append(match.evaluations)
    if grid == "10x10":
        assert 800 < np.mean(evaluations) < 1400


def test_grid_is_refined_only_for_a_high_cost_up_to_the_give_up_ratio() -> None:
    a = scan_at(room(), Pose(2.2, 1.7, 0.4))
    b = scan_at(furnished_rooms(), Pose(2.9, 2.2, 1.2))
    points = polar_points(a.ranges_m, a.spec, 0.1)

    def matched(ranges: np.ndarray, **paper: object) -> Match:
        return match_polar(ranges, points, a.spec, Pose(), Config(method="paper", paper=PaperConfig(**paper)))

    easy, coarse = matched(a.ranges_m), matched(b.ranges_m, expert=PaperExpert(refine_factor=1), gate_mm2=1e6)
    hard = matched(b.ranges_m, gate_mm2=coarse.cost_m2 * 1e6 / GIVE_UP_RATIO + 1)
    given_up = matched(b.ranges_m, gate_mm2=coarse.cost_m2 * 1e6 / GIVE_UP_RATIO - 1)
    assert given_up.evaluations <= coarse.evaluations
    assert given_up.cost_m2 >= coarse.cost_m2
    assert easy.cost_m2 < 300e-6 < coarse.cost_m2
    assert easy.evaluations < 2000
    assert hard.evaluations > 3 * coarse.evaluations
    assert hard.cost_m2 <= coarse.cost_m2


def test_search_that_can_only_end_in_a_wrong_place_ends_at_once() -> None:
    a, b = scan_at(room(), Pose(2.2, 1.7, 0.4)), scan_at(furnished_rooms(), Pose(2.9, 2.2, 1.2))
    points = polar_points(a.ranges_m, a.spec, 0.1)
    whole, ended = (
        match_polar(b.ranges_m, points, a.spec, Pose(), Config(method="paper", paper=PaperConfig(**paper)))
        for paper in ({"expert": PaperExpert(refine_factor=1), "gate_mm2": 1e6}, {"gate_mm2": 100.0})
    )
    assert whole.converged
    assert not ended.converged
    assert ended.evaluations < 0.7 * whole.evaluations
    assert min(whole.cost_m2, ended.cost_m2) > GIVE_UP_RATIO * 100e-6


def test_scans_that_share_nothing_cost_infinity() -> None:
    a = scan_at(room(), Pose(2.2, 1.7, 0.4))
    points = polar_points(a.ranges_m, a.spec, 0.1)
    match = match_polar(np.full(a.spec.beams, np.nan), points, a.spec, Pose(), Config(method="paper"))
    assert match.cost_m2 == math.inf
    assert not match.converged
