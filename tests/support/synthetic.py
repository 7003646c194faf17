"""Scenes of line segments, seen by an ideal or a noisy laser: scans with known true poses.

Ray casting is exact (ray against segment, in numpy). All random numbers depend on the seed only.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from math import atan2, hypot, pi

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.pose import Pose, Trajectory, wrap_angle
from mavnav.scan import LaserSpec, Scan

Segments = NDArray[np.float64]
"""Walls, (n, 4): x1, y1, x2, y2 in m, map frame."""

DEG = pi / 180.0

URG_04LX = LaserSpec(-340 * 360 / 1024 * DEG, 360 / 1024 * DEG, 681, 0.02, 5.6, 0.1 / 1024, 0.1)
"""240 degrees in 681 beams, 5.6 m, 10 Hz."""

LDS_01 = LaserSpec(0.0, DEG, 360, 0.12, 3.5, 0.0, 0.2)
"""A full turn in 360 beams, 3.5 m, 5 Hz."""


def polyline(*xy_m: tuple[float, float], closed: bool = False) -> Segments:
    """Return the walls between consecutive points."""
    points = np.array([*xy_m, xy_m[0]] if closed else xy_m, dtype=np.float64)
    return np.column_stack((points[:-1], points[1:]))


def box(x_m: float, y_m: float, width_m: float, depth_m: float, yaw_rad: float = 0.0) -> Segments:
    """Return the four sides of a box, given its center."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (width_m / 2, depth_m / 2)
    xy = corners @ np.array([(c, s), (-s, c)]) + (x_m, y_m)
    return polyline(*map(tuple, xy), closed=True)


def moved(segments: Segments, by: Pose) -> Segments:
    """Return the walls of a frame in the one in which its pose is ``by``."""
    c, s = np.cos(by.yaw_rad), np.sin(by.yaw_rad)
    ends = segments.reshape(-1, 2) @ np.array([(c, s), (-s, c)]) + (by.x_m, by.y_m)
    return ends.reshape(-1, 4)


def corridor_with_rooms() -> Segments:
    """Return a corridor of 24 x 2.4 m along the x axis, with an open, furnished room on either side every 5 m."""
    walls = [polyline((0.0, -1.2), (0.0, 1.2)), polyline((24.0, -1.2), (24.0, 1.2))]
    for side in (-1.0, 1.0):
        door_m = [0.0, *np.ravel([(x, x + 1.0) for x in np.arange(2.0, 24.0, 5.0) + 0.7 * (side > 0)]), 24.0]
        walls += [polyline((a, 1.2 * side), (b, 1.2 * side)) for a, b in zip(door_m[::2], door_m[1::2], strict=True)]
        walls += [polyline((0.0, 4.5 * side), (24.0, 4.5 * side))]
        walls += [polyline((x, 1.2 * side), (x, 4.5 * side)) for x in np.arange(0.0, 25.0, 5.0)]
        walls += [box(x + 1.0, 3.6 * side, 0.8, 0.6) for x in np.arange(0.5, 24.0, 5.0)]
    return np.vstack(walls)


def room(width_m: float = 6.0, depth_m: float = 4.0) -> Segments:
    """Return an empty room with its lower left corner at the origin."""
    return polyline((0, 0), (width_m, 0), (width_m, depth_m), (0, depth_m), closed=True)


def furnished_rooms() -> Segments:
    """Return a room of 6 x 4 m with three boxes, and a smaller one behind a doorway of 0.9 m."""
    walls = [
        polyline((4.2, 4.0), (0, 4.0), (0, 0), (6, 0), (6, 4.0), (5.1, 4.0)),  # doorway from x = 4.2 to 5.1
        polyline((4.2, 4.0), (3.0, 4.0), (3.0, 6.5), (6.5, 6.5), (6.5, 4.0), (5.1, 4.0)),
        box(1.9, 2.0, 0.7, 0.5, 0.3),
        box(4.2, 1.9, 0.4, 0.6, -0.2),
        box(0.25, 3.75, 0.5, 0.5),
        box(3.4, 6.2, 0.6, 0.4, 0.1),
    ]
    return np.vstack(walls)


def cast(segments: Segments, xy_m: tuple[float, float], bearings_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the exact distance to the nearest wall along each bearing, (n,) in metres; inf where there is none."""
    dx, dy = np.cos(bearings_rad)[:, None], np.sin(bearings_rad)[:, None]
    ax, ay = segments[:, 0] - xy_m[0], segments[:, 1] - xy_m[1]
    ex, ey = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    # Solve r d = a + u e for the range r along the ray and the share u along the wall.
    denominator = dx * ey - dy * ex
    with np.errstate(divide="ignore", invalid="ignore"):
        r = (ax * ey - ay * ex) / denominator
        u = (ax * dy - ay * dx) / denominator
    hit = (denominator != 0) & (r > 0) & (u >= 0) & (u <= 1)
    return np.where(hit, r, np.inf).min(axis=1)


def scan_at(
    segments: Segments,
    map_T_laser: Pose,
    spec: LaserSpec = URG_04LX,
    *,
    stamp_ns: int = 0,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Scan:
    """Return one scan at rest; ``noise`` is the standard deviation as a share of the range. No return gives NaN."""
    bearings = spec.angles_rad + map_T_laser.yaw_rad
    ranges = cast(segments, (map_T_laser.x_m, map_T_laser.y_m), bearings)
    if noise:
        ranges = ranges * (1.0 + noise * (rng or np.random.default_rng(0)).standard_normal(len(ranges)))
    ranges[(ranges < spec.range_min_m) | (ranges > spec.range_max_m)] = np.nan
    return Scan(stamp_ns, ranges, spec)


def along(
    waypoints_m: list[tuple[float, float]],
    period_s: float = 0.1,
    speed_m_s: float = 0.5,
    turn_rad_s: float = 1.0,
    start_ns: int = 1_700_000_000_000_000_000,
) -> Trajectory:
    """Return a trajectory along waypoints at constant speed, turning towards the next one at a bounded rate."""
    stamps, poses = [start_ns], [Pose(*waypoints_m[0], _bearing(waypoints_m[0], waypoints_m[1]))]
    for goal in waypoints_m[1:]:
        while True:
            at = poses[-1]
            left = hypot(goal[0] - at.x_m, goal[1] - at.y_m)
            if left < 1.5 * speed_m_s * period_s:
                break
            error = wrap_angle(_bearing((at.x_m, at.y_m), goal) - at.yaw_rad)
            turn = float(np.clip(error, -turn_rad_s * period_s, turn_rad_s * period_s))
            step = speed_m_s * period_s * max(0.0, np.cos(error - turn)) ** 4  # nearly in place in sharp turns
            poses.append(at @ Pose(0.0, 0.0, turn) @ Pose(float(step), 0.0, 0.0))
            stamps.append(stamps[-1] + round(period_s * 1e9))
    return Trajectory.of(stamps, poses)


def _bearing(a: tuple[float, float], b: tuple[float, float]) -> float:
    return atan2(b[1] - a[1], b[0] - a[0])


class Recording(Struct, frozen=True):
    """Scans, and the true pose of the laser at each of them: ``world_T_laser``."""

    scans: list[Scan]
    world_T_laser: Trajectory

    @property
    def map_T_laser(self) -> Trajectory:
        """Return the true poses in the map frame, which is the first laser pose."""
        first = self.world_T_laser[0]
        poses = [first.between(self.world_T_laser[k]) for k in range(len(self.world_T_laser))]
        return Trajectory.of(self.world_T_laser.stamps_ns.tolist(), poses)


NOTHING: Segments = np.zeros((0, 4))


def record(
    segments: Segments,
    world_T_laser: Trajectory,
    spec: LaserSpec = URG_04LX,
    noise: float = 0.01,
    seed: int = 0,
    carried: Segments = NOTHING,
) -> Recording:
    """Return the scans along a trajectory; ``carried`` (n, 4), in the laser frame, moves with the laser."""
    rng, scans = np.random.default_rng(seed), []
    for k, stamp in enumerate(world_T_laser.stamps_ns):
        seen = np.vstack((segments, moved(carried, world_T_laser[k])))
        scans.append(scan_at(seen, world_T_laser[k], spec, stamp_ns=int(stamp), noise=noise, rng=rng))
    return Recording(scans, world_T_laser)


SHORT = LaserSpec(-120 * DEG, 0.5 * DEG, 481, 0.05, 6.0, 0.0, 0.1)
"""A laser that does not see the ends of a corridor."""


def corridor(doors: Sequence[float] = ()) -> Recording:
    """Return a drive of 26 m through the middle of a corridor, past doors of 0.9 m, 0.12 m deep, at some places, m."""
    walls = polyline((0.0, -1.2), (40.0, -1.2), (40.0, 1.2), (0.0, 1.2), closed=True)
    frames = [box(x_m, side * 1.2, 0.9, 0.24) for x_m, side in zip(doors, cycle((-1, 1)))]
    path = along([(7.0, 0.0), (20.0, 0.2), (33.0, 0.0)], speed_m_s=0.9)
    return record(np.vstack((walls, *frames)), path, SHORT, 0.01)


def past_cupboards(bare_m: float = 0.0) -> Recording:
    """Return a drive of 24 m along a corridor, past cupboards 0.3 m deep at uneven distances, then bare walls."""
    rng, spec, end_m = np.random.default_rng(3), LaserSpec(-2.3, 4.6 / 540, 541, 0.05, 12.0, 0.0, 0.1), 30.0 + bare_m
    cupboards = [box(x_m, rng.choice((-1.2, 1.2)), rng.uniform(0.5, 1.5), 0.6) for x_m in np.arange(1.0, 30.0, 1.9)]
    walls = np.vstack((polyline((0, -1.2), (end_m, -1.2), (end_m, 1.2), (0, 1.2), closed=True), *cupboards))
    return record(walls, along([(2.0, 0.0), (14.0, 0.1), (end_m - 4.0, 0.0)], speed_m_s=0.8), spec, 0.003)


def drifting_odometry(
    world_T_base: Trajectory, seed: int = 0, length_share: float = 0.03, turn_share: float = 0.04
) -> Trajectory:
    """Return wheel odometry: every step and turn is too large by a constant share plus a random one."""
    rng = np.random.default_rng(seed)
    poses = [Pose()]
    for k in range(1, len(world_T_base)):
        step = world_T_base[k - 1].between(world_T_base[k])
        stretch, turn = 1.0 + length_share * (1 + rng.standard_normal()), 1.0 + turn_share * (1 + rng.standard_normal())
        poses.append(poses[-1] @ Pose(step.x_m * stretch, step.y_m * stretch, step.yaw_rad * turn))
    return Trajectory.of(world_T_base.stamps_ns.tolist(), poses)


TOUR = [(0.8, 0.7), (4.9, 0.7), (5.2, 2.2), (4.65, 3.4), (4.65, 5.2), (5.9, 5.2), (4.65, 4.9), (4.65, 3.4), (3.0, 3.2),
        (1.1, 3.2), (0.8, 0.9)]  # fmt: skip
"""Waypoints of a loop through ``furnished_rooms``: around the boxes, into the small room and back."""
