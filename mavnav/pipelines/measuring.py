"""What is measured of a tracked log before it is written: its map, and the slices of that by height."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mavnav.mapping.occupancy_grid import known_area, measured_area
from mavnav.mapping.slices import scans_with_heights, slice_map
from mavnav.metrics.journey import Journey
from mavnav.metrics.map_quality import measure_map
from mavnav.profiling import Stage, timed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mavnav.config.models import Config
    from mavnav.logs import Log
    from mavnav.mapping.slices import PlacedScan, Slices
    from mavnav.metrics.map_quality import MeasuredMap
    from mavnav.slam.result import SlamResult


@timed("measuring")
def measured_map(outcome: SlamResult, log: Log) -> MeasuredMap:
    """Measure the known part of the map of a run, with the scans behind it."""
    journey = Journey(
        outcome.trajectory, log.scans, outcome.tracked_share, outcome.lost_for_good, planar=outcome.planar
    )
    return measure_map(measured_area(outcome.grid), journey)


def map_slices_of(outcome: SlamResult, log: Log, config: Config) -> Slices | None:
    """Cut the map of a run into slices by height; None where the height of the laser is not known, or hardly varies."""
    attitude = log.attitude
    if attitude is None or not attitude.has_heights:
        return None

    def place_scans() -> Iterator[PlacedScan]:
        return scans_with_heights(log.scans(), outcome.trajectory, attitude.height_at)

    with Stage("slices"):
        return slice_map(place_scans, known_area(outcome.grid), config.slice_m)
