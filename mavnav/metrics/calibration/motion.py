"""How odometry predicts the motion of a laser: hand-eye calibration in the plane (Censi et al. 2013).

Seven parameters, in the order of `NAMES`: pose of the laser on the base (m, m, rad), time to add to the stamps of the
odometry (s), factors on its distances and on its turns, and how much a straight path turns (rad/m), as wheels of
unequal size make it.

The noise of the steps between poses: each pose has an error of its own, and each step a slip of the wheels. The error
of a pose enters the steps before and behind it with opposite signs, so the covariance is tridiagonal. It has a constant
part and one that grows with the speed, as of stamps that jitter. Slips grow with the distance and with the turn, each
by a factor of its own (Thrun, Burgard, Fox, *Probabilistic Robotics*, 2005, section 5.4).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.linalg.lapack import dgbsv, dpbtrf  # scipy's own functions check for longer than LAPACK solves
from scipy.optimize import minimize

from mavnav.pose import Trajectory
from mavnav.units import NS

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

NAMES: Final = ("x_m", "y_m", "yaw_rad", "offset_s", "distance_scale", "turn_scale", "veer_rad_m")

YAW, OFFSET, DISTANCE, TURN = range(2, 6)
"""Their numbers, as far as they are used one by one."""

STEP_S: Final = 0.3
"""Steps take at least so long: shorter ones are as small as the noise of the odometry."""

LONGEST_STEP_S: Final = 1.5
"""A longer gap of the scans or of the odometry parts two chains of steps."""

LONGEST_OFFSET_S: Final = 1.2
"""Offsets are searched up to this, either way: beyond the longest that a replay corrects."""


class Wheels(NamedTuple):
    """What corrects odometry: factors on distances and turns, and the turn of a straight path, rad/m."""

    distance_scale: float = 1.0
    turn_scale: float = 1.0
    veer_rad_m: float = 0.0


GOOD_WHEELS: Final = Wheels()


class PlaneSteps(Struct, frozen=True):
    """Steps between poses: ``moved`` (n,) in the plane, complex, m, seen from the mean heading; ``turned`` (n,) rad."""

    moved: Complex
    turned: Array

    @classmethod
    def between(cls, where: Complex, heading_rad: Array) -> PlaneSteps:
        """Return the steps from each of the poses (n + 1,) to the next; headings are not wrapped."""
        mean_rad = 0.5 * (heading_rad[:-1] + heading_rad[1:])
        return cls(np.diff(where) * np.exp(-1j * mean_rad), np.diff(heading_rad))

    def path(self, wheels: Wheels) -> tuple[Complex, Array]:
        """Return positions (n + 1,), complex, m, and headings (n + 1,), rad, that corrected steps lead to from 0."""
        turned = wheels.turn_scale * self.turned + wheels.veer_rad_m * self.moved.real
        heading_rad = np.concatenate(((0.0,), np.cumsum(turned)))
        moved = wheels.distance_scale * self.moved * np.exp(1j * (heading_rad[:-1] + 0.5 * turned))
        return np.concatenate(((0.0,), np.cumsum(moved))), heading_rad


class Motions(Struct, frozen=True):
    """The tracked poses of a laser and the odometry of its base.

    ``laser_s`` (n,), ``where`` (n,) complex, m, and ``heading_rad`` (n,), not wrapped, are the track of the laser;
    ``linked`` (n - 1,) is false for its steps across a gap. ``odom_s`` (m,) and ``odom`` (m - 1 steps) are the
    odometry. Times begin with the odometry.
    """

    laser_s: Array
    where: Complex
    heading_rad: Array
    linked: NDArray[np.bool_]
    odom_s: Array
    odom: PlaneSteps

    def mirror(self) -> Motions:
        """Return the same as seen by a laser that is turned over about its x axis."""
        return replace(self, where=self.where.conj(), heading_rad=-self.heading_rad)

    def halves(self) -> tuple[Motions, Motions]:
        """Return the motions of the first and of the second half of the track; both have the pose between them."""
        middle = len(self.linked) // 2
        first, second = (
            replace(
                self,
                laser_s=self.laser_s[begin : end + 1],
                where=self.where[begin : end + 1],
                heading_rad=self.heading_rad[begin : end + 1],
                linked=self.linked[begin:end],
            )
            for begin, end in ((0, middle), (middle, len(self.linked)))
        )
        return first, second

    def laser_steps(self) -> PlaneSteps:
        """Return the steps of the laser (n - 1)."""
        return PlaneSteps.between(self.where, self.heading_rad)

    def predicted_steps(self, parameters: Array) -> PlaneSteps:
        """Return the same as the odometry predicts them by the parameters (7,)."""
        x_m, y_m, yaw_rad, offset_s, *wheels = parameters.tolist()
        where, heading_rad = self.base(offset_s, Wheels(*wheels))
        return PlaneSteps.between(where + complex(x_m, y_m) * np.exp(1j * heading_rad), heading_rad + yaw_rad)

    def base(self, offset_s: float, wheels: Wheels = GOOD_WHEELS) -> tuple[Complex, Array]:
        """Return positions (n,), complex, m, and headings (n,), rad, of the base at the scans, by the odometry."""
        where, heading_rad = self.odom.path(wheels)
        at_s = self.laser_s - offset_s
        x, y, yaw = (np.interp(at_s, self.odom_s, track) for track in (where.real, where.imag, heading_rad))
        return x + 1j * y, yaw


def motions_of(map_T_laser: Trajectory, odom_T_base: Trajectory, sweep_s: float) -> Motions:
    """Return the motions of a tracked log, in steps of `STEP_S` or more; a pose is that at the middle of its sweep.

    Scans at which no odometry is known, at any offset up to the longest, are left out.
    """
    odom_s = (odom_T_base.stamps_ns - odom_T_base.stamps_ns[0]) * NS
    laser_s = (map_T_laser.stamps_ns - odom_T_base.stamps_ns[0]) * NS + 0.5 * sweep_s
    inside = (laser_s > LONGEST_OFFSET_S) & (laser_s < odom_s[-1] - LONGEST_OFFSET_S)
    laser_s, poses = laser_s[inside], map_T_laser.xyyaw[inside]
    period_s = float(np.median(np.diff(laser_s))) if len(laser_s) > 1 else STEP_S
    every = max(1, int(np.ceil(STEP_S / period_s - 0.1)))
    laser_s, poses = laser_s[::every], poses[::every]
    where, heading_rad = _plane(poses)
    longest_s = max(LONGEST_STEP_S, 2.0 * every * period_s)
    gaps = np.concatenate(((0,), np.cumsum(np.diff(odom_s) > longest_s)))
    stretch = gaps[np.clip(np.searchsorted(odom_s, laser_s), 0, len(gaps) - 1)]  # of the odometry, between its gaps
    linked = (np.diff(laser_s) <= longest_s) & (np.diff(stretch) == 0)
    return Motions(laser_s, where, heading_rad, linked, odom_s, PlaneSteps.between(*_plane(odom_T_base.xyyaw)))


def _plane(xyyaw: Array) -> tuple[Complex, Array]:
    return xyyaw[:, 0] + 1j * xyyaw[:, 1], np.unwrap(xyyaw[:, 2])


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
    return np.asarray(dgbsv(1, 0, np.vstack((np.zeros(factor.shape[1]), factor)), errors)[2])


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
            return np.asarray(total * np.exp(np.clip(logs, -14.0, 4.0)) / np.array(shares))

        def unlikeliness(logs: Array) -> float:
            return self.noise(variances(logs), added).unlikeliness(errors)

        return self.noise(variances(minimize(unlikeliness, START, method="Nelder-Mead", options=SEARCH).x))
