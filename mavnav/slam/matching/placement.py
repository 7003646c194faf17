"""Placement of many scans, whose poses in a frame of their own are known, in a given map: they must agree on one pose.

One scan fits a coarse map of thick walls at many places. Every scan proposes its best ones, and all scans judge them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from mavnav.config.models import Config
from mavnav.kernels.maps.layout import EXPLAINED_CELLS
from mavnav.mapping.line_map import LineMap
from mavnav.mapping.occupancy_grid import GridBuilder
from mavnav.pose import Pose, rigid_fit
from mavnav.slam.matching.relocalization import (
    AMBIGUITY_MARGIN,
    MAP_CANDIDATES,
    SEPARATE_M,
    Credit,
    apart,
    everywhere,
    is_near_start,
    lowest,
    search_credit,
    unambiguous,
    with_conflicts,
)
from mavnav.slam.matching.scan_matching import Match, Schedule, search_lines

PosedScan = tuple[Pose, NDArray[np.float64]]
"""The pose of a scan in a frame of its own, and its points (n, 2), m, laser frame, shuffled."""


AHEAD = Pose(1.0, 0.0, 0.0)
"""A point before the laser, by which headings count where the laser hardly moves."""


def place_together(
    scans: Sequence[PosedScan],
    lines: LineMap,
    grid: GridBuilder,
    config: Config,
    start: Pose | None = None,
    credit: Credit | None = None,
) -> Match | None:
    """Return the pose of the scans' own frame in the map, with the mean evidence of all scans.

    ``start`` is about where the first scan is, None if unknown. None without scans, if they fit another place about as
    well, or if the searches of all scans use up the credit. In a coarse map visibility conflicts do not tell near
    places apart: these are the same.
    """
    if not scans:
        return None
    middle = scans[len(scans) // 2][0]
    posed = [(middle.between(pose), points) for pose, points in scans]
    least_m = max(SEPARATE_M, EXPLAINED_CELLS * lines.cell_m)
    credit = search_credit() if credit is None else credit
    proposed = _propose(posed, lines, grid, config, credit)
    if start:
        proposed = [place for place in proposed if is_near_start(place @ posed[0][0], start)]
    places = _keep_best(proposed, posed, lines, config, least_m)
    best = unambiguous([_match_all(p, posed, lines, grid, config) for p in places], AMBIGUITY_MARGIN, config, least_m)
    return best._replace(map_T_laser=best.map_T_laser @ middle.inverse()) if best and credit[0] else None


def _propose(
    scans: Sequence[PosedScan], lines: LineMap, grid: GridBuilder, config: Config, credit: Credit
) -> list[Pose]:
    """Return the poses of the scans' frame at which one of them fits well."""
    region, expert = everywhere(grid), config.robust.expert
    few = ((pose, points[: expert.first_level_points]) for pose, points in scans)
    starts = (
        (pose, lowest(some, lines, region, expert.truncate_m, MAP_CANDIDATES, credit=credit)) for pose, some in few
    )
    return [start @ pose.inverse() for pose, poses in starts for _, start in poses]


def _keep_best(
    proposed: Sequence[Pose], scans: Sequence[PosedScan], lines: LineMap, config: Config, least_m: float
) -> list[Pose]:
    """Return the separate poses of the scans' frame that fit all scans best."""
    expert, kept = config.robust.expert, list[Pose]()
    some = [(pose, points[: expert.first_level_points]) for pose, points in scans]
    costs = [_mean_cost(place, some, lines, expert.truncate_m) for place in proposed]
    for k in np.argsort(costs, kind="stable").tolist():
        if len(kept) < MAP_CANDIDATES and all(apart(proposed[k], other, least_m) for other in kept):
            kept.append(proposed[k])
    return kept


def _mean_cost(place: Pose, scans: Iterable[PosedScan], lines: LineMap, truncate_m: float) -> float:
    """Return the mean cost of scans at one pose of their frame, m2."""
    at = ((place @ pose, points) for pose, points in scans)
    costs = (lines.costs(points, np.array([pose[:2]]), np.array([pose.yaw_rad]), truncate_m) for pose, points in at)
    return float(np.mean([cost[0, 0] for cost in costs]))


def _match_all(place: Pose, scans: Sequence[PosedScan], lines: LineMap, grid: GridBuilder, config: Config) -> Match:
    """Match every scan near a pose of their frame, moved to where they fit; return it with their mean evidence."""
    expert = config.robust.expert
    schedule = Schedule.of(config, lines, (expert.near_window_m, expert.near_window_rad))
    own_xy_m = _with_headings([pose for pose, _ in scans])
    for _ in range(2):
        matches = [search_lines(points, lines, place @ pose, schedule) for pose, points in scans]
        place = rigid_fit(own_xy_m, _with_headings([match.map_T_laser for match in matches]))
    pairs = zip(matches, scans, strict=True)
    judged = [with_conflicts(match, points, lines, grid) for match, (_, points) in pairs]
    cost_m2, inliers, conflicts = np.mean([(m.cost_m2, m.inliers, m.conflicts) for m in judged], axis=0).tolist()
    return judged[0]._replace(map_T_laser=place, cost_m2=cost_m2, inliers=inliers, conflicts=conflicts)


def _with_headings(poses: Sequence[Pose]) -> NDArray[np.float64]:
    """Return the positions of poses, and the points ahead of them, (2 n, 2), m."""
    return np.array([pose[:2] for pose in (*poses, *(pose @ AHEAD for pose in poses))])
