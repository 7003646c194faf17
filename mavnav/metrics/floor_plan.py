"""The floor plan of a map: straight walls turned along the axes, with openings such as doors as gaps.

The lines of `straight_walls` are hypotheses; ends and offsets are those of the occupied cells along them.
"""

from __future__ import annotations

from itertools import chain
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from mavnav.mapping.occupancy_grid import FREE, Grid, occupancy, occupied_xy_m
from mavnav.metrics.map_quality import only_occupied
from mavnav.metrics.wall_spread import WallCuts
from mavnav.metrics.walls import Array, straight_walls, wall_sections
from mavnav.pose import Pose, transform_points
from mavnav.units import DEG

SNAP_RAD: Final = 5.0 * DEG
"""Walls that differ less from the main direction, or from its normal, are turned into it."""

SUPPORT_M, SUPPORT_CELLS = 0.03, 2.0
"""Greatest distance of the cells of a wall from its line, the larger of the two."""

HALF_WALL_M: Final = 0.1
"""Cells so near to a wall are not another wall beside it."""

LEAST_TURN_RAD, STRAIGHT_SHARE = 1.0 * DEG, 0.5
"""A picture is turned by no less, and if so much of the walls is along two axes."""

LEAST_RUN_M: Final = 0.45
"""Least length of a run along an axis: columns and slanted furniture have shorter ones."""

DENSE_SHARE: Final = 0.5
"""Least share of the cells of a run along an axis that are occupied."""

GAP_M: Final = 0.2
"""Greatest distance of two cells along one wall."""

LEAST_LENGTH_M: Final = 0.3
CORNER_M: Final = 0.2
"""Ends so near to another wall's line are moved onto it."""

OPENING_M: Final = (0.6, 1.6)
"""Least and greatest width of an opening that is called one; wider gaps are only gaps."""

BESIDE: Final = 1.5
"""Least length of the parts of a wall beside an opening, of its width."""

ACROSS_M: Final = 1e-6
"""A line along an axis moves less across it; coordinates are rounded."""

OPEN_SHARE: Final = 0.8
"""Share of the cells between two parts of a wall that are free if it has an opening there."""


class FloorPlan(Struct, frozen=True):
    """Walls (n, 4) and openings (m, 4), each x0, y0, x1, y1 in m, the longest wall first.

    They lie in the frame of the plan, which is that of the map turned about its origin: ``plan_T_map``. The longer side
    of the place lies along x.
    """

    walls: Array
    openings: Array
    plan_T_map: Pose


def floor_plan(grid: Grid, map_T_grid: Pose) -> FloorPlan:
    """Return the floor plan of a grid that lies at ``map_T_grid`` in the map frame.

    Walls that are too short to be measured, or too near to others, are looked for along the axes afterwards.
    """
    xy_m, free, straight = occupied_xy_m(grid), occupancy(grid) == FREE, _straight_lines(grid)
    yaw_rad = _main_direction(straight, xy_m)
    turn = Pose(0.0, 0.0, -yaw_rad)
    points = transform_points(turn, xy_m)
    straight[:, :2], straight[:, 3] = transform_points(turn, straight[:, :2]), straight[:, 3] - yaw_rad
    fresh = np.ones(len(points), np.bool_)
    walls, openings = [np.zeros((0, 4))], [np.zeros((0, 4))]
    for line in chain(straight, _axis_runs(points, grid.cell_m)):
        parts, near = _parts(points, line[:2], line[3], grid.cell_m, fresh)
        fresh &= ~near
        walls.append(parts)
        openings += [gap for gap in _gaps(parts) if _is_open(gap, grid, turn, free)]
    plan_T_map = Pose(0.0, 0.0, -yaw_rad - map_T_grid.yaw_rad)
    shift = np.tile(transform_points(plan_T_map, np.array([[map_T_grid.x_m, map_T_grid.y_m]]))[0], 2)
    closed, doors = _closed_corners(_sorted(np.vstack(walls))), _one_per_door(_sorted(np.vstack(openings)))
    return FloorPlan(closed + shift, doors + shift, plan_T_map)


def turn_to_walls(grid: Grid) -> Pose | None:
    """Return the turn of at most an eighth that brings most walls of a grid along the axes; None without any."""
    length_m, direction_rad = _straight_lines(grid)[:, 2:].T
    return Pose(0.0, 0.0, -_off_axes(length_m, direction_rad)) if len(length_m) else None


def _off_axes(length_m: Array, direction_rad: Array) -> float:
    """Return how far most walls, (n,) lengths and directions, are turned from the axes, in rad, at most an eighth.

    The mean of directions modulo a quarter turn is that of all walls first, then of those near it.
    """
    mean, near = 0.0, np.ones(len(length_m), np.bool_)
    for _ in range(5):
        mean = float(np.angle((length_m[near] * np.exp(4j * direction_rad[near])).sum())) / 4.0
        off = _beside_axes(direction_rad - mean) <= SNAP_RAD
        near = off if off.any() else near
    return mean


def _beside_axes(direction_rad: Array) -> Array:
    """Return the angles (n,) between directions and the nearest axis, rad."""
    return np.abs((direction_rad + np.pi / 4.0) % (np.pi / 2.0) - np.pi / 4.0)


def turn_to_cuts(cuts: WallCuts | None) -> float:
    """Return the turn of at most an eighth, in rad, after which the measured walls are along the axes of a picture.

    It is 0 where that is hardly a turn, and where the walls have no common direction.
    """
    if cuts is None or not len(cuts.length_m):
        return 0.0
    off_rad = _off_axes(cuts.length_m, cuts.direction_rad)
    straight = cuts.length_m @ (_beside_axes(cuts.direction_rad - off_rad) <= SNAP_RAD)
    turns = abs(off_rad) >= LEAST_TURN_RAD and straight >= STRAIGHT_SHARE * cuts.length_m.sum()
    return -off_rad if turns else 0.0


def _straight_lines(grid: Grid) -> Array:
    """Return the straight walls of a grid, the longest first: x, y and length in m, direction in rad, (n, 4)."""
    walls = straight_walls(wall_sections(only_occupied(grid), grid.cell_m, 1), grid)
    return np.array([(w.x_m, w.y_m, w.length_m, w.direction_deg * DEG) for w in walls]).reshape(-1, 4)


def _axis_runs(xy_m: Array, cell_m: float) -> Array:
    """Return runs of points (n, 2) along the axes, the longest first, as `_straight_lines` does."""
    runs = []
    for angle_rad in (0.0, np.pi / 2.0):
        axes = _axes(angle_rad)
        u, v = (xy_m @ axes).T
        row = np.floor(v / cell_m)
        order = np.lexsort((u, row))
        ends = (np.diff(row[order]) > 0) | (np.diff(u[order]) > max(GAP_M, SUPPORT_CELLS * cell_m))
        for some in np.split(order, np.flatnonzero(ends) + 1):
            length = float(np.ptp(u[some])) + cell_m if len(some) else 0.0
            if length >= LEAST_RUN_M and len(some) * cell_m >= DENSE_SHARE * length:
                runs.append((*(axes @ (u[some].mean(), v[some].mean())), length, angle_rad))
    return np.array(sorted(runs, key=lambda run: (-run[2], *run))).reshape(-1, 4)


def _sorted(lines: Array) -> Array:
    """Return lines (n, 4), the longest first."""
    return lines[np.lexsort((*lines.T, -_lengths(lines)))]


def _lengths(lines: Array) -> Array:
    return np.hypot(lines[:, 2] - lines[:, 0], lines[:, 3] - lines[:, 1])


def _main_direction(lines: Array, xy_m: Array) -> float:
    """Return the direction of the longer side of points (n, 2), of the two of most walls, in [-pi/2, pi/2).

    The walls (n, 4) have their lengths and directions last.
    """
    mean = _off_axes(*lines[:, 2:].T)
    along, across = np.ptp(xy_m @ _axes(mean), axis=0) if len(xy_m) else (0.0, 0.0)
    return (mean + (np.pi / 2.0 if across > along else 0.0) + np.pi / 2.0) % np.pi - np.pi / 2.0


def _axes(angle_rad: float) -> Array:
    """Return the unit vectors along and across a direction as columns, (2, 2)."""
    c, s = np.round((np.cos(angle_rad), np.sin(angle_rad)), 12) + 0.0
    return np.array([[c, -s], [s, c]])


def _parts(
    xy_m: Array, middle: Array, angle_rad: float, cell_m: float, fresh: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the parts (n, 4) of the wall on a line in their order along it, and which points are near them.

    Points (n, 2) of the wall are near the line as it is; its parts get the direction of an axis, if that is near. Parts
    of which most points are not ``fresh`` belong to a wall that is known.
    """
    along, across = ((xy_m - middle) @ _axes(angle_rad)).T
    wall = np.flatnonzero(np.abs(across) <= max(SUPPORT_M, SUPPORT_CELLS * cell_m))
    wall = wall[np.argsort(along[wall], kind="stable")]
    chains = [c for c in _split(wall, along, OPENING_M[1]) if along[c[0]] <= 0.0 <= along[c[-1]]]
    groups = [group for chain in chains for group in _split(chain, along, max(GAP_M, SUPPORT_CELLS * cell_m))]
    axis_rad = round(angle_rad / (np.pi / 2.0)) * np.pi / 2.0
    axes = _axes(axis_rad if abs(angle_rad - axis_rad) <= SNAP_RAD else angle_rad)
    u, v = ((xy_m - middle) @ axes).T
    least_m = LEAST_LENGTH_M - cell_m
    kept = [g for g in groups if along[g[-1]] - along[g[0]] >= least_m and 2 * np.count_nonzero(fresh[g]) >= len(g)]
    near = np.zeros(len(xy_m), np.bool_)
    if not kept:
        return np.zeros((0, 4)), near
    offset = float(v[np.concatenate(kept)].mean())
    spans = [(u[group].min() - cell_m / 2.0, u[group].max() + cell_m / 2.0) for group in kept]
    for group in kept:
        low, high = along[group[0]] - cell_m, along[group[-1]] + cell_m
        near |= (np.abs(across) <= HALF_WALL_M) & (along >= low) & (along <= high)
    ends = np.array([[(low, offset), (high, offset)] for low, high in spans])
    return (middle + ends @ axes.T).reshape(-1, 4), near


def _split(some: NDArray[np.intp], along: Array, gap_m: float) -> list[NDArray[np.intp]]:
    """Split points, in their order along a line, where two are farther apart than ``gap_m``."""
    return [part for part in np.split(some, np.flatnonzero(np.diff(along[some]) > gap_m) + 1) if len(part)]


def _gaps(parts: Array) -> Array:
    """Return the gaps between the parts of a wall along an axis that are as wide as openings.

    The parts on both sides are longer together: two pieces of furniture in a line have no door between them.
    """
    gaps = np.column_stack((parts[:-1, 2:], parts[1:, :2]))
    width_m, beside_m = _lengths(gaps), _lengths(parts[:-1]) + _lengths(parts[1:])
    straight = np.abs(gaps[:, 2:] - gaps[:, :2]).min(axis=1) < ACROSS_M
    return np.asarray(
        gaps[straight & (width_m >= OPENING_M[0]) & (width_m <= OPENING_M[1]) & (beside_m >= BESIDE * width_m)]
    )


def _is_open(gap: Array, grid: Grid, plan_T_grid: Pose, free: NDArray[np.bool_]) -> bool:
    """Return whether the laser saw through most of a gap."""
    share = np.linspace(0.0, 1.0, 2 + int(np.hypot(*(gap[2:] - gap[:2])) / grid.cell_m))[1:-1, None]
    xy_m = transform_points(plan_T_grid.inverse(), gap[:2] + share * (gap[2:] - gap[:2]))
    col, row = np.floor((xy_m - grid.origin_xy_m) / grid.cell_m).astype(np.int64).T
    return float(free[row, col].mean()) >= OPEN_SHARE


def _one_per_door(openings: Array) -> Array:
    """Leave out openings beside another one, on the other face of the same wall."""
    kept: list[Array] = []
    for gap in openings:
        if all(np.abs(gap - other).max() > 2.0 * CORNER_M for other in kept):
            kept.append(gap)
    return np.array(kept).reshape(-1, 4)


def _closed_corners(walls: Array) -> Array:
    """Move ends of walls (n, 4) onto the lines of other walls that pass near them."""
    closed = walls.copy()
    ends, step = walls.reshape(-1, 2, 2), walls[:, 2:] - walls[:, :2]
    for k, at in np.ndindex(len(walls), 2):
        cross = step[k, 0] * step[:, 1] - step[k, 1] * step[:, 0]
        steep = np.abs(cross) > 0.5 * np.hypot(*step[k]) * np.hypot(*step.T)
        off = ends[:, 0] - ends[k, at]
        safe = np.where(steep, cross, 1.0)
        along = (off[:, 0] * step[:, 1] - off[:, 1] * step[:, 0]) / safe * np.hypot(*step[k])
        other = (off[:, 0] * step[k, 1] - off[:, 1] * step[k, 0]) / safe
        margin = CORNER_M / np.hypot(*step.T)
        near = steep & (np.abs(along) <= CORNER_M) & (other >= -margin) & (other <= 1.0 + margin)
        if near.any():
            best = np.argmin(np.where(near, np.abs(along), np.inf))
            closed[k, 2 * at : 2 * at + 2] += along[best] * step[k] / np.hypot(*step[k])
    return closed
