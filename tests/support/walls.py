"""Walls of known thickness, and walking people."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import Grid
from mavnav.metrics.journey import PlacedScans
from mavnav.metrics.wall_spread import WallSpread, cut_walls, wall_spread
from mavnav.pose import Pose
from support.synthetic import Segments, box, polyline, scan_at

CELL_M = 0.02


def planted_wall(angle_rad: float, across_m: NDArray[np.float64]) -> WallSpread:
    """Measure a wall of 4 m with hits at these distances from its center line, seen perpendicularly by one laser."""
    rng, c, s = np.random.default_rng(0), np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array(((c, s), (-s, c)))
    wall = np.array(((-2.0, 0.0), (2.0, 0.0))) @ turn
    at = Pose(*(np.array((0.0, -1.5)) @ turn), angle_rad + np.pi / 2)
    scan = scan_at(polyline(*map(tuple, wall)), at)
    xy_m = np.column_stack((rng.uniform(-2.2, 2.2, len(across_m)), across_m)) @ turn
    col, row = np.floor(xy_m / CELL_M).astype(int).T + 200
    hits = np.zeros((400, 400), np.int64)
    np.add.at(hits, (row, col), 1)
    scans = PlacedScans(scan.spec, np.zeros(1, np.int64), at.as_array()[None], scan.ranges_m[None])
    return wall_spread(cut_walls(Grid(CELL_M, (-4.0, -4.0), hits, 0 * hits), scans, 1), CELL_M)


def walking_people(rng: np.random.Generator, people: int, steps: int) -> list[Segments]:
    """Return the outlines of people walking in ``synthetic.room``, one array per step."""
    xy, heading = rng.uniform((0.8, 0.6), (5.2, 3.4), (people, 2)), rng.uniform(-np.pi, np.pi, people)
    outlines = []
    for _ in range(steps):
        for k in range(people):
            ahead = xy[k] + 0.09 * np.array([np.cos(heading[k]), np.sin(heading[k])])
            free = 0.8 < ahead[0] < 5.2 and 0.6 < ahead[1] < 3.4 and np.hypot(*(ahead - (2.9, 1.0))) > 0.5
            xy[k], heading[k] = (ahead, heading[k]) if free else (xy[k], heading[k] + rng.uniform(0.5, 1.5))
        outlines.append(np.vstack([np.zeros((0, 4)), *(box(x, y, 0.35, 0.25, 0.4) for x, y in xy)]))
    return outlines
