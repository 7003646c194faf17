"""The path in the pose graph: tight where walls show the motion, loose where the tracker may have slipped.

Along plain walls a scan fits as well a little farther on. A track can stand still there while the laser moves, and jump
where it meets walls that it has mapped before. Such motion differs from the motion before and after it.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mavnav.pose import motions
from mavnav.slam.findings import Edge
from mavnav.slam.matching.relocalization import ACCELERATION_M_S2, SLACK_M
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from mavnav.pose import Pose, Trajectory
    from mavnav.slam.loop_closure.key_frames import KeyFrame

    Floats = NDArray[np.float64]
    InformationOf = Callable[[Floats, Pose], Floats]
    """Points (n, 2), laser frame, m, and their pose -> what the map shows of it, (6,) (`Refiner.observability`)."""

PATH_SIGMA_M, PATH_SIGMA_RAD = 0.01, 0.2 * DEG
"""Standard deviations of the motion from key frame to key frame where the walls show it."""

USUAL_S = 5.0
"""The usual velocity is the median of this long before and after."""

WEAK, OBSERVABLE = 0.02, 0.04
"""Information, in shares of a point, up to which a translation is not measured, and from which it is in full."""


class Weakest(NamedTuple):
    """The translation that a scan shows least: information, a share of a point, and direction (2,), map frame."""

    information: float
    direction: Floats


def path_edges(map_T_laser: Trajectory, keys: Sequence[KeyFrame], information_of: InformationOf) -> list[Edge]:
    """Return the motion from key frame to key frame as tracked, as edges of the pose graph."""
    rows, speeds = np.array([key.row for key in keys]), velocities(map_T_laser)
    stamps_ns = map_T_laser.stamps_ns
    weakest = [weakest_translation(information_of(k.points, k.map_T_laser), len(k.points)) for k in keys]
    path = [a.map_T_laser.between(b.map_T_laser) for a, b in pairwise(keys)]
    moved_m, elapsed_s = np.array([motion[:2] for motion in path]), np.diff(stamps_ns[rows]) * NS
    edges = []
    for k, motion in enumerate(path):
        near = [j for j in (k - 1, k + 1) if 0 <= j < len(path)]
        usual = usual_velocity(speeds, stamps_ns, stamps_ns[rows[k : k + 2]])
        expected = [usual, *(moved_m[j] / elapsed_s[j] for j in near)]
        unusual_m = moved_m[k] - np.array(expected) * elapsed_s[k]
        weak = min(weakest[k : k + 2], key=lambda each: each.information)
        edges.append(
            Edge(k, k + 1, motion, sqrt_information(unusual_m, float(elapsed_s[k]), weak, keys[k].map_T_laser))
        )
    return edges


def velocities(map_T_laser: Trajectory) -> Floats:
    """Return the velocity from each pose to the next, (n - 1, 2), m/s, in the frame of the laser."""
    rows = np.arange(len(map_T_laser))
    steps = motions(map_T_laser.xyyaw, rows[:-1], rows[1:])[:, :2]
    speeds: Floats = steps / (np.diff(map_T_laser.stamps_ns) * NS)[:, None]
    return speeds


def usual_velocity(speeds: Floats, stamps_ns: NDArray[np.int64], around_ns: NDArray[np.int64]) -> Floats:
    """Return the median velocity (2,) about two stamps, m/s."""
    first, last = np.searchsorted(stamps_ns, around_ns + np.array((-USUAL_S, USUAL_S)) / NS)
    middle: Floats = np.median(speeds[first:last], axis=0)
    return middle


def weakest_translation(information: Floats, points: int) -> Weakest:
    """Return the translation about which the information (6,) of so many points is least, whatever the rotation."""
    xx, xy, yy, xr, yr, rr = information / max(points, 1)
    turning = np.array((xr, yr))
    values, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]) - np.outer(turning, turning) / max(rr, 1e-9))
    return Weakest(max(float(values[0]), 0.0), vectors[:, 0])


def sqrt_information(unusual_m: Floats, elapsed_s: float, weak: Weakest, map_T_a: Pose) -> Floats:
    """Return the root (3, 3) of the information of a motion in the frame of its start ``a``; 1/m, 1/m and 1/rad.

    ``unusual_m`` (n, 2) is by how much the motion differs from the usual one, and from those before and after. A jump
    that no acceleration explains is loose in both directions, other motion in the weakest one if it is not observable.
    """
    jump_m = float(np.hypot(*unusual_m.T).min())
    if jump_m > SLACK_M + 0.5 * ACCELERATION_M_S2 * elapsed_s**2:
        return np.diag((1.0 / (PATH_SIGMA_M + jump_m), 1.0 / (PATH_SIGMA_M + jump_m), 1.0 / PATH_SIGMA_RAD))
    c, s = np.cos(map_T_a.yaw_rad), np.sin(map_T_a.yaw_rad)
    along = np.array(((c, s), (-s, c))) @ weak.direction
    unobserved = float(np.clip((OBSERVABLE - weak.information) / (OBSERVABLE - WEAK), 0.0, 1.0))
    loose_m = PATH_SIGMA_M + unobserved * abs(float(along @ unusual_m[0]))
    root = np.diag((0.0, 0.0, 1.0 / PATH_SIGMA_RAD))
    root[0, :2], root[1, :2] = along / loose_m, np.array((-along[1], along[0])) / PATH_SIGMA_M
    return root
