"""Fusion of matches with commands: what walls show weighs there, commands elsewhere; both errors are estimated."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.config.models import Config
from mavnav.pose import Pose
from mavnav.slam.matching.fusion import APPARENT, WHEELS, Evidence, Fusion, evidence_of
from mavnav.slam.matching.scan_matching import empty_line_map

RNG = np.random.default_rng(0)
ALONG = np.column_stack((np.arange(-3.0, 3.0, 0.01), np.full(600, 1.0)))
WALLS = np.vstack((ALONG, ALONG * (1.0, -1.0)))
TRUNCATE_M = 0.15


def evidence_at(pose: Pose) -> Evidence:
    """Return the evidence of a scan between two walls, taken at the origin, at another pose."""
    line_map = empty_line_map(Config())
    line_map.insert(WALLS)
    seen = WALLS[np.abs(WALLS[:, 0]) < 2.0]
    return evidence_of(seen, pose, line_map, TRUNCATE_M)


def test_along_two_walls_only_yaw_and_the_direction_across_are_known() -> None:
    off = evidence_at(Pose(0.1, 0.01))
    across, along = off.hessian[1, 1], off.hessian[0, 0]
    assert along < 1e-4 * across
    assert off.pull[1] / across == pytest.approx(-0.01, abs=1e-3)
    assert off.spread[1, 1] > 5.0 * off.pull[1] ** 2 / across  # more than of as many independent residuals


@pytest.mark.parametrize(("frame_points", "least", "most"), [(0, 0.0, 0.01), (40, 0.9, 1.0)])
def test_what_rough_walls_seem_to_show_of_the_direction_along_them_does_not_count(
    frame_points: int, least: float, most: float
) -> None:
    """Beside a door frame that share hardly matters."""
    rough = WALLS + np.column_stack((np.zeros(len(WALLS)), 0.005 * RNG.standard_normal(len(WALLS))))
    frame = np.column_stack((np.full(frame_points, 0.5), np.linspace(0.8, 1.0, frame_points)))
    walls, line_map = np.vstack((rough, frame)), empty_line_map(Config())
    line_map.insert(walls)
    seen = walls[np.abs(walls[:, 0]) < 2.0]
    whole, less = (evidence_of(seen, Pose(), line_map, TRUNCATE_M, share).hessian for share in (0.0, APPARENT))
    assert least <= less[0, 0] / whole[0, 0] <= most
    assert less[1, 1] == pytest.approx(whole[1, 1], rel=0.01)


def test_commands_decide_along_the_walls_and_the_match_across() -> None:
    matched, predicted = Pose(0.1), Pose(0.15, 0.02, 0.01)
    fused, _ = Fusion().fuse(evidence_at(matched), matched, predicted, 1.0)
    assert fused.x_m == pytest.approx(predicted.x_m, abs=1e-3)
    assert fused.y_m == pytest.approx(matched.y_m, abs=2e-3)
    assert fused.yaw_rad == pytest.approx(matched.yaw_rad, abs=2e-3)


@pytest.mark.parametrize(("noise_m", "factor"), [(0.03, 1.0), (0.01, 9.0)])
def test_the_errors_of_commands_and_of_matches_are_learnt(noise_m: float, factor: float) -> None:
    fusion, hessian, stated = Fusion(), 100.0 * np.eye(3), np.array((0.03, 0.003, 0.003))
    for _ in range(3000):
        matched = factor**0.5 * stated * RNG.standard_normal(3)
        predicted = np.array((noise_m, noise_m, 0.02)) * RNG.standard_normal(3)
        evidence = Evidence(hessian, np.zeros(3), hessian @ np.diag(stated**2) @ hessian)
        _, fusion = fusion.fuse(evidence, Pose(*matched), Pose(*predicted), 1.0)
    assert fusion.position_m2**0.5 == pytest.approx(noise_m, rel=0.2)
    assert fusion.yaw_rad2**0.5 == pytest.approx(0.02, rel=0.2)
    assert fusion.factor == pytest.approx(factor, rel=0.3)


def test_wheels_that_go_on_contradicting_are_ignored_until_they_agree_again() -> None:
    hessian, stated, fusion = 100.0 * np.eye(3), np.array((0.03, 0.003, 0.003)), WHEELS
    evidence = Evidence(hessian, np.zeros(3), hessian @ np.diag(stated**2) @ hessian)
    for _ in range(500):  # carried: every scan is 0.3 rad off
        carried, fusion = fusion.fuse(evidence, Pose(0.1, 0.0, 0.3), Pose(), 0.01)
    assert carried.x_m == pytest.approx(0.1, abs=1e-3)
    assert fusion[:4] == WHEELS[:4]  # what is ignored shows nothing
    assert not fusion.covariance.any()
    for _ in range(50):
        on_the_floor, fusion = fusion.fuse(evidence, Pose(0.1), Pose(0.06), 0.01)
    assert on_the_floor.x_m == pytest.approx(0.06, abs=0.01)


def test_an_error_of_wheels_beyond_the_usual_counts_less() -> None:
    hessian = 100.0 * np.eye(3)
    evidence = Evidence(hessian, np.zeros(3), hessian @ np.diag((1e-4, 1e-4, 1e-4)) @ hessian)
    small, large = (WHEELS.fuse(evidence, Pose(x_m), Pose(), 0.1)[0].x_m / x_m for x_m in (0.01, 0.1))
    assert 2.0 * small < large


def test_a_small_error_of_every_prediction_adds_up_until_walls_show_it() -> None:
    """Wheels that count 4 % too much: a wall ahead shows the place to 20 mm, each step is 3 mm off."""
    hessian, stated, fusion, here_m = 100.0 * np.eye(3), np.array((0.02, 1e-3, 1e-3)), WHEELS, 0.0
    evidence = Evidence(hessian, np.zeros(3), hessian @ np.diag(stated**2) @ hessian)
    for step in range(1, 400):
        true_m, matched = 0.075 * step, stated * RNG.standard_normal(3)
        matched[0] += true_m
        pose, fusion = fusion.fuse(evidence, Pose(*matched), Pose(here_m + 1.04 * 0.075), 0.075)
        here_m = pose.x_m
        assert abs(here_m - true_m) < 0.15
    assert 0.0 < fusion.covariance[0, 0] < 0.02**2
