"""A flight with roll, pitch and height through a furnished room: replayed with the attitude, and without."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

import mavnav
from mavnav.cli import run
from mavnav.outputs.pictures.canvas import rgb_of
from mavnav.outputs.pictures.map_axes import END, START
from mavnav.pose import transform_points
from support.log_files import START_NS
from support.tilted import flight, furnished, write_flight

SCANS = 140
SLICES = ["map_0.3m", "map_0.6m", "map_0.9m", "map_1.2m", "map_1.5m", "map_1.8m", "map_2.1m"]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Replay a flight with its attitude (folder ``auto``) and without (``off``)."""
    folder = tmp_path_factory.mktemp("flown")
    log = write_flight(folder / "flight.mcap", SCANS)
    rows = [
        f"{(START_NS + k * 10**8) * 1e-9:.9f} {p.x_m} {p.y_m} 0 0 0 {np.sin(p.yaw_rad / 2)} {np.cos(p.yaw_rad / 2)}"
        for k, (p, _) in enumerate(flight(SCANS))
    ]
    (folder / "truth.tum").write_text("\n".join(rows) + "\n")
    for attitude in ("auto", "off"):
        mavnav.replay(
            log, attitude=attitude, truth=folder / "truth.tum", directory=folder / attitude, report=attitude == "auto"
        )
    return folder


def document(flown: Path, attitude: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((flown / attitude / "run.json").read_text())
    return found


def to_walls(xy_m: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """Return the distance of points to the nearest wall, (n,)."""
    start, along = walls[:, :2], walls[:, 2:] - walls[:, :2]
    off = xy_m[:, None] - start
    share = np.clip((off * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(off - share[..., None] * along, axis=2).min(axis=1)


def drawn(folder: Path, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pixels of a map, lowest row first, and the middles of its occupied cells in the room."""
    about = yaml.safe_load((folder / f"{name}.yaml").read_text())
    pixels = np.asarray(Image.open(folder / about["image"]))[::-1]
    row, col = np.nonzero(pixels == 0)
    xy_m = (np.column_stack((col, row)) + 0.5) * about["resolution"] + about["origin"][:2]
    return pixels, np.column_stack((row, col)), transform_points(flight(1)[0][0], xy_m)


@pytest.mark.slow
def test_the_attitude_makes_track_and_walls_better(flown: Path) -> None:
    used, ignored = (document(flown, attitude) for attitude in ("auto", "off"))
    assert used["reference"]["ate"]["rmse_m"] < 0.003
    assert used["reference"]["ate"]["rmse_m"] < 0.3 * ignored["reference"]["ate"]["rmse_m"]
    assert used["wall_thickness"]["spread"]["p95_mm"] < 45.0 < ignored["wall_thickness"]["spread"]["p95_mm"]
    assert used["input"]["attitude"]["topic"] == "/attitude"
    assert used["input"]["attitude"]["tilt_max_deg"] == pytest.approx(13.9, abs=0.1)
    assert "attitude" not in ignored["input"]
    assert "slices" not in ignored


def test_every_slice_is_a_map_of_its_walls(flown: Path) -> None:
    scene, found = furnished(), document(flown, "auto")["slices"]
    assert [each["map"] for each in found] == [f"{name}.yaml" for name in SLICES]
    for name, each in zip(SLICES, found, strict=True):
        _, _, xy_m = drawn(flown / "auto", name)
        there = scene.walls[scene.tops_m > each["from_m"]]
        assert (to_walls(xy_m, there) <= 0.04).mean() > 0.98
        assert each["middle_m"] == pytest.approx((each["from_m"] + each["to_m"]) / 2)
        assert each["occupied"] == len(xy_m)


def test_the_table_is_only_in_the_slices_that_it_reaches(flown: Path) -> None:
    """The cells above the table are free; those of its sides below stay occupied though beams pass above them."""
    table = furnished().walls[4:8]
    lowest, lower, upper = (drawn(flown / "auto", name) for name in ("map_0.3m", "map_0.6m", "map_1.2m"))
    on_table = [cells[to_walls(xy_m, table) < 0.03] for _, cells, xy_m in (lowest, lower, upper)]
    assert [len(cells) > 40 for cells in on_table] == [True, True, False]
    above = upper[0][tuple(on_table[1].T)]
    assert (above == 254).mean() > 0.95


def test_the_files_have_one_frame_and_are_listed(flown: Path) -> None:
    folder = flown / "auto"
    whole, first = (yaml.safe_load((folder / f"{name}.yaml").read_text()) for name in ("map", SLICES[0]))
    assert whole | {"image": f"{SLICES[0]}.pgm"} == first
    outputs = document(flown, "auto")["outputs"]
    assert {"map_3d.png", *(f"{name}.{end}" for name in SLICES for end in ("pgm", "yaml"))} <= set(outputs)
    with Image.open(folder / "map_3d.png") as picture:
        counts = {colour: count for count, colour in picture.getcolors(1 << 24)}
    assert sum(count > 500 for count in counts.values()) > 15  # seven heights, three faces each
    for mark in (START, END):  # on the path and in the legend
        assert counts[rgb_of(mark.colour)] > 100


def test_the_page_shows_the_slices(flown: Path) -> None:
    page = (flown / "auto" / "report.html").read_text()
    assert "Slices by height" in page
    assert "0.15 to 0.45" in page
    assert page.count("Walls as columns, by height") == 1


def test_the_thickness_is_a_setting_and_the_group_may_be_left_out(flown: Path, tmp_path: Path) -> None:
    options = ["--set", "slice_mm=1000", "--end", "3", "-q"]
    assert (
        run(["replay", str(flown / "flight.mcap"), "-o", str(tmp_path / "thick"), "--outputs", "slices", *options]) == 0
    )
    names = sorted(path.name for path in (tmp_path / "thick").iterdir())
    assert names == ["map_1m.pgm", "map_1m.yaml", "map_2m.pgm", "map_2m.yaml", "map_3d.png", "run.json"]
