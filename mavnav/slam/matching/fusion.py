"""Fusion of a match with the predicted motion, each weighed by its information (docs/method.md, "Local search").

Where walls leave a direction open, the least cost slides along them, by more than its Hessian shows: residuals on one
piece of wall have a common cause. The covariance of a match is the sandwich of Hessian and covariance of the gradient
(White 1980; of clusters: Liang and Zeger 1986). Its factor and the variances of predictions follow from what both
differ by: steps of expectation maximization over the scans, which change nothing where a scan shows nothing. Wheels
slip, so their errors have Student's t distribution (Lange, Little and Taylor 1989).
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavnav.mapping.line_map import LineMap
from mavnav.pose import Pose, wrap_angle
from mavnav.slam.matching.observability import LEAST_SIGMA_M, symmetric
from mavnav.units import DEG

Array = NDArray[np.float64]


RATE, FIRST_SCANS = 0.01, 10
"""Least weight of a scan in the running variances, and weight of their first values in scans: the n-th one that is
accepted weighs 1 / (n + ``FIRST_SCANS``)."""

MEMORY, MOST_EXCESS, IGNORED = 0.9, 10.0, 1e-9
"""Weight of the past in the running mean of excess, excess from which a prediction hardly weighs, and its weight then:
the wheels of a carried vehicle show nothing."""

APPARENT = 0.002
"""Share of its points by which a scan seems to show the direction that walls leave open, as the directions of lines
have noise: it is as large in plain corridors. A quarter to four times of it does as well."""

EYE = np.eye(3)
NONE = np.zeros((3, 3))
LEAST = np.array((LEAST_SIGMA_M**2, LEAST_SIGMA_M**2, 0.1))
"""Least variances and factor that are learnt."""


class Evidence(NamedTuple):
    """Quadratic cost of a match in x, y (m, map frame) and yaw (rad) about the laser.

    ``hessian`` (3, 3) is half the second derivative, ``pull`` (3,) half the negative gradient at the pose, ``spread``
    (3, 3) the covariance of the latter.
    """

    hessian: Array
    pull: Array
    spread: Array

    def regular(self) -> tuple[Array, Array]:
        """Return the Hessian and the spread (3, 3) with a floor that lets them be inverted."""
        hessian = self.hessian + 1e-6 * max(float(self.hessian.trace()), 1.0) * EYE
        return hessian, self.spread + LEAST_SIGMA_M**2 * hessian


def evidence_of(
    points: Array, map_T_laser: Pose, line_map: LineMap, truncate_m: float, apparent: float = 0.0
) -> Evidence:
    """Return what points (n, 2), m, laser frame, show about a pose near it, by distances across their lines alone.

    Points on unmapped area and beyond the truncation show nothing. In the direction that walls leave most open, they
    show less by the share ``apparent`` of their number, as if so many points were across it.
    """
    information, pulls = line_map.pulls(points, map_T_laser, truncate_m)
    hessian, count, pulls = symmetric(information), float(pulls[5].sum()), pulls[:3]
    if not apparent:
        return Evidence(hessian, pulls.sum(axis=1), pulls @ pulls.T)
    along = np.append(np.linalg.eigh(hessian[:2, :2])[1][:, 0], 0.0)
    gradient = hessian @ along
    curvature = max(float(along @ gradient), 1e-9)
    reduce = EYE - min(1.0, apparent * count / curvature) * np.outer(gradient, along) / curvature
    return Evidence(reduce @ hessian, reduce @ pulls.sum(axis=1), reduce @ pulls @ pulls.T @ reduce.T)


def longer_than_predicted(evidence: Evidence, matched: Pose, predicted: Pose, before: Pose) -> tuple[float, float]:
    """Return the share by which the motion from a pose is longer than predicted if the match alone decides.

    Beside it the inverse of its variance; both are 0 without motion. What walls leave open weighs nothing.
    """
    moved_m = np.array((predicted.x_m - before.x_m, predicted.y_m - before.y_m))
    driven_m = float(np.hypot(*moved_m))
    if driven_m == 0.0:
        return 0.0, 0.0
    ahead = np.append(moved_m / driven_m, 0.0)
    hessian, spread = evidence.regular()
    along = np.linalg.solve(hessian, ahead)
    apart = (matched.x_m - predicted.x_m, matched.y_m - predicted.y_m)
    off_m = float(ahead[:2] @ apart + along @ evidence.pull)
    return off_m / driven_m, driven_m**2 / float(along @ spread @ along)


class Fusion(NamedTuple):
    """Variances of a prediction over a unit of motion, m2 and rad2, and the factor on the covariance of a match.

    The unit is a scan period of commands, or a meter or radian of wheels. The variances of commands begin with the
    20 mm and 5 deg of the paper; matches are believed once they are seen to agree. ``scans`` is the number of scans
    that they are learnt from, ``excess`` a running mean of what predictions and matches differ by, squared, as a
    multiple of the expected one (normalized innovation squared; Bar-Shalom, Li and Kirubarajan 2001, 5.4), and
    ``freedom`` the degrees of freedom of Student's t: the fewer, the less a prediction weighs far from the match.
    ``covariance`` (3, 3) is that of the last fused pose, of which the next prediction inherits the share ``inherited``:
    a small error of every prediction, as of the scale of wheels, adds up until walls show it. The share is less than 1,
    as errors of matches of scans in a row are alike. ``strict`` is the factor by which a match counts as more exact
    where it judges a prediction: walls seldom move. ``apparent`` is that of `evidence_of`.
    """

    position_m2: float = 0.02**2
    yaw_rad2: float = (5 * DEG) ** 2
    factor: float = 4.0
    scans: int = 0
    excess: float = 1.0
    freedom: float = inf
    covariance: Array = NONE
    inherited: float = 0.0
    strict: float = 1.0
    apparent: float = 0.0

    def fuse(self, evidence: Evidence, matched: Pose, predicted: Pose, units: float) -> tuple[Pose, Fusion]:
        """Return the mean of a matched pose and that which is predicted after some motion; what it shows."""
        (hessian, pull, _), (regular, spread) = evidence, evidence.regular()
        (x_m, y_m, yaw_rad), old = predicted, np.array(self[:3])
        shift = np.array((matched.x_m - x_m, matched.y_m - y_m, wrap_angle(matched.yaw_rad - yaw_rad)))
        gain = np.linalg.solve(spread, hessian)
        information = hessian @ gain
        moving, before = units * old[[0, 0, 1]], self.inherited * self.covariance
        precision = np.linalg.inv(np.diag(moving) + before)
        apart, toward = shift + np.linalg.solve(regular, pull), information @ shift + gain.T @ pull
        strict = self.factor / self.strict
        usual = np.linalg.inv(information / strict + precision) @ toward / strict
        unlikely = float(toward @ (apart - usual)) / strict
        excess = MEMORY * self.excess + (1.0 - MEMORY) * unlikely / 3.0
        ignored = excess >= MOST_EXCESS
        weight = IGNORED if ignored else (1.0 + 3.0 / self.freedom) / (1.0 + unlikely / self.freedom)
        covariance = np.linalg.inv(information / self.factor + weight * precision)
        moved = covariance @ toward / self.factor
        off = apart - moved
        new_share = moving / (moving + before.diagonal())
        of_prediction = new_share * (new_share * (moved**2 + covariance.diagonal()) + before.diagonal())
        of_match = (off @ information @ off + (information @ covariance).trace()) / 3.0
        x_m2, y_m2, yaw_rad2 = (weight * of_prediction / units).tolist()
        rate = max(RATE, 1.0 / (FIRST_SCANS + self.scans + 1))
        new = np.array((0.5 * (x_m2 + y_m2), yaw_rad2, of_match))
        position_m2, yaw_rad2, factor = np.maximum(old + rate * (new - old), LEAST).tolist()
        across_m, up_m, turned_rad = moved.tolist()
        fused = Pose(x_m + across_m, y_m + up_m, wrap_angle(yaw_rad + turned_rad))
        learnt = self._replace(excess=excess)
        if not ignored:
            learnt = learnt._replace(position_m2=position_m2, yaw_rad2=yaw_rad2, factor=factor, scans=self.scans + 1)
            learnt = learnt._replace(covariance=covariance)
        return fused, learnt


WHEELS = Fusion(position_m2=1e-3, yaw_rad2=1e-3, factor=8.0, freedom=4.0, inherited=0.8, strict=2.0, apparent=APPARENT)
"""What is known of wheels at first: the error of a motion of 0.1 m or 0.1 rad is a tenth of it."""
