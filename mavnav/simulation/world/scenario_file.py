"""Scenarios from files and by name; an error names its file and line, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import asdict

from mavnav.config import loading
from mavnav.config.layers import Key, Layer
from mavnav.config.models import Config, OdometryConfig
from mavnav.config.yaml_layers import read_yaml
from mavnav.errors import ConfigError, missing
from mavnav.simulation.world.laser import LASERS
from mavnav.simulation.world.scenario import Scenario
from mavnav.simulation.world.shapes import XY, Shape, WallEntry
from mavnav.units import MM

LASER_BY_NAME = (("laser",), "preset")
"""The section that may be written as a word, and the key that the word is."""

STANDS_OUT_M = 0.5
"""How far other walls may stand out of the world's outline: a column in a wall, a porch."""


def load_scenario(
    file: str | Path, sets: Iterable[str] = (), overrides: loading.Overrides = None, config: str | Path | None = None
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
    given = read_yaml(path, f"the YAML file of a scenario, or a shipped one: {', '.join(loading.scenarios())}")
    layer = loading.overlay(loading.file_layer(config).within("slam").over(given), sets, overrides, LASER_BY_NAME)
    layer = layer.over(loading.method_layer(layer.values.get(("slam", "method"))).within("slam"))
    layer = layer.over(Layer({("name",): path.stem}))
    scenario = loading.read_model(Scenario, layer, str(path))
    for key, problem in _problems(scenario):
        raise ConfigError(f"{loading.origin(layer, key, str(path))}: {'.'.join(key)} {problem}")
    return scenario


def scenario_path(file: str | Path) -> Path:
    """Find the file of a scenario: as named, else among the shipped ones (``corner`` or ``corner.yaml``)."""
    path = Path(file)
    if path.is_file():
        return path
    if path.parent == Path() and path.name.removesuffix(".yaml") in loading.scenarios():
        return loading.package_folder("configs") / f"{path.name.removesuffix('.yaml')}.yaml"
    if path.exists():
        return path
    raise ConfigError(missing(path, f"name a YAML file, or a scenario: {', '.join(loading.scenarios())}"))


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema of scenario files, for editors that check while one types."""
    schema = loading.schema_of(Scenario)
    schema["$defs"]["WallEntry"] |= {"minProperties": 1, "maxProperties": 1}
    laser = schema["properties"]["laser"]
    laser["anyOf"] = [{"$ref": laser.pop("$ref")}, {"enum": list(LASERS)}]
    return schema


def _problems(scenario: Scenario) -> Iterator[tuple[Key, str]]:
    """Check the geometry: return each wrong key, and what is wrong with it."""
    if scenario.laser.spec.range_min_m >= scenario.laser.spec.range_max_m:
        yield ("laser",), "has a least range that is not below its greatest; raise range_max_mm or lower range_min_mm"
    yield from _slam_problems(scenario.slam)
    yield from _height_problems(scenario)
    places: dict[Key, XY] = {("start",): (scenario.start.x_m, scenario.start.y_m), ("goal_m",): scenario.goal_m}
    places |= {("via_m", str(k)): xy_m for k, xy_m in enumerate(scenario.via_m)}
    for key, xy_m in places.items():
        problem = _placement_problem(scenario, xy_m)
        if problem:
            yield key, f"[{xy_m[0]:g}, {xy_m[1]:g}] {problem}"


def _slam_problems(slam: Config) -> Iterator[tuple[Key, str]]:
    """Check the settings of a replay that choose or correct the inputs of a log."""
    if slam.attitude not in ("auto", "off"):
        yield ("slam", "attitude"), f"is {slam.attitude!r}, a mission has one sensor; write auto or off"
    if slam.odom not in ("auto", "off"):
        yield ("slam", "odom"), f"is {slam.odom!r}, the odometry of a mission is its commands; write auto or off"
    for name, value in asdict(slam.odometry).items():
        if value != getattr(OdometryConfig(), name):
            yield ("slam", "odometry", name), f"is {value:g}, commands need no correction; leave it out"
    if slam.upside_down:
        yield ("slam", "upside_down"), "is true, the laser of a mission is upright; leave it out"


def _height_problems(scenario: Scenario) -> Iterator[tuple[Key, str]]:
    """Check the heights: those of walls need a vehicle with one, which must fit between floor and ceiling."""
    flight, ceiling_m = scenario.flight, scenario.ceiling_m
    if flight is None:
        for number, wall in enumerate(scenario.walls):
            if wall.has_heights:
                yield ("walls", str(number), wall.kind), "has heights; give the vehicle one too, as flight.height_m"
        if ceiling_m is not None:
            yield ("ceiling_m",), "needs a vehicle with a height; give flight.height_m"
    elif flight.slice_m[0] < 0.0 or flight.slice_m[1] > (ceiling_m or flight.slice_m[1]):
        low_m, high_m = flight.slice_m
        within = "the floor" if low_m < 0.0 else f"the ceiling at {ceiling_m:g} m"
        yield ("flight",), f"reaches from {low_m:g} to {high_m:g} m, into {within}; change height_m or slice_mm"


def _placement_problem(scenario: Scenario, xy_m: XY) -> str:
    """Return what is wrong with a position; empty where the vehicle fits.

    The closed polyline around everything, if there is one, is the world's outline; every other closed shape is solid.
    """
    around = _outline(scenario)
    left, low, right, top = scenario.world.bounds_m
    if not (left <= xy_m[0] <= right and low <= xy_m[1] <= top) or (around and not around.parts[0].contains(xy_m)):
        return f"lies outside the world; move it into x {left:g} to {right:g}, y {low:g} to {top:g}, within the walls"
    for number, wall in enumerate(scenario.walls):
        if wall is not around and any(part.contains(xy_m) for part in wall.parts if _is_met(part, scenario)):
            return f"lies inside a wall (walls.{number}.{wall.kind}); move it into the open"
    need = scenario.vehicle.radius_m
    clearance = float(scenario.obstacles.clearance_m(np.array([xy_m]))[0])
    if clearance < need:
        return f"is {clearance / MM:.0f} mm from a wall, the vehicle's radius is {need / MM:g} mm; move it away"
    return ""


def _is_met(part: Shape, scenario: Scenario) -> bool:
    """Return whether a shape reaches into the slice at flight height."""
    if scenario.flight is None or part.height_m is None:
        return True
    low_m, high_m = scenario.flight.slice_m
    return part.height_m[0] < high_m and part.height_m[1] > low_m


def _outline(scenario: Scenario) -> WallEntry | None:
    """Return the closed polyline around all walls; columns and the like may stand out of it a little."""
    whole = scenario.world.bounds_m
    for wall in scenario.walls:
        if wall.polyline and wall.polyline.closed:
            xy = np.array(wall.polyline.points_m)
            if np.allclose((*xy.min(axis=0), *xy.max(axis=0)), whole, rtol=0.0, atol=STANDS_OUT_M):
                return wall
    return None
