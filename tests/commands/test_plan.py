"""``mavnav plan``: drawings of a floor plan that other programs read, true to scale."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from shutil import copytree
from xml.etree import ElementTree

import numpy as np
import pytest

from mavnav.ground_truth.map_file import read_map
from support.changed_rooms import mapped, rooms, saved
from support.map_files import pgm

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def walls(tmp_path_factory) -> Path:
    """Return the map of some rooms, as of a run."""
    return saved(mapped(rooms()), tmp_path_factory.mktemp("maps") / "rooms")


def lines_of(path: Path, name: str) -> np.ndarray:
    """Return the lines (n, 4) of a group of an SVG, mm on paper."""
    root = ElementTree.parse(path).getroot()
    (group,) = (each for each in root.iter(f"{SVG}path") if each.get("id") == name)
    return np.array([part.replace("L", " ").split() for part in group.get("d").split("M")[1:]], float).reshape(-1, 4)


def test_a_drawing_has_the_walls_at_its_scale(mavnav, spawn, walls, tmp_path) -> None:
    process = spawn("plan", walls, "-o", tmp_path / "a.svg", "--json")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    document = json.loads(out)
    ends = np.array([[*line["from_m"], *line["to_m"]] for line in document["walls"]])
    drawn = lines_of(tmp_path / "a.svg", "walls")
    top = ends[:, 1::2].max()
    shift = drawn[0, :2] - (ends[0, 0] * 10.0, (top - ends[0, 1]) * 10.0)
    assert np.allclose(drawn[:, ::2], ends[:, ::2] * 10.0 + shift[0], atol=0.02)
    assert np.allclose(drawn[:, 1::2], (top - ends[:, 1::2]) * 10.0 + shift[1], atol=0.02)
    assert document["size_m"] == pytest.approx([7.0, 6.5], abs=1.0)
    assert sum(line["length_m"] for line in document["walls"]) == pytest.approx(document["wall_m"], abs=0.01)
    assert len(lines_of(tmp_path / "a.svg", "openings")) == len(document["openings"]) >= 1
    assert mavnav("plan", walls, "-o", tmp_path / "b.svg", "--scale", 50, "-q")[0] == 0
    assert np.allclose(np.ptp(lines_of(tmp_path / "b.svg", "walls"), axis=0), 2.0 * np.ptp(drawn, axis=0), atol=0.03)
    assert "1:50;" in (tmp_path / "b.svg").read_text()


def test_a_dxf_has_the_same_lines_in_meters_and_the_same_bytes(mavnav, walls, tmp_path) -> None:
    ezdxf = pytest.importorskip("ezdxf")
    document = json.loads(mavnav("plan", walls, "-o", tmp_path / "a.dxf", "--json", "-q")[1])
    assert mavnav("plan", walls, "-o", tmp_path / "b.dxf", "-q")[0] == 0
    assert (tmp_path / "a.dxf").read_bytes() == (tmp_path / "b.dxf").read_bytes()
    drawing = ezdxf.readfile(tmp_path / "a.dxf")
    assert drawing.units == ezdxf.units.M
    assert not drawing.audit().errors
    for layer, name in (("WALLS", "walls"), ("OPENINGS", "openings")):
        lines = drawing.modelspace().query(f'LINE[layer=="{layer}"]')
        ends = [[*line.dxf.start.xyz[:2], *line.dxf.end.xyz[:2]] for line in lines]
        assert np.allclose(ends, [[*line["from_m"], *line["to_m"]] for line in document[name]], atol=6e-4)


def test_a_dxf_without_its_library_says_how_to_get_it(mavnav, walls, tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    code, _, err = mavnav("plan", walls, "-o", tmp_path / "a.dxf", "-q")
    assert (code, list(tmp_path.iterdir())) == (2, [])
    assert "pip install 'mavnav[dxf]', or write an .svg" in err
    assert mavnav("plan", walls, "-o", tmp_path / "a.svg", "-q")[0] == 0


def test_a_map_of_another_tool_has_a_plan_beside_it(mavnav, tmp_path) -> None:
    shades = np.full((60, 100), 254)
    shades[[5, 54], 5:95] = shades[5:55, [5, 94]] = 0
    shades[5:55, 50] = 0
    shades[20:38, 50] = 254  # a door of 0.9 m
    (tmp_path / "map.pgm").write_bytes(pgm(shades))
    (tmp_path / "map.yaml").write_text("image: map.pgm\nresolution: 0.05\norigin: [-1.0, 2.0, 0.5]\n")
    code, out, err = mavnav("plan", tmp_path / "map.yaml", "--json")
    document = json.loads(out)
    assert (code, document["output"]) == (0, str(tmp_path / "map-plan.svg")), err
    assert document["size_m"] == pytest.approx([89 * 0.05, 49 * 0.05], abs=0.01)  # middle to middle
    assert [line["length_m"] for line in document["openings"]] == pytest.approx([0.9], abs=0.051)
    assert document["yaw_deg"] == pytest.approx(-np.degrees(0.5), abs=0.2)
    assert read_map(tmp_path / "map.yaml").grid.hits.sum() > 0
    code, _, err = mavnav("plan", tmp_path / "map.yaml")
    assert (code, "exists; choose another file, or --force" in err) == (6, True)


def test_a_run_has_its_plan_inside_so_that_runs_can_still_be_checked_all(mavnav, walls, tmp_path) -> None:
    """A file beside the runs would be one of ``runs/*``."""
    for name in ("a", "b"):
        copytree(walls, tmp_path / name)
        (tmp_path / name / "run.json").write_text('{"exit_code": 0, "outputs": {}}')
    code, out, err = mavnav("plan", tmp_path / "a", "--json")
    assert (code, json.loads(out)["output"]) == (0, str(tmp_path / "a" / "plan.svg")), err
    code, out, err = mavnav("check", *sorted(tmp_path.iterdir()))
    assert (code, len(out.splitlines())) == (0, 2), err
    assert mavnav("check", tmp_path / "a" / "plan.svg")[0] == 2


def test_what_cannot_be_drawn_is_refused(mavnav, walls, tmp_path) -> None:
    (tmp_path / "map.pgm").write_bytes(pgm(np.full((9, 9), 254)))
    (tmp_path / "map.yaml").write_text("image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")
    for words, part in (
        ((walls, "-o", tmp_path / "a.png"), "name it with .svg"),
        ((tmp_path / "map.yaml", "-o", tmp_path / "a.svg"), "the map has no straight wall"),
        ((tmp_path / "none", "-o", tmp_path / "a.svg"), "name a run directory"),
        ((walls, "-o", tmp_path / "a.svg", "--scale", "0"), "--scale"),
    ):
        code, out, err = mavnav("plan", *words, "-q")
        assert (code, out) == (2, ""), (words, err)
        assert part in err
    assert {file.name for file in tmp_path.iterdir()} == {"map.pgm", "map.yaml"}
