"""Localise-only: the robust method in a map that is given and stays as it is (docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavnav.mapping.line_map import LineMap
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, transform_points
from mavnav.slam.relocalization import CLEAR_BY, around, candidates, everywhere, unrivalled
from mavnav.slam.robust import Robust
from mavnav.slam.scan_matching import no_match
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mavnav.config.models import Config
    from mavnav.scan import Scan
    from mavnav.slam.motion_model import Motion
    from mavnav.slam.prior_map import PriorMap
    from mavnav.slam.relocalization import Region
    from mavnav.slam.scan_matching import Match

START_M, START_RAD = 1.0, 45 * DEG
"""The laser begins so near to where it is said to."""

MANY = 30
"""So many places of a whole map are compared closely."""


class Localizer(Robust):
    """Follows the laser in a known map; ``grid`` counts what the scans saw, in the map's frame."""

    builds_map = False
    found_conflicts = 1.0  # furniture moved since the map was made conflicts with every pose

    def __init__(self, config: Config, known: PriorMap) -> None:
        """Start anywhere in the map, or near where the laser is said to be."""
        super().__init__(config)
        robust, cell_m = config.robust, known.grid.cell_m
        self.known = GridBuilder.of(known.grid)
        self.lines = LineMap(cell_m, robust.line_sigma_mm * MM, robust.line_noise_mm * MM)
        self.lines.insert(known.walls_xy_m)
        self.start, self.tries = known.start, 0

    def first(self, scan: Scan) -> Match:
        """Find the laser: near the given start, or else, at the 1st, 2nd, 4th, 8th ... try, in the whole map."""
        points = self.match_points(scan)
        if len(points) < self.config.robust.min_points:
            return no_match(Pose(), len(points))
        self.tries += 1
        found = self._only_place(points, around(self.start, START_M, START_RAD)) if self.start else None
        if found is None and self.tries.bit_count() == 1:
            found = self._only_place(points, everywhere(self.known))
        return found or no_match(self.start or Pose(), len(points))

    def _only_place(self, points: NDArray[np.float64], region: Region) -> Match | None:
        """Return where in a region the scan fits; None where it fits nowhere, or elsewhere about as well."""
        found = candidates(points, self.lines, self.known, region, self.config, MANY)
        best = unrivalled(found, CLEAR_BY, self.config)
        return best if best and self._is_good(best) else None

    def insert(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> None:
        """Count what the scan saw; the map that is matched against stays."""
        self.grid.insert(map_T_laser, transform_points(map_T_laser, self._points(scan, motion)[0]))

    def remove_dynamic_cells(self) -> None:
        """Take back what did not stay; the map that is matched against stays."""
        self.grid.remove_dynamic_cells()
