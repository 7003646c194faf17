"""Sessions in furnished rooms with known true poses, each in a frame of its own."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from mavnav.config.models import Config
from mavnav.pose import Pose, Trajectory
from mavnav.scan import LaserSpec
from mavnav.sessions.group import Session, make_session
from support.log_files import LASER, Message, write_mcap
from support.synthetic import DEG, LDS_01, Recording, Segments, along, box, furnished_rooms, polyline, record

TOURS = {
    "hall": [(0.8, 0.8), (3.0, 0.8), (5.2, 1.0), (5.2, 3.0)],
    "both": [(5.2, 1.0), (5.0, 2.8), (4.65, 3.5), (4.65, 5.2)],
    "back": [(5.8, 5.6), (4.65, 5.2), (4.65, 3.4), (3.0, 3.2)],
}
"""Paths through two rooms that overlap, in the world, m."""

WIDE = LaserSpec(-135 * DEG, 0.5 * DEG, 541, 0.05, 12.0, 0.0, 0.1)
"""270 degrees in 541 beams, 12 m."""

CELLAR = np.vstack([polyline((0, 0), (7, 0), (8, 4), (3, 5.5), (0, 3), closed=True), polyline((2, 2), (3.3, 2.9))])
"""Walls of another building."""


def tour(path: str, seed: int = 0, walls: Segments | None = None) -> Recording:
    """Return scans along a path, every 0.5 s."""
    track = along(TOURS[path], speed_m_s=0.3, period_s=0.5, turn_rad_s=0.6)
    return record(furnished_rooms() if walls is None else walls, track, LDS_01, seed=seed)


def twin_room(x_m: float) -> Recording:
    """Return scans of one of two identical rooms, and of the corridor outside, which ends at another side of each."""
    walls = [polyline((0, 2), (0, 0), (10, 0), (10, 2))]
    for a in (0.0, 5.0):
        walls += [polyline((a, 2), (a + 2, 2)), polyline((a + 3, 2), (a + 5, 2)), box(a + 3.8, 5, 0.8, 0.6)]
        walls += [polyline((a, 2), (a, 6), (a + 5, 6), (a + 5, 2))]
    path = [(2.5, 1.0), (2.5, 3.5), (1.2, 4.6), (2.6, 4.8), (2.5, 1.2), (3.5, 1.0), (1.2, 0.9)]
    track = along([(x + x_m, y) for x, y in path], speed_m_s=0.8, period_s=0.5)
    return record(np.vstack(walls), track, WIDE, seed=int(x_m))


def session(name: str, recording: Recording) -> Session:
    """Return a session with the true poses, in the frame of its first scan."""
    return make_session(name, lambda: recording.scans, recording.map_T_laser, Config())


def cut(recording: Recording, parts: int) -> list[Recording]:
    """Cut a recording into parts of about as many scans."""
    path = recording.world_T_laser
    edges = np.linspace(0, len(path), parts + 1).astype(int).tolist()
    return [
        Recording(recording.scans[a:b], Trajectory(path.stamps_ns[a:b], path.xyyaw[a:b])) for a, b in pairwise(edges)
    ]


def written(recording: Recording, path: Path) -> Path:
    """Write the scans of a recording as a log."""
    spec = recording.scans[0].spec
    about = {"angle_min": spec.angle_min_rad, "angle_increment": spec.angle_step_rad, "range_max": spec.range_max_m}
    scans = (Message("/scan", LASER, s.stamp_ns, about | {"ranges": s.ranges_m}) for s in recording.scans)
    return write_mcap(path, list(scans))


def errors_m(poses: Trajectory, recording: Recording, world_T_map: Pose) -> float:
    """Return the largest position error of a trajectory, m."""
    off_m = poses.seen_from(world_T_map).xyyaw[:, :2] - recording.world_T_laser.xyyaw[:, :2]
    return float(np.hypot(*off_m.T).max())
