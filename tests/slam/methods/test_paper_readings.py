"""The reading of the paper's text that is shipped as ``paper``: each of its parts does what it says, and it flies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavnav.config.loading import load_config
from mavnav.config.models import Config, PaperConfig, PaperExpert
from mavnav.logs import open_log
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose
from mavnav.scan import LaserSpec, Scan
from mavnav.simulation.mission import fly
from mavnav.simulation.world.scenario_file import load_scenario
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.scan_matching import MatchVerdict, no_match
from mavnav.slam.matching.steps import Step, Steps, refused_by
from mavnav.slam.methods.paper import Paper, acceptance_scale, match_polar, polar_points
from mavnav.slam.pipeline import run_slam
from support.marks import slow
from support.synthetic import room, scan_at

if TYPE_CHECKING:
    from pathlib import Path

SPEC = LaserSpec(-1.0, 0.01, 200, 0.02, 10.0)


def reading(**values: object) -> Config:
    """Return the literal reading with some values."""
    expert = {key: values.pop(key) for key in [*values] if key in PaperExpert.__struct_fields__}
    return Config(method="paper", paper=PaperConfig(**values, expert=PaperExpert(**expert)))


# ---- the acceptance threshold ---------------------------------------------------------------------------------------


@given(range_m=st.floats(0.2, 4.9), factor=st.floats(0.3, 1.0))
def test_the_threshold_grows_with_the_square_of_the_range(range_m: float, factor: float) -> None:
    """As the variance of a range does: 1.5 % of the distance."""
    ranges = np.full(200, range_m)
    config = reading(gate_range_mm=1000.0, near_mm=10.0)
    assert acceptance_scale(ranges, config) == pytest.approx(range_m**2)
    assert acceptance_scale(factor * ranges, config) == pytest.approx((factor * range_m) ** 2)
    assert acceptance_scale(ranges, reading()) == 1.0


def test_only_ranges_that_contribute_to_the_cost_scale_the_threshold() -> None:
    config = reading(gate_range_mm=1000.0, near_mm=500.0, far_mm=3000.0)
    assert acceptance_scale(np.array([1.0, 1.0, 0.2, 4.0, np.nan]), config) == 1.0
    assert acceptance_scale(np.array([0.2, 4.0, np.nan]), config) == 1.0


@pytest.mark.parametrize(("cost_mm2", "verdict"), [(1990.0, MatchVerdict.SURE), (2010.0, MatchVerdict.REFUSED)])
def test_a_match_is_accepted_up_to_the_threshold_at_its_range(cost_mm2: float, verdict: MatchVerdict) -> None:
    scan, motion = Scan(0, np.full(SPEC.beams, 2.0), SPEC), Motion(0.1)
    match = no_match(Pose())._replace(cost_m2=cost_mm2 * 1e-6)
    assert Paper(reading(gate_mm2=500.0, gate_range_mm=1000.0)).gate(match, scan, motion) is verdict
    assert Paper(reading(gate_mm2=500.0)).gate(match, scan, motion) is MatchVerdict.REFUSED


# ---- what contributes -----------------------------------------------------------------------------------------------


def test_the_least_share_may_be_of_the_valid_beams() -> None:
    """Of a laser that sees with 30 % of its beams only."""
    scan = scan_at(room(), Pose(2.2, 1.7, 0.4))
    ranges = np.where(np.arange(scan.spec.beams) < 0.3 * scan.spec.beams, scan.ranges_m, np.nan)
    points = polar_points(ranges, scan.spec, 0.1)

    def cost(of: str) -> float:
        config = reading(min_beams_share=0.4, min_beams_of=of)
        return match_polar(scan.ranges_m, points, scan.spec, Pose(), config).cost_m2

    assert cost("valid") < 1e-8
    assert cost("scan") == np.inf


def test_a_shrinking_occlusion_threshold_finds_from_afar_and_leaves_out_what_moved() -> None:
    """A box of which the virtual scan knows nothing, 80 mm before the wall: within a wide threshold it counts."""
    scan = scan_at(room(), Pose(2.2, 1.7, 0.4))
    changed = scan.ranges_m.copy()
    changed[200:240] -= 0.08
    points = polar_points(changed, scan.spec, 0.1)
    errors = {}
    for shrink in (1.0, 0.6):
        config = reading(shrink=0.5, occlusion_mm=500.0, occlusion_shrink=shrink, occlusion_least_mm=40.0)
        match = match_polar(scan.ranges_m, points, scan.spec, Pose(), config)
        errors[shrink] = match.map_T_laser.distance_m
    assert errors[0.6] < 0.5e-3
    assert errors[1.0] > 4 * errors[0.6]


def test_what_the_search_leaves_out_counts_for_the_acceptance() -> None:
    """Nine of twenty beams end 0.3 m before the wall: what is left fits exactly, but it is not most of the scan."""
    scan = scan_at(room(), Pose(2.2, 1.7, 0.4))
    nearer = np.where(np.arange(scan.spec.beams) % 20 < 9, scan.ranges_m - 0.3, scan.ranges_m)
    points = polar_points(nearer, scan.spec, 0.1)
    narrow = {"occlusion_mm": 100.0, "gate_occlusion_mm": 80.0}
    blind, sharp = (
        match_polar(scan.ranges_m, points, scan.spec, Pose(), reading(gate_share=share, **narrow)) for share in (0, 0.6)
    )
    assert blind.cost_m2 < 1e-8
    assert sharp.cost_m2 == np.inf
    assert blind.inliers == sharp.inliers == pytest.approx(0.5, abs=0.05)


def test_the_cost_of_the_acceptance_is_that_at_its_own_threshold() -> None:
    """A fifth of the beams end 60 mm before the wall, beyond the last threshold of the search."""
    scan = scan_at(room(), Pose(2.2, 1.7, 0.4))
    moved = np.arange(scan.spec.beams) % 100 < 20
    points = polar_points(np.where(moved, scan.ranges_m - 0.06, scan.ranges_m), scan.spec, 0.1)
    costs = [
        match_polar(scan.ranges_m, points, scan.spec, Pose(), reading(occlusion_mm=30.0, gate_occlusion_mm=mm)).cost_m2
        for mm in (30.0, 80.0)
    ]
    assert costs[0] < 1e-6  # beams between two surfaces
    assert costs[1] == pytest.approx(moved.mean() * 0.06**2, rel=0.1)


def test_each_refused_scan_names_its_rule() -> None:
    fits = no_match(Pose(), 500)._replace(cost_m2=1e-4, evaluations=1000)
    costly, few, blind = fits._replace(cost_m2=0.1), fits._replace(cost_m2=np.inf), no_match(Pose(), 20)
    matches = [(fits, True), (costly, False), (few, False), (blind, False)]
    steps = Steps(Step(k, k, match, tracked) for k, (match, tracked) in enumerate(matches))
    assert refused_by(steps).tolist() == ["", "cost", "share", "beams"]


@pytest.mark.parametrize("pivot", ["laser", "centroid"])
@pytest.mark.parametrize("converged", ["both", "either"])
def test_the_search_ends_at_the_motion(pivot: str, converged: str) -> None:
    scan, motion = scan_at(room(), Pose(2.2, 1.7, 0.4)), Pose(0.06, -0.04, 0.08)
    moved = scan_at(room(), Pose(2.2, 1.7, 0.4) @ motion)
    points = polar_points(moved.ranges_m, moved.spec, 0.1)
    match = match_polar(scan.ranges_m, points, scan.spec, Pose(), reading(pivot=pivot, converged=converged, shrink=0.5))
    error = motion.between(match.map_T_laser)
    assert match.converged
    assert error.distance_m < 2e-3
    assert abs(error.yaw_rad) < 1e-3


def test_without_commands_the_laser_may_be_expected_to_move_on() -> None:
    assert Paper(reading(predict="rest")).expects_rest
    assert not Paper(reading(predict="velocity")).expects_rest


# ---- a young map ----------------------------------------------------------------------------------------------------


def test_the_middle_of_a_wall_of_equal_cells_is_where_the_wall_is() -> None:
    """Noisy scans of a wall, each in a map of its own: the nearest cell lies before the wall, the middle one in it."""
    bearings = np.linspace(-0.25, 0.25, 101)
    ahead = np.column_stack((np.cos(bearings), np.sin(bearings)))
    errors = []
    for seed in range(20):
        noise, grid = np.random.default_rng(seed).normal(0.0, 0.03, 400), GridBuilder(0.014)
        grid.insert(Pose(), np.column_stack((1.5 + noise, np.linspace(-0.5, 0.5, 400))))
        seen = [grid.virtual_scan(Pose(), ahead, 5.0, 11, middle=middle) * ahead[:, 0] for middle in (False, True)]
        errors.append(np.nanmean(seen, axis=1) - 1.5)
    nearest_m, middle_m = np.mean(errors, axis=0)
    assert nearest_m < -0.008
    assert abs(middle_m) < 0.003


# ---- the whole ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scenario", "seed"), [("corner-paper", 0), ("corner", 1), slow("complex", 2)])
def test_the_method_completes_the_paper_s_missions_at_the_paper_s_noise(scenario: str, seed: int) -> None:
    flight = fly(load_scenario(scenario, (), {"seed": seed, "slam.method": "paper"}))
    assert flight.mission.reached
    assert flight.slam.steps.share("tracked") > 0.97
    assert 800 < flight.slam.steps.column("evaluations").mean() < 1600


def test_the_literal_reading_does_not() -> None:
    flight = fly(load_scenario("complex", (), {"seed": 2}, "paper-literal"))
    assert not flight.mission.reached
    assert flight.slam.steps.share("tracked") < 0.2


@pytest.mark.slow
@pytest.mark.real_logs
def test_the_recording_of_the_paper_s_own_sensor_is_tracked_to_its_end(real_logs: Path) -> None:
    log, config = open_log(real_logs / "ccny_demo" / "ccny_demo.mcap", odom="off"), load_config("paper")
    outcome = run_slam(log.scans, config, log.period_s)
    assert outcome.steps.share("tracked") >= 0.99
    assert not outcome.lost
