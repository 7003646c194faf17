"""Ghost walls: planted duplicates are found, real walls are not reported. docs/notes/metrics-evidence.md has more."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.mapping.occupancy_grid import Grid
from support.planted import CELL_M, PLANTED, REAL, Scene, as_published, found, ghost, ghosts_of, map_of

ANGLES_DEG = (0.0, 17.0, 45.0, 68.0, 90.0, 131.0)


@pytest.mark.parametrize("counted", [True, False], ids=["counts", "map file"])
@pytest.mark.parametrize("cells", [2, 3, 6, 12])
def test_planted_duplicates_are_found(cells: int, counted: bool) -> None:
    for seed, angle in enumerate(ANGLES_DEG):
        grid = map_of(ghost, cells, angle, 0.005, seed)
        assert found(grid if counted else as_published(grid), cells, angle, counted=counted), (cells, angle)


@pytest.mark.parametrize("cells", [4, 8, 12])
def test_a_faint_duplicate_is_found_in_noise(cells: int) -> None:
    hits = [found(map_of(PLANTED["faint_ghost"], cells, a, 0.01, 7), cells, a) for a in ANGLES_DEG]
    assert sum(hits) >= len(hits) - 1


@pytest.mark.parametrize("counted", [True, False], ids=["counts", "map file"])
@pytest.mark.parametrize("kind", REAL)
def test_real_walls_are_not_reported(kind: str, counted: bool) -> None:
    for seed, angle in enumerate(ANGLES_DEG):
        for cells in (4, 8):
            grid = map_of(REAL[kind], cells, angle, 0.01, seed)
            assert ghosts_of(grid if counted else as_published(grid), counted=counted).count == 0, (angle, cells)


def test_the_place_is_that_of_the_ridge_in_front() -> None:
    scene = Scene(0.0, 0.003, 1)
    ghost(scene, 6 * CELL_M)
    walls = ghosts_of(scene.grid.by_rows())
    (place,) = walls.places
    assert (walls.count, walls.worst_offset_mm) == (1, place.offset_mm)
    assert walls.worst_offset_cells == pytest.approx(6, abs=1)
    assert place.x_m == pytest.approx(0.013, abs=0.15)
    assert place.y_m == pytest.approx(0.007, abs=CELL_M)
    assert walls.length_m == place.length_m == pytest.approx(2.0, abs=0.25)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_turned_map_has_the_same_ghosts(turns: int) -> None:
    grid = map_of(ghost, 5, 30.0, 0.005, 3)
    turned = Grid(CELL_M, (0.0, 0.0), np.rot90(grid.hits, turns).copy(), np.rot90(grid.passes, turns).copy())
    a, b = ghosts_of(grid), ghosts_of(turned)
    assert a.count == b.count == 1
    assert a.worst_offset_mm == pytest.approx(b.worst_offset_mm, abs=10)
    assert a.length_m == pytest.approx(b.length_m, abs=0.2)


@pytest.mark.parametrize("shape", [(0, 0), (30, 40)])
def test_no_map_no_ghosts(shape: tuple[int, int]) -> None:
    walls = ghosts_of(Grid(CELL_M, (0.0, 0.0), np.zeros(shape, np.int32), np.zeros(shape, np.int32)))
    assert (walls.count, walls.length_m, walls.places) == (0, 0.0, ())
    assert np.isnan(walls.worst_offset_mm)
    assert np.isnan(walls.worst_offset_cells)


@pytest.mark.parametrize("margin", [1, 2])
def test_nothing_depends_on_how_a_map_was_cut_out(margin: int) -> None:
    for seed in range(6):
        grid = map_of(ghost, 5, 30.0, 0.01, seed)
        x_m, y_m = grid.origin_xy_m
        corner = (x_m - margin * CELL_M, y_m - 2 * margin * CELL_M)
        wide = [np.pad(part, ((2 * margin, 3), (margin, 0))) for part in (grid.hits, grid.passes)]
        a, b = ghosts_of(grid), ghosts_of(Grid(CELL_M, corner, *wide))
        assert (a.count, a.worst_offset_mm) == (b.count, b.worst_offset_mm)
        assert a.length_m == pytest.approx(b.length_m, abs=1e-9)
