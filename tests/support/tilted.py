"""Rooms with walls of finite heights, seen by a laser that tilts and climbs: one ray at a time, against every wall."""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.scan import Attitude, LaserSpec, Scan
from support.synthetic import Segments

FLOOR, NOTHING = -1, -2


def directions_3d(spec: LaserSpec, yaw_rad: float, attitude: Attitude) -> NDArray[np.float64]:
    """Return the directions of the beams in the map, (beams, 3): ``Rz(yaw) Ry(pitch) Rx(roll)`` times their own."""
    (cr, cp, cy), (sr, sp, sy) = (f((attitude.roll_rad, attitude.pitch_rad, yaw_rad)) for f in (np.cos, np.sin))
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    own = np.column_stack((spec.directions, np.zeros(spec.beams)))
    return own @ (yaw @ pitch @ roll).T


def cast_3d(
    walls: Segments, tops_m: NDArray[np.float64], origin: tuple[float, float, float], directions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the length of each ray and the number of the wall that it meets, `FLOOR`, or `NOTHING` with inf.

    Walls (n, 4) stand on the floor at height 0 and end at ``tops_m`` (n,).
    """
    ranges, hits = np.full(len(directions), inf), np.full(len(directions), NOTHING)
    for k, (dx, dy, dz) in enumerate(directions):
        if dz < 0.0:
            ranges[k], hits[k] = -origin[2] / dz, FLOOR
        ax, ay = walls[:, 0] - origin[0], walls[:, 1] - origin[1]
        wx, wy = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            along = (ax * wy - ay * wx) / (dx * wy - dy * wx)
            share = (ax * dy - ay * dx) / (dx * wy - dy * wx)
            height = origin[2] + along * dz
            met = (along > 1e-9) & (share >= 0) & (share <= 1) & (height >= 0) & (height <= tops_m)
        along = np.where(met, along, inf)
        if along.min() < ranges[k]:
            ranges[k], hits[k] = along.min(), along.argmin()
    return ranges, hits


def tilted_scan(
    walls: Segments, tops_m: NDArray[np.float64], pose: Pose, attitude: Attitude, spec: LaserSpec, stamp_ns: int = 0
) -> tuple[Scan, NDArray[np.int64]]:
    """Return what a laser measures that stands still at a pose, and what each beam met."""
    origin = (pose.x_m, pose.y_m, attitude.height_m)
    ranges, hits = cast_3d(walls, tops_m, origin, directions_3d(spec, pose.yaw_rad, attitude))
    valid = (ranges >= spec.range_min_m) & (ranges <= spec.range_max_m)
    return Scan(stamp_ns, np.where(valid, ranges, np.nan), spec), hits
