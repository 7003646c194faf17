"""Distances between two scans that see the same walls, at their given poses."""

from __future__ import annotations

import numpy as np

from mavnav.kernels.machine.jit import F64_1D, F64_2D, I64_2D, helper, kernel


@helper
def _sample_ends(ranges_m: F64_1D, directions: F64_2D, near_m: float, far_m: float, every: int, points: F64_2D) -> int:
    """Write x and y of each ``every``-th end point of a scan; return the number."""
    skip, n = 0, 0
    for i in range(len(ranges_m)):
        if near_m <= ranges_m[i] <= far_m:
            if skip == 0:
                points[0, n], points[1, n] = ranges_m[i] * directions[i, 0], ranges_m[i] * directions[i, 1]
                skip, n = every, n + 1
            skip -= 1
    return n


@helper
def _to_polar(sampled: F64_2D, n: int, motion: F64_1D, step: float, centre: float, points: F64_2D) -> None:
    """Turn and shift points (2, n) by a motion (4,); write x, y, range, and bearing from ``centre`` in beams (4, n)."""
    c, s, x, y = motion
    for k in range(n):
        qx, qy = c * sampled[0, k] - s * sampled[1, k] + x, s * sampled[0, k] + c * sampled[1, k] + y
        points[0, k], points[1, k], points[2, k] = qx, qy, np.sqrt(qx * qx + qy * qy)
        off = np.arctan2(qy, qx) - centre
        points[3, k] = (off - 2.0 * np.pi * np.floor(off / (2.0 * np.pi) + 0.5)) / step


@helper
def _nearest2(x: float, y: float, r: float, middle: int, ends: F64_2D, turn: int, aside2: F64_1D, cap2: float) -> float:
    """Return the least squared distance from a point to the end points of beams (2, n), at most ``cap2``.

    Beams are tested from the one that points at it outwards, as long as their end points could be nearer.
    """
    count, nearest2, k = ends.shape[1], cap2, 0
    while k < len(aside2) and r * r * aside2[k] <= nearest2:
        for beam in (middle - k, middle + k + 1):
            at = beam + turn if beam < 0 else beam - turn if beam >= count else beam
            if 0 <= at < count:
                ex, ey = ends[0, at] - x, ends[1, at] - y
                nearest2 = min(nearest2, ex * ex + ey * ey)
        k += 1
    return nearest2


@kernel
def scan_distances(
    ranges_m: F64_2D, poses: F64_2D, pairs: I64_2D, directions: F64_2D, beams: F64_1D, cap_m: float, every: int
) -> F64_2D:
    """Return the distances from the points of one scan of a pair to the nearest points of the other, summed.

    Parameters
    ----------
    ranges_m : (scans, beams), NaN where there is no return
    poses : (scans, 3) map_T_laser, m, m, rad
    pairs : (n, 2) which scans
    directions : (beams, 2) cosines and sines in the laser's frame
    beams : (4,) bearing of the first beam and step in rad, least and greatest range used in m
    cap_m : largest distance
    every : step between the used points of the first scan

    Returns
    -------
    (n, 5): number and summed distance (m) of the points with a neighbour within the cap; number and summed distance,
    each at most the cap, of the points that the second scan could have seen; and the number of all points. A point can
    be seen if the beam that points at it has a return, not nearer than the point less the cap.
    """
    count = ranges_m.shape[1]
    first, step, near_m, far_m = beams
    turn, half = round(2.0 * np.pi / abs(step)), 0.5 * (count - 1)
    aside2 = np.empty(count + 2)  # squared sine of the least angle to the k-th beam aside
    for k in range(count + 2):
        aside2[k] = np.sin(min(max(k - 1, 0) * abs(step), 0.5 * np.pi)) ** 2
    out, ends = np.zeros((len(pairs), 5)), np.empty((2, count))
    sampled, points = np.empty((2, count)), np.empty((4, count))
    cos, sin = directions[:, 0].copy(), directions[:, 1].copy()
    last, n = -1, 0
    for pair in range(len(pairs)):
        a, b = pairs[pair]
        if a != last:  # the pairs of a scan follow each other
            last, n = a, _sample_ends(ranges_m[a], directions, near_m, far_m, every, sampled)
        dx, dy, dyaw = poses[a, 0] - poses[b, 0], poses[a, 1] - poses[b, 1], poses[a, 2] - poses[b, 2]
        c, s = np.cos(poses[b, 2]), np.sin(poses[b, 2])
        motion = np.array([np.cos(dyaw), np.sin(dyaw), c * dx + s * dy, c * dy - s * dx])
        _to_polar(sampled, n, motion, step, first + half * step, points)
        for j in range(count):
            r = ranges_m[b, j]
            r = r if (near_m <= r) & (r <= far_m) else np.inf
            ends[0, j], ends[1, j] = r * cos[j], r * sin[j]
        for i in range(n):
            r, middle = points[2, i], int(np.floor(points[3, i] + half + 0.5))
            nearest2 = _nearest2(points[0, i], points[1, i], r, middle, ends, turn, aside2, cap_m * cap_m)
            if nearest2 < cap_m * cap_m:
                out[pair, 0] += 1
                out[pair, 1] += np.sqrt(nearest2)
            if 0 <= middle < count and r <= far_m and ranges_m[b, middle] > r - cap_m:
                out[pair, 2] += 1
                out[pair, 3] += np.sqrt(nearest2)
        out[pair, 4] = n
    return out
