"""Rooms with walls of finite heights, seen by a laser that tilts and climbs: every ray against every wall."""

from __future__ import annotations

from math import inf
from pathlib import Path

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.pose import Pose
from mavnav.scan import Attitude, LaserSpec, Scan
from support.log_files import LASER, POSE, START_NS, Message, write_mcap
from support.synthetic import DEG, Segments, box, room

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
    walls: Segments,
    tops_m: NDArray[np.float64],
    origin: tuple[float, float, float],
    directions: NDArray[np.float64],
    ceiling_m: float = inf,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the length of each ray and the number of the wall that it meets, `FLOOR` (or ceiling), or `NOTHING`: inf.

    Walls (n, 4) stand on the floor at height 0 and end at ``tops_m`` (n,).
    """
    (dx, dy, dz), (ox, oy, oz) = directions.T[:, :, None], origin
    (ax, ay), (wx, wy) = (walls[:, :2] - (ox, oy)).T, (walls[:, 2:] - walls[:, :2]).T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        along, share = (ax * wy - ay * wx) / (dx * wy - dy * wx), (ax * dy - ay * dx) / (dx * wy - dy * wx)
        height = oz + along * dz
        met = (along > 1e-9) & (share >= 0) & (share <= 1) & (height >= 0) & (height <= tops_m)
        floor = np.where(dz < 0.0, -oz / dz, np.where(dz > 0.0, (ceiling_m - oz) / dz, inf))
    lengths = np.column_stack((np.where(met, along, inf), floor))
    nearest = lengths.argmin(axis=1)
    ranges = lengths[np.arange(len(lengths)), nearest]
    return ranges, np.where(np.isinf(ranges), NOTHING, np.where(nearest == len(walls), FLOOR, nearest))


def tilted_scan(
    walls: Segments,
    tops_m: NDArray[np.float64],
    pose: Pose,
    attitude: Attitude,
    spec: LaserSpec,
    ceiling_m: float = inf,
) -> tuple[Scan, NDArray[np.int64]]:
    """Return what a laser measures that stands still at a pose, and what each beam met."""
    origin = (pose.x_m, pose.y_m, attitude.height_m)
    ranges, hits = cast_3d(walls, tops_m, origin, directions_3d(spec, pose.yaw_rad, attitude), ceiling_m)
    valid = (ranges >= spec.range_min_m) & (ranges <= spec.range_max_m)
    return Scan(0, np.where(valid, ranges, np.nan), spec), hits


class Scene(Struct, frozen=True):
    """Walls (n, 4) that end at ``tops_m`` (n,)."""

    walls: Segments
    tops_m: NDArray[np.float64]


def furnished() -> Scene:
    """Return a room of 6 x 4 m, 2.5 m high, with a table of 0.8 m, a bench of 0.5 m and a cupboard."""
    parts = [(room(6.0, 4.0), 2.5), (box(2.9, 1.9, 0.9, 0.7, 0.2), 0.8), (box(4.9, 0.35, 1.4, 0.5), 0.5)]
    parts += [(box(0.35, 3.3, 0.7, 1.0), 2.0)]
    return Scene(np.vstack([w for w, _ in parts]), np.concatenate([np.full(len(w), top) for w, top in parts]))


SPEC = LaserSpec(-np.pi, 2 * np.pi / 240, 240, 0.1, 12.0, 0.0, 0.1)
NOISE_M = 0.005


def flight(scans: int) -> list[tuple[Pose, Attitude]]:
    """Return poses round the table, tilted by sines of 10 deg, at heights of 0.3 to 1.5 m, ten a second."""
    out = []
    for t in 0.1 * np.arange(scans):
        at = 2 * np.pi * t / 14.0
        pose = Pose(3.0 + 1.6 * np.cos(at), 2.0 + 1.2 * np.sin(at), at + 0.6 * np.pi)
        roll, pitch = 10 * DEG * np.sin(2 * np.pi * t / 2.3), 10 * DEG * np.sin(2 * np.pi * t / 3.1 + 1.0)
        out.append((pose, Attitude(roll, pitch, 0.9 - 0.6 * np.cos(2 * np.pi * t / 6.0))))
    return out


def quaternion(attitude: Attitude) -> dict[str, float]:
    """Return roll and pitch as a quaternion without yaw."""
    (cr, cp), (sr, sp) = (f(np.array(attitude[:2]) / 2) for f in (np.cos, np.sin))
    return {"x": sr * cp, "y": cr * sp, "z": -sr * sp, "w": cr * cp}


def attitude_message(stamp_ns: int, attitude: Attitude, topic: str = "/attitude") -> Message:
    return Message(topic, POSE, stamp_ns, {"x": 0.0, "y": 0.0, "z": attitude.height_m, "q": quaternion(attitude)})


def flight_messages(scene: Scene, scans: int) -> list[Message]:
    """Return scans of a flight and the attitude at their stamps."""
    rng, messages, path = np.random.default_rng(7), [], flight(scans)
    for k, (pose, attitude) in enumerate(path):
        scan, _ = tilted_scan(scene.walls, scene.tops_m, pose, attitude, SPEC)
        ranges = scan.ranges_m + rng.normal(0.0, NOISE_M, SPEC.beams)
        told = {"angle_min": SPEC.angle_min_rad, "angle_increment": SPEC.angle_step_rad, "ranges": ranges}
        stamp_ns = START_NS + k * 100_000_000
        messages += [
            attitude_message(stamp_ns, attitude),
            Message("/scan", LASER, stamp_ns, told | {"range_max": 12.0}),
        ]
    return messages


def write_flight(path: Path, scans: int = 140) -> Path:
    return write_mcap(path, flight_messages(furnished(), scans))
