"""Slow, obvious twins of the kernels that the metrics use."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage
from scipy.sparse.csgraph import connected_components


def wall_profiles(counts, stations, half_length, reach):
    rows, cols = counts.shape
    out = np.zeros((len(stations), 2, 4 * reach + 1))
    for k, (col, row, angle) in enumerate(stations):
        along, left = (math.cos(angle), math.sin(angle)), (-math.sin(angle), math.cos(angle))
        for half, side in enumerate((-1, 1)):
            for b in range(4 * reach + 1):
                found = []
                for i in range(2 * half_length):
                    u, v = side * (0.25 + i / 2), b / 2 - reach
                    c = math.floor(col + u * along[0] + v * left[0] + 0.5)
                    r = math.floor(row + u * along[1] + v * left[1] + 0.5)
                    found.append(counts[r, c] if 0 <= r < rows and 0 <= c < cols else 0)
                out[k, half, b] = np.mean(found)
    return out


def scan_distances(ranges_m, poses, pairs, directions, beams, cap_m, every):
    """Compare every point with every point; the field of view is the span of the beams."""
    first, step, near_m, far_m = beams
    count = ranges_m.shape[1]
    used = (ranges_m >= near_m) & (ranges_m <= far_m)
    out = np.zeros((len(pairs), 5))
    for k, (a, b) in enumerate(pairs):
        targets = placed(poses[b], ranges_m[b, used[b], None] * directions[used[b]])
        for point in placed(poses[a], ranges_m[a, used[a], None] * directions[used[a]])[::every]:
            distance = min(np.hypot(*(targets - point).T).min(initial=np.inf), cap_m)
            out[k, 4] += 1
            if distance < cap_m:
                out[k, :2] += 1, distance
            x, y = point - poses[b, :2]
            off = math.remainder(math.atan2(y, x) - poses[b, 2] - first - (count - 1) * step / 2, 2 * math.pi)
            beam = round(off / step + (count - 1) / 2)
            r = math.hypot(x, y)
            if 0 <= beam < count and r <= far_m and ranges_m[b, beam] > r - cap_m:
                out[k, 2:4] += 1, distance
    return out


def placed(pose, xy_m):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.column_stack((c * xy_m[:, 0] - s * xy_m[:, 1], s * xy_m[:, 0] + c * xy_m[:, 1])) + pose[:2]


def region_sizes(mask, diagonal):
    labels, _ = ndimage.label(mask, np.ones((3, 3)) if diagonal else None)
    return np.bincount(labels.ravel())[1:]


def smoothed(image, down, across, down_sign, across_sign):
    for axis, weights, sign in ((0, down, down_sign), (1, across, across_sign)):
        image = ndimage.correlate1d(image, np.concatenate((sign * weights[:0:-1], weights)), axis)
    return image


def link_groups(xy_m, directions, reach_m, across_m, sin_turn):
    """Compare every point with every point."""
    dx, dy = (xy_m[None] - xy_m[:, None]).transpose(2, 0, 1)
    (c, s) = directions.T
    turned, beside = np.abs(np.outer(c, s) - np.outer(s, c)), np.abs(c[:, None] * dy - s[:, None] * dx)
    linked = (np.hypot(dx, dy) <= reach_m) & (turned <= sin_turn) & (np.maximum(beside, beside.T) <= across_m)
    return connected_components(linked, directed=False)[1]


def straight_beams(xy_m, spacing_m, radii_m, least_reach, max_ratio, min_points):
    """Follow the docstring of the kernel of that name to the letter."""
    direction, kept = np.full(len(xy_m), np.nan), []
    for beam, point in enumerate(xy_m):
        if np.isfinite(point).all() and (not kept or np.hypot(*(point - xy_m[kept[-1]])) >= spacing_m):
            kept.append(beam)
    xy = xy_m[kept]
    for i, beam in enumerate(kept):
        for radius_m in radii_m:
            far = np.flatnonzero(np.hypot(*(xy - xy[i]).T) > radius_m)
            before, after = far[far < i].max(initial=-1) + 1, far[far > i].min(initial=len(xy))
            reach_m = min(np.hypot(*(part - xy[i]).T).max(initial=0) for part in (xy[before:i], xy[i + 1 : after]))
            if after - before < min_points or reach_m < least_reach * radius_m:
                continue
            thin, wide = np.linalg.eigvalsh(np.cov(xy[before:after].T, ddof=0))
            if thin <= max_ratio**2 * wide:
                along = np.linalg.eigh(np.cov(xy[before:after].T, ddof=0))[1][:, 1]
                direction[beam] = np.arctan(along[1] / along[0])
                break
    return direction
