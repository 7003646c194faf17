"""Map files, read back as map_server and numpy do."""

import numpy as np
import pytest
import yaml
from msgspec.structs import replace

from mavnav.mapping.occupancy_grid import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Grid,
    GridBuilder,
    known_area,
    measured_area,
    occupancy,
)
from mavnav.outputs.files.gridmap import write_npz, write_pgm, write_yaml
from mavnav.pose import Pose


def load_map(folder):
    """Read a map as map_server's trinary mode does: (cells with row 0 at the bottom, resolution, origin)."""
    info = yaml.safe_load((folder / "map.yaml").read_text())
    magic, size, depth, pixels = (folder / info["image"]).read_bytes().split(b"\n", 3)
    assert (magic, depth) == (b"P5", b"255")
    cols, rows = map(int, size.split())
    shade = np.frombuffer(pixels, np.uint8).reshape(rows, cols)
    occupied = (shade / 255.0) if info["negate"] else (255 - shade) / 255.0
    cells = np.full(shape=(rows, cols), fill_value=-1)
    cells[occupied > info["occupied_thresh"]] = 100
    cells[occupied < info["free_thresh"]] = 0
    assert info["mode"] == "trinary"
    return cells[::-1], info["resolution"], info["origin"]


@pytest.fixture
def loaded(run, tmp_path):
    write_pgm(run, tmp_path / "map.pgm")
    write_yaml(run, tmp_path / "map.yaml")
    return load_map(tmp_path)


def test_map_server_reads_the_same_three_kinds_of_cells(run, loaded):
    cells, resolution, origin = loaded
    part = known_area(run.slam.grid)
    np.testing.assert_array_equal(cells, occupancy(part))
    assert {-1, 0, 100} == set(np.unique(cells))
    assert resolution == part.cell_m
    assert origin == [*part.origin_xy_m, 0.0]


def test_the_map_lies_where_the_laser_saw_it(run, loaded):
    """The wall 1 m to the right of the first pose is occupied, the way along x is free."""
    cells, resolution, (x0, y0, _) = loaded

    def at(x, y):
        return cells[int((y - y0) / resolution), int((x - x0) / resolution)]

    assert at(0.5, 0.0) == 0
    assert 100 in [at(0.5, -1.0 + d) for d in (-0.02, 0.0, 0.02)]
    assert at(0.5, -1.09) == -1


def test_counts_are_those_of_the_grid_cell_by_cell(run, loaded, tmp_path):
    write_npz(run, tmp_path / "hits.npz")
    with np.load(tmp_path / "hits.npz") as file:
        counts, passes = file["counts"], file["passes"]
        assert file["cell_m"] == run.slam.grid.cell_m
        np.testing.assert_allclose(file["origin_xy_m"], loaded[2][:2])
    assert counts.shape == loaded[0].shape
    assert counts.sum() == run.slam.grid.hits.sum()
    assert passes.sum() == run.slam.grid.passes.sum()
    assert counts.dtype == np.int32


@pytest.mark.parametrize(
    ("hits", "passes", "expected"),
    [(0, 0, UNKNOWN), (0, 1, FREE), (1, 0, OCCUPIED), (1, 4, OCCUPIED), (1, 5, FREE), (2, 8, OCCUPIED), (9, 99, FREE)],
)
def test_occupied_is_what_stops_a_fifth_of_the_beams(hits, passes, expected):
    grid = Grid(0.02, (0.0, 0.0), np.array([[hits]], np.int32), np.array([[passes]], np.int32))
    assert occupancy(grid).item() == expected


def test_the_known_part_moves_the_origin_along():
    grid = Grid(0.1, (-5.0, 2.0), np.zeros((50, 60), np.int32), np.zeros((50, 60), np.int32))
    grid.hits[20, 30], grid.passes[25, 40] = 7, 1
    part = known_area(grid)
    row, col = np.argwhere(part.hits)[0]
    assert part.origin_xy_m[0] + col * 0.1 == pytest.approx(-5.0 + 3.0)
    assert part.origin_xy_m[1] + row * 0.1 == pytest.approx(2.0 + 2.0)
    assert part.hits.shape == (6 + 4, 11 + 4)


@pytest.mark.parametrize("shape", [(0, 0), (30, 40)])
def test_an_empty_map_is_one_unknown_cell(run, shape, tmp_path):
    grid = Grid(0.02, (0.0, 0.0), np.zeros(shape, np.int32), np.zeros(shape, np.int32))
    empty = replace(run, slam=replace(run.slam, grid=grid))
    write_pgm(empty, tmp_path / "map.pgm")
    write_yaml(empty, tmp_path / "map.yaml")
    assert load_map(tmp_path)[0].tolist() == [[-1]]


def test_the_measured_part_does_not_depend_on_how_far_the_grid_reaches():
    tally = GridBuilder(0.02)
    tally.insert(Pose(0.3, 0.2, 0.0), np.array([(1.5, 0.9), (-0.7, -1.9)]))
    part = measured_area(tally.by_rows())
    tally._cover((-700, -500), (900, 300))
    again = measured_area(tally.by_rows())
    assert again.origin_xy_m == part.origin_xy_m
    np.testing.assert_array_equal(again.hits, part.hits)
    np.testing.assert_array_equal(again.passes, part.passes)
    assert all(n % 64 == 0 for n in part.hits.shape)
