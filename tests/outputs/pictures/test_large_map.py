"""A large map is measured and written in little more memory than the map itself takes."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.mapping.occupancy_grid import Grid
from mavnav.metrics.map_quality import MeasuredMap, measure_map
from mavnav.outputs.run import KEPT_CELLS, RunResult
from mavnav.outputs.writers import WRITERS
from support.memory_use import added_mb

pytestmark = pytest.mark.slow

SIDE = 4200
"""Cells; a mask of them all takes 17 MB, and one of them more fails what follows."""


@pytest.fixture(scope="module")
def large() -> Grid:
    """Return two corridors that cross, with walls of two cells."""
    hits, passes = np.zeros((2, SIDE, SIDE), np.uint16)
    passes[2000:2200] = passes[:, 1000:1200] = 3
    for wall in (1998, 2200):
        hits[wall : wall + 2] = 5
    for wall in (998, 1200):
        hits[:, wall : wall + 2] = 5
    hits[passes > 0] = 0
    assert hits.size > KEPT_CELLS
    return Grid(0.02, (-20.0, -40.0), hits, passes)


@pytest.fixture(scope="module")
def measured(large: Grid) -> MeasuredMap:
    """Measure the map."""
    return measure_map(large)


def test_a_large_map_is_measured_in_few_masks(large: Grid, measured: MeasuredMap) -> None:
    assert len(measured.quality.walls) == 8
    assert added_mb(lambda: measure_map(large)) < 55  # 38 to 42, and 17 more with one more mask


@pytest.mark.parametrize(
    ("name", "most_mb"),
    [("map.pgm", 35), ("hits.npz", 15), ("map.png", 50), ("wall_thickness.png", 55), ("result.mcap", 85)],
)
def test_a_large_map_is_written_in_few_masks(
    name: str, most_mb: float, run: RunResult, large: Grid, measured: MeasuredMap, tmp_path
) -> None:
    shown = replace(run, slam=replace(run.slam, grid=large), metrics=measured)
    assert added_mb(lambda: WRITERS[name](shown, tmp_path / name)) < most_mb
