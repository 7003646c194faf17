"""Straight walls told apart; corners, enclosed areas, occupied share."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.mapping import tiled_arrays
from mavnav.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Grid, occupancy, occupied_xy_m
from mavnav.metrics.map_quality import corners, enclosed_areas, near_walls, occupied_share, only_occupied
from mavnav.metrics.walls import straight_walls, wall_sections

CELL_M = 0.02


def canvas(size: int = 300) -> np.ndarray:
    return np.full((size, size), UNKNOWN, np.int8)


def draw(cells: np.ndarray, start, end, thickness: float = 2.0) -> None:
    row, col = np.indices(cells.shape)
    (x1, y1), (x2, y2) = start, end
    length = np.hypot(x2 - x1, y2 - y1)
    c, s = (x2 - x1) / length, (y2 - y1) / length
    u, v = c * (col - x1) + s * (row - y1), c * (row - y1) - s * (col - x1)
    cells[(u >= -1) & (u <= length + 1) & (np.abs(v) <= thickness / 2)] = OCCUPIED


def rectangle(angle_deg: float, width: float = 180, height: float = 120) -> np.ndarray:
    cells, c, s = canvas(), np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    half = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (width / 2, height / 2)
    points = half @ np.array([(c, s), (-s, c)]) + 150
    for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
        draw(cells, a, b)
    return cells


def walls_of(cells: np.ndarray):
    hits = (cells == OCCUPIED).astype(np.int32)
    return straight_walls(wall_sections(hits, CELL_M, 1), Grid(CELL_M, (1.0, -2.0)))


@pytest.mark.parametrize("angle_deg", [0, 10, 30, 45, 77])
def test_a_room_has_four_walls(angle_deg: float) -> None:
    walls = walls_of(rectangle(angle_deg))
    # 0.2 m at each corner are no straight wall
    assert [w.length_m for w in walls] == pytest.approx([3.2, 3.2, 2.0, 2.0], abs=0.1)
    expected = np.array([angle_deg, angle_deg, angle_deg + 90, angle_deg + 90])
    off = [(w.direction_deg - e + 90) % 180 - 90 for w, e in zip(walls, expected, strict=True)]
    assert np.abs(off).max() < 1.5
    assert all(0 <= w.direction_deg < 180 for w in walls)
    assert all(1.5 <= w.p95_cells <= 4.5 for w in walls)
    assert walls[0].p95_mm == pytest.approx(20 * walls[0].p95_cells)
    middle = np.mean([(w.x_m, w.y_m) for w in walls], axis=0)
    np.testing.assert_allclose(middle, (1.0 + 150.5 * CELL_M, -2.0 + 150.5 * CELL_M), atol=0.05)


@pytest.mark.parametrize("angle_deg", [0, 10, 30, 45, 77])
@pytest.mark.parametrize("cell_m", [0.1, 0.15, 0.25])
def test_a_hall_on_coarse_cells_has_four_walls(cell_m: float, angle_deg: float) -> None:
    hits = (rectangle(angle_deg) == OCCUPIED).astype(np.int32)
    walls = straight_walls(wall_sections(hits, cell_m, 1), Grid(cell_m, (1.0, -2.0)))
    assert [w.length_m / cell_m for w in walls] == pytest.approx([172, 172, 112, 112], abs=6)


def test_a_thick_wall_is_told_from_thin_ones() -> None:
    cells = canvas()
    draw(cells, (30, 50), (270, 50), 2.0)
    draw(cells, (30, 150), (250, 150), 7.0)
    thin, thick = walls_of(cells)
    assert (thin.p95_cells < 4, 6 <= thick.p95_cells <= 9) == (True, True)


def test_a_curve_is_no_single_wall() -> None:
    cells = canvas()
    row, col = np.indices(cells.shape)
    cells[np.abs(np.hypot(row - 150, col - 150) - 120) <= 1.2] = OCCUPIED
    walls = walls_of(cells)
    assert len(walls) >= 4
    assert max(w.length_m for w in walls) < 2.5


@pytest.mark.parametrize("angle_deg", [0, 10, 30, 45, 77])
def test_a_room_has_four_corners_and_is_one_area(angle_deg: float) -> None:
    cells = rectangle(angle_deg)
    assert corners(cells, CELL_M) == 4
    areas = enclosed_areas(cells, CELL_M)
    assert (areas.count, areas.area_m2) == (1, pytest.approx(3.56 * 2.36, rel=0.03))


def outline(angle_deg: float, cell_m: float) -> np.ndarray:
    """Return a rectangle of 8 x 5 m, turned about the origin, its walls one cell thick."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    points = np.array([(0, 0), (8, 0), (8, 5), (0, 5)]) @ np.array([(c, s), (-s, c)]) + (0.013, 0.007)
    low_m = points.min(axis=0) - 1
    cells = canvas(int(12 / cell_m))
    for a, b in zip(points, np.roll(points, -1, axis=0), strict=True):
        along_m = a + np.linspace(0, 1, int(40 / cell_m))[:, None] * (b - a)
        col, row = ((along_m - low_m) / cell_m).astype(int).T
        cells[row, col] = OCCUPIED
    return cells


@pytest.mark.parametrize("angle_deg", [0, 10, 20, 30, 45, 60, 80])
@pytest.mark.parametrize("cell_m", [0.02, 0.021, 0.025, 0.03, 0.04, 0.05, 0.1])
def test_a_room_on_coarse_cells_has_four_corners(cell_m: float, angle_deg: float) -> None:
    assert corners(outline(angle_deg, cell_m), cell_m) == 4


def test_a_wall_drawn_twice_has_more_corners_and_areas() -> None:
    cells = rectangle(0)
    draw(cells, (62, 112), (240, 112))
    assert corners(cells, CELL_M) > 4
    assert enclosed_areas(cells, CELL_M).count == 2


def test_an_open_room_encloses_nothing() -> None:
    cells = rectangle(0)
    cells[88:94, 140:150] = FREE
    assert enclosed_areas(cells, CELL_M).count == 0


def test_occupied_share() -> None:
    cells = canvas(10)
    assert np.isnan(occupied_share(cells))
    cells[:2], cells[0, :3] = FREE, OCCUPIED
    assert occupied_share(cells) == 0.15
    assert corners(canvas(10), CELL_M) == 0
    assert enclosed_areas(np.zeros((0, 0), np.int8), CELL_M).count == 0


def test_a_map_measured_in_bands_is_the_map_measured_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Corners, what lies near walls and where walls are do not depend on how much is looked at at a time."""
    rng = np.random.default_rng(0)
    hits = np.zeros((700, 150), np.int32)
    for row, col, length in zip(
        rng.integers(0, 650, 40), rng.integers(0, 120, 40), rng.integers(5, 60, 40), strict=True
    ):
        hits[row : row + length, col : col + 2] = hits[row : row + 2, col : col + length] = 3
    grid = Grid(CELL_M, (0.0, 0.0), hits, np.zeros_like(hits))

    def measured() -> list[np.ndarray]:
        cells = occupancy(grid)
        return [
            *(np.array(corners(cells, m)) for m in (CELL_M, 0.05)),
            near_walls(only_occupied(grid)),
            occupied_xy_m(grid),
        ]

    whole = measured()
    monkeypatch.setattr(tiled_arrays, "BAND_CELLS", 1)
    for banded, at_once in zip(measured(), whole, strict=True):
        np.testing.assert_array_equal(banded, at_once)
    assert whole[0] > 5
