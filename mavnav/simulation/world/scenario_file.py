"""Scenarios from files and by name; an error names its file and line, and what to do about it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mavnav.config.layers import Key, Layer
from mavnav.config.loading import file_layer, method_layer, origin, overlaid, presets_folder, scenarios, validated
from mavnav.config.yaml_layers import read_yaml
from mavnav.errors import ConfigError
from mavnav.simulation.world.laser import LASERS
from mavnav.simulation.world.scenario import Scenario
from mavnav.units import MM

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from mavnav.simulation.world.shapes import XY, Wall

STANDS_OUT_M = 0.5
"""How far other walls may stand out of the world's outline: a column in a wall, a porch."""


def load_scenario(
    file: str | Path,
    sets: Iterable[str] = (),
    overrides: Mapping[str, object] | None = None,
    config: str | Path | None = None,
) -> Scenario:
    """Load a scenario.

    Parameters
    ----------
    file
        Path of a YAML file, or the name of a shipped scenario where no such file lies in the current folder.
    sets
        ``key=value`` with dotted keys, values read as YAML; for example ``slam.method=paper``.
    overrides
        Values of command line options by dotted key; what is None was not given.
    config
        Configuration file or preset, above the scenario's own ``slam`` section.

    Raises
    ------
    ConfigError
        One line: file and line, key, what is wrong, what to do.
    """
    path = scenario_path(file)
    layer = overlaid(file_layer(config).within("slam").over(read_yaml(path)), sets, overrides or {})
    layer = layer.over(method_layer(layer.values.get(("slam", "method"))).within("slam"))
    layer = layer.over(Layer({("name",): path.stem}))
    scenario = validated(Scenario, layer, str(path))
    for key, problem in _problems(scenario):
        raise ConfigError(f"{origin(layer, key, str(path))}: {'.'.join(key)} {problem}")
    return scenario


def scenario_path(file: str | Path) -> Path:
    """Find the file of a scenario: as named, else among the shipped ones (``corner`` or ``corner.yaml``)."""
    path = Path(file)
    if path.is_file():
        return path
    if path.parent == Path() and path.name.removesuffix(".yaml") in scenarios():
        return presets_folder() / f"{path.name.removesuffix('.yaml')}.yaml"
    if path.exists():
        return path
    raise ConfigError(f"{path}: no such file; name a YAML file, or a scenario: {', '.join(scenarios())}")


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema of scenario files, for editors that check while one types."""
    schema = Scenario.model_json_schema()
    laser = schema["properties"]["laser"]
    laser["anyOf"] = [{"$ref": laser.pop("$ref")}, {"enum": list(LASERS)}]
    return schema


def _problems(scenario: Scenario) -> Iterator[tuple[Key, str]]:
    """Check the geometry: return each wrong key, and what is wrong with it."""
    if scenario.laser.spec.range_min_m >= scenario.laser.spec.range_max_m:
        yield ("laser",), "has a least range that is not below its greatest; raise range_max_mm or lower range_min_mm"
    places: dict[Key, XY] = {("start",): (scenario.start.x_m, scenario.start.y_m), ("goal_m",): scenario.goal_m}
    places |= {("via_m", str(k)): xy_m for k, xy_m in enumerate(scenario.via_m)}
    for key, xy_m in places.items():
        problem = _misplaced(scenario, xy_m)
        if problem:
            yield key, f"[{xy_m[0]:g}, {xy_m[1]:g}] {problem}"


def _misplaced(scenario: Scenario, xy_m: XY) -> str:
    """Return what is wrong with a position; empty where the vehicle fits.

    The closed polyline around everything, if there is one, is the world's outline; every other closed shape is solid.
    """
    around = _outline(scenario)
    left, low, right, top = scenario.world.bounds_m
    if not (left <= xy_m[0] <= right and low <= xy_m[1] <= top) or (around and not around.shape.contains(xy_m)):
        return f"lies outside the world; move it into x {left:g} to {right:g}, y {low:g} to {top:g}, within the walls"
    for number, wall in enumerate(scenario.walls):
        if wall is not around and wall.shape.contains(xy_m):
            return f"lies inside a wall (walls.{number}.{wall.kind}); move it into the open"
    need = scenario.vehicle.radius_mm * MM
    clearance = float(scenario.world.clearance_m(np.array([xy_m]))[0])
    if clearance < need:
        return f"is {clearance / MM:.0f} mm from a wall, the vehicle's radius is {need / MM:g} mm; move it away"
    return ""


def _outline(scenario: Scenario) -> Wall | None:
    """Return the closed polyline around all walls; columns and the like may stand out of it a little."""
    whole = scenario.world.bounds_m
    for wall in scenario.walls:
        if wall.polyline and wall.polyline.closed:
            xy = np.array(wall.polyline.points_m)
            if np.allclose((*xy.min(axis=0), *xy.max(axis=0)), whole, rtol=0.0, atol=STANDS_OUT_M):
                return wall
    return None
