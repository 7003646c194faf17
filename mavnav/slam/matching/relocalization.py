"""Correlative search of a wide region, or of the whole map, for the poses of a scan, and their ranking."""

from __future__ import annotations

from functools import lru_cache
from math import atan2, pi
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.kernels.maps.conflicts import conflicts
from mavnav.kernels.maps.free_cells import free_positions
from mavnav.kernels.scans.correlative_search import separate_minima
from mavnav.kernels.scans.lowest_poses import lowest_poses
from mavnav.kernels.scans.points import extent
from mavnav.mapping.line_map import LineMap
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.mapping.tiled_arrays import Extent
from mavnav.pose import Pose, wrap_angle
from mavnav.profiling import as_stage
from mavnav.slam.matching.scan_matching import Match, Schedule, search_lines, with_effort
from mavnav.units import DEG

Floats = NDArray[np.float64]
Region = tuple[Floats, Floats]
"""Positions (p, 2), m, and yaws (q,), rad, map frame; the poses are all their combinations."""
Start = tuple[float, Pose]
"""Cost, m2, and pose of a minimum of the search."""
Credit = NDArray[np.int64]
"""Number of squares and positions (1,) that searches may still look at; at 0 they return nothing."""


STEP_M, STEP_RAD = 0.1, 4 * DEG
"""Spacing of the search: the cost of a point depends on walls up to 0.15 m away."""

REFINED = 1.5 * STEP_M, 1.5 * STEP_RAD
"""Half-widths of the search that refines a minimum, m and rad."""

SEPARATE_M, SEPARATE_RAD = 0.25, 12 * DEG
SEPARATE = np.array((SEPARATE_M, SEPARATE_RAD))
"""Distance and rotation up to which two poses are the same minimum."""

_ROW = 1 << 20
"""Length of a row in the numbering of lattice positions."""

START_M, START_RAD = 1.0, 45 * DEG
"""Radius and half-width of the search around a given start pose, m and rad."""

CANDIDATES, MAP_CANDIDATES = 6, 30
"""Numbers of minima of a region, and of a whole given map, that are refined and compared."""

WORTH_PRUNING = 1 << 19
"""Minimum number of point cost evaluations of a search that is pruned; below, the exhaustive search is faster."""

AT_ONCE = 1 << 16
"""Number of positions whose costs an exhaustive search holds at a time, in 47 MB."""

MOST_SQUARES = 500_000
"""Number of squares and positions at which a search ends, or all searches that share a credit, without a result.

Searches in recorded maps look at up to 88 000, and 7 of 12 that must agree on a map in another at 400 000.
"""

FARTHEST_M = 2.5
"""Largest radius of a search; a laser that is lost for longer is searched in the whole map."""

PRIOR = 0.05
"""Weight of the motion cost beside the misfit."""

ACCELERATION_M_S2, ACCELERATION_RAD_S2 = 4.0, 600 * DEG
SLACK_M, SLACK_RAD = 0.1, 5 * DEG
"""Strong accelerations of vehicles and hands, and the error of velocity estimates and stamps; for the motion cost."""

MOST_MOTION_COST = 4.0
"""Upper limit of the motion cost: beyond, someone carried the laser, and all poses are equally likely."""

AMBIGUITY_MARGIN = 0.05
"""Minimum difference in rank to another pose; below, a match is ambiguous."""

AGREEING_SCANS = 3
"""Number of scans that must agree on a pose after a gap, or on that of a part: one may fit by chance."""

DIRECTIONS_RAD = np.arange(8, dtype=np.float64) * (pi / 4)
"""Directions of the steps that test whether a pose is observable."""

ACROSS = 0.2
"""Minimum increase of the cost, as a share of the worst cost, ``SEPARATE_M`` across an unobservable direction."""

CONFLICT_POINTS = 150
"""Number of points, a sample of the scan, for the visibility conflicts."""


@as_stage("gate")
def with_conflicts(match: Match, points: Floats, line_map: LineMap, grid: GridBuilder) -> Match:
    """Return the match with the visibility conflicts of its points (n, 2), laser frame."""
    pose, counts, some = match.map_T_laser.as_array(), (grid.lattice, grid.hits, grid.passes), points[:CONFLICT_POINTS]
    count = conflicts(some, pose, *counts, line_map.nearest, line_map.geometry)
    return match._replace(conflicts=count / max(len(some), 1))


def misfit(match: Match, config: Config) -> float:
    """Return the cost of a match as a share of the worst cost, plus its share of visibility conflicts; 0 is best."""
    return match.cost_m2 / config.robust.expert.truncate_m**2 + match.conflicts


def within_reach(pose: Pose, elapsed_s: float) -> Region:
    """Return the poses that a vehicle can reach from a pose in the elapsed time: a disc of positions, and yaws."""
    radius_m = float(np.clip(0.15 + 1.5 * elapsed_s, 0.3, FARTHEST_M))
    half_rad = float(np.clip(10 * DEG + 150 * DEG * elapsed_s, 20 * DEG, pi))
    return around(pose, radius_m, half_rad)


def within_reach_of(poses: tuple[Pose, ...], elapsed_s: float) -> Region:
    """Return the poses that a vehicle can reach from any of several poses: the union of the discs, and their yaws.

    Positions are on the lattice of the first pose, and occur once where discs overlap.
    """
    first_xy, yaws_rad = within_reach(poses[0], elapsed_s)
    cells = [np.round((within_reach(p, elapsed_s)[0] - first_xy[0]) / STEP_M).astype(np.int64) for p in poses]
    col, row = np.concatenate(cells).T
    row, col = np.divmod(np.unique(row * _ROW + col + _ROW // 2), _ROW)
    more_rad = max(abs(wrap_angle(pose.yaw_rad - poses[0].yaw_rad)) for pose in poses)
    half_rad = min(pi, 0.5 * (len(yaws_rad) - 1) * STEP_RAD + more_rad)
    return first_xy[0] + STEP_M * np.column_stack((col - _ROW // 2, row)), around(poses[0], 0.0, half_rad)[1]


def around(pose: Pose, radius_m: float, half_rad: float) -> Region:
    """Return the poses around a pose: a disc of positions, m, and yaws within ``half_rad``."""
    k = int(np.ceil(half_rad / STEP_RAD))
    return _disc(radius_m) + pose.as_array()[:2], pose.yaw_rad + STEP_RAD * np.arange(-k, k + 1, dtype=np.float64)


@lru_cache(maxsize=8)
def _disc(radius_m: float) -> Floats:
    """Return the lattice positions (p, 2) of a disc about the origin, m."""
    n = int(np.ceil(radius_m / STEP_M))
    rows, cols = np.indices((2 * n + 1, 2 * n + 1), dtype=np.float64)
    lattice = STEP_M * (np.column_stack((cols.ravel(), rows.ravel())) - n)
    return np.asarray(lattice[np.hypot(*lattice.T) <= radius_m + 1e-9])


def everywhere(grid: GridBuilder) -> Region:
    """Return the free positions (p, 2) of the map, row by row, m, and the yaws (q,) of a full turn, rad."""
    yaws_rad = np.arange(-pi, pi, STEP_RAD)
    if not grid.passes.size:
        return np.zeros((0, 2)), yaws_rad
    axes = zip(grid.origin_xy_m[::-1], grid.passes.shape, strict=True)
    centres_m = (first_m + (np.arange(n) + 0.5) * grid.cell_m for first_m, n in axes)
    cells = [np.round(axis_m / STEP_M).astype(np.int64) for axis_m in centres_m]
    row, col = np.nonzero(free_positions(grid.hits, grid.passes, *(lattice - lattice[0] for lattice in cells)))
    return np.column_stack(((col + cells[1][0]) * STEP_M, (row + cells[0][0]) * STEP_M)), yaws_rad


def candidates(
    points: Floats,
    line_map: LineMap,
    grid: GridBuilder,
    region: Region,
    config: Config,
    most: int = CANDIDATES,
    limit: float = np.inf,
    credit: Credit | None = None,
) -> list[Match]:
    """Return `refined_minima` with their visibility conflicts."""
    matches = refined_minima(points, line_map, region, config, most, limit, credit)
    return [with_conflicts(match, points, line_map, grid) for match in matches]


@as_stage("search")
def refined_minima(
    points: Floats,
    line_map: LineMap,
    region: Region,
    config: Config,
    most: int = CANDIDATES,
    limit: float = np.inf,
    credit: Credit | None = None,
) -> list[Match]:
    """Search a region of poses; return up to ``most`` separate minima, refined.

    Minima with a cost above ``limit``, a share of the worst cost, are left out. ``points`` (n, 2) are those of the
    scan, laser frame, m, shuffled, so that any prefix is a fair sample. ``credit`` is that of this search by default.
    """
    few, truncate_m = points[: config.robust.expert.first_level_points], config.robust.expert.truncate_m
    limit_m2, exhaustive = limit * truncate_m**2, config.search == "exhaustive"
    starts = lowest(few, line_map, region, truncate_m, most, limit_m2, credit, exhaustive=exhaustive)
    schedule = Schedule.of(config, line_map, REFINED)
    return [search_lines(points, line_map, pose, schedule) for _, pose in starts]


def reaches(points: Floats, line_map: LineMap, region: Region, config: Config, limit: float) -> bool:
    """Return whether the cost of a scan is at most ``limit``, a share of the worst, at a pose of a region.

    ``points`` (n, 2) as those of `refined_minima`, of which this is the first and cheaper part.
    """
    few, truncate_m = points[: config.robust.expert.first_level_points], config.robust.expert.truncate_m
    return bool(lowest(few, line_map, region, truncate_m, 1, limit * truncate_m**2))


def lowest(
    points: Floats,
    line_map: LineMap,
    region: Region,
    truncate_m: float,
    most: int,
    limit_m2: float = np.inf,
    credit: Credit | None = None,
    *,
    exhaustive: bool = False,
) -> list[Start]:
    """Return the ``most`` lowest separate minima of the cost of points (n, 2) in a region, up to ``limit_m2``.

    The pruned search returns the same minima as the exhaustive one. The exhaustive search is used for small regions,
    and if positions are not whole cells apart. The pruned one returns nothing if it uses up the credit.
    """
    credit = search_credit() if credit is None else credit
    xy_m, yaws_rad = region
    step = round(STEP_M / line_map.cell_m)
    small = len(xy_m) * len(yaws_rad) * len(points) < WORTH_PRUNING
    if exhaustive or small or abs(step * line_map.cell_m - STEP_M) > 1e-9:
        starts = lowest_exhaustive(points, line_map, region, truncate_m, most)
        return [start for start in starts if start[0] <= limit_m2]
    if not credit[0]:
        return []
    floors = line_map.cost_floors(truncate_m, step, reached_by(points, xy_m))
    bounds, lines = (floors.corner, floors.levels, floors.planes), (line_map.nearest, line_map.lines, line_map.geometry)
    poses = lowest_poses(points, xy_m, yaws_rad, truncate_m, SEPARATE, limit_m2, most, step, *bounds, *lines, credit)
    return starts_of(poses, xy_m, yaws_rad) if credit[0] else []


def search_credit() -> Credit:
    """Return the credit of a search, or of several that share it."""
    return np.array([MOST_SQUARES])


def reached_by(points: Floats, xy_m: Floats) -> Extent:
    """Return the extent that points (n, 2), laser frame, m, can have at positions (p, 2) and any yaw."""
    far_m = float(np.hypot(*points.T).max())
    x0, y0, x1, y1 = extent(xy_m)
    return x0 - far_m, y0 - far_m, x1 + far_m, y1 + far_m


def lowest_exhaustive(points: Floats, line_map: LineMap, region: Region, truncate_m: float, most: int) -> list[Start]:
    """Return the ``most`` lowest separate minima from the costs of all poses, for ``AT_ONCE`` positions at a time."""
    xy_m, yaws_rad = region
    starts: list[Start] = []
    for first in range(0, len(xy_m), AT_ONCE):
        some = xy_m[first : first + AT_ONCE]
        starts += minima(line_map.costs(points, some, yaws_rad, truncate_m), some, yaws_rad, most)
    return starts if len(starts) <= most else lowest_starts(starts, most)


def best_of(matches: list[Match], expected: tuple[Pose, ...], elapsed_s: float, config: Config) -> Match:
    """Return the match of lowest rank, by misfit and motion cost; ambiguous if another pose ranks about equally."""
    costs = (min(motion_cost(pose, m.map_T_laser, elapsed_s) for pose in expected) for m in matches)
    weighed = [m._replace(motion_cost=cost) for m, cost in zip(matches, costs, strict=True)]
    ranks = [misfit(m, config) + PRIOR * min(m.motion_cost, MOST_MOTION_COST) for m in weighed]
    lowest = min(ranks)
    best = weighed[ranks.index(lowest)]
    rivals = [rank for m, rank in zip(weighed, ranks, strict=True) if apart(best.map_T_laser, m.map_T_laser)]
    return with_effort(best, *matches)._replace(ambiguous=min(rivals, default=np.inf) < lowest + AMBIGUITY_MARGIN)


def unambiguous(matches: list[Match], margin: float, config: Config, least_m: float = SEPARATE_M) -> Match | None:
    """Return the match of least misfit; None without matches, or if another pose ranks within ``margin`` of it.

    Poses up to ``least_m`` away are the same.
    """
    ranked = sorted(matches, key=lambda match: misfit(match, config))
    best = next(iter(ranked), None)
    rival = next((m for m in ranked if best and apart(best.map_T_laser, m.map_T_laser, least_m)), None)
    clear = best and (rival is None or misfit(rival, config) >= misfit(best, config) + margin)
    return best if clear else None


def least_growth(points: Floats, map_T_laser: Pose, line_map: LineMap, config: Config) -> float:
    """Return the least increase of the cost at ``SEPARATE_M`` from a pose, over all directions.

    It is a share of the worst cost, and nearly 0 between parallel walls, where the position along them is not
    observable.
    """
    return float(growth(points, map_T_laser, line_map, DIRECTIONS_RAD, SEPARATE_M, config).min())


def growth(
    points: Floats, map_T_laser: Pose, line_map: LineMap, angles_rad: Floats, step_m: float, config: Config
) -> Floats:
    """Return the increase of the cost a step away from a pose in some directions (k,), as shares of the worst cost."""
    truncate_m = config.robust.expert.truncate_m
    steps = step_m * np.column_stack((np.cos(angles_rad), np.sin(angles_rad)))
    xy_m, yaw_rad = np.vstack(([(0.0, 0.0)], steps)) + map_T_laser.as_array()[:2], np.array([map_T_laser.yaw_rad])
    costs = line_map.costs(points, xy_m, yaw_rad, truncate_m)[0]
    return np.asarray((costs[1:] - costs[0]) / truncate_m**2)


def unobservable_direction(
    points: Floats, map_T_laser: Pose, line_map: LineMap, least: float, config: Config
) -> float | None:
    """Return the direction (rad, map frame) in which a pose can be moved at a cost below ``least``.

    None if there is no such direction, or if moving across it costs less than ``ACROSS``. The cost of small steps is a
    quadratic form, whose axis is the second harmonic of its values around the pose.
    """
    if least_growth(points, map_T_laser, line_map, config) >= least:
        return None
    small = growth(points, map_T_laser, line_map, DIRECTIONS_RAD, STEP_M, config)
    along_rad = 0.5 * atan2(-float(small @ np.sin(2 * DIRECTIONS_RAD)), -float(small @ np.cos(2 * DIRECTIONS_RAD)))
    across = along_rad + np.array((0.5, -0.5)) * pi
    return along_rad if growth(points, map_T_laser, line_map, across, SEPARATE_M, config).min() >= ACROSS else None


def motion_cost(expected: Pose, pose: Pose, elapsed_s: float) -> float:
    """Return the squared distance from the expected pose, relative to the reach of strong accelerations meanwhile."""
    off, half_t2 = expected.between(pose), 0.5 * elapsed_s**2
    reach_m, reach_rad = SLACK_M + ACCELERATION_M_S2 * half_t2, SLACK_RAD + ACCELERATION_RAD_S2 * half_t2
    return (off.distance_m / reach_m) ** 2 + (off.yaw_rad / reach_rad) ** 2


def apart(a: Pose, b: Pose, least_m: float = SEPARATE_M) -> bool:
    """Return whether two poses are too far apart to be the same minimum."""
    off = a.between(b)
    return off.distance_m > least_m or abs(off.yaw_rad) > SEPARATE_RAD


def is_near_start(pose: Pose, start: Pose) -> bool:
    """Return whether a pose is as near to a given start pose as that may be wrong."""
    off_m, off_rad = start.gap(pose)
    return off_m <= FARTHEST_M and off_rad <= START_RAD


def minima(costs: Floats, xy_m: Floats, yaws_rad: Floats, most: int = CANDIDATES) -> list[Start]:
    """Return the ``most`` lowest separate minima of the costs (q, p), with their poses; the costs are overwritten."""
    return starts_of(separate_minima(costs, xy_m, yaws_rad, SEPARATE, most), xy_m, yaws_rad)


def starts_of(rows: Floats, xy_m: Floats, yaws_rad: Floats) -> list[Start]:
    """Return the poses of minima (m, 3): cost, index of yaw and of position."""
    at = ((cost, *xy_m[int(p)].tolist(), float(yaws_rad[int(q)])) for cost, q, p in rows.tolist())
    return [(cost, Pose(x_m, y_m, wrap_angle(yaw_rad))) for cost, x_m, y_m, yaw_rad in at]


def lowest_starts(starts: list[Start], most: int) -> list[Start]:
    """Return the ``most`` lowest separate minima among those of several parts of a region."""
    kept: list[Start] = []
    for start in sorted(starts, key=itemgetter(0)):
        if all(apart(start[1], other) for _, other in kept):
            kept.append(start)
    return kept[:most]
