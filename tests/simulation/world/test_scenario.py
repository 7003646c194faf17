"""Scenarios: the shipped ones are sound, and whatever is wrong with one is said in a line that names its place."""

from __future__ import annotations

from itertools import pairwise
from json import dumps, loads
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec import convert
from scipy import ndimage

from mavnav.config.loading import fields, presets, scenarios
from mavnav.errors import ConfigError, ExitCode
from mavnav.pose import Pose
from mavnav.simulation.world.laser import LASERS, take_scan
from mavnav.simulation.world.scenario import LaserConfig, Scenario, laser_model
from mavnav.simulation.world.scenario_file import load_scenario, scenario_schema
from mavnav.units import DEG, MM

if TYPE_CHECKING:
    from pathlib import Path

GOOD = """\
walls:
  - polyline: {closed: true, points_m: [[0, 0], [6, 0], [6, 4], [0, 4]]}
  - box: {center_m: [3, 2], size_m: [1, 1], yaw_deg: 45}
  - circle: {center_m: [5, 1], radius_m: 0.3}
  - polyline: {closed: true, points_m: [[1, 3], [1.5, 3], [1.5, 3.5]]}
start: {x_m: 1, y_m: 1}
goal_m: [5, 3]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "mission.yaml"
    path.write_text(text)
    return path


def shipped() -> list[str]:
    rooms = ["complex", "complex-paper", "corner", "corner-paper", "corridor", "curved"]
    return [*rooms, "dead_end", "doorway", "hall", "hallway", "hover", "loop", "ring", "u_trap"]


# ---- shipped ---------------------------------------------------------------------------------------------------------


def test_scenarios_and_presets_are_told_apart() -> None:
    assert scenarios() == shipped()
    assert not set(scenarios()) & set(presets())


@pytest.mark.parametrize("name", shipped())
def test_a_scenario_is_found_by_name(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).mkdir()  # a run's folder of that name is no scenario
    scenario = load_scenario(name)
    assert scenario == load_scenario(f"{name}.yaml")
    assert scenario.name == name
    assert scenario.about
    (tmp_path / f"{name}.yaml").write_text(GOOD)
    assert load_scenario(f"{name}.yaml").goal_m == (5, 3)


@pytest.mark.parametrize("name", shipped())
def test_the_vehicle_fits_from_the_start_to_every_goal(name: str) -> None:
    """Flood the places with 100 mm more clearance than the vehicle needs."""
    scenario = load_scenario(name)
    left, low, right, top = scenario.world.bounds_m
    x, y = np.arange(left, right, 0.1), np.arange(low, top, 0.1)
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    free = (
        scenario.obstacles.clearance_m(xy.reshape(-1, 2)).reshape(xy.shape[:2]) > scenario.vehicle.radius_mm * MM + 0.1
    )
    regions, _ = ndimage.label(free, np.ones((3, 3)))
    places = [(scenario.start.x_m, scenario.start.y_m), *scenario.goals_xy_m]
    found = {regions[round((py - low) / 0.1), round((px - left) / 0.1)] for px, py in places}
    assert len(found) == 1
    assert found != {0}


def share_seen(scenario: Scenario, x_m: float, y_m: float) -> float:
    """Return the share of the beams that a scan at a position has a return of."""
    pose = Pose(x_m, y_m, scenario.world_T_base.yaw_rad) @ scenario.base_T_laser
    scan = take_scan(scenario.world, pose, laser_model(scenario), np.random.default_rng(0), 0)
    return float(np.isfinite(scan.ranges_m).mean())


@pytest.mark.parametrize("name", [name for name in shipped() if name != "hall"])
def test_a_first_scan_has_enough_returns(name: str) -> None:
    scenario = load_scenario(name)
    assert share_seen(scenario, scenario.start.x_m, scenario.start.y_m) > 0.4


def test_the_walls_of_the_hall_are_out_of_range_in_its_middle() -> None:
    hall = load_scenario("hall")
    assert share_seen(hall, hall.start.x_m, hall.start.y_m) > 0.3
    assert share_seen(hall, 9.0, 7.0) < 0.1


HIDDEN = ("corner", "u_trap", "curved", "dead_end", "doorway", "hallway")
"""Scenarios whose goal is out of sight of the start, whatever the laser's range."""


@pytest.mark.parametrize(("name", "seen"), [*((name, False) for name in HIDDEN), ("corridor", True)])
def test_which_goals_are_in_sight(name: str, *, seen: bool) -> None:
    scenario = load_scenario(name)
    start = np.array((scenario.start.x_m, scenario.start.y_m))
    way = np.array(scenario.goal_m) - start
    free, _ = scenario.world.cast(start, np.array([np.arctan2(way[1], way[0])]))
    assert (free[0] > np.hypot(*way)) == seen


def test_the_trap_opens_towards_the_start() -> None:
    scenario = load_scenario("u_trap")
    ranges, _ = scenario.world.cast((2.5, 2.2), np.array([0.0, np.pi / 2, -np.pi / 2, np.pi]))
    np.testing.assert_allclose(ranges, [0.6, 0.8, 0.8, 2.5])


def test_the_loop_goes_once_round() -> None:
    scenario = load_scenario("loop")
    around = np.array([(scenario.start.x_m, scenario.start.y_m), *scenario.goals_xy_m]) - (4.0, 3.0)
    bearings = np.arctan2(around[:, 1], around[:, 0])
    steps = [(b - a + np.pi) % (2 * np.pi) - np.pi for a, b in pairwise(bearings)]
    assert sum(steps) == pytest.approx(2 * np.pi, abs=0.1)


def test_the_corridor_brings_its_hand_measured_map() -> None:
    scenario = load_scenario("corridor")
    assert len(scenario.measured_walls.segments) < len(scenario.world.segments)
    left, _, right, _ = scenario.world.bounds_m
    assert right - left == pytest.approx(15)
    assert load_scenario("corner").measured_walls is None


def test_the_documented_example_loads_and_names_what_ships(repo_root: Path, tmp_path: Path) -> None:
    page = (repo_root / "docs" / "scenarios.md").read_text()
    scenario = load_scenario(written(tmp_path, page.partition("```yaml\n")[2].partition("```")[0]))
    assert (scenario.slam.method, scenario.seed, len(scenario.walls)) == ("paper", 3, 4)
    assert [name for name in scenarios() if f"| `{name}` |" not in page] == []
    keys = [key[-1] for key, _ in fields(Scenario) if key[0] not in {"slam", "planner"}]
    assert [key for key in keys if key not in page] == []


# ---- values ----------------------------------------------------------------------------------------------------------


def test_layers_and_the_method_s_preset(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD + "slam: {azimuth: 30, robust: {cell_mm: 15}}\nseed: 4\n")
    scenario = load_scenario(path, ["slam.azimuth=25", "laser.noise_percent=0.5"], {"seed": 9, "slam.method": "paper"})
    assert (scenario.seed, scenario.slam.azimuth, scenario.slam.robust.cell_mm) == (9, 25, 15)
    assert (scenario.slam.method, scenario.slam.odom, scenario.slam.final_pass) == ("paper", "off", False)
    assert load_scenario(path).slam.method == "robust"
    assert laser_model(scenario).noise == pytest.approx(0.005)
    assert str(load_scenario(path, ["slam.grid=5x6"]).slam.grid) == "5x6"


def test_defaults_are_the_paper_s(tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, GOOD))
    assert (scenario.vehicle.noise_xy_mm, scenario.vehicle.noise_yaw_deg, scenario.goal_radius_mm) == (20, 5, 250)
    laser = laser_model(scenario)
    assert (laser.spec, laser.noise, laser.bias) == (LASERS["urg-04lx"], 0.015, 0.0)
    assert laser.incidence_max_rad == pytest.approx(60 * DEG)


def test_a_run_s_bias_is_drawn_within_its_bound(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    drawn = [laser_model(load_scenario(path, ["laser.bias_percent=3"], {"seed": seed})).bias for seed in range(12)]
    assert len(set(drawn)) == 12
    assert max(map(abs, drawn)) <= 0.03
    assert min(drawn) < -0.01
    assert max(drawn) > 0.01


def test_the_incidence_limit_can_be_turned_off(tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, GOOD), ["laser.incidence_max_deg=null"])
    assert laser_model(scenario).incidence_max_rad == np.inf


def test_a_laser_by_name_and_with_changes() -> None:
    spec = LaserConfig(preset="utm-30lx", field_of_view_deg=180, step_deg=1, range_max_mm=8000, period_ms=50).spec
    assert (spec.beams, spec.range_max_m, spec.scan_time_s) == (181, 8.0, 0.05)
    assert spec.angle_min_rad == pytest.approx(-np.pi / 2)
    assert spec.time_increment_s == pytest.approx(0.05 / 360)
    assert LaserConfig(field_of_view_deg=360, step_deg=1).spec.beams == 360


@pytest.mark.parametrize(
    "sets",
    [
        ["laser.noise_percent=3"],
        ["laser=ust-10lx", "laser.noise_percent=3"],
        ["laser.noise_percent=3", "laser=ust-10lx"],
    ],
)
def test_a_laser_by_name_is_kept_under_changes(tmp_path: Path, sets: list[str]) -> None:
    laser = load_scenario(written(tmp_path, GOOD + "laser: utm-30lx\n"), sets).laser
    assert (laser.preset, laser.noise_percent) == ("utm-30lx" if len(sets) == 1 else "ust-10lx", 3)
    with pytest.raises(ConfigError, match=r"mission.yaml:8: laser.preset is 'urg'"):
        load_scenario(written(tmp_path, GOOD + "laser: urg\n"), ["laser.noise_percent=3"])
    with pytest.raises(ConfigError, match=r"^--set laser=urg: laser.preset is 'urg'"):
        load_scenario(written(tmp_path, GOOD + "laser: {preset: utm-30lx}\n"), ["laser=urg"])


@pytest.mark.parametrize("sets", [[], ["flight.slice_mm=300"], ["flight={}"]])
def test_an_empty_section_of_flight_flies(tmp_path: Path, sets: list[str]) -> None:
    flight = load_scenario(written(tmp_path, GOOD + "flight: {}\n"), sets).flight
    assert flight is not None
    assert (flight.height_m, flight.slice_mm) == (1.2, 300 if "flight.slice_mm=300" in sets else 400)
    assert load_scenario(written(tmp_path, GOOD), ["flight={}"]).flight is not None
    assert load_scenario(written(tmp_path, GOOD + "flight: {height_m: 1}\n"), ["flight={}"]).flight.height_m == 1


def test_a_scenario_survives_its_document() -> None:
    for name in shipped():
        scenario = load_scenario(name, ["laser.incidence_max_deg=null", "slam.grid=5x7"])
        assert convert(loads(dumps(scenario.document())), Scenario) == scenario


def test_the_schema_is_json_and_its_references_hold() -> None:
    schema = loads(dumps(scenario_schema()))
    assert set(schema["required"]) == {"walls", "start", "goal_m"}
    assert schema["properties"]["walls"]["minItems"] == 1
    assert not schema["additionalProperties"]
    refs = [part.split('"')[0] for part in dumps(schema).split('"$ref": "#/$defs/')[1:]]
    assert {"WallEntry", "Polyline", "LaserConfig", "PlannerConfig", "Config"} <= set(refs) <= set(schema["$defs"])
    assert {"enum": list(LASERS)} in schema["properties"]["laser"]["anyOf"]


def test_schema_and_page_say_when_a_goal_is_reached(repo_root: Path) -> None:
    said = scenario_schema()["properties"]["goal_radius_mm"]["description"]
    for text in (said, (repo_root / "docs" / "scenarios.md").read_text()):
        assert "the vehicle stops when its estimated position is within this distance of the goal" in text
        assert "reached if the true one is within twice that" in text


# ---- errors ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("goal_m: [5, 3]", "goal_m: [3, 2.1]", 7, "goal_m [3, 2.1] lies inside a wall (walls.1.box); move it"),
        ("goal_m: [5, 3]", "goal_m: [5.1, 1]", 7, "goal_m [5.1, 1] lies inside a wall (walls.2.circle); "),
        ("goal_m: [5, 3]", "goal_m: [1.4, 3.2]", 7, "goal_m [1.4, 3.2] lies inside a wall (walls.3.polyline); "),
        ("goal_m: [5, 3]", "goal_m: [5.9, 3]", 7, "goal_m [5.9, 3] is 100 mm from a wall, the vehicle's radius is 150"),
        ("{x_m: 1, y_m: 1}", "{x_m: -1, y_m: 1}", 6, "start [-1, 1] lies outside the world; move it into x 0 to 6,"),
        ("{x_m: 1, y_m: 1}", "{x_m: 0.05, y_m: 1}", 6, "start [0.05, 1] is 50 mm from a wall"),
        ("goal_m: [5, 3]", "goal_m: [5, 3]\nvia_m:\n  - [1, 2]\n  - [3, 2]", 10, "via_m.1 [3, 2] lies inside a wall"),
        ("goal_m", "goal", 7, "unknown key goal; did you mean goal_m?"),
        ("size_m: [1, 1], ", "", 3, "walls.1.box.size_m is missing; give the edges"),
        ("size_m", "sise_m", 3, "unknown key walls.1.box.sise_m; did you mean walls.1.box.size_m?"),
        ("yaw_deg: 45", "yaw_dg: 45", 3, "unknown key walls.1.box.yaw_dg; did you mean walls.1.box.yaw_deg?"),
        ("  - box:", "  - bocks:", 3, "unknown key walls.1.bocks; did you mean walls.1.box?"),
        ("radius_m: 0.3}", "radius_m: 0.3}\n    box: {center_m: [3, 2], size_m: [1, 1]}", 4, "it must be one shape"),
        ("radius_m: 0.3", "radius_m: -0.3", 4, "walls.2.circle.radius_m is -0.3, it should be greater than 0; radius"),
        ("[[1, 3], [1.5, 3], [1.5, 3.5]]", "[[1, 3]]", 5, "walls.3.polyline.points_m is [[1, 3]], it should have at"),
        ("[[1, 3], [1.5, 3],", "[[1, 3], [1, 3.0],", 5, "it has [1, 3] twice in succession, a wall without length"),
        ("circle: {", "arc: {sweep_deg: 0, ", 4, "arc.sweep_deg is 0, it makes a wall without length; give a sw"),
        ("  - circle: {", "  - opening: {points_m: [[1, 2], [1, 2]], open_m: [0, 2]}\n  - circle: {", 4, "2] twice"),
        ("[[1, 3],", "[[1],", 5, "walls.3.polyline.points_m.0 is [1], it should have 2 items"),
        ("[[1, 3],", "[[1, 2e3],", 5, "walls.3.polyline.points_m.0.1 is 2000.0, it should be less"),
        ("start: ", "vehicle: {noise_xy_mm: -20}\nstart: ", 6, "vehicle.noise_xy_mm is -20, it should be greater than"),
        ("start: ", "laser: {noise_percent: -1}\nstart: ", 6, "laser.noise_percent is -1, it should be greater than"),
        ("start: ", "laser: urg\nstart: ", 6, "laser.preset is 'urg', it should be 'urg-04lx', 'utm-30lx',"),
        ("start: ", "laser: {range_max_mm: 10}\nstart: ", 6, "laser has a least range that is not below its greatest"),
        ("start: ", "slam: {grid: 5}\nstart: ", 6, "slam.grid is 5, it should be a word or a section"),
        ("start: ", "slam: {grid: 5x}\nstart: ", 6, "slam.grid is '5x', it should be NxM with 2 to 200"),
        ("start: ", "slam:\n  robust: {cel_mm: 5}\nstart: ", 7, "robust.cel_mm; did you mean slam.robust.cell_mm?"),
        ("0.3}", "0.3, height_m: [2, 1]}", 4, "walls.2.circle.height_m is [2, 1], it has 2 m at its bottom and 1 m at"),
        ("0.3}", "0.3, height_m: [-1, 1]}", 4, "walls.2.circle.height_m.0 is -1, it should be greater than or equal"),
        ("0.3}", "0.3, height_m: [0, 1]}", 4, "walls.2.circle has heights; give the vehicle one too, as"),
        ("start: ", "ceiling_m: 2\nstart: ", 6, "ceiling_m needs a vehicle with a height; give flight.height_m"),
        ("start: ", "flight: {height_m: 0.1}\nstart: ", 6, "flight reaches from -0.1 to 0.3 m, into the floor; change"),
        ("start: ", "ceiling_m: 2\nflight: {height_m: 1.9}\nstart: ", 7, "flight reaches from 1.7 to 2.1 m, into the"),
        ("start: ", "slam: {attitude: /imu}\nstart: ", 6, "slam.attitude is '/imu', a mission has one sensor; wr"),
        ("start: ", "slam: {odom: /odom}\nstart: ", 6, "slam.odom is '/odom', the odometry of a mission is its"),
        ("start: ", "slam: {odometry: {turn_scale: 2}}\nstart: ", 6, "slam.odometry.turn_scale is 2, commands need no"),
        ("start: ", "slam:\n  upside_down: true\nstart: ", 7, "slam.upside_down is true, the laser of a mission is u"),
        ("start: ", "flight: {tilt_noise_deg: -1}\nstart: ", 6, "flight.tilt_noise_deg is -1, it should be greater"),
        ("  - box: {", "  - table: {top_m: [1, 1], ", 3, "walls.1.table.top_m is [1, 1], it has 1 m at its bottom"),
        ("  - circle: {", "  - opening: {points_m: [[0, 0]], open_m: [0, 2]}\n  - circle: {", 4, "should have 2 items"),
        ("start: ", "name: a/b\nstart: ", 6, "name is 'a/b', it should be a name for files, without slashes"),
        ("start: ", "name: \"a\\nb\"\nstart: ", 6, "name is 'a\\nb', it should be a name for files"),
        ("start: ", "planner: {techniqe: field}\nstart: ", 6, "planner.techniqe; did you mean planner.technique?"),
    ],
)  # fmt: skip
def test_errors_name_the_line_and_what_to_do(tmp_path: Path, old: str, new: str, line: int, message: str) -> None:
    path = written(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    said = str(caught.value)
    assert said.startswith(f"{path}:{line}: "), said
    assert message in said
    assert "\n" not in said
    assert caught.value.exit_code == ExitCode.USAGE


def test_a_closed_polyline_may_end_where_it_begins(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD.replace("[0, 4]]", "[0, 4], [0, 0]]"))
    assert load_scenario(path).world.bounds_m == pytest.approx((0, 0, 6, 4))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD.replace("goal_m: [5, 3]\n", ""), ": goal_m is missing; give the position to reach"),
        ("walls: []\nstart: {x_m: 1, y_m: 1}\ngoal_m: [1, 1]\n", ":1: walls is [], it should have at least 1 item; "),
        ("", ": walls is missing; "),
        ("walls: [[1, 2]]\nstart: {x_m: 1, y_m: 1}\ngoal_m: [1, 1]\n", ":1: walls.0 is [1, 2], it should be a section"),
        ("walls:\n - arc: {a: 1, a: 2}\n", ":2: arc.a is given twice"),
    ],
)  # fmt: skip
def test_errors_of_a_file_that_lacks_something(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    assert str(caught.value).startswith(f"{path}{message}")


def test_errors_of_options_name_the_option(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    listed = written(tmp_path, GOOD + "via_m:\n  - [1, 1]\n  - [2, 1]\n")
    with pytest.raises(ConfigError, match=r"^--set via_m=.*: via_m.1.0 is 'x'"):  # not the line of the file's own list
        load_scenario(listed, ["via_m=[[1, 1], [x, 1]]"])
    with pytest.raises(ConfigError, match=r"^--set goal_m=\[9, 9\]: goal_m \[9, 9\] lies outside"):
        load_scenario(path, ["goal_m=[9, 9]"])
    with pytest.raises(ConfigError, match=r"^--seed: seed is -1"):
        load_scenario(path, [], {"seed": -1})
    with pytest.raises(ConfigError, match=r"no such file; .* scenario: complex, complex-paper"):
        load_scenario("korner.yaml")


@pytest.mark.parametrize("key", ["noise_xy_mm", "noise_yaw_deg", "laser_x_mm", "laser_y_mm"])
def test_the_vehicle_s_numbers_have_bounds(tmp_path: Path, key: str) -> None:
    path = written(tmp_path, GOOD)
    with pytest.raises(ConfigError, match=rf"vehicle.{key} is .*, it should be less than or equal to"):
        load_scenario(path, [f"vehicle.{key}=1e8"])
    with pytest.raises(ConfigError, match=rf"vehicle.{key} is .*, it should be greater than or equal to"):
        load_scenario(path, [f"vehicle.{key}=-1e8"])


def test_places_are_checked_at_flight_height(tmp_path: Path) -> None:
    text = GOOD.replace("radius_m: 0.3", "radius_m: 0.3, height_m: [0, 0.8]") + "flight: {height_m: 1.2}\n"
    above = load_scenario(written(tmp_path, text.replace("goal_m: [5, 3]", "goal_m: [5.1, 1]")))
    assert above.goal_m == (5.1, 1)
    with pytest.raises(ConfigError, match=r"goal_m \[5.1, 1\] lies inside a wall \(walls.2.circle\)"):
        load_scenario(written(tmp_path, text), ["goal_m=[5.1, 1]", "flight.height_m=0.6"])


def test_a_world_without_a_closed_outline_ends_at_its_bounds() -> None:
    with pytest.raises(ConfigError, match=r"goal_m \[3, 5.5\] lies outside the world; move it into x 0 to 7, y 0 to 5"):
        load_scenario("curved", ["goal_m=[3, 5.5]"])


def test_a_column_may_stand_out_of_the_outline(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD.replace("center_m: [5, 1]", "center_m: [6, 1]"))
    assert load_scenario(path).world.bounds_m == pytest.approx((0, 0, 6.3, 4))
    with pytest.raises(ConfigError, match="outside"):
        load_scenario(path, ["goal_m=[6.1, 3]"])


def test_an_l_shaped_outline_has_an_outside_within_its_bounds() -> None:
    with pytest.raises(ConfigError, match=r"start .* lies outside the world"):
        load_scenario("corner", ["start.x_m=3", "start.y_m=3"])
