"""Trajectory errors against a truth: absolute, with and without alignment by a rigid motion, and relative."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
from msgspec import Struct

from mavnav.metrics.fields import Measured, number
from mavnav.pose import Trajectory, between, rigid_fit, transform_points
from mavnav.units import DEG

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_GAP_NS: Final = 1_000_000_000
"""Longest gap in the truth over which it is interpolated."""

GAP_PERIODS: Final = 2.5
"""A gap between compared poses is longer than `MAX_GAP_NS` and than this many median steps; no stretch spans it."""

DELTA_M: Final = 1.0
"""Length of the stretches of the estimated path for relative errors."""

NO_TURN_RAD: Final = 1e-6
"""A truth whose headings all lie within this angle has none: quaternions of a constant heading are rounded."""


class AbsoluteError(Struct, frozen=True):
    """Absolute trajectory error (Sturm et al. 2012) over ``poses`` positions, in metres; NaN without poses."""

    poses: int
    rmse_m: float
    median_m: float
    max_m: float


class RelativeError(Struct, frozen=True):
    """Relative pose error (Sturm et al. 2012) over stretches of the estimated path without a gap; null without one.

    Translation and rotation are null as well if the truth has no headings.
    """

    pairs: Annotated[int, number("stretches of the path, without a gap, that were compared")]
    delta_m: Annotated[float, number("length of a stretch")]
    translation_rmse_m: Annotated[Measured, number("root mean square error of the motion over a stretch")]
    rotation_rmse_deg: Annotated[Measured, number("root mean square error of the turn over a stretch")]
    distance_rmse_m: Annotated[
        Measured, number("root mean square error of the distance between the ends of a stretch; it needs no headings")
    ]


def absolute_error(
    estimate_xy_m: NDArray[np.float64], truth_xy_m: NDArray[np.float64], *, aligned: bool = True
) -> AbsoluteError:
    """Return the errors of positions (n, 2), m; ``aligned``: after the best rigid motion."""
    n = len(estimate_xy_m)
    if n == 0:
        return AbsoluteError(0, np.nan, np.nan, np.nan)
    if aligned:
        estimate_xy_m = transform_points(rigid_fit(estimate_xy_m, truth_xy_m), estimate_xy_m)
    error = np.hypot(*(estimate_xy_m - truth_xy_m).T)
    return AbsoluteError(n, float(np.sqrt((error**2).mean())), float(np.median(error)), float(error.max()))


def relative_error(estimate: Trajectory, truth: Trajectory) -> RelativeError:
    """Return the errors of motions over stretches of the path; poses at the same times, each in its own frame."""
    first, last = _stretches(estimate)
    if not len(first):
        return RelativeError(0, DELTA_M, np.nan, np.nan, np.nan)
    moved, should = (between(path.xyyaw[first], path.xyyaw[last]) for path in (estimate, truth))
    error = between(should, moved)
    apart = np.hypot(*moved[:, :2].T) - np.hypot(*should[:, :2].T)
    yaw_rad = truth.xyyaw[:, 2]
    turned = (yaw_rad - yaw_rad[0] + np.pi) % (2.0 * np.pi) - np.pi
    headed = bool(np.ptp(turned) > NO_TURN_RAD)
    return RelativeError(
        pairs=len(first),
        delta_m=DELTA_M,
        translation_rmse_m=_rms(np.hypot(error[:, 0], error[:, 1])) if headed else np.nan,
        rotation_rmse_deg=_rms(error[:, 2]) / DEG if headed else np.nan,
        distance_rmse_m=_rms(apart),
    )


def associate(estimate: Trajectory, truth: Trajectory) -> tuple[Trajectory, Trajectory]:
    """Return the estimated poses that have a truth, and the true ones at the same times.

    The truth is interpolated; estimates before it, after it and in its longer gaps are left out.
    """
    true_poses = [(k, truth.at(int(stamp_ns), MAX_GAP_NS)) for k, stamp_ns in enumerate(estimate.stamps_ns)]
    rows = [k for k, pose in true_poses if pose is not None]
    stamps_ns = estimate.stamps_ns[rows]
    true = Trajectory.of(stamps_ns.tolist(), [pose for _, pose in true_poses if pose is not None])
    return Trajectory(stamps_ns, estimate.xyyaw[rows]), true


def position_errors(estimate: Trajectory, truth: Trajectory, *, aligned: bool) -> NDArray[np.float64]:
    """Return the position error of every pose, (n,), m, after alignment if ``aligned``; NaN without a truth."""
    true_poses = [truth.at(int(stamp_ns), MAX_GAP_NS) for stamp_ns in estimate.stamps_ns]
    true_xy_m = np.array([(np.nan, np.nan) if pose is None else pose[:2] for pose in true_poses]).reshape(-1, 2)
    known, xy_m = np.isfinite(true_xy_m[:, 0]), estimate.xyyaw[:, :2]
    if aligned and known.any():
        xy_m = transform_points(rigid_fit(xy_m[known], true_xy_m[known]), xy_m)
    errors_m: NDArray[np.float64] = np.hypot(*(xy_m - true_xy_m).T)
    return errors_m


def _stretches(path: Trajectory) -> tuple[list[int], list[int]]:
    """Return the first and last rows of stretches of a path, each of `DELTA_M` or just above and without a gap."""
    steps_ns = np.diff(path.stamps_ns)
    longest_ns = max(MAX_GAP_NS, GAP_PERIODS * float(np.median(steps_ns))) if len(steps_ns) else MAX_GAP_NS
    first: list[int] = []
    last: list[int] = []
    start, walked_m = 0, 0.0
    steps_m = np.hypot(*np.diff(path.xyyaw[:, :2], axis=0).T)
    for k, (step_m, step_ns) in enumerate(zip(steps_m, steps_ns, strict=True), start=1):
        if step_ns > longest_ns:
            start, walked_m = k, 0.0
            continue
        walked_m += float(step_m)
        if walked_m >= DELTA_M:
            first.append(start)
            last.append(k)
            start, walked_m = k, 0.0
    return first, last


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))
