"""Localization: the robust method in a given map, which does not change (docs/method.md)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, transform_points
from mavnav.scan import Scan
from mavnav.slam.matching.motion_model import Motion
from mavnav.slam.matching.prior_map import PriorMap
from mavnav.slam.matching.relocalization import (
    AMBIGUITY_MARGIN,
    MAP_CANDIDATES,
    START_M,
    START_RAD,
    Region,
    around,
    candidates,
    everywhere,
    unambiguous,
)
from mavnav.slam.matching.scan_matching import Match, empty_line_map, no_match
from mavnav.slam.methods.fused import Fused


class Localizer(Fused):
    """The robust method in a given map; ``grid`` counts hits and crossings of the scans, in the frame of that map."""

    builds_map = False
    found_conflicts = 1.0  # no limit: furniture moved since the map was made conflicts with every pose

    def __init__(self, config: Config, known: PriorMap) -> None:
        """Start at an unknown pose in the map, or near the given start pose."""
        super().__init__(config)
        self.known = GridBuilder.of(known.grid)
        self.lines = empty_line_map(config, known.grid.cell_m)
        self.lines.insert(known.walls_xy_m)
        self.start, self.tries = known.start, 0

    def first(self, scan: Scan) -> Match:
        """Find the laser: near the given start pose, else in the whole map at the 1st, 2nd, 4th, 8th ... try."""
        points = self.match_points(scan)
        if len(points) < self.config.robust.min_points:
            return no_match(Pose(), len(points))
        self.tries += 1
        match = self._only_pose(points, around(self.start, START_M, START_RAD)) if self.start else None
        if match is None and self.tries.bit_count() == 1:
            match = self._only_pose(points, everywhere(self.known))
        return match or no_match(self.start or Pose(), len(points))

    def _only_pose(self, points: NDArray[np.float64], region: Region) -> Match | None:
        """Return the match of the scan in a region; None if it fits nowhere, or at another pose about as well."""
        matches = candidates(points, self.lines, self.known, region, self.config, MAP_CANDIDATES)
        best = unambiguous(matches, AMBIGUITY_MARGIN, self.config)
        return best if best and self.acceptance.is_good(best) else None

    def insert(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> None:
        """Insert the scan into ``grid``; the map for matching does not change."""
        self.grid.insert(map_T_laser, transform_points(map_T_laser, self._points(scan, motion)[0]))

    def remove_dynamic_cells(self) -> None:
        """Remove dynamic cells from ``grid``; the map for matching does not change."""
        self.grid.remove_dynamic_cells()
