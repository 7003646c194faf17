"""Slow, simple twins of the kernels of the metrics."""

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
    """Implement the docstring of the kernel of this name directly."""
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


def wall_normals(ranges_m, directions, limits_m):
    """Fit a line to the points next to each end point, one side after the other."""
    used = (ranges_m >= limits_m[0]) & (ranges_m <= limits_m[1])
    out = np.full((*ranges_m.shape, 2), np.nan)
    for s, i in np.argwhere(used):
        ends = ranges_m[s, :, None] * directions
        sides = [beside(ends, used[s], i, step) for step in (-1, 1)]
        if min(map(len, sides)) < 2:
            continue
        points = ends[[i, *sides[0], *sides[1]]]
        thin, wide = np.linalg.eigvalsh(np.cov(points.T, ddof=0))
        normal = np.linalg.eigh(np.cov(points.T, ddof=0))[1][:, 0]
        normal = -normal if normal @ directions[i] > 0 else normal
        spread_m = 0.03 + 0.01 * ranges_m[s, i]
        if thin <= min(0.1 * wide, spread_m**2) and -normal @ directions[i] >= 0.25:
            out[s, i] = normal
    return out


def beside(ends, used, i, step):
    found = []
    for k in range(i + step, len(ends) if step > 0 else -1, step):
        if not used[k]:
            continue
        far = np.hypot(*(ends[k] - ends[i])) > 0.15
        if (far and len(found) >= 2) or np.hypot(*(ends[k] - ends[(found or [i])[-1]])) > 0.25:
            break
        found.append(k)
    return found


def wall_gaps(ranges_m, normals, pairs, b_T_a, directions, beams, every):
    first, step, least_m, far_m = beams
    points = range(0, ranges_m.shape[1], every)
    out, bearing = np.full((len(pairs), len(points)), np.nan), np.arctan2(normals[..., 1], normals[..., 0])
    for p, (a, b) in enumerate(pairs):
        for m, i in enumerate(points):
            (end,), normal = placed(b_T_a[p], (ranges_m[a, i] * directions[i])[None]), bearing[a, i] + b_T_a[p, 2]
            r, towards = np.hypot(*end), np.array([np.cos(normal), np.sin(normal)])
            if np.isnan(normal) or not least_m <= r <= far_m or abs(towards @ end) / r < 0.25:
                continue
            centre = (ranges_m.shape[1] - 1) / 2
            off = math.remainder(math.atan2(end[1], end[0]) - first - centre * step, 2 * math.pi)
            beam = math.floor(off / step + centre + 0.5)
            if not 0 <= beam < ranges_m.shape[1] or not least_m <= ranges_m[b, beam] <= far_m:
                continue
            gap = (ranges_m[b, beam] - r) * (abs(towards @ end) / r)
            parallel = abs(np.cos(bearing[b, beam] - normal)) > 0.94
            out[p, m] = 0.0 if abs(gap) <= 0.05 + 0.01 * r else gap if gap < 0 or parallel else np.inf
    return out


def closeness(points, targets, size):
    """Return the mean closeness of points (n, 2) to the nearest targets (m, 2), from the centers of 50 mm cells."""
    cells = np.floor(points / 0.05 + size // 2)
    middles = (cells + 0.5 - size // 2) * 0.05
    at = np.floor(targets / 0.05)
    total = 0
    for cell, middle in zip(cells - size // 2, middles, strict=True):
        near = targets[np.abs(at - cell).max(axis=1) <= 2]
        away_m = np.hypot(*(near - middle).T).min(initial=np.inf)
        inside = (cell + size // 2 >= 0).all() and (cell + size // 2 < size).all()
        total += math.floor(255 * max(0.0, 1 - away_m / 0.12)) if inside else 0
    return total / 255 / max(len(points), 1)


def best_alignments(ranges_m, pairs, b_T_a, directions, limits_m, reach):
    """Evaluate all poses of each level, and keep the first of the best."""
    used = (ranges_m >= limits_m[0]) & (ranges_m <= limits_m[1])
    size, out = 2 * int(limits_m[1] / 0.05) + 2, b_T_a.copy()
    for p, (a, b) in enumerate(pairs):
        points, targets = (ranges_m[k, used[k], None] * directions[used[k]] for k in (a, b))
        best = np.zeros(3)
        for level in range(4):
            some = points[:: max(1, len(points) // (160 if level else 40))]
            steps, turns = (1, 1) if level else (reach, 3)
            grid = np.mgrid[-turns : turns + 1, -steps : steps + 1, -steps : steps + 1].reshape(3, -1).T
            tries = best + grid[:, [1, 2, 0]] * (0.1, 0.1, math.pi / 90) / 2**level
            scores = [
                closeness(placed(b_T_a[p] + at, some), targets, size) - 0.03 * np.hypot(*at[:2]) - 0.1 * abs(at[2])
                for at in tries
            ]
            best = tries[np.argmax(scores)]
        out[p] += best
    return out
