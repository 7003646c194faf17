"""Free positions of a map, on a coarser lattice."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import I64_1D, U8_2D, U16_2D, U16_3D, kernel, uint8
from mavnav.kernels.maps.layout import SHIFT, WIDE


@kernel
def free_positions(hits: U16_3D, passes: U16_2D, rows: I64_1D, cols: I64_1D) -> U8_2D:
    """Return which positions of a lattice have a free cell: one that more beams crossed than ended in.

    ``rows`` and ``cols``, ascending from 0, are the lattice row of each row of cells, and the same for columns.
    """
    free = np.zeros((rows[-1] + 1, cols[-1] + 1), np.uint8)
    for row in range(len(rows)):
        out = free[rows[row]]
        for strip in range(len(hits)):
            ended, crossed = hits[strip, row], passes[row, strip << SHIFT : (strip + 1) << SHIFT]
            for k in range(min(WIDE, len(cols) - (strip << SHIFT))):
                if crossed[k] > ended[k]:
                    out[cols[(strip << SHIFT) + k]] = uint8(1)
    return free
