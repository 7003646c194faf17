"""A mission's outputs: truth.tum, true_map.png, the truth on map.png, and the animation."""

from math import pi

import numpy as np
import pytest
from msgspec.structs import replace
from PIL import Image

from mavnav.errors import OutputError, UsageError
from mavnav.outputs.documents.schema import number_schema
from mavnav.outputs.files.trajectory import write_true_walls, write_truth_tum
from mavnav.outputs.pictures import animation, canvas, map_axes, map_picture
from mavnav.outputs.pictures.animation import animate
from mavnav.outputs.pictures.canvas import Canvas
from mavnav.outputs.run import Truth
from mavnav.outputs.writers import write_run
from mavnav.pose import Pose, Trajectory, transform_points
from support.synthetic import furnished_rooms

START = Pose(1.0, 1.0, 0.0)
"""Where `fabricate` begins, in the coordinates of `furnished_rooms`."""


@pytest.fixture(scope="module")
def mission(run):
    """The fabricated run with its truth: the poses that it was given, 5 cm to the left."""
    walls, first = furnished_rooms(), START.inverse()
    segments = np.hstack([transform_points(first, walls[:, :2]), transform_points(first, walls[:, 2:])])
    stamps = [s.stamp_ns for s in run.slam.steps]
    poses = [s.match.map_T_laser @ Pose(0.0, 0.05, 0.0) for s in run.slam.steps]
    arcs = np.array([[1.0, 1.0, 0.5, 0.0, pi]])
    truth = Truth(segments, arcs, map_T_laser=Trajectory.of(stamps, poses), goal_xy_map_m=(3.5, 4.4))
    return replace(run, truth=truth)


def pixels(path, frame=0):
    with Image.open(path) as image:
        image.seek(frame)
        return np.asarray(image.convert("RGB")).astype(int)


def count(picture, colour, tolerance=60):
    rgb = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return int((np.abs(picture - rgb).sum(axis=-1) < tolerance).sum())


def test_a_run_with_a_truth_writes_it_and_one_without_does_not(run, mission, tmp_path):
    written = set(write_run(mission, tmp_path / "a")["outputs"])
    assert written - set(write_run(run, tmp_path / "b")["outputs"]) == {"truth.tum", "true_walls.json", "true_map.png"}


def test_the_truth_is_written_for_every_scan_tracked_or_not(mission, tmp_path):
    write_truth_tum(mission, tmp_path / "truth.tum")
    rows = np.loadtxt(tmp_path / "truth.tum")
    assert len(rows) == len(mission.slam.steps) > len(mission.slam.trajectory)
    np.testing.assert_allclose(rows[:, 1:3], mission.truth.map_T_laser.xyyaw[:, :2], atol=1e-9)


@pytest.mark.parametrize("write", [write_truth_tum, write_true_walls, map_picture.write_true_map])
def test_without_a_truth_there_is_nothing_to_write(run, write, tmp_path):
    with pytest.raises(ValueError, match="truth"):
        write(run, tmp_path / "x")


def test_arcs_are_drawn_where_they_are():
    arc = np.array([[2.0, 3.0, 0.5, pi / 2, -pi]])
    truth = Truth(np.array([[0.0, 1.0, 2.0, 3.0]]), arc, map_T_laser=Trajectory.of([], []), goal_xy_map_m=(0.0, 0.0))
    straight, curved = map_axes.wall_lines(truth)
    assert straight.tolist() == [[0.0, 1.0], [2.0, 3.0]]
    np.testing.assert_allclose(np.hypot(*(curved - (2.0, 3.0)).T), 0.5)
    np.testing.assert_allclose(curved[[0, len(curved) // 2, -1]], [(2.0, 3.5), (2.5, 3.0), (2.0, 2.5)], atol=1e-12)
    assert np.hypot(*np.diff(curved, axis=0).T).max() < 0.5 * map_axes.ARC_STEP_RAD * 1.001


def test_the_true_map_shows_walls_start_heading_and_goal(mission, tmp_path):
    map_picture.write_true_map(mission, tmp_path / "t.png")
    picture = pixels(tmp_path / "t.png")
    assert count(picture, canvas.INK) > 5000
    for colour in (canvas.START_BLUE, canvas.GOAL_RED, canvas.POSE_MAGENTA):
        assert count(picture, colour) > 50


def test_the_legend_of_the_true_map_names_the_arrow(mission, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Canvas, "text", lambda _, xy, text, *args, **options: drawn.append(text))
    map_picture.write_true_map(mission, tmp_path / "t.png")
    assert {"start", "heading at the start", "goal"} <= set(drawn)


def test_the_true_map_counts_the_scans_as_run_json_does(mission, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Canvas, "text", lambda _, xy, text, *args, **options: drawn.append(text))
    map_picture.write_true_map(mission, tmp_path / "t.png")
    assert any(f" in {len(mission.truth.map_T_laser)} scans, ends " in text for text in drawn)
    assert "scans taken" in number_schema("mission.steps")["description"]


def test_the_map_of_a_mission_shows_the_truth_on_top(run, mission, tmp_path):
    map_picture.write(run, tmp_path / "without.png")
    map_picture.write(mission, tmp_path / "with.png")
    for colour, more in ((canvas.TRUE_ORANGE, 1000), ("#000000", 50)):
        without, with_truth = (count(pixels(tmp_path / f"{n}.png"), colour, 20) for n in ("without", "with"))
        assert with_truth > without + more, colour


def test_true_poses_are_those_at_the_stamps_of_the_circles(mission):
    some = np.arange(0, len(mission.slam.trajectory), 3)
    marks = map_picture.end_marks(mission, mission.slam.trajectory.stamps_ns[some].tolist())
    drawn = {mark.name: xy_m for mark, xy_m in marks}
    apart = np.hypot(*(mission.slam.trajectory.xyyaw[some, :2] - drawn["true pose"]).T)
    np.testing.assert_allclose(apart, 0.05, atol=1e-12)
    assert drawn["goal"].tolist() == [[3.5, 4.4]]
    assert drawn["start"].tolist() == [mission.truth.map_T_laser.xyyaw[0, :2].tolist()]


def test_a_mission_without_a_believed_pose_is_drawn(mission, tmp_path):
    lost = replace(mission, slam=replace(mission.slam, trajectory=Trajectory.of([], [])))
    map_picture.write(lost, tmp_path / "map.png")
    animate(lost, tmp_path / "a.gif")
    assert count(pixels(tmp_path / "map.png"), canvas.GOAL_RED) > 50


def test_the_animation_grows_and_repeats_to_the_byte(mission, tmp_path):
    for name in ("a.gif", "b.gif"):
        animate(mission, tmp_path / name)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
    with Image.open(tmp_path / "a.gif") as image:
        frames, size = image.n_frames, image.size
    assert frames == len(mission.slam.trajectory)
    assert max(size) <= animation.LONGEST_PIXELS + animation.CAPTION_PIXELS
    white = [count(pixels(tmp_path / "a.gif", k), "#ffffff", 1) for k in (0, frames // 2, frames - 1)]
    assert white[0] > white[1] > white[2]
    last = pixels(tmp_path / "a.gif", frames - 1)
    for colour in (canvas.POSE_MAGENTA, canvas.START_BLUE, canvas.GOAL_RED, "#000000"):
        assert count(last, colour, 1) > 20


def test_many_scans_are_shown_in_few_frames(mission, tmp_path, monkeypatch):
    monkeypatch.setattr(animation, "MAX_FRAMES", 5)
    animate(mission, tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as image:
        assert image.n_frames == 5


def test_a_run_without_a_truth_can_be_animated(run, tmp_path):
    animate(run, tmp_path / "a.gif")
    assert count(pixels(tmp_path / "a.gif"), canvas.GOAL_RED, 1) == 0


def test_what_exists_stays_without_force(run, tmp_path):
    (tmp_path / "a.gif").write_text("precious")
    with pytest.raises(OutputError, match="--force"):
        animate(run, tmp_path / "a.gif")
    assert (tmp_path / "a.gif").read_text() == "precious"
    animate(run, tmp_path / "a.gif", force=True)
    assert (tmp_path / "a.gif").read_bytes().startswith(b"GIF89a")
    with pytest.raises(UsageError, match=r"\.gif"):
        animate(run, tmp_path / "a.mp4")
    (tmp_path / "f.gif").mkdir()
    with pytest.raises(OutputError, match="name a file"):
        animate(run, tmp_path / "f.gif", force=True)
    assert {p.name for p in tmp_path.iterdir()} == {"a.gif", "f.gif"}
