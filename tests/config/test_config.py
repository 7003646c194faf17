"""Configuration: layers, presets, strict YAML, and errors that name line, key and the nearest known name."""

from __future__ import annotations

import os
import pickle
import re
from copy import copy
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from mavnav.batch.manifest import Manifest
from mavnav.config.layers import by_dotted_key
from mavnav.config.loading import fields, file_layer, load_config, presets, read_model, schema_of, to_yaml
from mavnav.config.models import (
    Config,
    GridSize,
    InSI,
    PaperConfig,
    PaperExpert,
    PlannerConfig,
    RobustConfig,
    RobustExpert,
)
from mavnav.errors import ConfigError
from mavnav.simulation.world.scenario import FlightConfig, Scenario, VehicleConfig
from mavnav.simulation.world.scenario_file import load_scenario, scenario_schema
from mavnav.units import DEG

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


def write(folder: Path, text: str) -> Path:
    path = folder / "c.yaml"
    path.write_text(text)
    return path


def test_without_anything_the_defaults_hold() -> None:
    assert load_config() == Config() == read_model(Config, file_layer(Config().method))


def test_layers_win_in_order(tmp_path: Path) -> None:
    file = write(tmp_path, "azimuth: 30\ngrid: 5x6\nrobust:\n  cell_mm: 30\n")
    config = load_config(file, ["azimuth=40", "robust.voxel_mm=25"], {"azimuth": 50})
    assert (config.azimuth, str(config.grid)) == (50, "5x6")
    assert (config.robust.cell_mm, config.robust.voxel_mm) == (30, 25)
    assert load_config(file, ["azimuth=40"]).azimuth == 40


@pytest.mark.parametrize("how", ["name", "option", "set", "file"])
def test_the_method_brings_its_preset(tmp_path: Path, how: str) -> None:
    config = {
        "name": lambda: load_config("paper"),
        "option": lambda: load_config(None, [], {"method": "paper"}),
        "set": lambda: load_config(None, ["method=paper"]),
        "file": lambda: load_config(write(tmp_path, "method: paper")),
    }[how]()
    assert (config.method, config.odom, config.final_pass) == ("paper", "off", False)


def test_a_file_of_a_preset_s_name_is_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "paper").write_text("azimuth: 33")
    assert (load_config("paper").azimuth, load_config("paper").method) == (33, "robust")


def test_a_file_wins_over_the_preset(tmp_path: Path) -> None:
    assert load_config(write(tmp_path, "method: paper\nfinal_pass: true")).final_pass


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("1=2", "--set 1=2: unknown key 1; "),
        ("ROBUST.CELL_MM=5", "--set ROBUST.CELL_MM=5: unknown key ROBUST; "),
        ("robust.cell_mm.x=5", "--set robust.cell_mm.x=5: robust.cell_mm is {'x': 5}, it should be a number"),
        ("grid=10", "--set grid=10: grid is 10, it should be a word or a section"),
        ("grid=", "--set grid=: grid is None, it should be a word or a section"),
    ],
)
def test_odd_settings_are_refused_in_one_line(setting: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(None, [setting])
    assert str(caught.value).startswith(words)


def test_presets_hold_only_what_differs_from_what_lies_below_them(repo_root: Path) -> None:
    """Below a method's own preset lie the defaults, below any other the preset of its method."""
    assert presets() == ["fig8", "paper", "paper-literal", "robust"]
    for name in presets():
        config = load_config(name)
        below = load_config(config.method) if name != config.method else Config()
        usual = by_dotted_key(below.document())
        for key, value in load_layer(repo_root / "configs" / f"{name}.yaml").items():
            assert usual[".".join(key)] != value or key == ("method",), key
        assert config.method == {"fig8": "paper", "paper-literal": "paper"}.get(name, name)


def test_the_literal_reading_is_that_of_the_defaults() -> None:
    assert load_config("paper-literal").paper == PaperConfig()


def load_layer(path: Path) -> dict[tuple[str, ...], object]:
    from mavnav.config.yaml_layers import read_yaml

    return read_yaml(path).values


def test_words_of_yaml_1_1_stay_words(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, "odom: off\nrobust: {cell_mm: 2e1}\n"))
    assert config.odom == "off"
    assert config.robust.cell_mm == 20.0


def test_integers_are_those_of_yaml_1_2(tmp_path: Path) -> None:
    """Leading zeros do not make a number octal, 0o does."""
    assert load_config(None, ["robust.cell_mm=010"]).robust.cell_mm == 10.0
    assert load_config(None, ["azimuth=08"]).azimuth == 8
    assert load_config(None, ["azimuth=0o10"]).azimuth == 8
    assert load_config(write(tmp_path, "azimuth: +012")).azimuth == 12


@pytest.mark.parametrize("text", ["true", "1_0", "'20'"])
def test_words_and_truth_values_are_no_numbers(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match=r":2: robust\.cell_mm is .*, it should be a number; cell edge"):
        load_config(write(tmp_path, f"robust:\n  cell_mm: {text}"))
    with pytest.raises(ConfigError, match=r"goal_m\.1 is"):
        load_scenario("corner", [f"goal_m=[1.0, {text}]"])


def test_the_schema_takes_the_grids_that_are_read() -> None:
    schemas = (schema_of(Config)["properties"]["grid"], scenario_schema()["$defs"]["Config"]["properties"]["grid"])
    for schema in schemas:
        text, mapping = schema["anyOf"]
        assert mapping == {"$ref": "#/$defs/GridSize"}
        assert text["type"] == "string"
        for grid in ("2x2", "10x10", "3X4", "199x200", "007x12"):
            assert GridSize.parse(grid)
            assert re.search(text["pattern"], grid)
        for grid in ("5", "5x", "1x5", "5x201", "5x5x5", "x5", "-5x5", "5x300"):
            with pytest.raises(ValueError, match="2 to 200"):
                GridSize.parse(grid)
            assert not re.search(text["pattern"], grid)


def test_an_empty_section_replaces_nothing(tmp_path: Path) -> None:
    text = "method: paper\npaper: {}\nrobust: {}\n"
    assert load_config(write(tmp_path, text)) == load_config(None, ["method=paper"])
    assert load_config(write(tmp_path, text), ["paper.cell_mm=33", "paper={}"]).paper.cell_mm == 33
    with pytest.raises(ConfigError, match="unknown key rubost"):
        load_config(write(tmp_path, "rubost: {}\n"))


def test_grid_takes_text_and_mapping(tmp_path: Path) -> None:
    assert load_config(write(tmp_path, "grid: {nx: 3, ny: 4}")).grid == GridSize(nx=3, ny=4)
    assert load_config(None, ["grid=3x4"]).grid == load_config(write(tmp_path, "grid: 3X4")).grid


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("azimuth: 20\nrobust:\n  cel_mm: 3\n", 3, ["unknown key robust.cel_mm", "did you mean robust.cell_mm?"]),
        ("azimuth: 20\nrobust.cell_mm: 3", 2, ["robust.cell_mm is a key in a section", "write cell_mm below robust"]),
        ("metod: paper", 1, ["unknown key metod", "did you mean method?"]),
        ("grid: 0x5", 1, ["'0x5'", "2 to 200", "--grid 10x10"]),
        ("grid: {nx: 3, nz: 3}", 1, ["unknown key grid.nz", "did you mean grid.n"]),
        ("method: rubust", 1, ["method", "'rubust'", "'robust' or 'paper'"]),
        ("\nazimuth: 1", 2, ["azimuth is 1", "greater than or equal to 2"]),
        ("paper:\n  near_mm: abc", 2, ["paper.near_mm", "should be a number", "step vi"]),
        ("robust:\n  cell_mm: .inf", 2, ["robust.cell_mm"]),
        ("robust: 5", 1, ["robust is 5"]),
        ("azimuth: 3\nazimuth: 4", 2, ["azimuth is given twice"]),
        ("odom: &a x\nmethod: *a", 2, ["aliases"]),
        ("odom: !!python/name:os.system ''", 1, ["odom", "tag"]),
        ("odom: [[a, {b: c}]]", 1, ["odom"]),
        ("- a", 1, ["no mapping"]),
        ("? [a]\n: b", 1, ["no plain word"]),
        ('"\\ud800": 3', 1, ["no plain word"]),
        ('method: "\\ud800"', 1, ["is no text"]),
        ('robust: {deskew: "\\ud800"}', 1, ["is no text"]),
        ("azimuth: [1\n", 2, ["not valid YAML"]),
        ("[" * 40, 1, ["nested deeper"]),
        ("azimuth: [" + 60_000 * "0," + "0]", 1, ["more than 40000 keys and values"]),
        ("a: 1\nb: 2", 1, ["unknown key a; "]),
        ("azimuth: " + 100 * "x", 1, [f"azimuth is '{76 * 'x'}..., it should be"]),
    ],
)
def test_errors_name_file_line_and_what_to_do(tmp_path: Path, text: str, line: int, words: list[str]) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:{line}: "), message
    assert all(word in message for word in words), message
    assert "\n" not in message


def test_errors_of_set_name_the_option() -> None:
    for bad in ("x", "=3", "robust.cell_m=5", "azimuth=many", "azimuth=4\nmethod: paper", "grid=1x1"):
        with pytest.raises(ConfigError, match="--set"):
            load_config(None, [bad])


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    binary, large, pipe = tmp_path / "binary", tmp_path / "large", tmp_path / "pipe"
    binary.write_bytes(b"\xff\x00\x01")
    large.write_bytes(b"#" * 1_000_001)
    os.mkfifo(pipe)
    for path, words in (
        (tmp_path / "none.yaml", "no such file.*paper, paper-literal, robust"),
        (binary, "not YAML text"),
        (large, "larger than"),
        (pipe, "not a regular file"),
        (tmp_path, "not a regular file"),
    ):
        with pytest.raises(ConfigError, match=words):
            load_config(path)


@pytest.mark.parametrize("key", ["robust.truncate_mm", "paper.shrink"])
def test_keys_of_experts_say_where_they_went(key: str) -> None:
    section, _, name = key.partition(".")
    with pytest.raises(ConfigError, match=f"^--set {key}=0.5: {key} is {section}.expert.{name} now; write that$"):
        load_config(None, [f"{key}=0.5"])
    with pytest.raises(ConfigError, match=f"slam.{key} is slam.{section}.expert.{name} now"):
        load_scenario("corner", [f"slam.{key}=0.5"])


@pytest.mark.parametrize("method", ["robust", "paper"])
def test_what_matters_is_shown_first(method: str) -> None:
    """The settings of the method, then those of its experts, then what the method does not use."""
    lines = to_yaml(load_config(method)).split("\n")
    assert lines.index(f"{method}:  # settings of the method {method}") < lines.index("  expert:  # for experts") < 30


def test_every_default_survives_a_round_trip_as_yaml(tmp_path: Path) -> None:
    for name in presets():
        config = load_config(name, ["odom=/wheel odom", "azimuth=33"])
        assert load_config(write(tmp_path, to_yaml(config))) == config


@pytest.mark.parametrize("model", [Config, Scenario, Manifest])
def test_every_number_has_two_bounds(model: type) -> None:
    """Else NaN or infinity would be read; those of a pose are checked together."""
    schema = schema_of(model)
    assert [key for key, node in numbers(schema) if len(bounds(node)) < 2 and ".extrinsic." not in key] == []


UNITS = {
    "_mm2": ("_m2", 1e-6),
    "_mm": ("_m", 1e-3),
    "_ms": ("_s", 1e-3),
    "_deg_s": ("_rad_s", DEG),
    "_deg": ("_rad", DEG),
}


@pytest.mark.parametrize(
    "section",
    [Config, PaperConfig, PaperExpert, RobustConfig, RobustExpert, PlannerConfig, VehicleConfig, FlightConfig],
)
def test_values_in_si_are_those_of_their_keys(section: type) -> None:
    made, names = section(), {name for name, value in vars(section).items() if isinstance(value, InSI)}
    for key in section.__struct_fields__:
        suffix = next((suffix for suffix in UNITS if key.endswith(suffix)), None)
        if suffix and (name := key.removesuffix(suffix) + UNITS[suffix][0]) in names and getattr(made, key) is not None:
            assert getattr(made, name) == getattr(made, key) * UNITS[suffix][1]
            names.remove(name)
    assert names <= {"gate_range_m"}  # it is null


def numbers(node: object, key: str = "") -> Iterator[tuple[str, dict]]:
    if isinstance(node, dict) and node.get("type") == "number":
        yield key, node
    for name, child in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from numbers(child, f"{key}.{name}")


def bounds(node: dict) -> set[str]:
    return {"minimum", "maximum", "exclusiveMinimum"} & set(node)


def test_every_number_is_described() -> None:
    sections = {"method", "grid", "paper", "robust", "odometry", "nx", "ny"}
    assert [".".join(key) for key, text in fields() if not text and key[-1] not in sections] == []


@given(st.text(alphabet="ab: -[]{}&*!#'\"\n0x", max_size=40))
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    from mavnav.config.yaml_layers import layer_of

    try:
        layer_of(text, "f.yaml")
    except ConfigError as error:
        assert str(error).startswith("f.yaml")
        assert "\n" not in str(error)


@given(st.integers(2, 200), st.integers(2, 200))
def test_grid_sizes_round_trip(nx: int, ny: int) -> None:
    assert GridSize.parse(str(GridSize(nx=nx, ny=ny))) == GridSize(nx=nx, ny=ny)


@pytest.mark.parametrize("text", ["0x5", "5", "5x", "x5", "5x5x5", "-3x4", "1x2", "201x3", "5.0x5", ""])
def test_bad_grid_sizes_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="--grid 10x10"):
        GridSize.parse(text)


def test_sections_are_frozen_and_equal_by_value(tmp_path: Path) -> None:
    path = write(tmp_path, "robust: {cell_mm: 25}\ngrid: 12x8\n")
    read, made = load_config(path), Config(grid=GridSize(ny=8, nx=12), robust=RobustConfig(cell_mm=25.0))
    assert read == made
    assert hash(read) == hash(made)
    assert len({read, made, Config()}) == 2
    assert pickle.loads(pickle.dumps(made)) == copy(made) == replace(made) == made
    assert replace(made, azimuth=7).azimuth == 7
    assert made != Config()
    assert made.robust != made.paper
    with pytest.raises(AttributeError):
        made.azimuth = 3  # type: ignore[misc]
    with pytest.raises(AttributeError):
        del made.azimuth
    with pytest.raises(TypeError, match="colour"):
        Config(colour=1)
