"""Trajectory errors against a truth: absolute, with and without the best rigid motion taken out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mavnav.pose import Pose, transform_points

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class AbsoluteError:
    """Absolute trajectory error (Sturm et al. 2012) over ``poses`` positions, in metres; NaN without poses."""

    poses: int
    rmse_m: float
    median_m: float
    max_m: float


def align(from_xy_m: NDArray[np.float64], to_xy_m: NDArray[np.float64]) -> Pose:
    """Return the rigid motion that brings points (n, 2) closest to their partners, least squares (Umeyama 1991)."""
    a, b = from_xy_m.mean(axis=0), to_xy_m.mean(axis=0)
    p, q = from_xy_m - a, to_xy_m - b
    yaw = float(np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum()))
    turned = transform_points(Pose(0.0, 0.0, yaw), a[None])[0]
    return Pose(float(b[0] - turned[0]), float(b[1] - turned[1]), yaw)


def absolute_error(
    estimate_xy_m: NDArray[np.float64], truth_xy_m: NDArray[np.float64], *, aligned: bool = True
) -> AbsoluteError:
    """Compare positions (n, 2) one by one, in metres; ``aligned`` takes the best rigid motion out first."""
    n = len(estimate_xy_m)
    if n == 0:
        return AbsoluteError(0, np.nan, np.nan, np.nan)
    if aligned:
        estimate_xy_m = transform_points(align(estimate_xy_m, truth_xy_m), estimate_xy_m)
    error = np.hypot(*(estimate_xy_m - truth_xy_m).T)
    return AbsoluteError(n, float(np.sqrt((error**2).mean())), float(np.median(error)), float(error.max()))
