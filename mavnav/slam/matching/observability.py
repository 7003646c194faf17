"""How well the walls constrain poses: degenerate geometry without odometry, and covariances (docs/method.md).

Along a plain corridor, before a single wall and in a round room a shifted or turned pose fits a scan equally well.
Cost, inliers and map metrics do not show it (Zhang, Kaess and Singh 2016, "On degeneracy of optimization-based state
estimation problems"). The covariance of a matched pose follows from the Hessian of the matching at its solution.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mavnav.scan import runs_of
from mavnav.slam.matching.steps import LOST_SCANS, Steps
from mavnav.units import MM, NS

LEAST_OBSERVABILITY = 0.01
"""Minimum ``kernels.scans.observability`` of a constrained scan.

It is at least 0.033 on the recordings, and at most 0.002 in plain corridors, before a wall and in round rooms.
"""

UNMEASURED = 1.0
"""Observability that stands for a scan without a pose."""


def degeneracy_warning(steps: Steps, observed: NDArray[np.float64], meaning: Callable[[NDArray[np.int64]], str]) -> str:
    """Return a warning if ``LOST_SCANS`` or more successive scans are degenerate, else an empty string.

    ``observed`` (n,) is the observability of the steps. ``meaning`` says what follows for the stamps of the degenerate
    ones.
    """
    runs = runs_of(observed < LEAST_OBSERVABILITY, LOST_SCANS)
    if not runs:
        return ""
    from_s, to_s = ((steps[runs[0][k]].stamp_ns - steps[0].stamp_ns) * NS for k in (0, -1))
    share = 100.0 * sum(map(len, runs)) / len(steps)
    when = f"from {from_s:.1f} to {to_s:.1f} s" + (f", and {len(runs) - 1} more" if len(runs) > 1 else "")
    stamps_ns = np.array([steps[k].stamp_ns for run in runs for k in run], np.int64)
    return f"degenerate geometry in {share:.0f} % of the scans ({when}): {meaning(stamps_ns)}"


LEAST_SIGMA_M = 1 * MM
"""Lower bound of the standard deviation of points from their walls."""

SINGULAR = 1e-9
"""Ratio of the least to the largest eigenvalue of a Hessian below which a direction is not observable."""

_ROWS, _COLS = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)


def symmetric(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the symmetric matrices (..., 3, 3) of their values xx, xy, yy, x yaw, y yaw, yaw yaw, (..., 6)."""
    full = np.empty((*values.shape[:-1], 3, 3))
    full[..., _ROWS, _COLS] = full[..., _COLS, _ROWS] = values
    return full


def covariances_of(steps: Steps, hessians: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the covariances of the poses of steps in the map frame, (n, 6): xx, xy, yy, x yaw, y yaw, yaw yaw; m, rad.

    They are those of least squares: the mean squared distance of the points from their lines times the inverse Hessian.
    ``hessians`` (m, 6) are those of the first m steps. NaN without a Hessian, or if a direction is not observable.
    Points are taken as independent and the map as exact, so this is a lower bound.
    """
    out, n = np.full((len(steps), 6), np.nan), len(hessians)
    full = symmetric(hessians)
    eigenvalues = np.linalg.eigvalsh(full)
    known = eigenvalues[:, 0] > SINGULAR * np.maximum(eigenvalues[:, 2], 1e-300)
    variance_m2 = np.maximum(steps.column("cost_m2")[:n][known], LEAST_SIGMA_M**2)
    out[:n][known] = variance_m2[:, None] * np.linalg.inv(full[known])[:, _ROWS, _COLS]
    return out


def rotate_covariances(covariances: NDArray[np.float64], yaw_rad: float) -> NDArray[np.float64]:
    """Return covariances (n, 6), in the order of `covariances_of`, seen in a frame that is turned back by an angle."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])
    return np.asarray((turn @ symmetric(covariances) @ turn.T)[:, _ROWS, _COLS])
