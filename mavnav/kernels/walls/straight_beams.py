"""Straight walls in single scans."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, I64_1D, helper, kernel


@helper
def _thin(xy_m: F64_2D, spacing_m: float) -> tuple[I64_1D, F64_2D]:
    """Return the numbers of the points at least ``spacing_m`` from the one before, and these points."""
    beam, n = np.empty(len(xy_m), np.int64), 0
    for i in range(len(xy_m)):
        if np.isnan(xy_m[i, 0]):
            continue
        last = beam[n - 1] if n else i
        dx, dy = xy_m[i, 0] - xy_m[last, 0], xy_m[i, 1] - xy_m[last, 1]
        if n == 0 or dx * dx + dy * dy >= spacing_m * spacing_m:
            beam[n] = i
            n += 1
    return beam[:n], xy_m[beam[:n]]


@kernel
def straight_beams(
    xy_m: F64_2D, spacing_m: float, radii_m: F64_1D, least_reach: float, max_ratio: float, min_points: int
) -> F64_1D:
    """Find the end points of a scan that lie on a straight wall, and the wall's direction there.

    Parameters
    ----------
    xy_m : (n, 2) end points in the order of the beams, laser frame; NaN without a return
    spacing_m : least distance of a used point to the one before
    radii_m : (m,) radii of the neighbourhood, tried in this order until a point lies on a wall
    least_reach : least extent of the neighbourhood on both sides, as a share of the radius
    max_ratio : largest ratio of the points' standard deviations across and along the wall
    min_points : least number of points in the neighbourhood

    The neighbourhood of a point are those before and after it up to the first that lies farther away than the radius.

    Returns
    -------
    (n,): direction in rad, -pi/2 to pi/2, NaN where a point lies on no straight wall or was left out.
    """
    direction = np.full(len(xy_m), np.nan)
    beam, xy = _thin(xy_m, spacing_m)
    for radius_m in radii_m:
        for i in range(len(beam)):
            if not np.isnan(direction[beam[i]]):
                continue
            n, x, y, xx, yy, cov, reach_m2 = 1, 0.0, 0.0, 0.0, 0.0, 0.0, np.inf
            for step in (-1, 1):
                j, farthest_m2 = i + step, 0.0
                while 0 <= j < len(beam):
                    dx, dy = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
                    distance_m2 = dx * dx + dy * dy
                    if distance_m2 > radius_m * radius_m:
                        break
                    n += 1
                    x, y, xx, yy, cov = x + dx, y + dy, xx + dx * dx, yy + dy * dy, cov + dx * dy
                    farthest_m2 = max(farthest_m2, distance_m2)
                    j += step
                reach_m2 = min(reach_m2, farthest_m2)
            if n < min_points or reach_m2 < (least_reach * radius_m) ** 2:
                continue
            xx, yy, cov = xx / n - (x / n) ** 2, yy / n - (y / n) ** 2, cov / n - x * y / n**2
            mean, diff = (xx + yy) / 2.0, (xx - yy) / 2.0
            half = np.sqrt(diff * diff + cov * cov)  # np.hypot takes a fifth of the kernel's time
            if mean - half <= max_ratio**2 * (mean + half):
                direction[beam[i]] = 0.5 * np.arctan2(2.0 * cov, xx - yy)
    return direction
