"""The paper's method: radius differences against a virtual scan."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, transform_points
from mavnav.profiling import timed
from mavnav.slam.matching.paper_matching import acceptance_scale, match_polar, polar_points
from mavnav.slam.matching.scan_matching import first_match, no_match
from mavnav.slam.matching.track_state import MatchVerdict

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.config.models import Config
    from mavnav.mapping.occupancy_grid import Grid
    from mavnav.scan import LaserSpec, Scan
    from mavnav.slam.matching.motion_model import Motion
    from mavnav.slam.matching.scan_matching import Match

LEAST_BEAMS_SHARE = 0.1
"""Minimum share of valid beams of a scan to be matched, if ``min_beams_of`` is not ``scan``."""


class Paper:
    """The paper's method in all its steps; its map is the plain grid of hit counts, and it has no refiner."""

    uses_odometry = False
    refiner = None
    own_kernels = ("polar_search.cost", "polar_search.search", "maps.raycast")
    """The modules of kernels that no other method needs."""

    def __init__(self, config: Config) -> None:
        """Start with an empty map."""
        self.config = config
        self.expects_rest = config.paper.expert.predict == "rest"
        self.grid = GridBuilder(config.paper.cell_m)
        self._seen: tuple[Pose, LaserSpec, NDArray[np.float64]] | None = None

    def first(self, scan: Scan) -> Match:
        """Begin the map with any scan that has enough beams to be matched later."""
        beams = int(np.isfinite(scan.ranges_m).sum())
        return first_match(beams) if beams >= max(3.0, self._least_beams(scan.spec)) else no_match(Pose(), beams)

    def _least_beams(self, spec: LaserSpec) -> float:
        """Return the number of valid beams below which a scan is not matched."""
        paper = self.config.paper
        return (
            paper.expert.min_beams_share * spec.beams
            if paper.expert.min_beams_of == "scan"
            else LEAST_BEAMS_SHARE * spec.beams
        )

    def match(self, scan: Scan, predicted: Pose, motion: Motion) -> Match:
        """Match against a virtual scan from the predicted pose (cost steps i, ii)."""
        paper = self.config.paper
        points = polar_points(scan.ranges_m, scan.spec, paper.expert.mixed_pixel_m)
        if len(points) < self._least_beams(scan.spec):
            return no_match(predicted, len(points))._replace(threshold_m2=self._threshold_m2(scan))
        virtual_m = self._virtual_scan(predicted, scan.spec)
        match = match_polar(virtual_m, points, scan.spec, predicted, self.config)
        return match._replace(threshold_m2=self._threshold_m2(scan))

    def _virtual_scan(self, predicted: Pose, spec: LaserSpec) -> NDArray[np.float64]:
        """Return the virtual scan (beams,), m; the last one is reused while neither map nor prediction change."""
        if self._seen is None or self._seen[:2] != (predicted, spec):
            paper = self.config.paper
            ranges_m = self.grid.virtual_scan(
                predicted,
                spec.directions,
                paper.far_m,
                paper.expert.cluster_gap_cells,
                middle=paper.expert.equal_cells == "middle",
            )
            self._seen = predicted, spec, ranges_m
        return self._seen[2]

    @timed("gate")
    def gate(self, match: Match, scan: Scan, motion: Motion) -> MatchVerdict:
        """Accept a match whose cost is at most the threshold (paper, "Map Update")."""
        return MatchVerdict.SURE if match.cost_m2 <= self._threshold_m2(scan) else MatchVerdict.REFUSED

    def _threshold_m2(self, scan: Scan) -> float:
        """Return the acceptance threshold for a scan."""
        return acceptance_scale(scan.ranges_m, self.config) * self.config.paper.gate_m2

    def insert(self, scan: Scan, map_T_laser: Pose, motion: Motion) -> None:
        """Count the hits of every valid beam."""
        self._seen = None
        self.grid.insert(map_T_laser, transform_points(map_T_laser, scan.points()))

    def release_map(self) -> Grid:
        """Return the map."""
        return self.grid.by_rows()
