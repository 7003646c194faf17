"""The noise of steps between poses: each pose has an error of its own, and each step a slip of the wheels.

The error of a pose enters the steps before and behind it with opposite signs, so the covariance is tridiagonal. It has
a constant part and one that grows with the speed, as of stamps that jitter. Slips grow with the distance and with the
turn, each by a factor of its own (Thrun, Burgard, Fox, *Probabilistic Robotics*, 2005, section 5.4).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from scipy.linalg.lapack import dgbsv, dpbtrf  # scipy's own functions check for longer than LAPACK solves
from scipy.optimize import minimize

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

LEAST: Final = 1e-10
"""Minimum variance of a step, m2 or rad2."""

APART: Final = 1e6
"""Variance of a step across a gap, m2 or rad2: so large that the step has no weight."""

CLIP: Final = 2.5
"""A step that is wrong by more of its standard deviations counts as if it were wrong by so many."""

START: Final = np.log((0.2, 0.2, 0.3, 0.3))
"""Shares of poses, stamps, and slips by distance and by turn in the variance of the steps: where the search begins."""

SEARCH: Final = {
    "maxfev": 300,
    "xatol": 0.03,
    "fatol": 0.03,
    "initial_simplex": START + np.vstack((np.zeros(len(START)), -3.0 * np.eye(len(START)))),
}
"""Twice the logarithm of the likelihood changes by less than ``fatol`` at the end."""


class Noise(Struct, frozen=True):
    """Covariance of the errors of steps (n,) of one coordinate: ``diagonal`` (n,), ``between`` neighbours (n - 1,).

    ``slips`` (n,) are the part of the diagonal that the odometry has.
    """

    diagonal: Array
    between: Array
    slips: Array

    def whiten(self, errors: Array) -> Array:
        """Return errors (n,) or (n, k) as multiples of independent standard deviations."""
        return _forward(_factor(self.diagonal, self.between), errors)

    def unlikeliness(self, errors: Array) -> float:
        """Return twice the negative log-likelihood of errors (n,), up to a constant."""
        factor = _factor(self.diagonal, self.between)
        return float(2.0 * np.log(factor[0]).sum() + np.square(_forward(factor, errors)).sum())

    def alone(self) -> Array:
        """Return the variance of each error if all others are known, (n,)."""
        ahead: Array = np.square(_factor(self.diagonal, self.between)[0])
        behind: Array = np.square(_factor(self.diagonal[::-1], self.between[::-1])[0])[::-1]
        return ahead + behind - self.diagonal

    def unforeseen(self, errors: Array) -> Array:
        """Return how far each error (n,) is from what the others make expect."""
        factor = _factor(self.diagonal, self.between)
        upper = np.vstack((np.append(0.0, factor[1, :-1]), factor[0]))
        weighted: Array = dgbsv(0, 1, upper, _forward(factor, errors))[2]
        return weighted * self.alone()

    def of_odometry(self, errors: Array) -> Array:
        """Return the part of each error (n,) that is expected to be the odometry's."""
        return self.slips * self.unforeseen(errors) / self.alone()

    def inflate_outliers(self, errors: Array) -> Noise:
        """Return the covariance in which steps with errors (n,) out of all proportion are as uncertain as that.

        Such errors are taken for slips.
        """
        noise = self
        for _ in range(3):  # a large error first hides what is expected of its neighbours
            added = noise.diagonal - self.diagonal
            more = np.maximum(np.square(noise.unforeseen(errors) / CLIP) - (noise.alone() - added), 0.0)
            noise = Noise(self.diagonal + more, self.between, self.slips + more)
        return noise


def _factor(diagonal: Array, between: Array) -> Array:
    """Return the Cholesky factor of a covariance, (2, n): its diagonal, and what is below."""
    factor, wrong = dpbtrf(np.vstack((diagonal, np.append(between, 0.0))), lower=1)
    if wrong:
        raise np.linalg.LinAlgError("not the covariance of steps")
    return factor  # type: ignore[no-any-return]


def _forward(factor: Array, errors: Array) -> Array:
    """Solve for the errors (n,) or (n, k) that a factor (2, n) gives."""
    solved: Array = dgbsv(1, 0, np.vstack((np.zeros(factor.shape[1]), factor)), errors)[2]
    return solved


class NoiseModel(Struct, frozen=True):
    """What the noise depends on: ``speeds`` (n + 1,) at the poses, in m/s or rad/s, and what steps (n) are.

    ``motions`` (n, 2) are their distances, m, and turns, rad, none negative; ``linked`` (n,) is false across gaps.
    """

    speeds: Array
    motions: Array
    linked: NDArray[np.bool_]

    def noise(self, variances: Array, added: Array | float = 0.0) -> Noise:
        """Return the covariance by the variances (4,) of poses, stamps and slips; some steps have ``added`` more."""
        pose, stamp, *slip = variances
        slips = self.motions @ slip
        of_pose = pose + stamp * np.square(self.speeds)
        diagonal = of_pose[:-1] + of_pose[1:] + slips + LEAST + added
        between = np.where(self.linked[:-1] & self.linked[1:], -of_pose[1:-1], 0.0)
        return Noise(np.where(self.linked, diagonal, APART), between, slips)

    def fit(self, errors: Array, added: Array) -> Noise:
        """Return the likeliest covariance for errors (n,), 0 across gaps; some steps have ``added`` (n,) variance."""
        total = float(np.square(errors[self.linked]).mean()) + LEAST
        shares = 1.0, np.square(self.speeds).mean() + LEAST, *(self.motions[self.linked].mean(axis=0) + LEAST)

        def variances(logs: Array) -> Array:
            scaled: Array = total * np.exp(np.clip(logs, -14.0, 4.0)) / np.array(shares)
            return scaled

        def unlikeliness(logs: Array) -> float:
            return self.noise(variances(logs), added).unlikeliness(errors)

        return self.noise(variances(minimize(unlikeliness, START, method="Nelder-Mead", options=SEARCH).x))
