"""A pose graph in the plane: the poses that fit relative measurements between pairs of them best (docs/method.md).

Each edge measures one pose from another. The sum of the squared errors, weighted by the information matrices of the
edges and with a robust loss, is minimised by damped Gauss-Newton steps on the sparse normal equations (Kuemmerle et al.
2011, "g2o: A general framework for graph optimization"; Levenberg-Marquardt damping; Huber's loss).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mavnav.pose import Pose, wrap_angle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from scipy.sparse import csr_matrix

    from mavnav.slam.findings import Edge

OUTLIER_SIGMAS = 3.0
"""Error above which the loss is linear instead of quadratic, so that one wrong edge cannot distort the rest."""

MAX_ITERATIONS = 50
SMALL_STEP = 1e-6  # m, rad


def root_information(sigma_m: float, sigma_rad: float) -> NDArray[np.float64]:
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

    def errors(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the error of each edge, in standard deviations, (edges, 3)."""
        a, b = poses[self.start], poses[self.end]
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        dx, dy = (b - a)[:, :2].T
        error = np.column_stack((c * dx + s * dy, -s * dx + c * dy, b[:, 2] - a[:, 2])) - self.measured
        error[:, 2] = (error[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        scaled: NDArray[np.float64] = (self.weights @ error[:, :, None])[:, :, 0]
        return scaled

    def cost(self, poses: NDArray[np.float64]) -> float:
        """Return the sum of Huber's loss over the edges."""
        size = np.linalg.norm(self.errors(poses), axis=1)
        far = size > OUTLIER_SIGMAS
        return float(np.where(far, OUTLIER_SIGMAS * (2.0 * size - OUTLIER_SIGMAS), size**2).sum())

    def step(self, poses: NDArray[np.float64], damping: float) -> NDArray[np.float64]:
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

    def jacobian(self, poses: NDArray[np.float64]) -> csr_matrix:
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
