"""A pose graph in the plane: its edges along the path, and the poses that fit all edges best (docs/method.md).

Each edge measures one pose from another. The path is tight where walls show the motion, loose where the tracker may
have slipped. Along plain walls a scan fits as well a little farther on. A track can stand still there while the laser
moves, and jump where it meets walls that it has mapped before. Such motion differs from the motion before and after it.

The sum of the squared errors, weighted by the information matrices of the edges and with a robust loss, is minimised by
damped Gauss-Newton steps on the sparse normal equations (Kuemmerle et al. 2011, "g2o: A general framework for graph
optimization"; Levenberg-Marquardt damping; Huber's loss).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavnav.pose import Pose, Trajectory, motions, wrap_angle
from mavnav.slam.findings import Edge
from mavnav.slam.loop_closure.key_frames import KeyFrame
from mavnav.slam.matching.relocalization import ACCELERATION_M_S2, SLACK_M
from mavnav.units import DEG, NS

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Floats = NDArray[np.float64]
InformationOf = Callable[[Floats, Pose], Floats]
"""Points (n, 2), laser frame, m, and their pose -> what the map shows of it, (6,) (`Refiner.observability`)."""

OUTLIER_SIGMAS = 3.0
"""Error above which the loss is linear instead of quadratic, so that one wrong edge cannot distort the rest."""

MAX_ITERATIONS = 50
SMALL_STEP = 1e-6  # m, rad


def root_information(sigma_m: float, sigma_rad: float) -> Floats:
    """Return the square root (3, 3) of the information matrix of a pose with these standard deviations."""
    return np.diag(1.0 / np.array((sigma_m, sigma_m, sigma_rad)))


def optimize(poses: Sequence[Pose], edges: Sequence[Edge]) -> list[Pose]:
    """Return the poses that fit the edges best; the first pose does not change.

    ``poses`` are the start of the iteration, in any common frame; edges must connect all of them to the first.
    """
    graph = _EdgeErrors(edges, len(poses))
    here = np.array([(p.x_m, p.y_m, p.yaw_rad) for p in poses])
    cost, damping = graph.cost(here), 1e-6
    for _ in range(MAX_ITERATIONS):
        step = graph.step(here, damping)
        there = here + step
        there_cost = graph.cost(there)
        if not there_cost <= cost:  # also of a step that is not a number
            damping *= 10.0
        else:
            here, cost, damping = there, there_cost, max(0.1 * damping, 1e-9)
        if np.abs(step).max(initial=0.0) < SMALL_STEP:
            break
    return [poses[0], *(Pose(float(x), float(y), wrap_angle(float(yaw))) for x, y, yaw in here[1:])]


class _EdgeErrors:
    """The errors of all edges and their derivatives by the poses (n, 3), of which the first is fixed."""

    def __init__(self, edges: Sequence[Edge], n: int) -> None:
        self.start = np.array([e.start for e in edges], np.intp)
        self.end = np.array([e.end for e in edges], np.intp)
        self.measured = np.array([e.start_T_end.as_array() for e in edges]).reshape(-1, 3)
        self.weights = np.array([e.sqrt_information for e in edges]).reshape(-1, 3, 3)
        self.n = n

    def errors(self, poses: Floats) -> Floats:
        """Return the error of each edge, in standard deviations, (edges, 3)."""
        a, b = poses[self.start], poses[self.end]
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b - a)[:, :2].T
        error = np.column_stack((c * dx + s * dy, -s * dx + c * dy, b[:, 2] - a[:, 2])) - self.measured
        error[:, 2] = (error[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        return np.asarray((self.weights @ error[:, :, None])[:, :, 0])

    def cost(self, poses: Floats) -> float:
        """Return the sum of Huber's loss over the edges."""
        size = np.linalg.norm(self.errors(poses), axis=1)
        far = size > OUTLIER_SIGMAS
        return float(np.where(far, OUTLIER_SIGMAS * (2.0 * size - OUTLIER_SIGMAS), size**2).sum())

    def step(self, poses: Floats, damping: float) -> Floats:
        """Return the damped Gauss-Newton step at these poses, (n, 3); larger errors of outliers weigh less."""
        from scipy.sparse import diags  # noqa: PLC0415  takes 0.2 s to load, and few logs have a loop
        from scipy.sparse.linalg import spsolve  # noqa: PLC0415

        errors, jacobian = self.errors(poses), self.jacobian(poses)
        size = np.linalg.norm(errors, axis=1)
        outlier_weights = np.repeat(OUTLIER_SIGMAS / np.maximum(size, OUTLIER_SIGMAS), 3)
        weighted = jacobian.T @ diags(outlier_weights)
        normal = weighted @ jacobian
        damped = normal + damping * diags(normal.diagonal())
        step = spsolve(damped.tocsc(), -(weighted @ errors.ravel()))
        return np.concatenate((np.zeros(3), step)).reshape(-1, 3)

    def jacobian(self, poses: Floats) -> csr_matrix:
        """Return the derivatives of the errors by all poses but the first, (3 edges, 3 (n - 1))."""
        from scipy.sparse import csr_matrix  # noqa: PLC0415

        a, b = poses[self.start], poses[self.end]
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b - a)[:, :2].T
        zero, one = np.zeros(len(a)), np.ones(len(a))
        by_start = [[-c, -s, -s * dx + c * dy], [s, -c, -c * dx - s * dy], [zero, zero, -one]]
        by_end = [[c, s, zero], [-s, c, zero], [zero, zero, one]]
        values = self.weights[:, None] @ np.array([by_start, by_end]).transpose(3, 0, 1, 2)
        rows = 3 * np.arange(len(a))[:, None, None, None] + np.arange(3)[:, None]
        cols = 3 * (np.column_stack((self.start, self.end)) - 1)[:, :, None, None] + np.arange(3)
        rows, cols = np.broadcast_to(rows, values.shape), np.broadcast_to(cols, values.shape)
        free = cols >= 0
        return csr_matrix((values[free], (rows[free], cols[free])), shape=(3 * len(a), 3 * (self.n - 1)))


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
        root = sqrt_information(unusual_m, float(elapsed_s[k]), weak, keys[k].map_T_laser)
        edges.append(Edge(k, k + 1, motion, root))
    return edges


def velocities(map_T_laser: Trajectory) -> Floats:
    """Return the velocity from each pose to the next, (n - 1, 2), m/s, in the frame of the laser."""
    rows = np.arange(len(map_T_laser))
    steps = motions(map_T_laser.xyyaw, rows[:-1], rows[1:])[:, :2]
    return np.asarray(steps / (np.diff(map_T_laser.stamps_ns) * NS)[:, None])


def usual_velocity(speeds: Floats, stamps_ns: NDArray[np.int64], around_ns: NDArray[np.int64]) -> Floats:
    """Return the median velocity (2,) about two stamps, m/s."""
    first, last = np.searchsorted(stamps_ns, around_ns + np.array((-USUAL_S, USUAL_S)) / NS)
    ordered = np.sort(speeds[first:last], axis=0)  # np.median() takes seven times as long
    return np.asarray(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


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
        return root_information(PATH_SIGMA_M + jump_m, PATH_SIGMA_RAD)
    c, s = np.cos(map_T_a.yaw_rad), np.sin(map_T_a.yaw_rad)
    along = np.array(((c, s), (-s, c))) @ weak.direction
    unobserved = float(np.clip((OBSERVABLE - weak.information) / (OBSERVABLE - WEAK), 0.0, 1.0))
    loose_m = PATH_SIGMA_M + unobserved * abs(float(along @ unusual_m[0]))
    root = np.diag((0.0, 0.0, 1.0 / PATH_SIGMA_RAD))
    root[0, :2], root[1, :2] = along / loose_m, np.array((-along[1], along[0])) / PATH_SIGMA_M
    return root
