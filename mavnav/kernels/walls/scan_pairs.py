"""Pairs of scans whose poses may disagree: wall normals of a scan, gaps between walls, the best alignment."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import BOOL_1D, F64_1D, F64_2D, F64_3D, I64_1D, I64_2D, U8_2D, helper, kernel

HALF_LENGTH_M = 0.15
GAP_M = 0.25
LEAST_BESIDE = 2
"""Half-length of the part of a wall to which a line is fitted, largest gap in it, least number of points to a side."""

MOST_RATIO = 0.1
SPREAD_M, SPREAD_SHARE = 0.03, 0.01
"""Bounds on the spread of a wall's points across it: ratio of the variances, and m plus a share of the range."""

LEAST_COSINE = 0.25
"""Least cosine between a beam and the wall's normal: beams that graze a wall are not used."""

PARALLEL = 0.94
"""Least cosine between two parallel walls (20 degrees)."""

SAME_M, SAME_SHARE = 0.05, 0.01
"""Largest difference of two scans that see the same wall: m plus a share of the range."""

CELL_M = 0.05
CLOSE_M, CLOSE_CELLS = 0.12, 2
"""Distance up to which points of two scans count as close, in m and in cells."""

STEP_M, STEP_RAD = 0.1, np.pi / 90.0
TURNS = 3
LEVELS = 4
"""First steps of the search, number of turns to either side, and number of levels; every level halves the steps."""

COARSE_POINTS, FINE_POINTS = 40, 160
SHIFT_COST, TURN_COST = 0.03, 0.1
"""Cost of a metre and of a radian of correction, relative to a score of 1: of equal fits, the smallest one wins."""


@helper
def _used_ends(ranges_m: F64_1D, directions: F64_2D, limits_m: F64_1D, beam: I64_1D, xy: F64_2D, apart: BOOL_1D) -> int:
    """Write the end points (2, n) of a scan, their beams, and which are too far from the one before; return n."""
    n = 0
    for i in range(len(ranges_m)):
        r = ranges_m[i]
        if limits_m[0] <= r <= limits_m[1]:
            beam[n], xy[0, n], xy[1, n] = i, r * directions[i, 0], r * directions[i, 1]
            last = max(n - 1, 0)
            dx, dy = xy[0, n] - xy[0, last], xy[1, n] - xy[1, last]
            apart[n] = n == 0 or dx * dx + dy * dy > GAP_M * GAP_M
            n += 1
    return n


@helper
def _moments_beside(xy: F64_2D, apart: BOOL_1D, n: int, i: int) -> tuple[int, float, float, float, float, float, float]:
    """Return the lesser of the numbers of points near point ``i`` on its two sides, and the moments of all of them."""
    fewest, count, x, y, xx, xy_, yy = n, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for step in (-1, 1):
        near, k = 0, i + step
        while 0 <= k < n and not apart[max(k, k - step)]:
            dx, dy = xy[0, k] - xy[0, i], xy[1, k] - xy[1, i]
            if near >= LEAST_BESIDE and dx * dx + dy * dy > HALF_LENGTH_M * HALF_LENGTH_M:
                break
            count, x, y, xx, xy_, yy = count + 1.0, x + dx, y + dy, xx + dx * dx, xy_ + dx * dy, yy + dy * dy
            near, k = near + 1, k + step
        fewest = min(fewest, near)
    return fewest, count, x, y, xx, xy_, yy


@kernel
def wall_normals(ranges_m: F64_2D, directions: F64_2D, limits_m: F64_1D) -> F64_3D:
    """Return the wall's unit normal towards the laser at each end point, laser frame, (scans, beams, 2).

    NaN if a point does not lie on a straight wall, or the beam grazes it. ``ranges_m`` (scans, beams) are NaN without a
    return, ``directions`` (beams, 2) cosines and sines. ``limits_m`` are the least and greatest range of used points.
    """
    scans, beams = ranges_m.shape
    out, xy = np.full((scans, beams, 2), np.nan), np.empty((2, beams))
    beam, apart = np.empty(beams, np.int64), np.empty(beams, np.bool_)
    for s in range(scans):
        used = _used_ends(ranges_m[s], directions, limits_m, beam, xy, apart)
        for k in range(used):
            i = beam[k]
            fewest, n, x, y, xx, xy_, yy = _moments_beside(xy, apart, used, k)
            if fewest < LEAST_BESIDE:
                continue
            xx, xy_, yy = xx / n - x * x / n / n, xy_ / n - x * y / n / n, yy / n - y * y / n / n
            mean, diff = 0.5 * (xx + yy), 0.5 * (xx - yy)
            half = np.sqrt(diff * diff + xy_ * xy_)
            spread_m = SPREAD_M + SPREAD_SHARE * ranges_m[s, i]
            if mean - half > min(MOST_RATIO * (mean + half), spread_m * spread_m):
                continue
            turn_x, turn_y = (diff / half, xy_ / half) if half > 0.0 else (1.0, 0.0)  # by twice the angle
            longer = np.sqrt(0.5 + 0.5 * abs(turn_x))
            shorter = 0.5 * turn_y / longer
            nx, ny = (-shorter, longer) if turn_x > 0.0 else (-longer, shorter)
            towards = -(nx * directions[i, 0] + ny * directions[i, 1])
            if abs(towards) >= LEAST_COSINE:
                sign = 1.0 if towards > 0.0 else -1.0
                out[s, i, 0], out[s, i, 1] = sign * nx, sign * ny
    return out


@kernel
def wall_gaps(
    ranges_m: F64_2D, normals: F64_3D, pairs: I64_2D, b_T_a: F64_2D, directions: F64_2D, beams: F64_1D, every: int
) -> F64_2D:
    """Return how far behind the wall points of scan a scan b sees a wall, along its beams through them.

    Parameters
    ----------
    ranges_m, normals : (scans, beams) and (scans, beams, 2), as of `wall_normals`
    pairs : (n, 2) which scans are a and b
    b_T_a : (n, 3) pose of a in the frame of b, m, m, rad
    directions : (beams, 2) cosines and sines in the laser's frame
    beams : (4,) bearing of the first beam and step in rad, least and greatest range used in m
    every : step between the used beams of a

    Returns
    -------
    (n, beams / every): gap across the wall in m, 0 if b sees the wall too, negative if b sees something before it, inf
    if b sees something behind it that is no parallel wall. NaN if a has no wall point, or b has no used beam there. The
    side of the wall from which b sees it does not matter.
    """
    first, step, least_m, far_m = beams
    count = ranges_m.shape[1]
    half, turn = 0.5 * (count - 1), 2.0 * np.pi
    out = np.full((len(pairs), (count + every - 1) // every), np.nan)
    for p in range(len(pairs)):
        a, b = pairs[p]
        x0, y0, yaw = b_T_a[p]
        c, s = np.cos(yaw), np.sin(yaw)
        for m in range(out.shape[1]):
            i = m * every
            if not np.isfinite(normals[a, i, 0]):
                continue
            ax, ay = ranges_m[a, i] * directions[i, 0], ranges_m[a, i] * directions[i, 1]
            nx, ny = c * normals[a, i, 0] - s * normals[a, i, 1], s * normals[a, i, 0] + c * normals[a, i, 1]
            x, y = c * ax - s * ay + x0, s * ax + c * ay + y0
            r = np.sqrt(x * x + y * y)  # np.hypot takes a fifth of the kernel's time
            if not least_m <= r <= far_m:
                continue
            off = np.arctan2(y, x) - first - half * step
            beam = int(np.floor((off - turn * np.floor(off / turn + 0.5)) / step + half + 0.5))
            if not 0 <= beam < count or not least_m <= ranges_m[b, beam] <= far_m:
                continue
            cosine = abs(nx * x + ny * y) / max(r, 1e-9)
            if cosine < LEAST_COSINE:
                continue
            gap = (ranges_m[b, beam] - r) * cosine
            if abs(gap) <= SAME_M + SAME_SHARE * r:
                out[p, m] = 0.0
            else:  # not parallel if b has no normal, NaN
                parallel = gap >= 0.0 and abs(normals[b, beam, 0] * nx + normals[b, beam, 1] * ny) > PARALLEL
                out[p, m] = gap if gap < 0.0 or parallel else np.inf
    return out


@helper
def _draw(ends: F64_2D, image: U8_2D) -> None:
    """Draw the closeness of each cell (rows, cols) to points (n, 2), up to 255; (0, 0) is in the middle."""
    image[:] = 0
    size, middle = len(image), len(image) // 2
    for k in range(len(ends)):
        u, v = ends[k, 0] / CELL_M + middle, ends[k, 1] / CELL_M + middle
        for row in range(max(int(v) - CLOSE_CELLS, 0), min(int(v) + CLOSE_CELLS + 1, size)):
            for col in range(max(int(u) - CLOSE_CELLS, 0), min(int(u) + CLOSE_CELLS + 1, size)):
                away_m = CELL_M * np.hypot(col + 0.5 - u, row + 0.5 - v)
                close = int(255.0 * max(0.0, 1.0 - away_m / CLOSE_M))
                image[row, col] = max(image[row, col], close)


@helper
def _closeness(points: F64_2D, every: int, x: float, y: float, yaw: float, image: U8_2D) -> float:
    """Return the mean closeness, 0 to 1, of each ``every``-th point (n, 2) at a pose to the points of the image."""
    c, s, size, total, n = np.cos(yaw), np.sin(yaw), len(image), 0, 0
    u0, v0 = x / CELL_M + size // 2, y / CELL_M + size // 2
    c, s = c / CELL_M, s / CELL_M
    for k in range(0, len(points), every):
        col, row = int(c * points[k, 0] - s * points[k, 1] + u0), int(s * points[k, 0] + c * points[k, 1] + v0)
        if 0 <= row < size and 0 <= col < size:
            total += image[row, col]
        n += 1
    return total / (255.0 * max(n, 1))


@helper
def _ends(ranges_m: F64_1D, directions: F64_2D, limits_m: F64_1D) -> F64_2D:
    """Return the end points (n, 2) of a scan, m."""
    ends, n = np.empty((len(ranges_m), 2)), 0
    for i in range(len(ranges_m)):
        if limits_m[0] <= ranges_m[i] <= limits_m[1]:
            ends[n, 0], ends[n, 1] = ranges_m[i] * directions[i, 0], ranges_m[i] * directions[i, 1]
            n += 1
    return ends[:n]


@kernel
def best_alignments(
    ranges_m: F64_2D, pairs: I64_2D, b_T_a: F64_2D, directions: F64_2D, limits_m: F64_1D, reach: int
) -> F64_2D:
    """Search for the poses of scans a in the frames of scans b at which their end points are closest to each other.

    All poses up to ``reach`` steps of 0.1 m and three turns of 2 degrees from ``b_T_a`` (n, 3) are tried, then those
    around the best one with halved steps, three times. Arguments as of `wall_gaps` and `wall_normals`; returns the
    poses, (n, 3).
    """
    size = 2 * int(limits_m[1] / CELL_M) + 2
    out, image, at, best = b_T_a.copy(), np.empty((size, size), np.uint8), np.empty(3), np.empty(3)
    for p in range(len(pairs)):
        points = _ends(ranges_m[pairs[p, 0]], directions, limits_m)
        _draw(_ends(ranges_m[pairs[p, 1]], directions, limits_m), image)
        best[:] = 0.0
        for level in range(LEVELS):
            step, turn = STEP_M / 2**level, STEP_RAD / 2**level
            shifts, turns = (1, 1) if level else (reach, TURNS)
            every = max(1, len(points) // (FINE_POINTS if level else COARSE_POINTS))
            at[:], most = best, -np.inf
            for q in range(-turns, turns + 1):
                for i in range(-shifts, shifts + 1):
                    for j in range(-shifts, shifts + 1):
                        x, y, yaw = at[0] + i * step, at[1] + j * step, at[2] + q * turn
                        score = _closeness(points, every, b_T_a[p, 0] + x, b_T_a[p, 1] + y, b_T_a[p, 2] + yaw, image)
                        score -= SHIFT_COST * np.hypot(x, y) + TURN_COST * abs(yaw)
                        if score > most:
                            most, best[0], best[1], best[2] = score, x, y, yaw
        out[p] += best
    return out
