"""Edits of a map against slow, obvious twins, cell by cell."""

from __future__ import annotations

from collections import deque

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavnav.mapping.map_edits import MapEdits, Rectangle, edit_grid, largest_area
from mavnav.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Grid, occupancy
from mavnav.pose import Pose

CELL_M = 0.5
TURNED = Pose(1.0, -2.0, 0.7)


def random_grid(seed: int, shape: tuple[int, int] = (9, 12)) -> Grid:
    """Return a grid in which half of the cells are free, a quarter occupied, a quarter unknown."""
    kinds = np.random.default_rng(seed).integers(0, 4, shape)
    return Grid(CELL_M, (-2.0, 1.5), np.where(kinds == 0, 7, 0), np.where(kinds >= 2, 3, 0))


def centre(grid: Grid, map_T_grid: Pose, row: int, col: int) -> tuple[float, float]:
    """Return the centre of a cell in the map frame."""
    x_m, y_m = (at + (k + 0.5) * CELL_M for at, k in zip(grid.origin_xy_m, (col, row), strict=True))
    pose = map_T_grid @ Pose(x_m, y_m, 0.0)
    return pose.x_m, pose.y_m


def naive_inside(grid: Grid, rectangle: Rectangle, map_T_grid: Pose) -> np.ndarray:
    """Return which cells have their centres in a rectangle, one after the other."""
    inside = np.zeros(grid.hits.shape, bool)
    for row, col in np.ndindex(inside.shape):
        x_m, y_m = centre(grid, map_T_grid, row, col)
        inside[row, col] = rectangle.x0_m <= x_m <= rectangle.x1_m and rectangle.y0_m <= y_m <= rectangle.y1_m
    return inside


def naive_area(cells: np.ndarray) -> np.ndarray:
    """Flood every free area from its first cell; then the walls from each cell beside the largest."""

    def flood(start: tuple[int, int], kind: int, *, corners: bool) -> set[tuple[int, int]]:
        seen, queue = {start}, deque([start])
        while queue:
            r, c = queue.popleft()
            for dr, dc in np.ndindex(3, 3):
                near = r + dr - 1, c + dc - 1
                touches = corners or abs(dr - 1) + abs(dc - 1) == 1
                inside = 0 <= near[0] < cells.shape[0] and 0 <= near[1] < cells.shape[1]
                if touches and inside and near not in seen and cells[near] == kind:
                    seen.add(near)
                    queue.append(near)
        return seen

    areas = [flood(at, FREE, corners=False) for at in map(tuple, np.argwhere(cells == FREE).tolist())]
    largest = max(areas, key=len)
    beside = {(r + dr, c + dc) for r, c in largest for dr in (-1, 0, 1) for dc in (-1, 0, 1)}
    walls = [at for at in map(tuple, np.argwhere(cells == OCCUPIED).tolist()) if at in beside]
    kept = largest.union(*(flood(at, OCCUPIED, corners=True) for at in walls))
    mask = np.zeros(cells.shape, bool)
    mask[tuple(np.array(sorted(kept)).T)] = True
    return mask


@given(st.integers(0, 10**6), st.sampled_from([Pose(), TURNED]), st.tuples(*[st.floats(-6, 8)] * 4))
def test_erased_cells_are_free_and_unknown_ones_have_no_counts(seed: int, map_T_grid: Pose, corners) -> None:
    x0, y0, x1, y1 = corners
    rectangle = Rectangle(min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1))
    grid = random_grid(seed)
    inside, before = naive_inside(grid, rectangle, map_T_grid), occupancy(grid)
    erased = edit_grid(grid, MapEdits(erase=(rectangle,)), map_T_grid)
    assert (occupancy(erased) == np.where(inside & (before == OCCUPIED), FREE, before)).all()
    assert (erased.hits.astype(int) + erased.passes == grid.hits.astype(int) + grid.passes).all()
    blanked = edit_grid(grid, MapEdits(unknown=(rectangle,)), map_T_grid)
    assert (occupancy(blanked) == np.where(inside, UNKNOWN, before)).all()


@given(st.integers(0, 10**6), st.sampled_from([Pose(), TURNED]), st.tuples(*[st.floats(-6, 8)] * 4))
def test_a_crop_keeps_the_cells_inside_where_they_were(seed: int, map_T_grid: Pose, corners) -> None:
    x0, y0, x1, y1 = corners
    rectangle = Rectangle(min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1))
    grid = random_grid(seed)
    cut = edit_grid(grid, MapEdits(crop=rectangle), map_T_grid)
    inside = naive_inside(grid, rectangle, map_T_grid)

    def known(some: Grid, mask: np.ndarray) -> set:
        rows_cols = np.argwhere(mask & (some.hits + some.passes > 0)).tolist()
        return {
            (*np.round(centre(some, map_T_grid, r, c), 6), some.hits[r, c], some.passes[r, c]) for r, c in rows_cols
        }

    assert known(cut, np.ones(cut.hits.shape, bool)) == known(grid, inside)
    rows, cols = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    assert cut.hits.shape == ((np.ptp(rows) + 1, np.ptp(cols) + 1) if inside.any() else (1, 1))


@given(st.integers(0, 10**6))
def test_the_largest_free_area_has_the_walls_that_touch_it(seed: int) -> None:
    grid = random_grid(seed)
    mask, twin = largest_area(grid), naive_area(occupancy(grid))
    assert (mask == twin).all()


def test_full_counts_stay_full_and_the_input_stays_as_it_was() -> None:
    grid = Grid(CELL_M, (0.0, 0.0), np.full((2, 2), 65535), np.full((2, 2), 9))
    edited = edit_grid(grid, MapEdits(erase=(Rectangle(0.0, 0.0, 0.5, 0.5),)), Pose())
    assert edited.passes.tolist() == [[65535, 9], [9, 9]]
    assert (grid.hits == 65535).all()
