"""Where maps of the same log differ most: the places for close-ups (after the paper's Figure 8)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import distance_transform_edt, uniform_filter

from mavnav.outputs.viewport import Window

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mavnav.mapping.occupancy_grid import Grid

PLACES: Final = 3
MIN_HITS: Final = 2
"""Single hits are strays as often as walls."""

TOLERANCE_CELLS: Final = 2.0
"""A wall moved by no more is the same wall, if there are greater differences to show."""

MOST_M: Final = 0.5
"""A wall that is missing altogether counts no more than one this far away."""

SIDE_SHARE, LEAST_SIDE_M, MOST_SIDE_M = 0.12, 0.8, 4.0
LEAST_CELLS: Final = 6.0
"""Fewer cells of difference in a close-up (of one cell each) are noise."""


def differing_places(grids: Sequence[Grid], window: Window) -> list[Window]:
    """Return squares where the walls of maps in one frame differ most, the worst first; none for a single map.

    A wall cell counts by its distance to the nearest wall of the map that misses it most, beyond a tolerance.
    """
    if len(grids) < 2:
        return []
    cell_m = max(g.cell_m for g in grids)
    walls = [on_lattice(g, window, cell_m) for g in grids]
    gap = np.max([distance_transform_edt(~w) if w.any() else np.full(w.shape, np.inf) for w in walls], axis=0)
    seen = np.any(walls, axis=0)
    side_m = float(np.clip(SIDE_SHARE * max(window.size_m), LEAST_SIDE_M, MOST_SIDE_M))
    for tolerance in (TOLERANCE_CELLS, 0.0):
        difference = np.where(seen, np.clip(gap - tolerance, 0.0, max(MOST_M / cell_m, 1.0)), 0.0)
        places = peaks(difference, max(3, round(side_m / cell_m)))
        if places:
            return [_square(row, col, side_m, window, cell_m) for row, col in places]
    return []


def on_lattice(grid: Grid, window: Window, cell_m: float) -> NDArray[np.bool_]:
    """Tell which cells of a lattice over the window hold a wall of the map; row 0 at the least y."""
    cols, rows = (max(1, int(np.ceil(length / cell_m))) for length in window.size_m)
    row, col = np.nonzero(grid.hits >= MIN_HITS)
    middle = (np.column_stack((col, row)) + 0.5) * grid.cell_m + np.array(grid.origin_xy_m)
    at = np.floor((middle - (window.x0_m, window.y0_m)) / cell_m).astype(np.int64)
    inside = np.all((at >= 0) & (at < (cols, rows)), axis=1)
    walls = np.zeros((rows, cols), np.bool_)
    walls[at[inside, 1], at[inside, 0]] = True
    return walls


def peaks(difference: NDArray[np.float64], side_cells: int) -> list[tuple[int, int]]:
    """Return the middles (row, col) of up to `PLACES` squares that hold the most, none overlapping another."""
    left, found = difference.copy(), []
    for _ in range(PLACES):
        held = uniform_filter(left, side_cells, mode="constant") * side_cells**2
        best = divmod(int(np.argmax(held)), held.shape[1])
        if held[best] < LEAST_CELLS:
            break
        row, col = _centred(left, best, side_cells)
        found.append((row, col))
        left[_around(row, side_cells), _around(col, side_cells)] = 0.0
    return found


def _around(middle: int, reach: int) -> slice:
    return slice(max(middle - reach, 0), middle + reach + 1)


def _centred(difference: NDArray[np.float64], at: tuple[int, int], side_cells: int) -> tuple[int, int]:
    """Move a square to the middle of what it holds: many squares hold the same."""
    rows, cols = (_around(k, side_cells // 2) for k in at)
    held = difference[rows, cols]
    middle = np.indices(held.shape).reshape(2, -1) @ held.ravel() / held.sum()
    return round(rows.start + float(middle[0])), round(cols.start + float(middle[1]))


def _square(row: int, col: int, side_m: float, window: Window, cell_m: float) -> Window:
    """Frame a place, moved into the window where it fits."""
    ends = ((window.x0_m, window.x1_m, col), (window.y0_m, window.y1_m, row))
    half = side_m / 2
    x, y = (
        float(np.clip(a + (k + 0.5) * cell_m, min(a + half, (a + b) / 2), max(b - half, (a + b) / 2)))
        for a, b, k in ends
    )
    return Window(x - half, x + half, y - half, y + half)
