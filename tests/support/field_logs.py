"""Logs as robots in the field record them: beams cast one by one while the laser moves, and all that drivers do wrong.

``drive_log`` returns messages of `log_files`, of which a test changes what drivers, clocks or recorders do.
"""

from __future__ import annotations

from itertools import pairwise
from math import tau

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavnav.pose import Pose, Trajectory
from support.log_files import LASER, ODOM, Message
from support.synthetic import TOUR, Segments, along, furnished_rooms

PERIOD_S = 0.1
START_S = 1_700_000_000


def cast_moving(
    segments: Segments, xyyaw: NDArray[np.float64], bearings_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distance to the nearest wall of each beam (n,), m, each from its own pose (n, 3); inf without one."""
    dx, dy = (f(bearings_rad + xyyaw[:, 2])[:, None] for f in (np.cos, np.sin))
    ax, ay = segments[:, 0] - xyyaw[:, :1], segments[:, 1] - xyyaw[:, 1:2]
    ex, ey = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    denominator = dx * ey - dy * ex
    with np.errstate(divide="ignore", invalid="ignore"):
        r, u = (ax * ey - ay * ex) / denominator, (ax * dy - ay * dx) / denominator
    hit = (denominator != 0) & (r > 0) & (u >= 0) & (u <= 1)
    return np.asarray(np.where(hit, r, np.inf).min(axis=1))


def poses_at(path: Trajectory, stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the poses (n, 3) of a path, m, m, rad, at stamps within it."""
    columns = (path.xyyaw[:, 0], path.xyyaw[:, 1], np.unwrap(path.xyyaw[:, 2]))
    return np.column_stack([np.interp(stamps_ns, path.stamps_ns, column) for column in columns])


def tour(seconds: float, speed_m_s: float = 0.5, turn_rad_s: float = 1.0) -> Trajectory:
    """Return the beginning of a tour of the furnished rooms, with a pose every 20 ms."""
    path = along(TOUR, 0.02, speed_m_s, turn_rad_s, START_S * 10**9)
    most = int(seconds / 0.02) + 2
    return Trajectory(path.stamps_ns[:most], path.xyyaw[:most])


def drive_log(
    seconds: float = 10.0,
    *,
    beams: int = 240,
    period_s: float = PERIOD_S,
    time_increment_s: float | None = None,
    sweep_s: float | None = None,
    odometry: bool = False,
    noise_m: float = 0.01,
    walls: Segments | None = None,
    path: Trajectory | None = None,
    range_max_m: float = 12.0,
) -> list[Message]:
    """Return scans of a full turn, cast in ``sweep_s`` (by default a period), and good odometry every 50 ms.

    The messages state ``time_increment_s``, by default the true one. The odometry is that of the laser, at its origin.
    """
    rng, walls = np.random.default_rng(0), furnished_rooms() if walls is None else walls
    path = tour(seconds) if path is None else path
    true_s = (period_s if sweep_s is None else sweep_s) / beams
    step = tau / beams
    messages = []
    for k in range(int((path.stamps_ns[-1] - path.stamps_ns[0]) * 1e-9 / period_s) - 1):
        stamp_ns = int(path.stamps_ns[0]) + round(k * period_s * 1e9)
        at = poses_at(path, stamp_ns + np.round(true_s * 1e9 * np.arange(beams)).astype(np.int64))
        ranges_m = cast_moving(walls, at, -np.pi + step * np.arange(beams)) + noise_m * rng.standard_normal(beams)
        fields = {
            "angle_min": -np.pi,
            "angle_increment": step,
            "ranges": np.where(ranges_m > range_max_m, np.inf, ranges_m),
            "time_increment": true_s if time_increment_s is None else time_increment_s,
            "scan_time": period_s,
            "range_max": range_max_m,
        }
        messages.append(Message("/scan", LASER, stamp_ns, fields))
    return [*messages, *(wheels(path) if odometry else [])]


def wheels(path: Trajectory, topic: str = "/odom", child: str = "laser") -> list[Message]:
    """Return odometry messages of a path, every 50 ms, in the frame of its first pose."""
    messages = []
    for stamp_ns in range(int(path.stamps_ns[0]), int(path.stamps_ns[-1]), 50_000_000):
        x_m, y_m, yaw_rad = path[0].between(Pose(*poses_at(path, np.array([stamp_ns]))[0]))
        messages.append(Message(topic, ODOM, stamp_ns, {"x": x_m, "y": y_m, "yaw": yaw_rad, "child": child}))
    return messages


def with_fields(messages: list[Message], **fields: object) -> list[Message]:
    """Return the messages with other fields in the scans."""
    return [replace(m, fields=m.fields | fields) if m.type == LASER else m for m in messages]


def segments(messages: list[Message], parts: int, overlap: int = 0) -> list[Message]:
    """Return every scan as parts of a turn, stamped at their first beams; of sweeps with one time increment.

    Each but the first begins with the last ``overlap`` beams of the one before.
    """
    cut = []
    for scan in messages:
        f = scan.fields
        edges = np.linspace(0, len(f["ranges"]), parts + 1).astype(int).tolist()
        for begin, b in pairwise(edges):
            a = max(begin - overlap, 0)
            fields = f | {
                "angle_min": f["angle_min"] + a * f["angle_increment"],
                "ranges": f["ranges"][a:b],
                "scan_time": f["scan_time"] / parts,
            }
            cut.append(replace(scan, stamp_ns=scan.stamp_ns + round(a * f["time_increment"] * 1e9), fields=fields))
    return cut
