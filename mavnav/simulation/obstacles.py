"""What the planner goes round: the whole map, or of an aerial vehicle that knows its attitude a slice of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import transform_points

if TYPE_CHECKING:
    from mavnav.scan import Scan
    from mavnav.simulation.world import Scenario
    from mavnav.slam.matching.steps import Step


class Obstacles(Struct, frozen=True):
    """A map for the planner; ``slice_m`` are the lower and upper end of the slice that it shows, None for all."""

    grid: GridBuilder
    slice_m: tuple[float, float] | None = None

    @classmethod
    def of(cls, scenario: Scenario, whole: GridBuilder) -> Obstacles:
        """Take the map of the SLAM method as it is, or begin a slice of the same cells where scans are levelled."""
        if scenario.flight is None or not scenario.levels_scans:
            return cls(whole)
        return cls(GridBuilder(whole.cell_m), scenario.flight.slice_m)

    def note(self, scan: Scan, step: Step) -> None:
        """Count the returns of an accepted scan in the slice; their beams have not left it, as the laser is in it."""
        if self.slice_m is None or scan.heights_m is None or not step.tracked:
            return
        low_m, high_m = self.slice_m
        with np.errstate(invalid="ignore"):  # NaN: no return
            within = (scan.heights_m > low_m) & (scan.heights_m < high_m)
        xy_m = scan.ranges_m[within, None] * scan.spec.directions[within]
        self.grid.insert(step.match.map_T_laser, transform_points(step.match.map_T_laser, xy_m))
