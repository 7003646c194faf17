"""The data of the interactive map against what it was packed from."""

from __future__ import annotations

import io
import zlib
from base64 import b64decode

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from PIL import Image

from mavnav.logs import Odometry
from mavnav.mapping.occupancy_grid import FREE, OCCUPIED, Grid, occupancy
from mavnav.mapping.slices import Slice, Slices
from mavnav.outputs.files import replay_log
from mavnav.outputs.files.gridmap import slice_files, write_npz, write_slice
from mavnav.outputs.files.trajectory import write_poses, write_scans
from mavnav.outputs.report import page
from mavnav.outputs.report.entry import Entry, file_in, load, load_merge
from mavnav.outputs.report.view_data import (
    SHADES,
    Recording,
    beams,
    map_images,
    odometry_path,
    pack,
    read_recording,
    recording_of,
    slice_images,
    view_data,
)
from mavnav.pose import Pose, Trajectory
from support.report_runs import leave


def recorded(log) -> Recording:
    return Recording(len(log), log.sensor, log.scans, None)


def unpack(packed: dict) -> dict[str, np.ndarray]:
    content = zlib.decompress(b64decode(packed["bytes"]))
    return {
        name: np.frombuffer(content, f"<{kind}", length, offset)
        for name, (kind, offset, length) in packed["arrays"].items()
    }


def pixels(image: dict) -> np.ndarray:
    content = b64decode(image["src"].removeprefix("data:image/png;base64,"))
    return np.asarray(Image.open(io.BytesIO(content)))[::-1]


@given(st.lists(st.tuples(st.sampled_from(["u1", "u2", "i4", "f4", "f8"]), st.integers(0, 40)), max_size=5))
def test_arrays_come_back_as_they_were_and_begin_where_a_script_can_read_them(parts):
    arrays = {f"array{k}": np.arange(length).astype(kind) for k, (kind, length) in enumerate(parts)}
    packed = pack(arrays)
    assert all(offset % np.dtype(kind).itemsize == 0 for kind, offset, _ in packed["arrays"].values())
    back = unpack(packed)
    assert list(back) == list(arrays) and all(np.array_equal(back[name], array) for name, array in arrays.items())


def test_pictures_have_a_pixel_for_each_cell(run):
    grid = run.known
    free, hits = map_images(grid, top := float(grid.hits.max()))
    assert np.array_equal(pixels(free) == 1, occupancy(grid) == FREE)
    assert np.array_equal(pixels(hits) > 0, grid.hits > 0)
    assert pixels(hits)[grid.hits == top].min() == SHADES and pixels(hits)[grid.hits == 1].max() == 1
    rows, cols = grid.hits.shape
    x0, y0, x1, y1 = hits["box"]
    assert (x0, y0) == pytest.approx(grid.origin_xy_m, abs=1e-6)
    assert (x1 - x0, y1 - y0) == pytest.approx((cols * grid.cell_m, rows * grid.cell_m), abs=1e-5)


def test_cells_of_a_large_map_are_pooled_and_no_wall_is_lost():
    hits = np.zeros((100, 90), np.uint16)
    hits[5:95, 40] = 3
    hits[50, 5:85] = 1
    _, image = map_images(Grid(0.02, (0.0, 0.0), hits, hits), 10.0, max_pixels=1000)
    shown = pixels(image)
    assert shown.size <= 1000 and (shown > 0).any(axis=1).sum() >= 90 // 4
    assert image["box"][2] >= 86 * 0.02


def test_every_scan_is_packed_with_its_ranges_to_the_millimeter(run):
    stamps_s = np.array([scan.stamp_ns for scan in run.log.scans()]) * 1e-9
    packed = beams([recorded(run.log)], stamps_s, [0], 1_000_000)
    ranges = np.cumsum(packed["range"], axis=1, dtype=np.uint16)
    for k, scan in enumerate(run.log.scans()):
        expected = np.nan_to_num(scan.ranges_m * 1e3).round()
        np.testing.assert_array_equal(ranges[packed["row"][k]], expected)
    np.testing.assert_allclose(np.exp(1j * packed["bearing"]), scan.spec.directions @ (1, 1j), atol=1e-6)


def test_of_many_ranges_every_so_manieth_beam_is_kept_and_every_scan(run):
    stamps_s = np.array([scan.stamp_ns for scan in run.log.scans()]) * 1e-9
    packed = beams([recorded(run.log)], stamps_s, [0], 2000)
    assert packed["range"].size <= 2000 and (packed["row"] >= 0).all()


def test_a_scan_that_was_not_recorded_has_no_row(run):
    stamps_s = np.array([scan.stamp_ns for scan in run.log.scans()]) * 1e-9
    assert beams([recorded(run.log)], stamps_s[:3] + np.array([0.0, 0.1, 0.0]), [0], 10_000)["row"].tolist() == [
        0,
        -1,
        2,
    ]


def test_a_run_that_just_ended_shows_what_its_recording_would(run, tmp_path):
    stamps_ns = np.array([scan.stamp_ns for scan in run.log.scans()])
    ticks_ns = list(range(int(stamps_ns[0]) - 70_000_000, int(stamps_ns[-1]) + 100_000_000, 130_000_000))
    ahead = Trajectory.of(ticks_ns, [Pose(0.03 * k, 0.01 * k, 0.02 * k) for k in range(len(ticks_ns))])
    odometry = Odometry("/odom", "odom", ahead, ahead.compose(run.log.base_T_laser))
    moved = replace(run, log=replace(run.log, odometry=odometry))
    replay_log.write(moved, tmp_path / "result.mcap")
    kept, read = recording_of(moved), read_recording(tmp_path / "result.mcap")
    memory, file = (beams([log], stamps_ns * 1e-9, [0], 1_000_000) for log in (kept, read))
    np.testing.assert_array_equal(memory["row"], file["row"])
    ranges_mm = (np.cumsum(shown["range"], axis=1, dtype=np.uint16).astype(int) for shown in (memory, file))
    np.testing.assert_allclose(*ranges_mm, atol=1)  # a message holds them in single precision
    np.testing.assert_allclose(memory["bearing"], file["bearing"], atol=2e-6)
    first_s = float(run.slam.trajectory.stamps_ns[0]) * 1e-9
    paths = [odometry_path(log, first_s, run.slam.trajectory[0]) for log in (kept, read)]
    assert len(paths[0]) == len(run.slam.trajectory) > 10
    np.testing.assert_allclose(*paths, atol=1e-4)


@pytest.mark.parametrize("content", [None, b"no recording"])
def test_without_a_recording_the_page_has_poses_and_no_beams(run, tmp_path, content):
    cell = leave(run, tmp_path / "run")
    if content:
        (tmp_path / "run" / "result.mcap").write_bytes(content)
    entry = load(cell, tmp_path)
    assert isinstance(entry, Entry)
    (shown,) = view_data([entry], {})
    arrays = unpack(shown)
    assert "range" not in arrays and len(arrays["time"]) == 20
    assert arrays["state"].tolist() == [int(k not in {10, 11}) for k in range(20)]


def test_sessions_of_a_merge_follow_one_another_with_their_scans(run, tmp_path):
    scans, poses = list(run.log.scans()), run.slam.trajectory
    kept = [scan for scan in scans if scan.stamp_ns in set(poses.stamps_ns.tolist())]
    write_npz(run, tmp_path / "hits.npz")
    rows = []
    for name, part in {"monday": slice(10, 18), "tuesday": slice(0, 6)}.items():
        row = {"name": name, "joined": True, "trajectory": f"{name}.tum", "recording": f"{name}.mcap"}
        write_poses(Trajectory(poses.stamps_ns[part], poses.xyyaw[part]), tmp_path / row["trajectory"])
        write_scans(lambda part=part: iter(kept[part]), tmp_path / row["recording"])
        rows.append(row)
    refused = {"name": "friday", "joined": False, "trajectory": None, "recording": None}
    entry = load_merge({"sessions": [*rows, refused]}, tmp_path)
    (shown,) = view_data([entry], {})
    arrays = unpack(shown)
    assert shown["sessions"] == [{"name": "monday", "first": 0}, {"name": "tuesday", "first": 8}]
    assert arrays["row"].tolist() == list(range(14)) and (np.diff(arrays["time"]) > 0).all()
    order = [*range(10, 18), *range(6)]
    np.testing.assert_allclose(arrays["xy"].reshape(-1, 2), poses.xyyaw[order, :2], atol=1e-5)
    np.testing.assert_allclose(arrays["yaw"], poses.xyyaw[order, 2], atol=1e-5)
    ranges = np.cumsum(arrays["range"].reshape(14, -1), axis=1, dtype=np.uint16)
    np.testing.assert_allclose(ranges[9], np.nan_to_num(kept[1].ranges_m * 1e3), atol=1.0)


@pytest.mark.parametrize("name", ["../run/result.mcap", "/etc/hostname", "", "run/../x"])
def test_no_file_outside_of_a_run_is_read(tmp_path, name):
    with pytest.raises(ValueError, match="is no file of"):
        file_in(tmp_path, name)


def test_slices_are_drawn_where_they_lie(run, tmp_path):
    layer = Slice(0.3, 0.2, 0.4, run.known)
    files = slice_files([layer])
    for file in files:
        write_slice(replace(run, slices=Slices((layer,), np.zeros((0, 3)))), tmp_path / file)
    rows = [{"map": files[1], "from_m": 0.2, "to_m": 0.4}]
    (image,) = slice_images(tmp_path, rows)
    assert image["title"] == "Slice 0.20 to 0.40 m" and image["box"] == map_images(run.known, 10.0)[1]["box"]
    assert np.array_equal(pixels(image) == 1, occupancy(run.known) == OCCUPIED)
    with pytest.raises(ValueError, match="is no file of"):
        slice_images(tmp_path, [{**rows[0], "map": f"../{files[1]}"}])


def test_the_library_names_its_license_and_no_file():
    assert page.leaflet_script().startswith("/* @preserve\n * Leaflet 1.9")
    assert "sourceMappingURL" not in page.leaflet_script() and "</script" not in page.leaflet_script().lower()
    assert "url(" not in page.leaflet_style()


def test_a_jump_between_two_scans_is_no_lost_track(run, tmp_path):
    lost = {"start_s": 1.0, "end_s": 1.5, "scans": 5, "recovered": True}
    tracking = {"intervals": [lost, lost | {"scans": 0}], "doubt": None, "tracked_share": 1.0, "lost": False}
    (seen,) = view_data([load(leave(run, tmp_path / "a", tracking=tracking), tmp_path)], {})
    assert [place["text"] for place in seen["places"]] == ["track lost, 5 scans", "the path jumps"]
