"""References for the comparison of a run, besides its log: a true trajectory, a true map, relations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from mavnav.errors import UsageError
from mavnav.metrics.fields import ABSENT
from mavnav.metrics.reference import TOLERANCE_NS, Reference, TrueMap, map_distance, pose_errors, relation_errors
from mavnav.pose import Pose, Trajectory, correct_path, transform_points
from mavnav.units import NS

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.ground_truth.map_file import MapFile
    from mavnav.metrics.reference import Relations
    from mavnav.simulation.world.geometry import World
    from mavnav.simulation.world.scenario import Scenario

START_POSE: Final = "start pose"
"""Alignment of the walls of a scenario, which are relative to the laser's pose at the first scan of the mission."""

SPACING_M: Final = 0.02
"""Distance of the points along true walls."""


class References(Struct, frozen=True):
    """The references of a run, each None if it is not given.

    ``truth`` is the true trajectory of the laser in any frame; ``true_map`` the true walls in the map frame.
    ``map_file`` is the file of the true walls, if they are of one: it may have another frame.
    """

    truth: Trajectory | None = None
    true_map: TrueMap | None = None
    relations: Relations | None = None
    map_file: MapFile | None = None

    @property
    def of_poses(self) -> bool:
        """Whether there are references for the poses of a run, not only for its map."""
        return self.truth is not None or self.relations is not None

    @property
    def of_first_scan(self) -> bool:
        """Whether the true walls are known only in the frame of the first scan of a log."""
        return self.true_map is not None and self.true_map.alignment == START_POSE


def load_references(
    truth: Path | None = None, truth_map: Path | None = None, relations: Path | None = None
) -> References:
    """Read the given files; raises UsageError."""
    if truth is None and truth_map is None and relations is None:
        return References()
    from mavnav.ground_truth.tables import read_relations, read_tum  # noqa: PLC0415  few runs need it

    true_map, map_file = (None, None) if truth_map is None else read_true_map(truth_map)
    return References(
        truth=None if truth is None else read_tum(truth),
        true_map=true_map,
        relations=None if relations is None else read_relations(relations),
        map_file=map_file,
    )


def read_true_map(path: Path) -> tuple[TrueMap, MapFile | None]:
    """Read a scenario (with ``walls``) or a map_server map (with an ``image``), which is returned besides.

    A scenario's walls are given relative to the laser's first pose, which is the origin of a map; those of a map file
    are in its own frame. The name of a shipped scenario is used if there is no such file. Raises UsageError.
    """
    from mavnav.simulation.world.scenario_file import load_scenario, scenario_path  # noqa: PLC0415  models take time to build

    if not path.exists():
        path = scenario_path(path)
    from mavnav.config.yaml_layers import read_yaml  # noqa: PLC0415  yaml takes 10 ms to load

    keys = {key[0] for key in read_yaml(path, "the YAML file of a map, or a scenario").values}
    if "image" in keys:
        from mavnav.ground_truth.map_file import read_map  # noqa: PLC0415  few runs need it

        file = read_map(path)
        if not len(file.occupied_xy_m()):
            raise UsageError(f"{path} has no occupied cell; name a map with walls")
        return of_map(file, Pose(), "same frame"), file
    if "walls" not in keys:
        raise UsageError(f"{path} is neither a scenario (walls) nor a map (image); name one of them")
    scenario = load_scenario(path)
    return of_scenario(scenario, scenario.world_T_base @ scenario.base_T_laser), None


def of_scenario(scenario: Scenario, world_T_map: Pose) -> TrueMap:
    """Return the exact walls of a scenario; ``world_T_map`` is the laser's first pose.

    If the scene has heights, the walls are those in the slice at flight height. Distances are to the nearest surface at
    any height, because a cell may be at any height.
    """
    walls, every = scenario.obstacles.seen_from(world_T_map), scenario.world.seen_from(world_T_map)
    return TrueMap(every.distance_m, points_on(walls), START_POSE, walls.segments, walls.arcs)


def place_walls(true: TrueMap, map_T_walls: Pose) -> TrueMap:
    """Return true walls in a map frame in which their own frame has this pose."""
    segments, (centres, rest) = true.segments_map.reshape(-1, 2), np.split(true.arcs_map, [2], axis=1)
    turned = rest + np.array([0.0, map_T_walls.yaw_rad, 0.0])
    return replace(
        true,
        distance_m=lambda points: true.distance_m(transform_points(map_T_walls.inverse(), points)),
        xy_m=transform_points(map_T_walls, true.xy_m),
        segments_map=transform_points(map_T_walls, segments).reshape(-1, 4),
        arcs_map=np.hstack((transform_points(map_T_walls, centres), turned)),
    )


def of_map(file: MapFile, map_T_file: Pose, alignment: str) -> TrueMap:
    """Return the occupied cells of a map file as true walls, with the pose of its frame in the map frame."""
    from scipy.spatial import cKDTree  # noqa: PLC0415  takes 0.3 s to load

    xy_m = transform_points(map_T_file, file.occupied_xy_m())
    tree: Any = cKDTree(xy_m)
    return TrueMap(lambda points: tree.query(points)[0], xy_m, alignment)


def points_on(world: World) -> NDArray[np.float64]:
    """Return points all along the walls, `SPACING_M` apart, (n, 2) in the frame of the world."""
    parts = [np.zeros((0, 2))]
    for x1, y1, x2, y2 in world.segments:
        count = int(np.ceil(np.hypot(x2 - x1, y2 - y1) / SPACING_M)) + 1
        parts.append(np.linspace((x1, y1), (x2, y2), count))
    for x, y, radius, start, sweep in world.arcs:
        angle = start + np.linspace(0.0, sweep, int(np.ceil(abs(sweep) * radius / SPACING_M)) + 1)
        parts.append(np.column_stack((x + radius * np.cos(angle), y + radius * np.sin(angle))))
    return np.concatenate(parts)


def check_times(references: References, first_ns: int, last_ns: int) -> None:
    """Raise UsageError if a truth or relations lie outside the time of a log."""
    known = {}
    if references.truth is not None:
        known["the truth"] = references.truth.stamps_ns
    if references.relations is not None:
        columns = references.relations.stamps_ns.T
        known |= zip(("the first times of the relations", "the second times of the relations"), columns, strict=True)
    for what, stamps_ns in known.items():
        first, last = int(stamps_ns.min()), int(stamps_ns.max())
        if last < first_ns - TOLERANCE_NS or first > last_ns + TOLERANCE_NS:
            spans = f"{first * NS:.1f} to {last * NS:.1f} s, and the log, {first_ns * NS:.1f} to {last_ns * NS:.1f} s"
            raise UsageError(f"{what}, {spans}, share no time; give a reference of the same log and clock")


SWEEPS: Final = {"first": 1.0, "middle": 0.0, "last": -1.0}
"""Time from where a true pose with the stamp of a scan holds to the middle of its sweep, in halves of the sweep."""


def in_time_of_truth(trajectory: Trajectory, holds_s: float, truth_at: str) -> Trajectory:
    """Return tracked poses, which hold ``holds_s`` after their stamps, at the stamps of a truth of the same times.

    ``truth_at`` is the beam of a scan, first, middle or last, at whose time a true pose with its stamp holds.
    """
    return correct_path(trajectory, round(SWEEPS[truth_at] * holds_s / NS))


def compare_to(
    references: References, trajectory: Trajectory | None, occupied_xy_map_m: NDArray[np.float64]
) -> Reference | None:
    """Return the comparison of a run with its references; None without references.

    ``occupied_xy_map_m`` (n, 2) are the centres of the occupied cells. Without a trajectory (a single map file) only
    maps are compared. ATE and RPE are None if too few poses have a truth.
    """
    ate = rpe = distance = relations = ABSENT
    if references.truth is not None and trajectory is not None:
        ate, rpe = pose_errors(trajectory, references.truth)
    if references.true_map is not None:
        distance = map_distance(occupied_xy_map_m, references.true_map)
    if references.relations is not None and trajectory is not None:
        relations = relation_errors(references.relations, trajectory)
    comparison = Reference(ate, rpe, distance, relations)
    return None if comparison == Reference() else comparison
