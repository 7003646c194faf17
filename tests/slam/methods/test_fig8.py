"""The paper's Figure 8 (configs/fig8.yaml): where a coarse grid leaves gaps, a wall is drawn twice."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

from mavnav.config.loading import load_config
from mavnav.metrics.ghost_walls import GhostWalls
from mavnav.metrics.map_quality import measure_map
from mavnav.pose import Pose
from mavnav.scan import Scan
from mavnav.simulation.world.laser import take_scan
from mavnav.simulation.world.scenario import laser_model
from mavnav.simulation.world.scenario_file import load_scenario
from mavnav.slam.pipeline import run_slam


@pytest.fixture(scope="module")
def corridor() -> list[Scan]:
    """A cart pushed through the corridor, 0.1 m a scan, by a hand that shakes."""
    scenario = load_scenario("corridor", ["laser.noise_percent=0.2"])
    rng, scans, x_m, y_m, yaw_rad = np.random.default_rng(10), [], 0.8, 1.0, 0.0
    for k in range(40):
        scans.append(take_scan(scenario.world, Pose(x_m, y_m, yaw_rad), laser_model(scenario), rng, k * 10**8))
        x_m += 0.1 + rng.normal(0, 0.005)
        y_m += rng.normal(0, 0.005) - 0.1 * (y_m - 1.0)
        yaw_rad = 0.7 * yaw_rad + rng.normal(0, radians(1))
    return scans


def ghosts(scans: list[Scan], grid: str, azimuth: int) -> GhostWalls:
    config = load_config("fig8", [], {"grid": grid, "azimuth": azimuth})
    return measure_map(run_slam(lambda: iter(scans), config, 0.1).grid).quality.ghost_walls


@pytest.mark.slow
def test_a_coarse_grid_draws_walls_twice_finer_ones_do_not(corridor: list[Scan]) -> None:
    coarse = ghosts(corridor, "5x5", 10)
    assert coarse.count >= 2
    assert coarse.length_m > 1.0
    assert coarse.worst_offset_mm > 50.0
    assert ghosts(corridor, "10x10", 20).count == ghosts(corridor, "20x20", 40).count == 0
