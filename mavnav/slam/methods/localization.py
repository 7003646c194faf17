"""Localization: the robust method in a given map, which does not change (docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavnav.mapping.line_map import LineMap
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, transform_points
from mavnav.slam.matching.relocalization import AMBIGUITY_MARGIN, around, candidates, everywhere, unambiguous
from mavnav.slam.matching.scan_matching import no_match
from mavnav.slam.methods.robust import Robust
from mavnav.units import DEG

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from mavnav.config.models import Config
    from mavnav.scan import Scan
    from mavnav.slam.matching.motion_model import Motion
    from mavnav.slam.matching.prior_map import PriorMap
    from mavnav.slam.matching.relocalization import Region
    from mavnav.slam.matching.scan_matching import Match

START_M, START_RAD = 1.0, 45 * DEG
"""Radius and half-width of the search around a given start pose, m and rad."""

MAP_CANDIDATES = 30
"""Number of minima of a region of the map that are refined and compared."""


class Localizer(Robust):
    """The robust method in a given map; ``grid`` counts hits and crossings of the scans, in the frame of that map."""

    builds_map = False
    found_conflicts = 1.0  # no limit: furniture moved since the map was made conflicts with every pose

    def __init__(self, config: Config, known: PriorMap) -> None:
        """Start at an unknown pose in the map, or near the given start pose."""
        super().__init__(config)
        robust, cell_m = config.robust, known.grid.cell_m
        self.known = GridBuilder.of(known.grid)
        self.lines = LineMap(cell_m, robust.expert.line_sigma_m, robust.expert.line_noise_m)
        self.lines.insert(known.walls_xy_m)
        self.start, self.tries = known.start, 0

    def first(self, scan: Scan) -> Match:
        """Find the laser: near the given start pose, else in the whole map at the 1st, 2nd, 4th, 8th ... try."""
        points = self.match_points(scan)
        if len(points) < self.config.robust.min_points:
            return no_match(Pose(), len(points))
        self.tries += 1
        found = self._only_pose(points, around(self.start, START_M, START_RAD)) if self.start else None
        if found is None and self.tries.bit_count() == 1:
            found = self._only_pose(points, everywhere(self.known))
        return found or no_match(self.start or Pose(), len(points))

    def _only_pose(self, points: NDArray[np.float64], region: Region) -> Match | None:
        """Return the match of the scan in a region; None if it fits nowhere, or at another pose about as well."""
        found = candidates(points, self.lines, self.known, region, self.config, MAP_CANDIDATES)
        best = unambiguous(found, AMBIGUITY_MARGIN, self.config)
        return best if best and self.acceptance.is_good(best) else None

    def insert(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> None:
        """Insert the scan into ``grid``; the map for matching does not change."""
        self.grid.insert(map_T_laser, transform_points(map_T_laser, self._points(scan, motion)[0]))

    def remove_dynamic_cells(self) -> None:
        """Remove dynamic cells from ``grid``; the map for matching does not change."""
        self.grid.remove_dynamic_cells()
