"""The parameters that fit laser and odometry best, by generalized least squares, and how far they may be wrong.

Noise of the odometry in its own derivatives would bias the result (errors in variables). So a derivative with respect
to the offset is taken over a whole step, and the others where odometry and laser together expect the base: the
conditional score of Stefanski and Carroll, *Conditional scores and optimal scores for generalized linear
measurement-error models*, Biometrika 1987. Uncertainties are those of a jackknife over parts of the log, with
Student's t for the number of parts that constrain a parameter.

The iteration begins at time offset and mounting by linear least squares, with either side of the laser up.
"""

from __future__ import annotations

from itertools import count, pairwise
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from scipy.special import stdtrit

from mavnav.metrics.calibration import motion
from mavnav.metrics.calibration.motion import OFFSET, YAW, Array, Motions, Noise, NoiseModel, PlaneSteps
from mavnav.units import DEG

ROUNDS, LIKELIEST, CLOSE = 20, (0, 2, 5), 1e-5
"""Rounds at most; those in which the noise is estimated anew; changes below this end them."""

PARTS, STEPS_A_PART, LEAST_STEPS = 20, 5, 20
"""Parts of the log for the jackknife, steps that each has at least, and steps that a calibration needs."""

PRIOR: Final = np.array((1.0, 1.0, 3.0, 0.5, 0.3, 0.3, 10 * DEG))
"""Standard deviations about a laser on the base's origin and good odometry: they only keep the unknown finite."""

LOW: Final = np.array((-100.0, -100.0, -np.inf, -motion.LONGEST_OFFSET_S, 1 / 3, 1 / 3, -1.0))
HIGH: Final = np.array((100.0, 100.0, np.inf, motion.LONGEST_OFFSET_S, 3.0, 3.0, 1.0))
"""No parameter is searched beyond."""

FLOOR: Final = np.array((1e-3, 1e-3, 0.05 * DEG, 1e-3, 2.5e-3, 5e-4, 0.01 * DEG))
"""Standard deviations of what is wrong with all steps alike: of the track, measured with odometry without noise; and of
the distances, as wheels that slip turn too far."""

OFFSETS_S: Final = np.linspace(-motion.LONGEST_OFFSET_S, motion.LONGEST_OFFSET_S, 121)

ANOTHER_S: Final = 0.25
"""Offsets farther apart are different ones."""

LEAST: Final = 1e-6
"""No mean squared error counts as less, m2 or rad2."""


class FirstEstimate(NamedTuple):
    """The first estimate: parameters (7,), whether the laser is mirrored, correlation of the turns, -1 to 1.

    ``cost`` is twice the negative log-likelihood, up to a constant; ``distinct`` by how much other offsets have more.
    """

    parameters: Array
    mirrored: bool
    correlation: float
    cost: float
    distinct: float = 0.0

    @property
    def offset_s(self) -> float:
        """Time to add to the stamps of the odometry."""
        return float(self.parameters[OFFSET])


class Estimate(Struct, frozen=True):
    """Parameters (7,) in the order of `NAMES` and the half-widths (7,) of their 95 % intervals.

    ``mirrored``: the scans are mirrored; ``correlation`` is that of the turns of laser and odometry. ``parts`` (7,) are
    the numbers of parts of the log that constrain each. ``errors`` (n, 3) are those of the steps at ``seconds``
    (n,), m, m, rad.
    """

    values: Array
    ci95: Array
    parts: Array
    mirrored: bool
    correlation: float
    seconds: Array
    errors: Array


class _Equations(Struct, frozen=True):
    """What each step (n) adds to the normal equations, whitened: derivatives (3, n, 7), and the score (n, 7)."""

    derivatives: Array
    score: Array

    def normal(self, steps: slice = slice(None)) -> Array:
        rows = self.derivatives[:, steps].reshape(-1, self.derivatives.shape[2])
        return rows.T @ rows


def start_of(motions: Motions, *, turning: bool) -> FirstEstimate:
    """Return the offset and the side up that fit best; without turning they fit alike: it is as the log says."""
    sides = {False: motions, True: motions.mirror()} if turning else {False: motions}
    starts = [_start_at_offset(each, float(s), mirrored=side) for side, each in sides.items() for s in OFFSETS_S]
    best = min(starts, key=lambda start: start.cost)
    others = [start.cost for start in starts if abs(start.offset_s - best.offset_s) > ANOTHER_S]
    return best._replace(distinct=min(others) - best.cost)


def _start_at_offset(motions: Motions, offset_s: float, *, mirrored: bool) -> FirstEstimate:
    """Solve for an offset: a step of the laser is linear in scale and yaw together, and in lever arm and yaw."""
    laser, base = motions.laser_steps(), PlaneSteps.between(*motions.base(offset_s))
    linked = motions.linked
    turned, by_odometry = laser.turned[linked], base.turned[linked]
    turn_scale = max(float(turned @ by_odometry), 0.0) / float(by_odometry @ by_odometry + LEAST)
    lever = 2j * np.sin(0.5 * turn_scale * base.turned)  # how a point beside the base moves, seen from the mean heading
    columns = np.column_stack((base.moved, lever))[linked]
    moved = laser.moved[linked]
    normal = columns.conj().T @ columns + LEAST * np.eye(2)
    along, arm = np.linalg.solve(normal, columns.conj().T @ moved)
    plane_m2 = np.square(np.abs(moved - columns @ (along, arm))).mean() + LEAST
    turns_rad2 = np.square(turned - turn_scale * by_odometry).mean() + LEAST
    yaw_rad = -float(np.angle(along))
    at = arm * np.exp(1j * yaw_rad)
    parameters = np.array((at.real, at.imag, yaw_rad, offset_s, abs(along), turn_scale, 0.0))
    cost = len(moved) * float(2.0 * np.log(plane_m2) + np.log(turns_rad2))
    return FirstEstimate(parameters, mirrored, _correlation(turned, by_odometry), cost)


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation of two series, 0 where one does not change."""
    size = float(np.sqrt(np.square(a).sum() * np.square(b).sum()))
    return float((a * b).sum()) / size if size > 0.0 else 0.0


def estimate(motions: Motions, start: FirstEstimate) -> Estimate:
    """Estimate all parameters from the first ones on; the motions have half of `LEAST_STEPS` or more."""
    motions = motions.mirror() if start.mirrored else motions
    values, equations = _solve(motions, np.clip(start.parameters, LOW, HIGH))
    ci95, parts = _uncertainty(equations)
    linked, seconds = motions.linked, motions.laser_s[1:]
    errors = _errors(motions, values)[linked]
    return Estimate(values, ci95, parts, start.mirrored, start.correlation, seconds[linked], errors)


def _solve(motions: Motions, values: Array) -> tuple[Array, _Equations]:
    """Iterate from first values (7,) to the best; the noise and the steps out of all proportion follow from the fit."""
    models, added = _models(motions), np.zeros((3, len(motions.linked)))
    centre = np.array((0.0, 0.0, values[YAW], 0.0, 1.0, 1.0, 0.0))  # any yaw of the laser is as likely as another
    noises: list[Noise] = []
    for k in count():
        errors = _errors(motions, values)
        if k in LIKELIEST:
            noises = [model.fit(e, a) for model, e, a in zip(models, errors.T, added, strict=True)]
        clipped = [noise.inflate_outliers(e) for noise, e in zip(noises, errors.T, strict=True)]
        added = np.array([c.diagonal - noise.diagonal for c, noise in zip(clipped, noises, strict=True)])
        equations = _equations(motions, values, errors, clipped)
        score = equations.score.sum(axis=0) + (values - centre) / PRIOR**2
        change = np.linalg.solve(equations.normal() + np.diag(PRIOR**-2), score)
        values = np.clip(values - change, LOW, HIGH)
        if k == ROUNDS or (k > max(LIKELIEST) and np.abs(change).max() < CLOSE):
            break
    return values, equations


def _models(motions: Motions) -> list[NoiseModel]:
    """Return what the noise depends on, for x, y and yaw in the laser's frame."""
    laser, elapsed_s = motions.laser_steps(), np.diff(motions.laser_s)
    sizes = np.column_stack((np.abs(laser.moved), np.abs(laser.turned)))
    steps = (laser.moved.real, laser.moved.imag, laser.turned)
    return [NoiseModel(_at_poses(step / elapsed_s), sizes, motions.linked) for step in steps]


def _at_poses(speeds: Array) -> Array:
    """Return speeds at poses (n + 1,) by those of the steps (n,) beside them."""
    padded = np.concatenate((speeds[:1], speeds, speeds[-1:]))
    return 0.5 * (padded[:-1] + padded[1:])


def _errors(motions: Motions, values: Array) -> Array:
    """Return predicted less measured steps (n, 3), m, m, rad in the laser's frame; 0 across gaps."""
    ahead, laser = motions.predicted_steps(values), motions.laser_steps()
    plane = ahead.moved - laser.moved
    errors = np.column_stack((plane.real, plane.imag, ahead.turned - laser.turned))
    return np.where(motions.linked[:, None], errors, 0.0)


def _equations(motions: Motions, values: Array, errors: Array, noises: list[Noise]) -> _Equations:
    of_odometry = [noise.of_odometry(error) for noise, error in zip(noises, errors.T, strict=True)]
    derivatives = _derivatives(motions, values, np.column_stack(of_odometry))
    rows = np.array([noise.whiten(derivatives[:, c]) for c, noise in enumerate(noises)])
    left = np.array([noise.whiten(errors[:, c]) for c, noise in enumerate(noises)])
    return _Equations(rows, np.einsum("cni,cn->ni", rows, left))


def _derivatives(motions: Motions, values: Array, of_odometry: Array) -> Array:
    """Return the derivatives of the errors, (n, 3, 7), for odometry without its expected errors (n, 3), m, m, rad."""
    x_m, y_m, yaw_rad, _, distance_scale, turn_scale, veer_rad_m = values.tolist()
    ahead, arm, view = motions.predicted_steps(values), complex(x_m, y_m), np.exp(-1j * yaw_rad)
    moved = ahead.moved - of_odometry[:, 0] - 1j * of_odometry[:, 1]
    turned = ahead.turned - of_odometry[:, 2]
    lever, by_turn = 2j * np.sin(0.5 * turned), 1j * np.cos(0.5 * turned) * arm
    driven = (moved / view - lever * arm) / distance_scale
    turns = np.column_stack(((turned - veer_rad_m * driven.real) / turn_scale, driven.real))
    plane = (
        np.column_stack((lever, 1j * lever, -1j * moved / view, 0.0 * lever, driven, by_turn[:, None] * turns)) * view
    )
    yaw = np.column_stack((np.zeros((len(turned), 5)), turns))
    derivatives = np.stack((plane.real, plane.imag, yaw), axis=1)
    shift = np.zeros(len(values))
    shift[OFFSET] = np.median(np.diff(motions.laser_s))
    later, earlier = (_errors(motions, values + by) for by in (shift, -shift))
    derivatives[:, :, OFFSET] = (later - earlier) / (2.0 * shift[OFFSET])
    return np.where(motions.linked[:, None, None], derivatives, 0.0)


def _uncertainty(equations: _Equations) -> tuple[Array, Array]:
    """Return half-widths of the 95 % intervals (7,) and how many parts of the log constrain each (7,)."""
    steps = len(equations.score)
    number = min(PARTS, steps // STEPS_A_PART)
    edges = np.linspace(0, steps, number + 1).astype(int).tolist()
    parts = [slice(a, b) for a, b in pairwise(edges)]
    whole = equations.normal() + np.diag(PRIOR**-2)
    normals = [equations.normal(part) for part in parts]
    without = [
        np.linalg.solve(whole - normal, equations.score[part].sum(axis=0))
        for normal, part in zip(normals, parts, strict=True)
    ]
    spread = np.square(without - np.mean(without, axis=0)).sum(axis=0) * (number - 1) / number
    covariance = np.linalg.inv(whole)
    shares = np.array([np.einsum("ij,jk,ki->i", covariance, normal, covariance) for normal in normals])
    constraining = np.square(shares.sum(axis=0)) / np.maximum(np.square(shares).sum(axis=0), 1e-300)
    deviation = np.sqrt(np.maximum(spread, covariance.diagonal()) + FLOOR**2)
    return stdtrit(np.maximum(constraining - 1.0, 1.0), 0.975) * deviation, constraining
