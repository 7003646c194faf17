"""Robots with planted calibrations: a laser somewhere on a base with wheels, driven through furnished rooms."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.logs.writing.recorder import Recording, record
from mavnav.pose import Pose, Trajectory
from mavnav.scan import LaserSpec, Scan
from support.synthetic import DEG, LDS_01, TOUR, URG_04LX, Segments, along, furnished_rooms

START_S = 0.3
"""The first scan, after the first odometry."""

DRIVES = (
    TOUR,
    [(0.8, 0.8), (5.2, 0.8), (5.2, 3.2), (4.0, 3.0), (1.0, 3.2), (0.8, 0.9), (5.0, 1.0)],
    [(0.9, 3.0), (3.0, 3.3), (4.6, 4.0), (4.6, 5.2), (5.8, 5.6), (4.65, 5.2), (4.65, 3.2), (5.2, 1.0), (0.8, 0.8)],
)
"""Way-points in the rooms, m."""


ORIGIN = Pose()


class Robot(Struct, frozen=True):
    """What is wrong with a robot, and how it drives.

    Odometry has to be multiplied by the scales, turned by ``veer_rad_m`` for every meter, and its stamps need
    ``offset_s`` more. The noise of its steps is that of the path: ``length_noise`` m and ``yaw_noise`` rad for the root
    of a meter (and of a radian); in a share ``slips`` of them the wheels slip. Stamps of scans jitter by ``jitter_s``
    either way, those of the odometry by half of it. ``mirrored``: the laser is upside down. ``moving``: the
    beams of a sweep are of several times; ``backwards``: the last one is the first. The rooms are ``size`` times
    as large as `furnished_rooms`.
    """

    mounting: Pose = ORIGIN
    offset_s: float = 0.0
    distance_scale: float = 1.0
    turn_scale: float = 1.0
    veer_rad_m: float = 0.0
    mirrored: bool = False
    moving: bool = False
    backwards: bool = False
    spec: LaserSpec = URG_04LX
    drive: int = 0
    speed_m_s: float = 0.4
    turn_rad_s: float = 0.8
    odom_period_s: float = 0.05
    length_noise: float = 0.01
    yaw_noise: float = DEG
    jitter_s: float = 0.01
    slips: float = 0.0
    size: float = 1.0

    @property
    def truth(self) -> NDArray[np.float64]:
        """What a calibration has to find, (7,) in the order of its parameters."""
        wheels = (self.distance_scale, self.turn_scale, self.veer_rad_m)
        return np.array((*self.mounting, self.offset_s, *wheels))


class TruePath(Struct, frozen=True):
    """Where the base truly is, at any time: seconds (n,) and poses (n, 3), yaw not wrapped."""

    seconds: NDArray[np.float64]
    poses: NDArray[np.float64]
    start_ns: int

    def at(self, seconds: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([np.interp(seconds, self.seconds, column) for column in self.poses.T])


def path_of(robot: Robot, waypoints: list[tuple[float, float]] | None = None) -> TruePath:
    """Drive along way-points in steps of 20 ms."""
    places = [(robot.size * x, robot.size * y) for x, y in waypoints or DRIVES[robot.drive]]
    world_T_base = along(places, period_s=0.02, speed_m_s=robot.speed_m_s, turn_rad_s=robot.turn_rad_s)
    poses = world_T_base.xyyaw.copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    stamps = world_T_base.stamps_ns
    return TruePath((stamps - stamps[0]) * 1e-9, poses, int(stamps[0]))


def laser_at(robot: Robot, base: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bring poses (n, 3) of the base to the laser."""
    c, s, (x, y, yaw) = np.cos(base[:, 2]), np.sin(base[:, 2]), robot.mounting
    return np.column_stack((base[:, 0] + c * x - s * y, base[:, 1] + s * x + c * y, base[:, 2] + yaw))


def scans_of(robot: Robot, path: TruePath, rng: np.random.Generator, walls: Segments | None = None) -> list[Scan]:
    """Scan the furnished rooms, or other walls, along a path, with 1 % of noise."""
    spec = robot.spec if robot.moving else replace(robot.spec, time_increment_s=0.0)
    late_s = np.arange(spec.beams) * spec.time_increment_s
    late_s = late_s[::-1] if robot.backwards else late_s
    walls = robot.size * furnished_rooms() if walls is None else walls
    bearings, scans = spec.angles_rad * (-1 if robot.mirrored else 1), []
    for at_s in np.arange(START_S, path.seconds[-1] - 0.2, spec.scan_time_s):
        poses = laser_at(robot, path.at(at_s + late_s))
        ranges = cast_from(walls, poses[:, :2], bearings + poses[:, 2])
        ranges = ranges * (1.0 + 0.01 * rng.standard_normal(spec.beams))
        ranges[(ranges < spec.range_min_m) | (ranges > spec.range_max_m)] = np.nan
        jitter_s = rng.uniform(-robot.jitter_s, robot.jitter_s)
        scans.append(Scan(path.start_ns + round((at_s + jitter_s) * 1e9), ranges, spec))
    return scans


def cast_from(walls: Segments, xy_m: NDArray[np.float64], bearings_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance to the nearest wall along each bearing from a place of its own, (n,) m."""
    dx, dy = np.cos(bearings_rad)[:, None], np.sin(bearings_rad)[:, None]
    ax, ay = (walls[:, k] - xy_m[:, k, None] for k in (0, 1))
    ex, ey = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        r, u = (ax * ey - ay * ex) / (dx * ey - dy * ex), (ax * dy - ay * dx) / (dx * ey - dy * ex)
        return np.where((r > 0) & (u >= 0) & (u <= 1), r, np.inf).min(axis=1)


def odometry_of(robot: Robot, path: TruePath, rng: np.random.Generator) -> Trajectory:
    """Return what the wheels report: the inverse of the calibration, with noise and slips."""
    seconds = np.arange(0.0, path.seconds[-1], robot.odom_period_s)
    truth = path.at(seconds)
    true = [Pose(*pose) for pose in truth.tolist()]
    poses = [Pose()]
    for before, after in pairwise(true):
        step = before.between(after)
        length, turn = abs(step.x_m), abs(step.yaw_rad)
        by_length, by_yaw, slip, slip_x, slip_yaw = *rng.standard_normal(2), *rng.random(3)
        x = step.x_m / robot.distance_scale
        yaw = (step.yaw_rad - robot.veer_rad_m * x) / robot.turn_scale
        yaw += robot.yaw_noise * (np.sqrt(length) + np.sqrt(turn)) * by_yaw
        x += robot.length_noise * np.sqrt(length) * by_length
        slipped = slip < robot.slips
        poses.append(
            poses[-1]
            @ Pose(x + 0.1 * slip_x * slipped, step.y_m / robot.distance_scale, yaw + (slip_yaw - 0.5) * 0.4 * slipped)
        )
    jitter_s = rng.uniform(-0.5, 0.5, len(seconds)) * robot.jitter_s
    stamps = path.start_ns + np.round((seconds - robot.offset_s + jitter_s) * 1e9).astype(np.int64)
    return Trajectory.of(stamps.tolist(), poses)


def drive(robot: Robot, seed: int, waypoints: list[tuple[float, float]] | None = None) -> Recording:
    """Record a drive; the log says that the laser sits on the base's origin."""
    path, rng = path_of(robot, waypoints), np.random.default_rng([seed, 1])
    nowhere = Trajectory.of([], [])
    return Recording(scans_of(robot, path, rng), odometry_of(robot, path, rng), nowhere)


def written(robot: Robot, seed: int, path: Path, waypoints: list[tuple[float, float]] | None = None) -> Path:
    """Write a drive as a log."""
    record(drive(robot, seed, waypoints), path, force=True)
    return path


def perfect_track(robot: Robot, path: TruePath, noise_m: float = 0.001, seed: int = 0) -> Trajectory:
    """Return the track of the laser as scan matching would find it, every 0.1 s, in the frame of its first pose."""
    seconds = np.arange(START_S, path.seconds[-1] - 0.2, 0.1)
    poses = laser_at(robot, path.at(seconds)) + noise_m * np.random.default_rng(seed).standard_normal((len(seconds), 3))
    if robot.mirrored:
        poses *= (1, -1, -1)
    stamps = path.start_ns + np.round(seconds * 1e9).astype(np.int64)
    return Trajectory(stamps, poses).seen_from(Pose(*poses[0].tolist()).inverse())


SMALL = replace(LDS_01, scan_time_s=0.15, time_increment_s=0.15 / 360)
"""A laser of few beams, for short logs."""
