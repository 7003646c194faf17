"""Pictures: there, of a sane size, and drawn from any map."""

from io import BytesIO
from itertools import pairwise
from math import floor
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec.structs import replace
from PIL import Image

from mavnav.mapping.occupancy_grid import Grid
from mavnav.mapping.tiled_arrays import max_pool
from mavnav.metrics.floor_plan import turn_to_cuts
from mavnav.metrics.map_quality import measure_map
from mavnav.metrics.wall_spread import WallCuts
from mavnav.outputs.documents.verdict import Verdict
from mavnav.outputs.pictures import map_axes, map_picture, wall_picture
from mavnav.outputs.pictures.canvas import Canvas, font, png, rgb_of
from mavnav.outputs.pictures.map_axes import Viewport, window_of
from mavnav.outputs.pictures.plot import Axes, legend_room, legend_width, ticks
from mavnav.outputs.run import picture_turn_rad
from mavnav.pose import Pose, Trajectory
from mavnav.slam.findings import Doubt, Loop, Loops, Reason

FULL = "m" * int(wall_picture.HISTOGRAM[0] / font(wall_picture.TITLE_PT).getlength("m") + 1)
"""A title a little longer than its chart, which fits without a margin."""

WRITERS = pytest.mark.parametrize("write", [map_picture.write, wall_picture.write], ids=["map", "walls"])


def with_map(run, hits, trajectory=None, cell_m=0.02):
    grid = Grid(cell_m, (0.0, 0.0), hits.astype(np.int32), np.zeros(hits.shape, np.int32))
    slam = replace(run.slam, grid=grid, trajectory=trajectory or run.slam.trajectory)
    return replace(run, slam=slam, metrics=measure_map(grid))


def size_of(path):
    with Image.open(path) as image:
        image.verify()
        return image.size


@WRITERS
@pytest.mark.parametrize("shape", [(80, 80), (40, 3000), (3000, 40), (1200, 2200)])
def test_any_shape_of_map_gives_a_picture_that_fits_a_screen(run, write, shape, tmp_path):
    hits = np.zeros(shape)
    hits[5:-5, 5] = hits[5:-5, -5] = hits[5, 5:-5] = hits[-5, 5:-5] = 7
    write(with_map(run, hits), tmp_path / "p.png")
    width, height = size_of(tmp_path / "p.png")
    assert 600 < width < 2400
    assert 400 < height < 2000


@WRITERS
def test_an_empty_map_without_a_pose_is_drawn(run, write, tmp_path):
    write(with_map(run, np.zeros((0, 0)), Trajectory.of([], [])), tmp_path / "p.png")
    assert size_of(tmp_path / "p.png")[0] > 400


def test_the_colours_of_the_legend_are_in_the_map(run, tmp_path):
    map_picture.write(run, tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)

    def near(colour):
        return (np.abs(pixels - colour).sum(axis=1) < 60).sum()

    assert near((0xD6, 0x00, 0x9A)) > 200  # poses
    assert near((0x00, 0x33, 0xFF)) > 50  # start
    assert near((0xE0, 0x00, 0x00)) > 50  # end


def test_the_legend_of_the_map_names_its_areas_and_is_whole(run, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Canvas, "text", lambda _, xy, text, *args, **options: drawn.append(text))
    map_picture.write(run, tmp_path / "map.png")
    assert {"start", "end", "free", "unknown"} <= set(drawn)
    assert any("20 yaw samples, search grid 10x10" in text for text in drawn)
    marks = [map_axes.LOOP, map_axes.TRUE_WALL, map_axes.DOUBTFUL, map_axes.POSE, map_axes.TRUE_POSE, *map_axes.KNOWN]
    assert legend_room(marks) > legend_width(marks)


def test_no_line_is_drawn_where_the_track_was_lost(run):
    (lost,) = run.slam.lost
    before, after = map_picture.parts_of_path(run.slam)
    assert len(before) == np.count_nonzero(run.slam.trajectory.stamps_ns < lost.start_ns)
    assert len(before) + len(after) == len(run.slam.trajectory)
    leap = replace(lost, start_ns=int(run.slam.trajectory.stamps_ns[3]), scans=0)  # between two poses that there are
    assert len(map_picture.parts_of_path(replace(run.slam, lost=(leap,)))[0]) == 4


def test_closed_loops_are_joined_and_named(run, tmp_path):
    loop = Loop(0, len(run.slam.trajectory) - 1, Pose(), Pose(), 0.9)
    closed = replace(run, slam=replace(run.slam, loops=Loops((loop,))))

    def ink(a_run):
        map_picture.write(a_run, tmp_path / "map.png")
        with Image.open(tmp_path / "map.png") as image:
            pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
        return (np.abs(pixels - rgb_of(map_axes.LOOP.colour)).sum(axis=1) < 30).sum()

    assert ink(closed) > ink(run) + 100


def test_the_doubtful_part_of_the_path_is_marked(run, tmp_path):
    stamps_ns = run.slam.trajectory.stamps_ns
    slip = Reason("slip", int(stamps_ns[2]), int(stamps_ns[6]), 3.0)

    def red(probability):
        slam = replace(run.slam, doubt=Doubt(probability, (slip,)))
        map_picture.write(replace(run, slam=slam), tmp_path / "map.png")
        with Image.open(tmp_path / "map.png") as image:
            pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
        return (np.abs(pixels - rgb_of(map_axes.DOUBTFUL.colour)).sum(axis=1) < 20).sum()

    assert red(0.9) > red(0.4) + 200
    (part,) = map_picture.doubtful_parts(replace(run.slam, doubt=Doubt(0.9, (slip,))))
    np.testing.assert_array_equal(part, run.slam.trajectory.xyyaw[2:7, :2])


def test_a_wall_of_one_cell_survives_the_shrinking():
    hits = np.zeros((1000, 1003), np.int32)
    hits[500] = 3
    small = max_pool(hits, 7)
    assert small.shape == (143, 144)
    assert (small.max(axis=0) == 3).all()


def test_a_single_far_return_does_not_shrink_the_room(run):
    hits = np.zeros((4000, 4000), np.int32)
    hits[100, 100:2000] = hits[100:2000, 100] = 5
    hits[3990, 3990] = 1
    grid = Grid(0.02, (0.0, 0.0), hits, np.zeros_like(hits))
    window = window_of(grid, np.zeros((1, 2)))
    assert window.x1_m < 45
    assert window.x0_m < 0


def test_walls_seen_often_fill_the_picture_and_far_hits_do_not():
    hits = np.zeros((3000, 600), np.int32)
    hits[100:300, 100:300:199] = hits[100:300:199, 100:300] = 40
    hits[400:2900:25, 300] = 3
    room, path = Grid(0.02, (0.0, 0.0), hits, np.zeros_like(hits)), np.array([(4.0, 4.0), (4.0, 9.0)])
    near, seen = (window_of(grid, path) for grid in (room, replace(room, hits=np.minimum(hits, 3))))
    assert 9.0 < near.y1_m < 10.0  # the path is whole
    assert seen.y1_m > 57.0  # what was seen as often as the room


@pytest.mark.parametrize("shape", [(100, 900), (900, 100), (300, 400)])
def test_the_shorter_side_of_a_long_map_can_be_read(shape):
    height, width = shape
    across, up = Viewport(0.0, 0.1 * width, 0.0, 0.1 * height).size_pixels(7.5, 3.0)
    assert max(across, up) <= 1650
    assert min(across, up) == min(450, round(1650 / 9)) or max(across, up) == 1125
    assert across / up == pytest.approx(width / height, rel=0.01)


def test_a_path_with_many_circles_is_a_line(run, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Canvas, "text", lambda _, xy, text, *args, **options: drawn.append(text))
    for most, name in ((1000, "estimated pose"), (1, "estimated path")):
        monkeypatch.setattr(map_picture, "MOST_CIRCLES", most)
        drawn.clear()
        map_picture.write(run, tmp_path / "map.png")
        assert {"estimated pose", "estimated path"} & set(drawn) == {name}


def test_long_paths_are_thinned_evenly_along_their_length():
    xy = np.column_stack((np.concatenate((np.zeros(500), np.linspace(0, 10, 500))), np.zeros(1000)))
    some = map_picture.thin_path(xy, 0.2)
    assert 45 <= len(some) <= 51
    assert (some[0], some[-1]) == (0, 999)
    assert np.diff(xy[some, 0]).max() < 0.3


@pytest.mark.parametrize(("title", "wider"), [("a title that fits", False), (FULL, True), ("a long title " * 10, True)])
def test_a_picture_is_as_wide_as_the_titles_of_its_charts(run, tmp_path, monkeypatch, title, wider):
    for name, longest in (("p.png", "short"), ("q.png", title)):
        chart = wall_picture._Chart(f"short\n{longest}", "x", np.ones(6), 1.0, np.nan)
        monkeypatch.setattr(wall_picture, "_charts", lambda _, chart=chart: [chart])
        wall_picture.write(run, tmp_path / name)
    assert (size_of(tmp_path / "q.png")[0] > size_of(tmp_path / "p.png")[0]) == wider
    with Image.open(tmp_path / "q.png") as image:
        assert np.asarray(image)[:, -wall_picture.EDGE + 5 :].min() == 255


def test_the_legend_of_a_narrow_map_of_walls_is_whole(run, tmp_path):
    hits = np.zeros((1500, 20))
    hits[:, 5] = 7
    wall_picture.write(with_map(run, hits), tmp_path / "p.png")
    with Image.open(tmp_path / "p.png") as image:
        legend = np.asarray(image.convert("L"))[45 : wall_picture.TOP - 2]
    assert legend[:, : wall_picture.EDGE - 2].min() == 255
    assert np.flatnonzero(legend.min(axis=0) < 255)[0] < wall_picture.EDGE + 5


def test_a_chart_without_a_wall_has_no_ticks_in_y(monkeypatch):
    drawn = []
    monkeypatch.setattr(Canvas, "text", lambda _, xy, text, *args, **options: drawn.append(text))
    for metres in (np.zeros(4), np.ones(4)):
        chart = wall_picture._Chart("no straight wall", "thickness [cells]", metres, 1.0, np.nan)
        wall_picture._draw_bars(Canvas.of(400, 300), (100, 50, 350, 250), chart)
    names = ["thickness [cells]", "wall [m]"]
    in_x = ["0", "1", "2", "3"]
    assert drawn[: len(in_x) + 2] == [*in_x, *names]
    assert drawn[len(in_x) + 2 :] == [*in_x, "0", "0.5", "1", *names]


@pytest.mark.parametrize(("names", "title"), [("a", "1 session"), ("ab", "2 sessions")])
def test_the_title_of_a_merged_map_counts_its_sessions(run, tmp_path, monkeypatch, names, title):
    drawn = []
    monkeypatch.setattr(Canvas, "text", lambda _, xy, text, *args, **options: drawn.append(text))
    verdict = Verdict("suspect", "a session did not join", "")
    map_picture.write_merged(run, dict.fromkeys(names, run.slam.trajectory), verdict, tmp_path / "map.png", 0.0)
    assert f"{title}: suspect" in drawn
    assert any(text.startswith("a session did not join\n") for text in drawn)


def test_cut_lines_lie_across_their_walls():
    cuts = WallCuts(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([0.0, np.pi / 2]), np.array([0.2, np.nan]), np.ones(2))
    lines = wall_picture.cut_lines(cuts, 0.1)
    np.testing.assert_allclose(lines, [[(1.0, 1.9), (1.0, 2.1)], [(3.05, 4.0), (2.95, 4.0)]], atol=1e-12)


def test_marks_lie_where_their_points_are_and_y_grows_upwards():
    picture = Canvas.of(300, 200)
    axes = map_axes.map_axes(picture, Viewport(-1.0, 1.0, 0.0, 1.0), (50, 40, 250, 140))
    axes.mark(map_axes.START, np.array([[0.5, 0.25]]))
    pixels = np.asarray(picture.image).astype(int)
    row, col = np.argwhere(np.abs(pixels - (0x00, 0x33, 0xFF)).sum(axis=2) < 60).mean(axis=0)
    assert (col, row) == pytest.approx((50 + 150, 40 + 75), abs=1.0)


def test_cells_fill_their_squares():
    picture = Canvas.of(300, 200)
    hits = np.zeros((10, 20), np.int32)
    hits[9, 0] = hits[0, 19] = 1
    grid = Grid(0.1, (-1.0, 0.0), hits, np.zeros_like(hits))
    axes = map_axes.map_axes(picture, Viewport(-1.0, 1.0, 0.0, 1.0), (50, 40, 250, 140))
    map_axes.draw_cells(axes, grid, hits, lambda _: np.array((0, 0, 0), np.uint8))
    dark = np.asarray(picture.image).sum(axis=2) == 0
    expected = np.zeros((200, 300), bool)
    expected[40:50, 50:60] = expected[130:140, 240:250] = True
    np.testing.assert_array_equal(dark, expected)


@given(turn_rad=st.floats(-np.pi / 4, np.pi / 4), seed=st.integers(0, 99), corner=st.tuples(*2 * [st.floats(-50, 50)]))
def test_a_pixel_of_a_turned_map_shows_the_cell_that_its_middle_lies_in(turn_rad, seed, corner):
    rng = np.random.default_rng(seed)
    hits = rng.integers(0, 2, (7, 9)).astype(np.int32)
    grid, canvas = Grid(0.1, corner, hits, np.zeros_like(hits)), Canvas.of(200, 300)
    window = window_of(grid, np.zeros((0, 2)), turn_rad)
    axes = map_axes.map_axes(canvas, window, (10, 20, 170, 20 + round(160 * window.size_m[1] / window.size_m[0])))
    map_axes.draw_cells(axes, grid, hits, lambda _: np.array((0, 0, 0), np.uint8))
    dark, shown = np.asarray(canvas.image).sum(axis=2) == 0, 0
    for x, y in zip(rng.integers(10, 170, 200), rng.integers(20, axes.box[3], 200), strict=True):
        right_m, up_m = (x + 0.5 - 10) / axes.per_unit[0], (axes.box[3] - y - 0.5) / axes.per_unit[1]
        at = Pose(0.0, 0.0, -turn_rad) @ Pose(window.x0_m + right_m, window.y0_m + up_m)
        col, row = (at.x_m - corner[0]) / 0.1, (at.y_m - corner[1]) / 0.1
        if min(col % 1, row % 1, -col % 1, -row % 1) < 0.02:
            continue  # on a border but for rounding
        assert dark[y, x] == (0 <= col < 9 and 0 <= row < 7 and hits[floor(row), floor(col)])
        shown += int(dark[y, x])
    assert shown or not hits.any()


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, -44.0])
def test_ticks_tell_the_coordinates_of_the_map_also_if_the_picture_is_turned(turn_deg, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        Canvas, "text", lambda _, xy, text, *args, anchor="mm", **options: drawn.append((xy, text, anchor))
    )
    window = Viewport(-3.0, 5.0, 2.0, 8.0, np.radians(turn_deg))
    axes = map_axes.map_axes(Canvas.of(1000, 800), window, (100, 100, 900, 700))
    map_axes.draw_axes(axes)
    lower = [(xy[0], float(text)) for xy, text, anchor in drawn if anchor == "ma"]
    left = [(xy[1], float(text)) for xy, text, anchor in drawn if anchor == "rm"]
    assert min(len(lower), len(left)) >= 4
    back = Pose(0.0, 0.0, -np.radians(turn_deg))
    for x, value in lower:
        assert (back @ Pose(-3.0 + (x - 100) / 100, 2.0, 0.0)).x_m == pytest.approx(value)
    for y, value in left:
        assert (back @ Pose(-3.0, 2.0 + (700 - y) / 100, 0.0)).y_m == pytest.approx(value)
    grey = (np.asarray(axes.canvas.image)[101:700, 101:900] < 255).any()
    assert grey == (turn_deg != 0.0)  # lines of equal x and y


@pytest.mark.parametrize("turn_deg", [0.0, -23.7])
def test_the_labels_of_a_narrow_map_are_apart_and_inside_the_picture(turn_deg, monkeypatch):
    drawn, write = [], Canvas.text
    monkeypatch.setattr(Canvas, "text", lambda *args, **kw: (drawn.append((args, kw)), write(*args, **kw)))
    window = Viewport(1.4, 2.8, -3.6, 3.2, np.radians(turn_deg))
    axes = map_axes.map_axes(Canvas.of(1000, 1100), window, (100, 60, 285, 960))
    map_axes.draw_axes(axes)
    map_axes.name_axes(axes)
    lower = [(xy[0], font(8.0).getlength(text) / 2) for (_, xy, text, *_), kw in drawn if kw.get("anchor") == "ma"]
    in_x = lower[:-1]  # the last is the name
    assert len(in_x) >= 2
    assert all(x + a + 8 < y - b for (x, a), (y, b) in pairwise(in_x))
    picture = np.asarray(axes.canvas.image)
    assert picture[:, :5].min() == picture[:, -5:].min() == 255


def test_walls_outside_the_framed_part_are_not_drawn_over_the_rest_of_the_picture():
    axes = map_axes.map_axes(Canvas.of(300, 300), Viewport(0.0, 1.0, 0.0, 1.0), (100, 100, 200, 200))
    at = np.array([(0.5, 0.5), (0.5, 0.995), (0.5, 1.5), (-0.5, 0.5)])
    cuts = WallCuts(at, np.full(4, 0.0), np.full(4, 0.2), np.full(4, 1.0))
    wall_picture._draw_lines(axes, cuts, np.full(4, True), np.zeros((4, 3), np.uint8))
    dark = np.asarray(axes.canvas.image).max(axis=2) == 0
    assert dark[100:110, 150].all()  # the half of the second that is inside
    assert dark[150, 150]
    assert dark.sum() == dark[100:200, 100:200].sum() == pytest.approx(3 * (20 + 10), abs=9)


def cuts_along(*directions_deg, length_m=1.0):
    n = len(directions_deg)
    return WallCuts(np.zeros((n, 2)), np.radians(directions_deg), np.full(n, 0.05), np.full(n, length_m))


def test_pictures_are_turned_to_the_walls_by_an_eighth_at_most():
    for off_deg in (-40.0, -12.0, 3.0, 44.0):
        walls = cuts_along(off_deg, off_deg + 90, off_deg + 180, off_deg + 1, off_deg + 89)
        assert np.degrees(turn_to_cuts(walls)) == pytest.approx(-off_deg, abs=0.01)


def test_pictures_are_not_turned_without_a_common_direction_or_by_a_hardly_visible_angle():
    assert turn_to_cuts(None) == turn_to_cuts(cuts_along()) == turn_to_cuts(cuts_along(0.4, 90.6)) == 0.0
    assert turn_to_cuts(cuts_along(*range(0, 180, 6))) == 0.0  # a round room


@pytest.mark.parametrize("option", ["align", "map", "continue_from"])
def test_pictures_stay_in_a_frame_that_was_asked_for(option):
    walls = cuts_along(20.0, 110.0)
    assert picture_turn_rad(walls, None) != 0.0
    assert picture_turn_rad(walls, SimpleNamespace(start_s=2.0)) != 0.0
    assert picture_turn_rad(walls, SimpleNamespace(**{option: "none"})) == 0.0


@WRITERS
def test_a_turned_picture_says_so(run, write, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Canvas, "text", lambda _, xy, text, *args, **options: drawn.append(text))
    run = replace(run, provenance=replace(run.provenance, options=None))
    for off_deg, said in ((0.0, "x [m]"), (20.0, "x [m] along the grey lines; picture turned by -20.0° to the walls")):
        drawn.clear()
        walls = cuts_along(off_deg, off_deg + 90)
        write(replace(run, metrics=replace(run.measures, cuts=walls)), tmp_path / "p.png")
        assert said in drawn


@given(low=st.floats(-1e4, 1e4), span=st.floats(1e-3, 1e4))
def test_ticks_are_few_round_and_inside(low, span):
    found = ticks(low, low + span)
    assert 2 <= len(found) <= 10
    assert all(low - 1e-9 * span <= tick <= low + span + 1e-9 * span for tick in found)
    np.testing.assert_allclose(np.diff(found), found[1] - found[0], rtol=1e-6)


@WRITERS
def test_pictures_repeat_to_the_byte(run, write, tmp_path):
    for name in ("a.png", "b.png"):
        write(run, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@given(arrays(np.uint8, st.tuples(st.sampled_from([1, 2, 5, 63, 64, 65, 130]), st.integers(1, 5), st.just(3))))
def test_a_png_holds_every_pixel(pixels):
    with Image.open(BytesIO(png(Image.fromarray(pixels)))) as image:
        np.testing.assert_array_equal(np.asarray(image), pixels)


def test_a_line_is_broken_where_a_point_is_missing():
    picture = Canvas.of(120, 60)
    axes = Axes.chart(picture, (10, 10, 110, 50), (0.0, 10.0, 0.0, 4.0))
    axes.lines(map_axes.LOOP, [np.array([(0.0, 2.0), (3.0, 2.0), (np.nan, 2.0), (7.0, 2.0), (10.0, 2.0)])])
    dark = (np.asarray(picture.image).sum(axis=2) < 300).any(axis=0)
    assert dark[12:38].all() and dark[82:108].all()
    assert not dark[44:76].any()


def test_a_picture_of_double_density_shows_the_same_at_the_same_places():
    def drawn(density):
        canvas = Canvas.of(300, 200, density)
        axes = map_axes.map_axes(canvas, Viewport(-1.0, 1.0, 0.0, 1.0), (60, 20, 260, 120))
        hits = np.eye(10, 20, dtype=np.int32)
        grid = Grid(0.1, (-1.0, 0.0), hits, np.zeros_like(hits))
        map_axes.draw_cells(axes, grid, hits, lambda _: np.array((200, 0, 0), np.uint8))
        axes.lines(map_axes.TRUE_WALL, [np.array([(-0.9, 0.9), (0.9, 0.5)])])
        axes.mark(map_axes.END, np.array([(0.5, 0.2)]))
        map_axes.draw_axes(axes)
        canvas.gradient((270, 20, 290, 120), map_axes.HIT_COLOURS, upwards=True)
        return canvas

    plain, dense = drawn(1), drawn(2)
    assert (dense.width, dense.height) == (plain.width, plain.height) == (300, 200)
    assert dense.image.size == (600, 400)
    reduced, image = (np.asarray(i, float) for i in (dense.image.reduce(2), plain.image))
    assert np.abs(reduced - image).mean() < 2.0
    blurred = np.asarray(dense.image.reduce(10), float) - np.asarray(plain.image.reduce(5), float)
    assert np.abs(blurred).max() < 60.0  # of 255: nothing is missing or elsewhere


@pytest.mark.parametrize("upright", [False, True])
def test_text_of_double_density_covers_the_same_place(upright):
    plain, dense = Canvas.of(200, 200), Canvas.of(200, 200, 2)
    for canvas in (plain, dense):
        canvas.text((90, 100), "thickness", 9.0, "#000000", upright=upright)
    boxes = [np.array(Image.eval(c.image, lambda v: 255 - v).getbbox()) / c.density for c in (plain, dense)]
    np.testing.assert_allclose(*boxes, atol=1.5)


def test_nothing_is_drawn_outside_the_axes():
    picture = Canvas.of(120, 60)
    axes = Axes.chart(picture, (10, 10, 110, 50), (0.0, 10.0, 0.0, 4.0))
    far = np.array([(-100.0, -100.0), (100.0, 100.0)])
    axes.lines(map_axes.LOOP, [far])
    axes.lines(map_axes.TRUE_WALL, [far / (10, -10)])
    axes.mark(map_axes.START, np.array([(0.0, 0.0)]))
    pixels = np.asarray(picture.image).astype(int).sum(axis=2)
    assert (pixels[10:50, 10:110] < 700).any()
    pixels[10:50, 10:110] = 765
    assert (pixels == 765).all()
