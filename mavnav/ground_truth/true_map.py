"""True maps: the walls of a scenario, or a map file that is taken as true."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mavnav.errors import UsageError
from mavnav.ground_truth.map_file import read_map
from mavnav.metrics.reference import START_POSE, TrueMap

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from mavnav.pose import Pose
    from mavnav.simulation.world import Scenario, World

SPACING_M: Final = 0.02


def read_true_map(path: Path) -> TrueMap:
    """Read a scenario (with ``walls``) or a map_server map (with an ``image``).

    A scenario's walls are given relative to the laser's first pose, which is the origin of a map. A map file must have
    the frame of the map that it is compared with. The name of a shipped scenario is used if there is no such file.
    Raises UsageError.
    """
    from mavnav.simulation.world.scenario_file import load_scenario, scenario_path  # noqa: PLC0415  models take time to build

    if not path.exists():
        path = scenario_path(path)
    from mavnav.config.yaml_layers import read_yaml  # noqa: PLC0415  yaml takes 10 ms to load

    keys = {key[0] for key in read_yaml(path, "the YAML file of a map, or a scenario").values}
    if "image" in keys:
        return _of_map(path)
    if "walls" not in keys:
        raise UsageError(f"{path} is neither a scenario (walls) nor a map (image); name one of them")
    scenario = load_scenario(path)
    return of_scenario(scenario, scenario.world_T_base @ scenario.base_T_laser)


def of_scenario(scenario: Scenario, world_T_map: Pose) -> TrueMap:
    """Return the exact walls of a scenario; ``world_T_map`` is the laser's first pose.

    If the scene has heights, the walls are those in the slice at flight height. Distances are to the nearest surface at
    any height, because a cell may be at any height.
    """
    walls, every = scenario.obstacles.seen_from(world_T_map), scenario.world.seen_from(world_T_map)
    return TrueMap(every.distance_m, points_on(walls), START_POSE, walls.segments, walls.arcs)


def _of_map(path: Path) -> TrueMap:
    from scipy.spatial import cKDTree  # noqa: PLC0415  takes 0.3 s to load

    xy_m = read_map(path).occupied_xy_m()
    if not len(xy_m):
        raise UsageError(f"{path} has no occupied cell; name a map with walls")
    tree: Any = cKDTree(xy_m)
    return TrueMap(lambda points: tree.query(points)[0], xy_m, "same frame")


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
