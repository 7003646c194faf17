"""A large map is measured and written in little more memory than the map itself takes."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.mapping.occupancy_grid import Grid
from mavnav.metrics.map_quality import MeasuredMap, measure_map
from mavnav.outputs.run import KEPT_CELLS, RunResult
from mavnav.outputs.writers import WRITERS
from support.memory_use import taking_less_than

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
    measure_map(Grid(0.02, (0.0, 0.0), large.hits[:300, :300], large.passes[:300, :300]))  # what is loaded for it
    with taking_less_than(55):  # 44, and 17 more with one more mask
        return measure_map(large)


def test_a_large_map_is_measured_in_few_masks(measured: MeasuredMap) -> None:
    assert len(measured.quality.walls) == 8


@pytest.mark.parametrize(
    ("name", "most_mb"),
    [("map.pgm", 35), ("hits.npz", 15), ("map.png", 50), ("wall_thickness.png", 55), ("result.mcap", 85)],
)
def test_a_large_map_is_written_in_few_masks(
    name: str, most_mb: float, run: RunResult, large: Grid, measured: MeasuredMap, tmp_path
) -> None:
    WRITERS[name](run, tmp_path / name)  # what is loaded for it
    shown = replace(run, slam=replace(run.slam, grid=large), measured=measured)
    with taking_less_than(most_mb):
        WRITERS[name](shown, tmp_path / name)
