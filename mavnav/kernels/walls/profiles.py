"""Profiles across walls, smoothed images of them, and straight walls in single scans."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import helper, kernel
from mavnav.kernels.machine.types import F32_2D, F64_1D, F64_2D, F64_3D, I64_1D, U16_2D_STRIDED, int32, uint64


@kernel
def wall_profiles(counts: U16_2D_STRIDED, stations: F64_2D, half_length: int, reach: int) -> F64_3D:
    """Return the mean count at each distance from a wall, for both halves of a stretch of it.

    Parameters
    ----------
    counts : (rows, cols) hits or crossings; those outside are 0
    stations : (n, 3) column and row, in cells (whole numbers are centres), and direction of the wall in rad
    half_length : length of the wall on either side of a station, in cells
    reach : distance to either side of the wall, in cells

    Returns
    -------
    (n, 2, 4 * reach + 1): mean count a cell on the half behind the station and on the half ahead of it, every half cell
    along the normal (to the left of the direction) from ``-reach`` to ``reach``.
    """
    rows, cols = uint64(counts.shape[0]), uint64(counts.shape[1])
    bins, samples = 4 * reach + 1, 2 * half_length
    out, at = np.empty((len(stations), 2, bins)), np.empty((2, samples), np.int32)
    along = 0.5 * np.arange(samples) + 0.25
    for k in range(len(stations)):
        c, s = np.cos(stations[k, 2]), np.sin(stations[k, 2])
        for half in range(2):
            sign = 2.0 * half - 1.0
            for b in range(bins):
                v = 0.5 * b - reach
                for i in range(samples):  # in a loop without the sums, which uses SIMD lanes
                    u = sign * along[i]
                    at[0, i] = int32(np.floor(stations[k, 0] + u * c - v * s + 0.5))
                    at[1, i] = int32(np.floor(stations[k, 1] + u * s + v * c + 0.5))
                total = 0
                for i in range(samples):
                    col, row = uint64(at[0, i]), uint64(at[1, i])  # a negative number becomes a large one
                    if row < rows and col < cols:
                        total += counts[row, col]
                out[k, half, b] = total / samples
    return out


@helper
def _add(total: F64_1D, after: F64_1D, weight: float, sign: float, before: F64_1D) -> None:
    """Add two neighbours of each cell (n,), weighted."""
    for c in range(len(total)):
        total[c] += (after[c] + sign * before[c]) * weight


@kernel
def smooth_image(image: F32_2D, down: F64_1D, across: F64_1D, down_sign: float, across_sign: float) -> F32_2D:
    """Return the weighted sums of each cell of an image (rows, cols) and its neighbours, along columns, then rows.

    ``down`` and ``across`` are the weights of the middle and of the neighbours after it; those before it have the same
    weights times the sign, 1 or -1. The image is reflected at its edges. Sums are float64, rounded to float32 after
    each pass.
    """
    rows, cols = image.shape
    far_down, far_across = len(down) - 1, len(across) - 1
    wide = image.astype(np.float64)
    out = np.empty((rows, cols), np.float32)
    total, line = np.empty(cols), np.empty(cols + 2 * far_across)
    for r in range(rows):
        for c in range(cols):
            total[c] = wide[r, c] * down[0]
        for k in range(far_down, 0, -1):
            before, after = (r - k) % (2 * rows), (r + k) % (2 * rows)
            before, after = min(before, 2 * rows - 1 - before), min(after, 2 * rows - 1 - after)
            _add(total, wide[after], down[k], down_sign, wide[before])
        for c in range(cols):
            line[far_across + c] = np.float32(total[c])
        for k in range(far_across):
            left, right = (-1 - k) % (2 * cols), (cols + k) % (2 * cols)
            line[far_across - 1 - k] = line[far_across + min(left, 2 * cols - 1 - left)]
            line[far_across + cols + k] = line[far_across + min(right, 2 * cols - 1 - right)]
        for c in range(cols):
            total[c] = line[far_across + c] * across[0]
        for k in range(far_across, 0, -1):
            _add(total, line[far_across + k :], across[k], across_sign, line[far_across - k :])
        for c in range(cols):
            out[r, c] = np.float32(total[c])
    return out


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
