"""Maps of two furnished rooms before and after a change, from known poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mavnav.mapping.occupancy_grid import Grid, GridBuilder
from mavnav.pose import Pose, transform_points
from support.synthetic import LDS_01, Segments, box, cast, furnished_rooms, polyline, room

POSES = ((0.8, 0.8), (3.0, 0.8), (5.2, 1.0), (5.0, 3.0), (4.6, 4.0), (4.6, 5.2), (5.8, 5.6), (3.0, 3.3), (0.9, 3.0))
"""Positions of the laser, x and y in the world, m."""

MOVED, WALL, DOOR, TURNED = (2.2, 2.0), (0.5, 1.3), (4.65, 4.0), Pose(5.0, 3.0, 2.0)
"""Positions of the changes in the world, m; and the frame of another session."""

WORLD = Pose()
"""``world_T_map`` of a map in the world frame."""


def rooms(*, moved_m: float = 0.0, wall: bool = False, door: bool = False) -> Segments:
    """Return the rooms with a box moved along x, a new wall, or a closed door."""
    same = furnished_rooms()
    walls = [same[:10], box(1.9 + moved_m, 2.0, 0.7, 0.5, 0.3), same[14:]]
    walls += [polyline((0.0, 1.3), (1.0, 1.3))] if wall else []
    walls += [polyline((4.2, 4.0), (5.1, 4.0))] if door else []
    return np.vstack(walls)


def mapped(walls: Segments, world_T_map: Pose = WORLD, seed: int = 0, poses: object = POSES) -> Grid:
    """Return a map of the walls from known poses, with 10 mm of range noise."""
    rng, grid = np.random.default_rng(seed), GridBuilder(0.02)
    angles_rad = LDS_01.angles_rad[:, None] + np.arange(3) * (LDS_01.angle_step_rad / 3)
    bearings_rad = np.sort(angles_rad.ravel())
    for x_m, y_m in np.array(poses).tolist():
        for _ in range(3):
            ranges_m = cast(walls, (x_m, y_m), bearings_rad) + 0.01 * rng.standard_normal(len(bearings_rad))
            xy_m = np.array((x_m, y_m)) + ranges_m[:, None] * np.column_stack(
                (np.cos(bearings_rad), np.sin(bearings_rad))
            )
            grid.insert(world_T_map.between(Pose(x_m, y_m)), transform_points(world_T_map.inverse(), xy_m))
    return grid.by_rows()


def other_room(seed: int) -> Grid:
    """Return the map of a room of 4 to 8 m, with four boxes, in the frame of its walls."""
    rng = np.random.default_rng(seed)
    w, h = rng.uniform(4.0, 8.0, 2)
    boxes = [box(rng.uniform(1, w - 1), rng.uniform(1, h - 1), *rng.uniform(0.3, 0.8, 2)) for _ in range(4)]
    poses = (0.53, 0.61), (w - 0.47, 0.58), (w - 0.51, h - 0.63), (0.57, h - 0.49)
    return mapped(np.vstack([room(w, h), *boxes]), poses=poses)


def saved(grid: Grid, folder: Path) -> Path:
    """Write a map as in a run directory; return the directory."""
    folder.mkdir()
    arrays = {"counts": grid.hits, "passes": grid.passes, "cell_m": grid.cell_m, "origin_xy_m": grid.origin_xy_m}
    np.savez_compressed(folder / "hits.npz", **arrays)
    return folder
