"""Slow, simple twins of the kernels: reference implementations without optimization."""

from __future__ import annotations

import math
from collections import defaultdict
from itertools import pairwise

import numpy as np

from mavnav.kernels.scans.sweep_shift import BENT, BESIDE_M, JOINED_M, STILL
from mavnav.pose import Pose, transform_points

# ---- hits, raycast -------------------------------------------------------------------------------------------------


def cells_between(u0, v0, u1, v1):
    """Return the cells (row, col) from one point to another, in cell units, including both ends.

    Sorts all crossings with cell edges.
    """
    crossings = [0.0, 1.0]
    for a, b in ((u0, u1), (v0, v1)):
        lines = range(math.ceil(min(a, b)), math.floor(max(a, b)) + 1)
        crossings += [(line - a) / (b - a) for line in lines if a != b and 0 < (line - a) / (b - a) < 1]
    crossings.sort()
    middles = [(a + b) / 2 for a, b in pairwise(crossings) if b > a]
    return [(math.floor(v0 + t * (v1 - v0)), math.floor(u0 + t * (u1 - u0))) for t in middles]


def add_scan(xy_map_m, laser_xy_m, lattice, hits, passes, shielded, near=3):
    ox, oy, cell = lattice
    u0, v0 = (laser_xy_m[0] - ox) / cell, (laser_xy_m[1] - oy) / cell
    near_ends, last = set(), (-9, -9)
    for point in xy_map_m:
        row, col = cell_of(point - (ox, oy), cell)
        if max(abs(row - last[0]), abs(col - last[1])) > 1:
            last = (row, col)
            near_ends |= {(row + i, col + j) for i in range(-near, near + 1) for j in range(-near, near + 1)}
    for x, y in xy_map_m:
        *way, end = cells_between(u0, v0, (x - ox) / cell, (y - oy) / cell)
        for cell_on_way in way:
            passes[cell_on_way] += 1
            shielded[cell_on_way] += cell_on_way in near_ends
        hits[end] += 1


def show_ends(ranges_m, directions, pose, lattice, walls, cells):
    """Mark the wall cells in which the beams of a scan end; return the number of these beams."""
    (x, y, yaw), (ox, oy, cell), count = pose, lattice, 0
    for r, (dx, dy) in zip(ranges_m, directions, strict=True):
        if not math.isfinite(r):
            continue
        col = math.floor((x + math.cos(yaw) * r * dx - math.sin(yaw) * r * dy - ox) / cell)
        row = math.floor((y + math.sin(yaw) * r * dx + math.cos(yaw) * r * dy - oy) / cell)
        if 0 <= row < cells.shape[0] and 0 <= col < cells.shape[1] and walls[row, col] == 100:
            cells[row, col] = 100
            count += 1
    return count


def free_positions(hits, passes, rows, cols):
    free = np.zeros((rows[-1] + 1, cols[-1] + 1), np.uint8)
    for row, col in np.argwhere(passes > hits):
        free[rows[row], cols[col]] = 1
    return free


def dynamic_cells(hits, passes, shielded, clear=8, stays=0.15, wall=4, reach=7):
    through = passes - shielded
    share = np.where(hits > 0, hits / np.maximum(hits + through, 1), 0.0)
    walls = np.argwhere((hits >= wall) & (share >= stays))
    out = np.zeros(hits.shape, bool)
    for row, col in np.argwhere((hits > 0) & (through >= clear) & (share < stays)):
        out[row, col] = not (np.abs(walls - (row, col)).max(axis=1, initial=0) <= reach).any()
    return out


def virtual_scan(hits, lattice, pose, directions, far_m, gap_cells, middle=False):
    ox, oy, cell = lattice
    x, y, yaw = pose
    u, v = (x - ox) / cell, (y - oy) / cell
    out = []
    for cx, cy in directions:
        angle = math.atan2(cy, cx) + yaw
        far = far_m / cell
        cluster, empty = [], 0
        for row, col in cells_between(u, v, u + far * math.cos(angle), v + far * math.sin(angle)):
            inside = 0 <= row < hits.shape[0] and 0 <= col < hits.shape[1]
            if inside and hits[row, col] > 0:
                cluster.append((hits[row, col], cell * math.hypot(col + 0.5 - u, row + 0.5 - v)))
                empty = 0
            elif cluster:
                empty += 1
                if empty > gap_cells:
                    break
        if cluster:
            most = max(n for n, _ in cluster)
            equal = [r for n, r in cluster if n == most]
            centre = 0.5 * (cluster[0][1] + cluster[-1][1])
            out.append(min(equal, key=lambda r: round(abs(r - centre), 8)) if middle else equal[0])
        else:
            out.append(math.nan)
    return np.array(out)


# ---- beams ---------------------------------------------------------------------------------------------------------


def good_beams(ranges_m, directions, first_rad, step_rad, mixed_pixel_m):
    out = []
    for i, (r, (c, s)) in enumerate(zip(ranges_m, directions, strict=True)):
        neighbours = [ranges_m[i - 1], ranges_m[i + 1]] if 0 < i < len(ranges_m) - 1 else [r]
        if math.isfinite(r) and not all(abs(r - other) > mixed_pixel_m for other in neighbours):
            out.append((r * c, r * s, i, r, first_rad + step_rad * i))
    return np.array(out).reshape(-1, 5)


# ---- polar_search --------------------------------------------------------------------------------------------------


def polar_cost(virtual, points, x, y, yaw, limits):
    first, step, near, far, occlusion, edge, least, counted = limits
    turn = 2 * math.pi / abs(step)
    placed = []
    for px, py, beam, r, _ in points:
        qx, qy = x + math.cos(yaw) * px - math.sin(yaw) * py, y + math.sin(yaw) * px + math.cos(yaw) * py
        placed.append(((math.atan2(qy, qx) - first) / step % turn, math.hypot(qx, qy), beam, r))
    contributions = []
    for j, expected in enumerate(virtual):
        radii = []
        for (a0, r0, beam0, raw0), (a1, r1, beam1, raw1) in pairwise(placed):
            ahead = (a1 - a0 + turn / 2) % turn - turn / 2
            if beam1 != beam0 + 1 or abs(raw1 - raw0) >= edge or not 0 < ahead < turn / 4:
                continue
            behind = (j - a0) % turn
            if behind <= ahead:
                radii.append(r0 + behind / ahead * (r1 - r0))
        if not radii or math.isnan(expected):
            continue
        seen = min(radii)
        if not (near < expected < far and near < seen < far):
            continue
        if counted or abs(seen - expected) < occlusion:
            contributions.append(min((seen - expected) ** 2, occlusion**2))
    if len(contributions) < max(least, 1):
        return math.inf, len(contributions)
    return sum(contributions) / len(contributions), len(contributions)


# ---- points --------------------------------------------------------------------------------------------------------


def scan_points(ranges_m, directions, twist, time_increment_s, near_m, far_m):
    out = []
    n = len(ranges_m)
    share = max(0.05, 2.75 * abs(np.linalg.det(np.asarray(directions)[:2]))) if n > 1 else 0.05
    for i, r in enumerate(ranges_m):
        if math.isnan(r) or not near_m < r < far_m:
            continue
        if 0 < i < n - 1 and all(abs(r - ranges_m[k]) > max(0.1, share * r) for k in (i - 1, i + 1)):
            continue
        late = time_increment_s * (i - (n - 1) / 2)
        x, y = r * directions[i][0], r * directions[i][1]
        a = twist[2] * late
        out.append(
            (math.cos(a) * x - math.sin(a) * y + twist[0] * late, math.sin(a) * x + math.cos(a) * y + twist[1] * late)
        )
    return np.array(out).reshape(-1, 2)


def points_between(points, step_rad, reach_m, spacing_m):
    """Join neighbouring end points of one wall: one by one, by angles and distances."""
    joined = []
    for k in range(len(points) - 1):
        a, b = points[k], points[k + 1]
        turned = abs(math.remainder(math.atan2(b[1], b[0]) - math.atan2(a[1], a[0]), math.tau))
        near, apart = min(np.hypot(*a), np.hypot(*b)), np.hypot(*(b - a))
        across = near * math.sin(turned)
        missing = math.sin(turned) > 1.5 * step_rad
        beside = [(a, points[k - 1])] if k else []
        beside += [(b, points[k + 2])] if k + 2 < len(points) else []
        straight = False
        for at, other in beside:
            away = (a - b if at is a else b - a) / apart
            along, off = (other - at) @ away, abs(away[0] * (other - at)[1] - away[1] * (other - at)[0])
            straight |= along > 0 and off <= 0.02 + 0.2 * min(np.hypot(*(other - at)), apart)
        if across > reach_m and apart <= 3.0 and not missing and straight:
            count = int(apart / spacing_m)
            joined += [a + (b - a) * j / (count + 1) for j in range(1, count + 1)]
    return np.array(joined).reshape(-1, 2)


def voxel_means(points, voxel_m):
    """Return the means in any order."""
    voxels = defaultdict(list)
    for x, y in points:
        voxels[math.floor(x / voxel_m), math.floor(y / voxel_m)].append((x, y))
    return np.array([np.mean(members, axis=0) for members in voxels.values()]).reshape(-1, 2)


def extent(points):
    """Return the minimum and maximum coordinates: x, y, x, y."""
    xs, ys = [x for x, _ in points], [y for _, y in points]
    return min(xs), min(ys), max(xs), max(ys)


# ---- linemap, line_search ------------------------------------------------------------------------------------------


def cell_of(point, cell_m):
    return math.floor(point[1] / cell_m), math.floor(point[0] / cell_m)


def line_points(scans, cell_m, share):
    """Return the points that support lines, if new points of a cell wait until they exceed a share of the old ones."""
    known, new = defaultdict(list), defaultdict(list)
    for points in scans:
        for p in points:
            new[cell_of(p, cell_m)].append(p)
        for cell in {cell_of(p, cell_m) for p in points}:
            if len(new[cell]) > share * len(known[cell]):
                known[cell] += new.pop(cell)
    return [p for points in known.values() for p in points]


def insert_points(points, cell_m, sigma_m, noise_m, window=4):
    """Return the lines of all occupied cells from all points: cell (row, col) -> foot, metric A, supporting points.

    The foot is the centroid of the window across the wall, and that of the cell along it.
    """
    cells = defaultdict(list)
    for p in points:
        cells[cell_of(p, cell_m)].append(p)
    lines = {}
    for row, col in cells:
        weighted = [
            (math.exp(-0.5 * (i * i + j * j) * (cell_m / sigma_m) ** 2), q)
            for i in range(-window, window + 1)
            for j in range(-window, window + 1)
            for q in cells.get((row + i, col + j), [])
        ]
        w = np.array([a for a, _ in weighted])
        q = np.array([b for _, b in weighted])
        mu = (w[:, None] * q).sum(0) / w.sum()
        cov = np.einsum("k,ki,kj->ij", w, q - mu, q - mu) / w.sum()
        (l2, l1), vectors = np.linalg.eigh(cov)
        normal, along = vectors.T
        beta = (l2 + noise_m**2) / (l1 + noise_m**2)
        own = np.mean(cells[row, col], axis=0)
        foot = own + normal * (normal @ (mu - own)) + along * beta * (along @ (mu - own))
        lines[row, col] = (foot, beta * np.eye(2) + (1 - beta) * np.outer(normal, normal), w.sum())
    return lines


def line_costs(points, pose, lines, cell_m, truncate_m, reach=8):
    """Return each point's truncated squared distance to the line of the nearest occupied cell; None for a tie."""
    x, y, yaw = pose
    costs = []
    for px, py in points:
        p = np.array([x + math.cos(yaw) * px - math.sin(yaw) * py, y + math.sin(yaw) * px + math.cos(yaw) * py])
        row, col = cell_of(p, cell_m)
        distance = sorted(((r - row) ** 2 + (c - col) ** 2, (r, c)) for r, c in lines)
        d2 = distance[0][0]
        if d2 > reach * reach:
            costs.append(truncate_m**2)
        elif len(distance) > 1 and distance[1][0] == d2:
            costs.append(None)
        else:
            mu, a = lines[distance[0][1]][:2]
            costs.append(min((p - mu) @ a @ (p - mu), truncate_m**2))
    return costs


def on_mapped_area(points, pose, line_map, overlap_m, known_points):
    """Return the points with an occupied cell within ``overlap_m`` whose line has at least ``known_points`` points.

    If these are fewer than half, return all points. Of equally near occupied cells, the one hit first is used.
    """
    occupied = line_map.cells[1 : line_map.count] + np.array(line_map.origin_cells)[::-1]
    counts, window = line_map.moments[1 : line_map.count, 0], 4
    x, y, yaw = pose
    kept = []
    for px, py in points:
        p = np.array([x + math.cos(yaw) * px - math.sin(yaw) * py, y + math.sin(yaw) * px + math.cos(yaw) * py])
        away = ((occupied - cell_of(p, line_map.cell_m)) ** 2).sum(axis=1)
        apart = occupied - occupied[away.argmin()]
        weights = np.exp(-0.5 * (apart**2).sum(axis=1) * (line_map.cell_m / line_map.line_sigma_m) ** 2)
        support = (weights * counts)[(abs(apart) <= window).all(axis=1)].sum()
        if math.sqrt(away.min()) * line_map.cell_m <= overlap_m + 1e-9 and support >= known_points:
            kept.append((px, py))
    return np.array(kept if len(kept) >= 0.5 * len(points) else points)


def smooth(xy, elapsed, stiffness):
    """Return the smoothed positions from the dense system, and the log-likelihood of the accelerations.

    The likelihood assumes white noise of the positions with the optimal scale.
    """
    n = len(xy)
    rates = np.diff(np.eye(n), axis=0) / elapsed[:, None]
    accelerations = np.diff(rates, axis=0) * 2 / (elapsed[1:] + elapsed[:-1])[:, None]
    noise = accelerations @ accelerations.T + np.eye(n - 2) / stiffness
    seen = accelerations @ xy
    misfit = (seen * np.linalg.solve(noise, seen)).sum()
    likely = -(n - 2) * np.log(misfit) - np.linalg.slogdet(noise)[1]
    return np.linalg.solve(np.eye(n) + stiffness * accelerations.T @ accelerations, xy), likely


def fixed_cost(points, at, motion, line_map, truncate_m):
    """Return the sum of squared distances after a motion of the centroid, with the correspondences before it.

    ``at`` is x, y, yaw before the motion; ``motion`` is right, up and turn, each a number or an array over motions. A
    point that was truncated before stays truncated.
    """
    (x, y, yaw), (right, up, turn) = at, motion
    there, total = yaw + turn, 0.0
    for px, py in points:
        before = (x + math.cos(yaw) * px - math.sin(yaw) * py, y + math.sin(yaw) * px + math.cos(yaw) * py)
        after = (x + right + np.cos(there) * px - np.sin(there) * py, y + up + np.sin(there) * px + np.cos(there) * py)
        row, col = np.array(cell_of(before, line_map.cell_m)) - line_map.origin_cells[::-1]
        inside = 0 <= row < line_map.nearest.shape[0] and 0 <= col < line_map.nearest.shape[1]
        mu_x, mu_y, xx, xy, yy = line_map.lines[line_map.nearest[row, col] // 128 if inside else 0, :5]
        d2 = [
            (u - mu_x) ** 2 * xx + 2 * (u - mu_x) * (v - mu_y) * xy + (v - mu_y) ** 2 * yy for u, v in (before, after)
        ]
        total = total + (d2[1] if d2[0] < truncate_m**2 else truncate_m**2)
    return total


def pose_costs(points, xy_map_m, yaws_rad, lines, cell_m, truncate_m):
    """Return the mean cost at every yaw and position; None for a tie of cells."""
    costs = [[line_costs(points, (x, y, yaw), lines, cell_m, truncate_m) for x, y in xy_map_m] for yaw in yaws_rad]
    return [[None if None in point else sum(point) / len(point) for point in row] for row in costs]


def separate_minima(costs, xy_map_m, yaws_rad, separate, most):
    """Return cost, yaw and position of the lowest finite costs of which none is near another, the lowest first."""
    found = []
    for cost, q, p in sorted((costs[q, p], q, p) for q in range(len(yaws_rad)) for p in range(len(xy_map_m))):
        turned = [abs((yaws_rad[q] - yaws_rad[k] + math.pi) % math.tau - math.pi) for _, k, _ in found]
        moved = [math.dist(xy_map_m[p], xy_map_m[k]) for _, _, k in found]
        near = any(t < separate[1] and m < separate[0] for t, m in zip(turned, moved, strict=True))
        if math.isfinite(cost) and not near and len(found) < most:
            found.append([cost, q, p])
    return found


def lowest_poses(costs, xy_m, yaws_rad, separate, most):
    """Return the lowest costs (q, p) in order, each separated from those before it, as (cost, q, p)."""
    found = []
    for cost, q, p in sorted((cost, q, p) for q, row in enumerate(costs) for p, cost in enumerate(row)):
        turns = [abs(np.angle(np.exp(1j * (yaws_rad[q] - yaws_rad[other])))) for _, other, _ in found]
        steps = [np.hypot(*(xy_m[p] - xy_m[other])) for _, _, other in found]
        if all(turn >= separate[1] or step >= separate[0] for turn, step in zip(turns, steps, strict=True)):
            found.append((cost, q, p))
        if len(found) == most:
            break
    return found


def cost_floors(lines, box, step, truncate_m, levels):
    """Return the bounds of the cells of a box by level; ``lines`` as in ``line_costs``, of the nearest cell."""
    first_row, first_col, rows, cols = box

    def least(row, col):
        foot, metric, middle, half_m = lines(row, col) or (None, None, None, None)
        if foot is None:
            return 255
        off = middle - foot
        return int(255 * min(max(np.sqrt(off @ metric @ off) - half_m, 0.0) / truncate_m, 1.0) ** 2)

    cells = {(r, c): least(first_row + r, first_col + c) for r in range(rows) for c in range(cols)}
    out = np.zeros((levels, rows, cols), int)
    for level, r, c in np.ndindex(out.shape):
        shifts = [step * k for k in range(2**level)]
        out[level, r, c] = min(cells.get((r + i, c + j), 255) for i in shifts for j in shifts)
    return out


def observability(points, map_T_laser, line_map, within_m=np.inf, known_points=0.0):
    """Return the smallest eigenvalue of the mean information of points (n, 2), the total (3, 3), and pulls by squares.

    The information of a point comes from the normal of its line, and its pull (x, y, yaw) from its distance along that.
    """
    arm = np.linalg.norm(points, axis=1).mean()
    information, pulls = np.zeros((3, 3)), {}
    for x, y in transform_points(map_T_laser, points):
        col, row = np.floor((np.array([x, y]) - line_map.geometry[:2]) / line_map.cell_m).astype(int)
        inside = 0 <= row < line_map.nearest.shape[0] and 0 <= col < line_map.nearest.shape[1]
        slot = line_map.nearest[row, col] // 128 if inside else 0
        if slot == 0 or line_map.lines[slot, 5] < known_points:
            continue
        (axx, axy, ayy), off = line_map.lines[slot, 2:5], (x, y) - line_map.lines[slot, :2]
        metric = np.array([[axx, axy], [axy, ayy]])
        if off @ metric @ off >= within_m**2:
            continue
        (along_it, _), axes = np.linalg.eigh(metric)
        nx, ny = axes[:, 1]
        jacobian = np.array([nx, ny, ny * (x - map_T_laser.x_m) - nx * (y - map_T_laser.y_m)])
        information += (1.0 - along_it) * np.outer(jacobian, jacobian)
        square = np.floor(x / 0.3), np.floor(y / 0.3)
        pulls[square] = pulls.get(square, 0.0) - (1.0 - along_it) * (axes[:, 1] @ off) * jacobian
    units = np.array([1.0, 1.0, 1.0 / arm])
    return np.linalg.eigvalsh(information * np.outer(units, units) / len(points))[0], information, pulls


def coarse_to_fine(terms, start, grid, limits, dense, few=None, on_known=None, hopeless=None):
    """Run the schedule of ``line_search.search`` over any cost(x, y, yaw) of the pose, rotating about the pivot.

    ``terms`` are the cost, the pivot, the motion-prior cost per m2 between the pivot and its expected position, and
    fixed(at, motion), the cost after motions of the pivot with fixed correspondences. Within a cell, correspondences
    are fixed only for ``dense`` scans. Levels that may change correspondences use the terms ``few``, until the first
    level within a cell is repeated with the terms that ``on_known`` returns for its pose; finer levels alternate once.
    If ``hopeless(terms, pose)`` is true after the first grids with free correspondences, that pose is returned.
    """
    azimuths, nx, ny, extensions = map(int, grid[:4])
    half_m, half_rad, stop_m, stop_rad = limits[:4]
    pose, joint, (fixed_below_m, cell_m) = start, int(limits[6]), limits[8:10]
    alternations = joint
    while True:
        step_m, step_rad = 2 * half_m / (min(nx, ny) - 1), 2 * half_rad / (azimuths - 1)
        last, within = step_m < stop_m and step_rad < stop_rad, half_m <= cell_m
        fixed, sampled = half_m <= fixed_below_m and (dense or not within), within and on_known
        used = terms if on_known is None or (fixed and not sampled) else few
        for turn in range(joint + extensions if fixed else 0):
            pose, bordering = _best_of_both(used, pose, half_m, half_rad, grid, start)
            if turn + 1 >= joint and not bordering:
                break
        for turn in range((1 if sampled or (last and within) else 0) if fixed else alternations):
            pose = _best_turn(used, pose, half_rad, grid)
            pose = _best_shift(used, pose, half_m, grid, start)
            if turn == 0 and not fixed and half_m == limits[0] and hopeless and hopeless(used, pose):
                return pose
        if sampled:
            terms, on_known = on_known(*pose), None
            continue
        if last:
            return pose
        if within:
            alternations = 1
        half_m, half_rad = min(1.5 * step_m, 0.9 * half_m), min(1.5 * step_rad, 0.9 * half_rad)


def _middle(pose, pivot):
    """Return the position in the map of the pivot, given in the laser's frame."""
    (x, y, yaw), (px, py) = pose, pivot
    return np.array([x + math.cos(yaw) * px - math.sin(yaw) * py, y + math.sin(yaw) * px + math.cos(yaw) * py])


def _best_of_both(terms, pose, half_m, half_rad, grid, start):
    """Return the best pose with fixed correspondences, and whether it is on the border of the joint grid."""
    _, pivot, prior, fixed = terms
    azimuths, nx, ny = map(int, grid[:3])
    turns, rights, ups = (np.linspace(-h, h, n) for h, n in ((half_rad, azimuths), (half_m, nx), (half_m, ny)))
    turn, up, right = np.meshgrid(turns, ups, rights, indexing="ij")
    at = _middle(pose, pivot)
    expected = at - _middle(start, pivot)
    costs = fixed((*at, pose[2]), (right, up, turn))
    costs = costs + prior * ((right + expected[0]) ** 2 + (up + expected[1]) ** 2)
    a, j, i = np.unravel_index(costs.argmin(), costs.shape)
    x, y, yaw = _turned(pose, pivot, turns[a])
    bordering = not (0 < a < azimuths - 1 and 0 < j < ny - 1 and 0 < i < nx - 1)
    return (x + rights[i], y + ups[j], yaw), bordering


def _turned(pose, pivot, turn):
    """Return the pose after a turn about the pivot, which is given in the laser's frame."""
    x, y, yaw = pose
    (px, py), there = pivot, yaw + turn
    at_x, at_y = x + math.cos(yaw) * px - math.sin(yaw) * py, y + math.sin(yaw) * px + math.cos(yaw) * py
    return at_x - math.cos(there) * px + math.sin(there) * py, at_y - math.sin(there) * px - math.cos(there) * py, there


def _best_turn(terms, pose, half_rad, grid):
    cost, pivot, *_ = terms
    azimuths = int(grid[0])
    for _ in range(int(grid[3]) + 1):
        poses = [_turned(pose, pivot, turn) for turn in np.linspace(-half_rad, half_rad, azimuths)]
        best = min(range(azimuths), key=lambda i: (cost(*poses[i]), i))
        pose = poses[best]
        if 0 < best < azimuths - 1:
            break
    return pose


def _best_shift(terms, pose, half_m, grid, start):
    cost, pivot, prior, _ = terms
    nx, ny = int(grid[1]), int(grid[2])

    def costs(ji):
        return cost(*poses[ji]) + prior * ((_middle(poses[ji], pivot) - _middle(start, pivot)) ** 2).sum(), ji

    for _ in range(int(grid[3]) + 1):
        x, y, yaw = pose
        rights, ups = np.linspace(-half_m, half_m, nx), np.linspace(-half_m, half_m, ny)
        poses = {(j, i): (x + rights[i], y + ups[j], yaw) for j in range(ny) for i in range(nx)}
        j, i = min(poses, key=costs)
        pose = poses[j, i]
        if 0 < i < nx - 1 and 0 < j < ny - 1:
            break
    return pose


# ---- conflicts -----------------------------------------------------------------------------------------------------


def conflicts(xy_map_m, laser_xy_m, lattice, hits, passes, wall=4, free=3, reach=7, graze=10):
    """Return the number of points in free space or behind walls, checking the cells of each beam one by one."""
    u, v = (np.asarray(xy_map_m) - lattice[:2]).T / lattice[2]
    u0, v0 = (np.asarray(laser_xy_m) - lattice[:2]) / lattice[2]
    count = 0
    for u1, v1 in zip(u, v, strict=True):
        row, col = math.floor(v1), math.floor(u1)
        inside = 0 <= row < hits.shape[0] and 0 <= col < hits.shape[1]
        near = hits[max(row - reach, 0) : row + reach + 1, max(col - reach, 0) : col + reach + 1]
        in_free_space = inside and passes[row, col] >= free and not near.any()
        length = math.hypot(u1 - u0, v1 - v0)
        way = [(v0 + i * (v1 - v0) / length, u0 + i * (u1 - u0) / length) for i in range(2, int(length - graze))]
        cells = [(math.floor(r), math.floor(c)) for r, c in way]
        occluders = [hits[at] for at in cells if 0 <= at[0] < hits.shape[0] and 0 <= at[1] < hits.shape[1]
               and hits[at] >= max(wall, passes[at])]  # fmt: skip
        count += bool(in_free_space or occluders)
    return count


def add_to_slices(
    points: np.ndarray, laser: np.ndarray, lattice: np.ndarray, levels: np.ndarray, hits: np.ndarray, passes: np.ndarray
) -> None:
    """Cut each beam where it enters a cell or a slice, and count the middle of each piece."""
    corner, edge = np.array([*lattice[:2], levels[0]]), np.array([lattice[2], lattice[2], levels[1]])
    for point in points:
        a, b = (laser - corner) / edge, (point - corner) / edge
        cuts = [0.0, 1.0]
        for start, end in zip(a, b, strict=True):
            between = np.arange(np.ceil(min(start, end)), np.floor(max(start, end)) + 1)
            cuts += ((between - start) / (end - start)).tolist()
        cuts = sorted(cuts)
        for t in (np.array(cuts[:-1]) + cuts[1:]) / 2:
            col, row, layer = np.floor(a + t * (b - a)).astype(int)
            if 0 <= layer < len(hits):
                passes[layer, row, col] += 1
        col, row, layer = np.floor(b).astype(int)
        if 0 <= layer < len(hits):
            passes[layer, row, col] -= 1
            hits[layer, row, col] += 1


def naive_sweep_shift(scan, twist):
    """Return x, y and yaw of the laser at mid-sweep in the scan as recorded, by one least-squares fit."""
    used = np.flatnonzero(np.isfinite(scan.ranges_m))
    recorded = scan.ranges_m[used, None] * scan.spec.directions[used]
    poses = [Pose(*(twist * scan.late_s[i])) for i in used]
    seen = np.array([transform_points(pose, p[None])[0] for pose, p in zip(poses, recorded, strict=True)])
    rows, right = [], []
    for k in range(1, len(used) - 1):
        along_m = seen[k + 1] - seen[k - 1]
        apart_m = np.linalg.norm(along_m)
        normal = np.array((-along_m[1], along_m[0])) / apart_m
        if apart_m < JOINED_M and abs(normal @ (seen[k] - seen[k - 1])) <= BESIDE_M + BENT * apart_m:
            rows.append((*normal, normal @ (-seen[k][1], seen[k][0])))
            right.append(normal @ (recorded[k] - seen[k]))
    still = np.sqrt(STILL * len(rows)) * np.eye(3)
    answer = np.linalg.lstsq(np.vstack((rows, still)), np.concatenate((right, np.zeros(3))), rcond=None)
    return np.asarray(answer[0])
