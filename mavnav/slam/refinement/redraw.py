"""Step 15: redraw the map from the finished track, because scans were inserted before the whole map was known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.mapping.occupancy_grid import GridBuilder

if TYPE_CHECKING:
    from mavnav.slam.methods.method import Refiner
    from mavnav.slam.track import Track


def redraw_map(track: Track) -> Track:
    """Redraw the map: insert every scan, deskewed by the finished track, where it fits the whole map best.

    The trajectory does not change. The method takes the new map if it has fewer hit cells, because blurred and doubled
    walls have more. If the run is stopped early, the old map stays.
    """
    method, refiner = track.method, track.refiner
    if refiner and refiner.builds_map:
        drawn = draw_map(track, refiner)
        if drawn and np.count_nonzero(drawn.hits) < np.count_nonzero(method.grid.hits):
            method.grid = drawn
    return track


def draw_map(track: Track, refiner: Refiner) -> GridBuilder | None:
    """Return the new map; None if the run is stopped before the last tracked scan."""
    drawn, inserted = GridBuilder(track.method.grid.cell_m), 0
    for step, scan, motion in track.placed_scans("draw map"):
        pose = refiner.refine(refiner.match_points(scan, motion), step.match).map_T_laser
        drawn.insert(pose, *refiner.placed_points(scan, pose, motion))
        inserted += 1
    drawn.remove_dynamic_cells()
    return drawn if inserted == np.count_nonzero(track.steps.column("tracked")) else None
