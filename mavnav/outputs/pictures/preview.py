"""A map as a few lines of text: eight dots in every character of Braille, or a hash where there is no Braille."""

from __future__ import annotations

from typing import Final

import numpy as np

from mavnav.mapping.occupancy_grid import OCCUPIED, Grid, occupancy
from mavnav.mapping.tiled_arrays import crop, max_pool

DOTS: Final = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], np.uint32)
"""Bit of each dot in a character of Unicode's block U+2800: four rows of two."""


def preview(grid: Grid, columns: int = 76, lines: int = 24, *, braille: bool = True) -> list[str]:
    """Return the occupied cells as text of at most so many columns and lines, largest y on top, +x to the right.

    A dot stands for a square of cells and is set where one of them is occupied. Without ``braille``, every character
    that has a dot is a hash.
    """
    walls = occupancy(grid) == OCCUPIED
    walls = crop(walls, walls)[::-1]
    rows, cols = walls.shape
    step = max(-(-cols // (2 * columns)), -(-rows // (4 * lines)), 1)
    dots = max_pool(walls, step)
    height, width = -(-dots.shape[0] // 4), -(-dots.shape[1] // 2)
    padded = np.zeros((4 * height, 2 * width), np.uint32)
    padded[: dots.shape[0], : dots.shape[1]] = dots
    codes = np.einsum("iajb,ab->ij", padded.reshape(height, 4, width, 2), DOTS)
    return ["".join(_character(code, braille=braille) for code in line).rstrip() for line in codes.tolist()]


def _character(code: int, *, braille: bool) -> str:
    if not code:
        return " "
    return chr(0x2800 + code) if braille else "#"
