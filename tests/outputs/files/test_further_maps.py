"""Files that must be named: the map as vectors and in scale mode, and the pose graph."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from msgspec.structs import replace
from PIL import Image

from mavnav.errors import UsageError
from mavnav.ground_truth.map_file import read_map
from mavnav.mapping.occupancy_grid import OCCUPIED
from mavnav.outputs.files import gridmap
from mavnav.outputs.files.gridmap import write_pgm, write_yaml
from mavnav.outputs.files.trajectory import write_graph
from mavnav.outputs.pictures import vector_map
from mavnav.outputs.writers import GROUPS, check_groups, write_run
from mavnav.pose import Pose
from mavnav.slam.findings import Edge, Loops, PoseGraph

SVG = "{http://www.w3.org/2000/svg}"
RECTANGLE = re.compile(r"M(\d+) (\d+)h(\d+)v(\d+)h-(\d+)z")


def painted(path: str, shape: tuple[int, int]) -> np.ndarray:
    """Return how often each cell is covered by the rectangles of a path."""
    cells = np.zeros(shape, int)
    assert RECTANGLE.sub("", path) == ""
    for x, y, width, height, back in (map(int, found) for found in RECTANGLE.findall(path)):
        assert width == back
        cells[y : y + height, x : x + width] += 1
    return cells


@pytest.mark.parametrize("seed", range(5))
def test_outlines_cover_the_cells_once(seed):
    cells = np.random.default_rng(seed).random((13, 9)) < 0.5
    np.testing.assert_array_equal(painted(vector_map.outlines(cells), cells.shape), cells)


def test_equal_runs_of_rows_are_one_rectangle():
    cells = np.zeros((5, 7), bool)
    cells[1:4, 2:6] = True
    assert vector_map.outlines(cells) == "M2 1h4v3h-4z"
    assert vector_map.outlines(~cells[:0]) == ""


def test_the_svg_shows_walls_path_and_scale(run, tmp_path):
    vector_map.write(run, tmp_path / "map.svg")
    root = ElementTree.parse(tmp_path / "map.svg").getroot()
    walls, path, bar = root.findall(f".//{SVG}path")
    np.testing.assert_array_equal(painted(walls.get("d"), run.cells.shape), run.cells[::-1] == OCCUPIED)
    assert len(root.findall(f".//{SVG}circle")) == 2
    assert path.get("d").count("M") == 2  # the track was lost once
    metres = float(root.find(f"{SVG}text").text.removesuffix(" m"))
    assert float(bar.get("d").split("h")[1].split("v")[0]) == pytest.approx(metres / run.known.cell_m)
    assert root.find(f"{SVG}title").text == run.name


def test_the_scale_map_is_graded_and_occupied_as_the_map_is(run, tmp_path):
    for name in GROUPS["scale"]:
        gridmap.write_scale(run, tmp_path / name)
    write_pgm(run, tmp_path / "map.pgm")
    write_yaml(run, tmp_path / "map.yaml")
    scaled, plain = (read_map(tmp_path / name).grid for name in ("map_scale.yaml", "map.yaml"))
    different = np.count_nonzero(scaled.hits != plain.hits)
    assert different <= 0.02 * np.count_nonzero(plain.hits)  # shares next to the threshold are rounded
    pixels = np.asarray(Image.open(tmp_path / "map_scale.png"))[::-1]
    unknown = (run.known.hits == 0) & (run.known.passes == 0)
    np.testing.assert_array_equal(pixels[..., 1] == 0, unknown)
    assert len(np.unique(pixels[..., 0])) > 10
    assert set(pixels[(run.known.hits == 0) & ~unknown, 0]) == {255}


@pytest.fixture
def looped(run):
    edges = (Edge(0, 1, Pose(1.0, 0.5, 0.1), np.diag([10.0, 10.0, 100.0])), Edge(0, 1, Pose(), np.zeros((3, 3))))
    return replace(run, slam=replace(run.slam, loops=Loops(graph=PoseGraph((0, 9), edges))))


def test_the_graph_has_vertices_and_edges_by_scan(looped, tmp_path):
    write_graph(looped, tmp_path / "g.g2o")
    first, second, fixed, edge, weak = (line.split() for line in (tmp_path / "g.g2o").read_text().splitlines())
    steps = [step for step in looped.slam.steps if step.tracked]
    assert [first[:2], second[:2]] == [["VERTEX_SE2", "0"], ["VERTEX_SE2", str(steps[9].index)]]
    assert tuple(map(float, second[2:])) == pytest.approx(tuple(looped.slam.trajectory[9]), abs=1e-8)
    assert fixed == ["FIX", "0"]
    assert edge[:3] == ["EDGE_SE2", "0", str(steps[9].index)]
    assert [float(v) for v in edge[3:]] == [1.0, 0.5, 0.1, 100.0, 0.0, 0.0, 100.0, 0.0, 10000.0]
    assert {float(v) for v in weak[3:]} == {0.0}


def test_groups_that_must_be_named(run, looped, tmp_path):
    document = write_run(run, tmp_path / "a", groups=("svg", "graph", "slices"))
    assert document["outputs"].keys() == {"map.svg"}
    assert [line for line in document["warnings"] if "written" in line] == [
        "no slices written: the heights of the scans are not known",
        "no graph written: the path returns nowhere, or no loop was looked for",
    ]
    whole = write_run(looped, tmp_path / "b", groups=("all",))
    everything = whole["outputs"].keys()
    assert not [line for line in whole["warnings"] if "written" in line]
    assert everything >= {"map.svg", "map_scale.png", "map_scale.yaml", "pose_graph.g2o", "result.mcap", "map.pgm"}
    check_groups(("all",))
    with pytest.raises(UsageError, match=r"known are .*graph, all"):
        check_groups(("vectors",))
