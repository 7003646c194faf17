"""Layout of the arrays that kernels share, in plain numbers.

Counts of a grid are kept in strips, see ``mavnav.mapping.tiled_arrays``; an entry of ``nearest`` is described in
``linemap``. This file does without numba, so that it is imported at no cost.
"""

from __future__ import annotations

WIDE, SHIFT = 64, 6
"""Cells across a strip, and its logarithm."""

MOST, MOST_SHIELDED = 65535, 32767
"""Counts of hits and crossings end at the first, those of shielded crossings at the second."""

REACH_CELLS = 8
"""Nearest occupied cells are known this far."""
FAR = REACH_CELLS * REACH_CELLS
NEAR = 128
"""An entry of ``nearest`` is an index times this, plus how near the cell is: a power of 2 above `FAR` + 1."""

WALL_HITS = 4
"""A cell with fewer hits may hold strays."""
EXPLAINED_CELLS = 7
"""A hit so near explains an end point."""

WORST = 255
"""A bound of a point's cost in ``cost_floors``: the truncated cost."""
LEVELS = 3
"""Levels of ``cost_floors``: squares of 1, 2 and 4 positions a side are bounded."""
