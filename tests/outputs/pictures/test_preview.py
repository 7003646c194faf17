"""Maps as text."""

from __future__ import annotations

import numpy as np
import pytest

from mavnav.mapping.occupancy_grid import Grid
from mavnav.outputs.pictures.preview import preview


def grid_of(walls: np.ndarray) -> Grid:
    hits = np.asarray(walls, np.int32) * 5
    return Grid(0.02, (0.0, 0.0), hits, np.zeros_like(hits))


def test_every_cell_is_a_dot_of_its_own() -> None:
    for row in range(4):
        for col in range(2):
            walls = np.ones((4, 2), int)
            walls[row, col] = 0
            (text,) = preview(grid_of(walls))
            assert (ord(text) - 0x2800).bit_count() == 7
    assert preview(grid_of(np.ones((4, 2)))) == ["⣿"]


def test_the_largest_y_is_on_top_and_x_goes_right() -> None:
    walls = np.zeros((8, 4), int)
    walls[0, :] = 1  # least y
    walls[:, 0] = 1  # least x
    assert preview(grid_of(walls)) == ["⡇", "⣇⣀"]


def test_without_braille_it_is_hashes() -> None:
    walls = np.zeros((8, 4), int)
    walls[0, :] = walls[:, 0] = 1
    assert preview(grid_of(walls), braille=False) == ["#", "##"]


@pytest.mark.parametrize("shape", [(1, 1), (3, 900), (900, 3), (517, 1033), (97, 152), (96, 153)])
def test_it_fits_and_no_wall_is_lost(shape: tuple[int, int]) -> None:
    walls = np.zeros(shape, int)
    walls[0, :] = walls[-1, :] = walls[:, 0] = walls[:, -1] = 1
    lines = preview(grid_of(walls), columns=76, lines=24)
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 76
    assert " " not in lines[0]
    assert " " not in lines[-1]
    assert all(line[0] != " " for line in lines)


def test_an_empty_map_is_an_empty_line() -> None:
    assert preview(grid_of(np.zeros((9, 9)))) == [""]
