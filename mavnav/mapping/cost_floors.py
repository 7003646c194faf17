"""Lower bounds of a point's cost over a part of a line map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from mavnav.kernels.maps import cost_floors as kernels
from mavnav.kernels.maps.layout import LEVELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.mapping.tiled_arrays import Extent

MARGIN_M = 2.0
"""Distance by which bounds reach beyond the requested extent, so that the next search may be somewhat wider."""


class CostFloors(Struct, frozen=True):
    """Bounds in the cells from ``corner`` (row, col) on, by level and as planes; see ``kernels.maps.cost_floors``.

    They hold within ``extent_m``, for the truncated distance ``truncate_m`` and positions ``step`` cells apart.
    """

    corner: NDArray[np.int64]
    levels: NDArray[np.uint8]
    planes: NDArray[np.uint8]
    truncate_m: float
    step: int
    extent_m: Extent

    @classmethod
    def of(
        cls,
        nearest: NDArray[np.uint32],
        lines: NDArray[np.float64],
        geometry: NDArray[np.float64],
        truncate_m: float,
        step: int,
        extent_m: Extent,
    ) -> CostFloors:
        """Return bounds of the costs in an extent, and ``MARGIN_M`` beyond, of the line map with these arrays."""
        x0, y0, x1, y1 = extent_m
        wider = (x0 - MARGIN_M, y0 - MARGIN_M, x1 + MARGIN_M, y1 + MARGIN_M)
        origin, cell_m, shape = geometry[:2], geometry[2], np.array(nearest.shape[::-1])
        low = np.clip(np.floor((np.array(wider[:2]) - origin) / cell_m).astype(np.int64), 0, shape)
        high = np.clip(np.ceil((np.array(wider[2:]) - origin) / cell_m).astype(np.int64), low, shape)
        before = ((1 << (LEVELS - 1)) - 1) * step
        corner, size = (low - before)[::-1].copy(), (high - low + before)[::-1]
        box = np.concatenate((corner, size))
        return cls(
            corner, *kernels.cost_floors(box, step, truncate_m, nearest, lines, geometry), truncate_m, step, wider
        )

    def covers(self, truncate_m: float, step: int, extent_m: Extent) -> bool:
        """Return whether the bounds are valid for a search with these settings, whose points lie in an extent."""
        (x0, y0, x1, y1), (low_x, low_y, high_x, high_y) = extent_m, self.extent_m
        covered = low_x <= x0 and low_y <= y0 and x1 <= high_x and y1 <= high_y
        return covered and (truncate_m, step) == (self.truncate_m, self.step)
