"""Where a calibration begins: time offset and mounting by linear least squares, with either side of the laser up."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from mavnav.metrics.calibration.motion import LONGEST_OFFSET_S, OFFSET, PlaneSteps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mavnav.metrics.calibration.motion import Motions

    Array = NDArray[np.float64]

OFFSETS_S: Final = np.linspace(-LONGEST_OFFSET_S, LONGEST_OFFSET_S, 101)

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
