"""``mavnav edit``: a map that was edited on purpose is taken by every command that reads maps."""

from __future__ import annotations

import json
import shutil
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from mavnav.cli import run
from mavnav.ground_truth.map_file import read_map
from mavnav.mapping.occupancy_grid import OCCUPIED, cell_centres, occupancy
from mavnav.outputs.files.gridmap import read_npz
from mavnav.pose import Pose
from support.map_files import pgm

BOX = "-0.6,-0.6,0.6,0.6"


@pytest.fixture(scope="module")
def made(make_log, tmp_path_factory) -> Path:
    """Return the run of a short log, beside the log."""
    folder = tmp_path_factory.mktemp("runs")
    shutil.copy(make_log("short.mcap", last=20), folder / "short.mcap")
    assert run(["replay", str(folder / "short.mcap"), "-o", str(folder / "run"), "-q"]) == 0
    return folder / "run"


@pytest.mark.slow
def test_an_edited_run_is_a_run_for_all_commands(mavnav, spawn, made, tmp_path) -> None:
    grid = read_npz(made / "hits.npz")
    y, x = np.argwhere(occupancy(grid) == OCCUPIED)[0].tolist()
    wall = cell_centres(grid, np.array([y]), np.array([x]))[0].tolist()
    area = ",".join(f"{v:.3f}" for v in (wall[0] - 0.1, wall[1] - 0.1, wall[0] + 0.1, wall[1] + 0.1))
    new = tmp_path / "edited"
    process = spawn("edit", made, "--erase", area, "--keep-largest", "-o", new, "--json")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    document = json.loads(out)
    assert document["cells"]["after"]["occupied"] < document["cells"]["before"]["occupied"]
    edited, drawn = read_npz(new / "hits.npz"), read_map(new / "map.yaml")
    assert ((occupancy(edited) == OCCUPIED) == (drawn.grid.hits > 0)).all()
    assert not (occupancy(edited) == OCCUPIED)[y, x]
    before, after = (json.loads((each / "run.json").read_text()) for each in (made, new))
    assert after["provenance"]["edits"] == [document["command"]]
    assert after["warnings"] == [*before["warnings"], f"the map was edited: {document['command']}"]
    assert (after["verdict"], after["wall_thickness"]) == (before["verdict"], before["wall_thickness"])
    assert after["map"]["hits"] == edited.hits.sum() < before["map"]["hits"]
    assert json.loads((new / "metrics.json").read_text())["map"] == after["map"]
    assert {file.name for file in new.iterdir()} == {*after["outputs"], "run.json"}
    for words in (
        ("check", new),
        ("metrics", new, "-q"),
        ("diff", made, new, "-q"),
        (
            "replay",
            made.with_name("short.mcap"),
            "--map",
            new,
            "-q",
            "--end",
            0.6,
            "--online",
            "-o",
            tmp_path / "placed",
        ),
        ("merge", new, new, "-q", "-o", tmp_path / "merged"),
    ):
        code, _, err = mavnav(*words)
        assert code == (1 if words[0] == "merge" else 0), (words, err)  # the same scans join no second time
        assert "altered" not in err
    (new / "map.pgm").write_bytes((made / "map.pgm").read_bytes())
    assert "altered since it was written" in mavnav("check", new)[2]


def test_edits_of_edits_are_all_recorded_and_repeat(mavnav, made, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(made, "run")
    assert mavnav("edit", "run", "--unknown", BOX)[0] == 0
    assert mavnav("edit", "run-edited", "--keep-largest", "--crop", "-1234.56789,-99,99,99", "-o", "twice")[0] == 0
    edits = json.loads(Path("twice/run.json").read_text())["provenance"]["edits"]
    assert [line.split()[2] for line in edits] == [str(tmp_path / "run"), str(tmp_path / "run-edited")]
    assert "--crop=-1234.56789,-99.0,99.0,99.0" in edits[-1]
    code, _, err = mavnav("replay", "--again", "twice")
    assert (code, err.count(edits[-1])) == (2, 1)
    assert mavnav(*edits[-1].split()[1:], "-o", "thrice")[0] == 0
    for name in ("map.pgm", "map.yaml", "hits.npz", "map.png"):
        assert (tmp_path / "twice" / name).read_bytes() == (tmp_path / "thrice" / name).read_bytes()


@pytest.mark.parametrize("table", ["no table", "x_m,y_m,direction_deg,width_mm,length_m\n" + "0,0,20,50,1e308\n" * 3])
def test_a_strange_table_of_walls_leaves_the_picture_as_it_is(mavnav, made, tmp_path, table) -> None:
    shutil.copytree(made, tmp_path / "run")
    (tmp_path / "run" / "walls.csv").write_text(table)
    document = json.loads((made / "run.json").read_text())
    document["outputs"]["walls.csv"] = sha256(table.encode()).hexdigest()
    (tmp_path / "run" / "run.json").write_text(json.dumps(document))
    code, _, errors = mavnav("edit", tmp_path / "run", "--keep-largest", "-o", tmp_path / "clean", "-q")
    assert (code, errors) == (0, "")
    assert (tmp_path / "clean" / "map.png").stat().st_size > 1000


def test_a_merge_stays_a_merge(mavnav, made, tmp_path) -> None:
    assert mavnav("merge", made, made, "-q", "-o", tmp_path / "merged")[0] == 1
    assert mavnav("edit", tmp_path / "merged", "--keep-largest", "-q")[0] == 0
    code, out, _ = mavnav("metrics", tmp_path / "merged-edited", "-q", "--json")
    assert (code, json.loads(out)["maps"][0]["kind"]) == (0, "merge")


@pytest.mark.parametrize("yaw_rad", [0.0, 0.5])
def test_a_map_of_another_tool_becomes_a_map_at_the_same_place(mavnav, tmp_path, yaw_rad) -> None:
    shades = np.full((40, 60), 205)
    shades[5:35, 5:55] = 254
    shades[5:35, [5, 54]] = shades[[5, 34], 5:55] = 0
    shades[18:22, 28:32] = 0  # somebody who stood there
    shades[38, 58] = 254
    (tmp_path / "map.pgm").write_bytes(pgm(shades))
    about = (
        f"image: map.pgm\nresolution: 0.05\norigin: [-1.0, 2.0, {yaw_rad}]\nfree_thresh: 0.25\noccupied_thresh: 0.65\n"
    )
    (tmp_path / "map.yaml").write_text(about + "negate: 0\n")
    before = read_map(tmp_path / "map.yaml")
    x_m, y_m, _ = before.map_T_grid @ Pose(30 * 0.05, 20 * 0.05, 0.0)
    area = f"{x_m - 0.4},{y_m - 0.4},{x_m + 0.4},{y_m + 0.4}"
    words = ("edit", tmp_path / "map.yaml", "--erase", area, "--crop", "-9,-9,99,99", "--keep-largest")
    assert mavnav(*words)[0] == 0
    after = read_map(tmp_path / "map-edited.yaml")
    inside = (np.abs(before.occupied_xy_m() - (x_m, y_m)) <= 0.4).all(axis=1)
    assert np.allclose(after.occupied_xy_m(), before.occupied_xy_m()[~inside])
    assert (after.grid.passes > 0).sum() == 48 * 28
    assert mavnav("edit", tmp_path / "map-edited.yaml", "--unknown", area, "-o", tmp_path / "next.yaml")[0] == 0
    lines = (tmp_path / "next.yaml").read_text().splitlines()
    assert [line.startswith("# edited: mavnav edit ") for line in lines[:3]] == [True, True, False]
    assert mavnav("metrics", tmp_path / "next.yaml", "-q")[0] == 0


def test_what_cannot_be_edited_is_refused_and_nothing_is_overwritten(mavnav, made, tmp_path) -> None:
    content = {file: file.read_bytes() for file in made.iterdir()}
    for words, part in (
        ((made, "--keep-largest", "-o", made, "--force"), "is an input"),
        ((made / "map.yaml", "--keep-largest", "-o", made / "map.yaml", "--force"), "is an input"),
        ((made / "map.yaml", "--keep-largest", "-o", tmp_path / "x.png"), "name it with .yaml"),
        ((made,), "give --crop, --erase, --unknown or --keep-largest"),
        ((made, "--crop", "1,2,3"), "X0,Y0,X1,Y1"),
        ((made, "--erase", "0,0,0,nan"), "X0,Y0,X1,Y1"),
        ((made, "--crop", "90,90,91,91"), "no wall would be left"),
        ((tmp_path / "none", "--keep-largest"), "name a run directory"),
        ((tmp_path / "none", "--keep-largest", "-o", tmp_path / "x"), "none: no such file; name a run directory"),
        ((made.parent, "--keep-largest"), "holds no map of a run"),
    ):
        code, out, err = mavnav("edit", *words, "-q")
        assert (code, out) == (2, ""), (words, err)
        assert part in err
    assert {file: file.read_bytes() for file in made.iterdir()} == content
    assert not made.with_name("run-edited").exists()
