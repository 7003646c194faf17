"""Scan matching: where in the map is this scan?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mavnav.pose import Pose


@dataclass(frozen=True, slots=True)
class Match:
    """The best pose of a scan in the map, with its evidence.

    ``cost_m2`` is the mean squared distance over ``beams_used`` contributing beams (inf where too few
    contribute), ``inliers`` the share of the scan that agrees with the map, ``evaluations`` the number of
    candidate poses whose cost was asked for, ``iterations`` the number of grids searched.
    """

    map_T_laser: Pose
    cost_m2: float
    beams_used: int
    inliers: float
    evaluations: int
    iterations: int
    converged: bool
