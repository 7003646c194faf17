"""Points of a scan for matching and mapping: cleaning, de-skewing, voxel means (docs/method.md)."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, Out, helper, int32, kernel, uint64

MIXED_M, MIXED_SHARE = 0.1, 0.05
"""Difference in range to both neighbors of a mixed pixel, in m and as a share of the range."""

STEEPEST = 2.75
"""Tangent of the angle, 70 degrees, between a beam and the normal of a wall that its neighbors still meet."""


LONGEST_M, MISSING = 3.0, 1.5
"""Distance up to which two neighbouring end points are joined, m, and angle between them, in beams, that is a gap."""

NOISE_M, BEND = 0.02, 0.2
"""Distance of a point from the line through its two neighbours with which they are one wall, m and as a share."""


@helper
def _end_points(
    ranges_m: F64_1D,
    directions: F64_2D,
    twist: F64_1D,
    time_increment_s: float,
    near_m: float,
    far_m: float,
    out: F64_2D,
) -> int:
    """Write the end points (n, 2), m, of the valid beams in the laser frame at mid-sweep; return their number."""
    (v_x, v_y, rate), n, used = twist, len(ranges_m), 0
    turn = rate * time_increment_s
    first, step_c, step_s = -0.5 * (n - 1) * turn, np.cos(turn), np.sin(turn)
    next_c, next_s = np.cos(first), np.sin(first)
    share = MIXED_SHARE
    if n > 1:
        between = abs(directions[0, 0] * directions[1, 1] - directions[0, 1] * directions[1, 0])
        share = max(share, STEEPEST * between)
    for i in range(n):
        r, c, s = ranges_m[i], next_c, next_s
        next_c, next_s = step_c * c - step_s * s, step_s * c + step_c * s
        if not near_m < r < far_m:
            continue
        jump = max(MIXED_M, share * r)
        if 0 < i < n - 1 and abs(r - ranges_m[i - 1]) > jump and abs(r - ranges_m[i + 1]) > jump:
            continue
        late_s = time_increment_s * (i - 0.5 * (n - 1))
        x, y = r * directions[i, 0], r * directions[i, 1]
        out[used, 0] = c * x - s * y + v_x * late_s
        out[used, 1] = s * x + c * y + v_y * late_s
        used += 1
    return used


@helper
def voxel_means(points: F64_2D, voxel_m: float, out: F64_2D) -> int:
    """Write the means (m, 2) of points (n, 2) in square voxels in shuffled order, which depends only on the points.

    Returns the number of means. ``places`` is a sorted hash table of voxel numbers: a voxel is at the first bits of its
    key, or after it.
    """
    n, m, bits = len(points), 0, 1
    while 1 << bits < 2 * n:
        bits += 1
    places, keys, sums = np.zeros((1 << bits) + n, np.int32), np.empty(n + 1, np.uint64), np.zeros((n + 1, 3))
    for k in range(n):
        x, y = points[k, 0], points[k, 1]
        col = uint64(int(np.floor(x / voxel_m)) + (1 << 31))
        row = uint64(int(np.floor(y / voxel_m)) + (1 << 31))
        # An odd factor permutes the 64-bit numbers: voxels stay distinct, and their order is scrambled.
        key = ((row << uint64(32)) | col) * uint64(0x9E3779B97F4A7C15)
        at = key >> uint64(64 - bits)
        while places[at] and keys[places[at]] < key:
            at += uint64(1)
        voxel = places[at]
        if voxel == 0 or keys[voxel] != key:
            m += 1
            keys[m] = key
            voxel = moved = int32(m)
            while moved:
                moved, places[at] = places[at], moved
                at += uint64(1)
        sums[voxel, 0] += x
        sums[voxel, 1] += y
        sums[voxel, 2] += 1.0
    k, order = 0, np.empty(len(places), np.int32)
    for voxel in places:
        order[uint64(k)] = voxel  # overwritten unless there is a voxel: most places are empty
        k += voxel != 0
    for k in range(m):
        voxel = order[k]
        out[k, 0], out[k, 1] = sums[voxel, 0] / sums[voxel, 2], sums[voxel, 1] / sums[voxel, 2]
    return m


@kernel
def scan_points(
    ranges_m: F64_1D,
    directions: F64_2D,
    twist: F64_1D,
    time_increment_s: float,
    limits_m: F64_1D,
    ends: Out[F64_2D],
    means: Out[F64_2D],
) -> tuple[int, int]:
    """Write the end points of the valid beams in the laser frame at mid-sweep, and their means in square voxels.

    Parameters
    ----------
    ranges_m, directions : (beams,) m, NaN without a return, and (beams, 2) cosines and sines
    twist, time_increment_s : (3,) the laser's motion in its own frame, m/s, m/s, rad/s, and the time between two beams
    limits_m : (3,) least and greatest range of used beams, and the edge of a voxel
    ends, means : (beams, 2) output, m; the numbers of both are returned

    Mixed pixels are left out: beams that differ from both neighbours by more than 0.1 m and 5 % of their range. The
    means are shuffled, so that any prefix is a fair sample.
    """
    near_m, far_m, voxel_m = limits_m
    n = _end_points(ranges_m, directions, twist, time_increment_s, near_m, far_m, ends)
    return n, voxel_means(ends[:n], voxel_m, means)


@helper
def _is_straight(points: F64_2D, at: int, other: int, dx: float, dy: float) -> bool:
    """Return whether a point beside another one, ``at``, lies in the direction (dx, dy), m, about as noise allows."""
    if not 0 <= other < len(points):
        return False
    x, y = points[other, 0] - points[at, 0], points[other, 1] - points[at, 1]
    apart2 = dx * dx + dy * dy
    along, across = (x * dx + y * dy) / np.sqrt(apart2), abs(x * dy - y * dx) / np.sqrt(apart2)
    near = np.sqrt(min(x * x + y * y, apart2))
    return bool(along > 0.0 and across <= NOISE_M + BEND * near)


@kernel
def points_between(points: F64_2D, step_rad: float, reach_m: float, spacing_m: float, out: Out[F64_2D]) -> int:
    """Write points on the walls between beams that are farther apart than ``reach_m``; return their number.

    Parameters
    ----------
    points : (n, 2) end points of a scan in the order of its beams, m, laser frame
    step_rad : angle between two beams; points with a missing beam between them are not joined
    reach_m, spacing_m : distance of two beams, across them, above which they are joined, and of the points, m
    out : (m, 2) output, m, laser frame; with ``LONGEST_M / spacing_m`` rows a point it is never too short

    Two end points are on one wall if they are ``LONGEST_M`` apart at most and the point before or after continues the
    line through them: neither corners nor the gap behind an edge are bridged.
    """
    used = 0
    for k in range(len(points) - 1):
        x, y, to_x, to_y = points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1]
        range_m, next_m = np.sqrt(x * x + y * y), np.sqrt(to_x * to_x + to_y * to_y)
        sine = abs(x * to_y - y * to_x) / (range_m * next_m)
        if sine > MISSING * step_rad or min(range_m, next_m) * sine <= reach_m:
            continue
        dx, dy = to_x - x, to_y - y
        apart_m = np.sqrt(dx * dx + dy * dy)
        if apart_m > LONGEST_M:
            continue
        if not (_is_straight(points, k, k - 1, -dx, -dy) or _is_straight(points, k + 1, k + 2, dx, dy)):
            continue
        count = int(apart_m / spacing_m)
        for j in range(1, count + 1):
            share = j / (count + 1)
            out[used, 0], out[used, 1] = x + share * dx, y + share * dy
            used += 1
    return used


@helper
def _extent(points: F64_2D) -> tuple[float, float, float, float]:
    low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
    for k in range(len(points)):
        low_x, high_x = min(low_x, points[k, 0]), max(high_x, points[k, 0])
        low_y, high_y = min(low_y, points[k, 1]), max(high_y, points[k, 1])
    return low_x, low_y, high_x, high_y


@kernel
def extent(points: F64_2D) -> tuple[float, float, float, float]:
    """Return least x, least y, largest x and largest y of points (n, 2); without points inf, inf, -inf, -inf."""
    return _extent(points)


@kernel
def place_points(points: F64_2D, pose: F64_1D, out: Out[F64_2D]) -> tuple[float, float, float, float]:
    """Transform points (n, 2), m, by a ``pose`` (3,): x, y (m), yaw (rad).

    They are written to ``out`` (n, 2), in the frame in which the pose is given; returns their ``extent``.
    """
    to_x, to_y, yaw = pose
    c, s = np.cos(yaw), np.sin(yaw)
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        out[k, 0], out[k, 1] = to_x + c * x - s * y, to_y + s * x + c * y
    return _extent(out)
