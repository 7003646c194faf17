"""The map of a run: what it is made of, its frame, the references in that, and what is measured of it.

Returns are used beyond the default range where most of a log's are, and motion above the default speed is accepted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec.structs import replace

from mavnav.config.models import Config, RobustConfig
from mavnav.config.option_kinds import NOWHERE, WALLS
from mavnav.config.options import ReplayOptions
from mavnav.errors import UsageError
from mavnav.ground_truth.references import References, check_times, compare_to, of_map, place_walls
from mavnav.logs import Log
from mavnav.logs.preprocessing import FARTHEST_M
from mavnav.mapping.occupancy_grid import Grid, known_area, measured_area, occupied_xy_m
from mavnav.mapping.slices import PlacedScan, Slices, scans_with_heights, slice_map
from mavnav.metrics.floor_plan import turn_to_walls
from mavnav.metrics.journey import Journey
from mavnav.metrics.map_quality import MeasuredMap, measure_map
from mavnav.metrics.reference import COVERED_M, position_errors
from mavnav.outputs.directory import checked_file, digests_of
from mavnav.outputs.documents.run_json import FoundPose, Localisation, StartPose
from mavnav.pose import MAX_GAP_NS, Pose, Trajectory
from mavnav.profiling import Stage, as_stage
from mavnav.slam.matching.odometry_fit import usual_speed
from mavnav.slam.matching.prior_map import PriorMap, prior_map_of
from mavnav.slam.methods.registry import LOCALIZERS
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    from mavnav.slam.result import SlamResult
    from mavnav.slam.track import Placement


LOOKED_AT: Final = 200
"""Number of scans that are looked at."""

MOST_BEYOND: Final = 0.5
"""Share of the returns beyond the default from which the laser's own limit takes its place."""


def config_for_log(config: Config, log: Log) -> tuple[Config, tuple[str, ...]]:
    """Return a configuration for the ranges and the speed of a log, and warnings of what is another."""
    config, reach = with_reach(config, log)
    config, speed = with_speed(config, log)
    return config, (*reach, *speed)


def with_reach(config: Config, log: Log) -> tuple[Config, tuple[str, ...]]:
    """Return a configuration that uses the returns of a log, and a warning if it is another.

    A ``robust.far_mm`` that is not the default stays.
    """
    far_m = config.robust.far_m
    limit_m = min(log.sensor.range_max_m, FARTHEST_M)
    if config.method != "robust" or config.robust.far_mm != RobustConfig().far_mm or limit_m <= far_m:
        return config, ()
    ranges_m = np.concatenate([scan.ranges_m for scan in islice(log.scans(), LOOKED_AT)])
    returns_m = ranges_m[np.isfinite(ranges_m)]
    beyond = np.count_nonzero(returns_m >= far_m) / max(len(returns_m), 1)
    if beyond <= MOST_BEYOND:
        return config, ()
    text = f"{100 * beyond:.0f} % of the returns are farther than {far_m:g} m; returns up to {limit_m:g} m are used"
    reaching = replace(config, robust=replace(config.robust, far_mm=limit_m / MM))
    return reaching, (f"{text}: set robust.far_mm to choose another limit",)


FASTEST_M_S, FASTER = 20.0, 1.5
"""Speed by odometry above which it is in another unit, and factor on it that gives the highest one to be accepted."""


def with_speed(config: Config, log: Log) -> tuple[Config, tuple[str, ...]]:
    """Return a configuration that accepts the speed of a log by its odometry, and a warning if it is another.

    A ``robust.max_speed_m_s`` that is not the default stays.
    """
    limit_m_s = config.robust.max_speed_m_s
    if config.method != "robust" or limit_m_s != RobustConfig().max_speed_m_s or log.odometry is None:
        return config, ()
    fast_m_s = usual_speed(log.odometry.odom_T_laser)
    if not limit_m_s < fast_m_s <= FASTEST_M_S:
        return config, ()
    accepted_m_s = round(FASTER * fast_m_s, 1)
    text = f"the vehicle moves at {fast_m_s:.1f} m/s by its odometry; up to {accepted_m_s:g} m/s is accepted"
    faster = replace(config, robust=replace(config.robust, max_speed_m_s=accepted_m_s))
    return faster, (f"{text}: set robust.max_speed_m_s to choose another limit",)


def known_map(path: Path | None, start_pose: Pose | None, method: str) -> PriorMap | None:
    """Read the map to localize in, a map_server YAML file or the one in a run directory; raises UsageError.

    ``start_pose`` is about where in it the laser begins. Returns None without a path.
    """
    if path is None:
        return None
    if method not in LOCALIZERS:
        advice = f"use --method {' or '.join(LOCALIZERS)}"
        raise UsageError(f"--map: method {method} makes a map of its own; {advice}")
    from mavnav.ground_truth.map_file import read_map  # noqa: PLC0415  few runs need it

    if path.is_dir():
        digests = digests_of(path)
        for name in digests.keys() & {"map.yaml", "map.pgm"}:
            checked_file(path, name, digests)
        path /= "map.yaml"
    file = read_map(path)
    known = prior_map_of(file.grid, file.map_T_grid, start_pose)
    if not len(known.walls_xy_m):
        raise UsageError(f"{path}: the map has no occupied cell; name a map with walls")
    return known


def placement_of(alignment: str | Sequence[float] | None) -> Placement | None:
    """Return where a map is put by ``--align``; None where it stays."""
    if alignment in {None, NOWHERE}:
        return None
    if alignment == WALLS:
        return turn_to_walls
    x_m, y_m, yaw_rad = map(float, alignment.split(",") if isinstance(alignment, str) else alignment)
    return lambda _: Pose(x_m, y_m, yaw_rad)


def localisation(path: Path, start_pose: Pose | None, outcome: SlamResult) -> Localisation:
    """Return the section of run.json on localization in a known map: the given start pose, and the one found."""
    first = next((step for step in outcome.steps if step.tracked), None)
    pose = first and first.match.map_T_laser
    start = start_pose and StartPose(start_pose.x_m, start_pose.y_m, start_pose.yaw_rad / DEG)
    found_at = FoundPose(first.index, pose.x_m, pose.y_m, pose.yaw_rad / DEG) if first and pose else None
    return Localisation(str(path), start, found_at)


def rounded_pose(pose: Pose) -> dict[str, float]:
    """Describe a pose for a document, in m, m, deg; adding 0 turns -0.0 into 0.0."""
    values = round(pose.x_m, 4), round(pose.y_m, 4), round(pose.yaw_rad / DEG, 3)
    return {name: value + 0.0 for name, value in zip(("x_m", "y_m", "yaw_deg"), values, strict=True)}


def check_references(references: References, log: Log, options: ReplayOptions[Path], *, own_frame: bool) -> None:
    """Raise UsageError for references of another time than the log, or of a frame that its map will not have.

    ``options`` are those of the run. In its ``own_frame`` a map begins at a scan of the log, else it is in that of a
    given map or run.
    """
    check_times(_with_recorded_truth(references, log, None), log.first_ns, log.last_ns)
    if options.get("start_s") and references.of_first_scan and own_frame:
        relative = "the walls of a scenario are relative to the first scan of the mission"
        advice = "leave out --start, or give the true walls as a map file in the frame of the map"
        raise UsageError(f"{options.get('truth_map')}: {relative}; {advice}")


def references_in_map(
    references: References, log: Log, begin_ns: int | None, map_T_begin: Pose | None = None
) -> tuple[References, tuple[str, ...]]:
    """Return the references that a map is compared with, in its frame, and warnings of those left out.

    ``begin_ns`` is the stamp of the scan that begins the map and defines its frame, None where that is no scan of the
    log; ``map_T_begin`` is its pose if that was moved.
    """
    references = _with_recorded_truth(references, log, begin_ns, map_T_begin)
    if references.of_first_scan and begin_ns not in {None, log.first_ns}:
        relative = "after the first scan of the mission, to which the walls of the scenario are relative"
        return replace(references, true_map=None), (f"the map begins {relative}: it is not compared with them",)
    return with_walls_moved(references, map_T_begin), ()


def with_walls_moved(references: References, map_T_begin: Pose | None) -> References:
    """Return references with the walls of a scenario, which are relative to the first scan, where that was put."""
    walls = references.true_map if references.of_first_scan else None
    return replace(references, true_map=place_walls(walls, map_T_begin)) if walls and map_T_begin else references


def with_true_map_placed(
    references: References, grid: Grid, config: Config, map_T_grid: Pose | None = None
) -> References:
    """Return the references with the true map of a file placed in a map, if that has another frame.

    Their frame is the same if half of the occupied cells are close to true walls. It is taken for the same, and named
    so, if the file has no clear place. A map from a file is given with ``map_T_grid``.
    """
    file, true = references.map_file, references.true_map
    if file is None or true is None:
        return references
    from mavnav.sessions.map_alignment import align  # noqa: PLC0415  few runs need it

    drawn = prior_map_of(grid, map_T_grid) if map_T_grid else PriorMap(known_area(grid), occupied_xy_m(grid))
    if not len(drawn.walls_xy_m) or np.median(true.distance_m(drawn.walls_xy_m)) <= COVERED_M:
        return references
    alignment, _ = align(drawn, prior_map_of(file.grid, file.map_T_grid), config)
    if alignment is None:
        return replace(references, true_map=replace(true, alignment=f"{true.alignment}, no clear place"))
    place = alignment.a_T_b
    text = f"found at {place.x_m:.2f} m, {place.y_m:.2f} m, {place.yaw_rad / DEG:.1f} deg"
    return replace(references, true_map=of_map(file, place, text))


def comparison_fields(references: References, held: Trajectory, outcome: SlamResult, config: Config) -> dict[str, Any]:
    """Return what a `RunResult` has of the comparison with references in its frame.

    ``held`` are its poses at the times of the truth.
    """
    references = with_true_map_placed(references, outcome.grid, config)
    truth = references.truth
    reference = compare_to(references, held, occupied_xy_m(outcome.grid))
    errors_m = position_errors(held, truth, aligned=True) if truth else None
    return {"reference": reference, "true_map": references.true_map, "position_errors_m": errors_m}


def _with_recorded_truth(
    references: References, log: Log, begin_ns: int | None, map_T_begin: Pose | None = None
) -> References:
    """Add the truth that the log holds, if it was asked for, in the map frame: that of the scan which begins the map.

    Where that scan is unknown, or has no truth, it stays in its own frame.
    """
    if log.truth is None:
        return references
    truth = log.truth.world_T_laser
    first = None if begin_ns is None else truth.at(begin_ns, MAX_GAP_NS)
    seen = truth.seen_from(first.inverse()) if first else truth
    return replace(references, truth=seen.seen_from(map_T_begin) if first and map_T_begin else seen)


@as_stage("measuring")
def measured_map(outcome: SlamResult, log: Log) -> MeasuredMap:
    """Measure the known part of the map of a run, with the scans behind it."""
    journey = Journey(
        outcome.trajectory, log.scans, outcome.tracked_share, outcome.lost_for_good, planar=outcome.planar
    )
    return measure_map(measured_area(outcome.grid), journey)


def slices_of(outcome: SlamResult, log: Log, config: Config) -> Slices | None:
    """Cut the map of a run into slices by height; None where the height of the laser is not known, or hardly varies."""
    attitude = log.attitude
    if attitude is None or not attitude.has_heights:
        return None

    def place_scans() -> Iterator[PlacedScan]:
        return scans_with_heights(log.scans(), outcome.trajectory, attitude.height_at)

    with Stage("slices"):
        return slice_map(place_scans, known_area(outcome.grid), config.slice_m)
