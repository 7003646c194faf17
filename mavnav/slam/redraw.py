"""Step 15: redraw the map from the finished track, because scans were inserted before the whole map was known."""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING

import numpy as np

from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.slam.motion_model import LONGEST_S
from mavnav.slam.steps import jumps, tracked_trajectory
from mavnav.units import NS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from mavnav.pose import Trajectory
    from mavnav.slam.method import Refiner
    from mavnav.slam.motion_model import Motion
    from mavnav.slam.track import Track


def redraw_map(track: Track) -> Track:
    """Redraw the map: insert every scan, deskewed by the finished track, where it fits the whole map best.

    The trajectory does not change. The method takes the new map if it has fewer hit cells, because blurred and doubled
    walls have more. If the run is stopped early, the old map stays.
    """
    method, refiner = track.method, track.refiner
    if refiner and refiner.builds_map:
        drawn = redrawn(track, refiner)
        if drawn and np.count_nonzero(drawn.hits) < np.count_nonzero(method.grid.hits):
            method.grid = drawn
    return track


def redrawn(track: Track, refiner: Refiner) -> GridBuilder | None:
    """Return the new map; None if the run is stopped before the last tracked scan."""
    map_T_laser, drawn, inserted = tracked_trajectory(track.steps), GridBuilder(track.method.grid.cell_m), 0
    steps = track.reported(track.steps, "draw map")
    tracked = ((step, scan) for step, scan in zip(steps, track.log_scans(), strict=False) if step.tracked)
    for (step, scan), motion in zip(tracked, motions_along(map_T_laser, track.motion), strict=False):
        pose = refiner.refine(refiner.match_points(scan, motion), step.match).map_T_laser
        drawn.insert(pose, *refiner.placed_points(scan, pose, motion))
        inserted += 1
    drawn.remove_dynamic_cells()
    return drawn if inserted == len(map_T_laser) else None


def motions_along(map_T_laser: Trajectory, motion: Motion) -> Iterator[Motion]:
    """Yield the motion at every pose, with the velocity of the path before and after it."""
    for row, (x, y, yaw) in enumerate(twists(map_T_laser, motion.period_s).tolist()):
        stamp_ns = int(map_T_laser.stamps_ns[row])
        yield motion._replace(odometry=None, map_T_laser=map_T_laser[row], stamp_ns=stamp_ns, twist=(x, y, yaw))


def twists(map_T_laser: Trajectory, period_s: float) -> NDArray[np.float64]:
    """Return the velocity at every pose (n, 3), laser frame, m/s, m/s, rad/s; 0 between two gaps."""
    moved = np.diff(map_T_laser.xyyaw, axis=0)
    moved[:, 2] = (moved[:, 2] + pi) % (2.0 * pi) - pi
    elapsed_s = np.maximum(np.round(np.diff(map_T_laser.stamps_ns) * NS / period_s), 1.0) * period_s
    joined = (elapsed_s <= LONGEST_S) & ~jumps(map_T_laser)[1]
    weights = np.pad(np.where(joined, elapsed_s, 0.0), 1)
    sums = np.pad(np.where(joined[:, None], moved, 0.0), ((1, 1), (0, 0)))
    x, y, yaw = ((sums[:-1] + sums[1:]) / np.maximum(weights[:-1] + weights[1:], period_s)[:, None]).T
    cos, sin = np.cos(map_T_laser.xyyaw[:, 2]), np.sin(map_T_laser.xyyaw[:, 2])
    return np.column_stack((cos * x + sin * y, cos * y - sin * x, yaw))
