"""Layout of the arrays that kernels share, as constants; the grid of both searches.

Counts of a grid are stored in strips, see ``mavnav.mapping.tiled_arrays``; an entry of ``nearest`` is described in
``linemap``. This module does not import numba.
"""

from __future__ import annotations

from typing import NamedTuple

WIDE, SHIFT = 64, 6
"""Width of a strip in cells, and its binary logarithm."""

MOST, MOST_SHIELDED = 65535, 32767
"""Values at which counts saturate: of hits and crossings, and of shielded crossings."""

REACH_CELLS = 8
"""Largest distance at which the nearest occupied cell is known."""
FAR = REACH_CELLS * REACH_CELLS
NEAR = 128
"""Factor of the index in an entry of ``nearest``, to which the closeness is added: a power of 2 above `FAR` + 1."""

WALL_HITS = 4
"""Minimum number of hits of a wall: fewer may be stray readings."""
EXPLAINED_CELLS = 7
"""Largest distance of a hit that explains an end point."""

WORST = 255
"""Value of the truncated cost in the bounds of ``cost_floors``."""
LEVELS = 3
"""Number of levels of ``cost_floors``: bounds of squares of 1, 2 and 4 positions a side."""


class SearchGrid(NamedTuple):
    """The argument ``grid`` of a search.

    Numbers of yaw samples and of nodes of the plane in x and y; maximum number of border extensions; 1 to prune.
    """

    azimuths: float
    nx: float
    ny: float
    extensions: float
    prune: float
