"""report.html: a whole and safe page, the same bytes again, and what is honest about the sentence on top."""

import json
import re
from base64 import b64decode
from io import BytesIO

import numpy as np
import pytest
from msgspec.structs import replace
from PIL import Image

from mavnav.errors import OutputError
from mavnav.mapping.occupancy_grid import Grid
from mavnav.outputs.files.trajectory import write_true_walls
from mavnav.outputs.pictures import map_axes
from mavnav.outputs.pictures.canvas import MUTED, rgb_of
from mavnav.outputs.pictures.map_axes import Viewport
from mavnav.outputs.report import charts, panels, tables
from mavnav.outputs.report.entry import Entry, load
from mavnav.outputs.report.headline import headline
from mavnav.outputs.report.page import leaflet_script, leaflet_style, write_report
from mavnav.outputs.report.pictures import differing_places, draw
from mavnav.outputs.run import Truth
from mavnav.pose import Trajectory
from support.html_page import Page
from support.report_runs import doubled, leave, quality

EVIL = 'logs/<script>alert(1)</script>"onload="x.mcap'


@pytest.fixture(scope="module")
def base(run, tmp_path_factory):
    return tmp_path_factory.mktemp("comparison")


@pytest.fixture(scope="module")
def comparison(run, base):
    fine = leave(run, base / "fine", grid="20x20", azimuth=40, map_quality=quality())
    coarse = leave(doubled(run), base / "coarse", grid="5x5", map_quality=quality(ghosts=1.2), warnings=["<b>odd</b>"])
    failed = {**coarse, "grid": "40x40", "status": "failed", "error": "killed & gone", "directory": None}
    cells = [{**cell, "log": EVIL} for cell in (coarse, fine, failed)]
    return {"schema_version": 1, "mavnav_version": "0.1.0", "profile": "map-quality/2", "cells": cells}


@pytest.fixture(scope="module")
def report(comparison, base):
    write_report(comparison, base, base / "report.html")
    return (base / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(report):
    return Page(report)


@pytest.fixture(scope="module")
def entries(comparison, base):
    return [e for e in (load(cell, base) for cell in comparison["cells"]) if isinstance(e, Entry)]


def test_the_page_is_whole(page):
    assert page.open == []
    assert [name for name, _ in page.tags].count("h1") == 1
    assert all(attrs.get("scope") for attrs in page.all("th"))
    assert page.all("img") and all(attrs["alt"] and int(attrs["width"]) for attrs in page.all("img"))


def test_the_page_names_date_log_and_sensor(report, run):
    assert f"2026-01-31 12:00 UTC · log of {run.log.duration_s:.1f} s · {run.log.sensor.beams} beams, " in report
    assert "mavnav replay &#39;/logs/room [1].mcap&#39;" in report


def test_the_page_asks_for_nothing_from_outside(report, page):
    links = [v for _, attrs in page.tags for k, v in attrs.items() if k in {"src", "href", "srcset", "action", "data"}]
    assert links and all(link.startswith("data:") for link in links)
    assert not re.search(r"https?://|@import|url\(", report.replace(leaflet_script(), "").replace(leaflet_style(), ""))
    assert not {"iframe", "object", "form"} & {name for name, _ in page.tags}
    assert all("src" not in attrs for attrs in page.all("script"))
    policy = next(a["content"] for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy and "unsafe" not in policy


def test_what_came_from_a_log_is_escaped(report, page):
    assert report.count("<script") == 2 and "alert(1)</script" not in report and "<b>" not in report
    assert not any("onload" in attrs for _, attrs in page.tags)
    text = " ".join(page.words)
    assert "<b>odd</b>" in text and "x.mcap" in text


def test_the_headers_of_the_table_wrap_so_that_it_fits(report):
    assert re.search(r"^\.summary th \{[^}]*white-space: normal", report, re.MULTILINE)


def test_the_failed_run_is_named(page):
    text = " ".join("".join(page.words).split())
    assert "40x40" in text and "killed & gone" in text


def test_the_same_runs_give_the_same_bytes(comparison, base, report, tmp_path):
    write_report(comparison, base, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == report
    for name in ("maps.png", "closeups.png", "thickness.png", "cost.png"):
        assert (tmp_path / name).read_bytes() == (base / name).read_bytes()


def test_the_pictures_stand_beside_the_page(report, base):
    assert len(report) < 5_000_000
    sizes = {}
    for name in ("maps", "closeups", "thickness", "cost"):
        with Image.open(base / f"{name}.png") as image:
            sizes[name] = image.size
    assert min(min(size) for size in sizes.values()) > 200


def test_a_scan_is_rejected_unless_it_is_lost(entries):
    scans = replace(entries[0].scans, time_s=np.arange(6.0), tracked=np.array([1, 0, 1, 0, 0, 0], bool))
    lost = {"intervals": [{"start_s": 4.0, "end_s": 5.0}]}
    entry = with_document(replace(entries[0], scans=scans), tracking=lost)
    assert np.flatnonzero(charts.rejected_scans(entry)).tolist() == [1, 3]


def test_a_short_scale_of_costs_is_named_too():
    assert charts.named_costs(90.0, 1100.0) == [(100, "100"), (200, "200"), (500, "500"), (1000, "1000")]
    assert charts.between_powers(90.0, 1100.0) == [90.0, *range(200, 1000, 100)]


def test_a_long_scale_of_costs_is_named_by_few_powers_of_ten():
    assert [name for _, name in charts.named_costs(0.2, 3e5)] == ["1e0", "1e1", "1e2", "1e3", "1e4", "1e5"]
    assert [name for _, name in charts.named_costs(0.05, 3e8)] == ["1e0", "1e2", "1e4", "1e6", "1e8"]


def test_the_scale_of_costs_ends_near_the_data(entries):
    scans = entries[0].scans
    level = replace(scans, cost_mm2=np.full(len(scans.time_s), 500.0), threshold_mm2=np.full(len(scans.time_s), np.nan))
    (panel,) = charts.cost_panels([with_document(replace(entries[0], scans=level), tracking=None)])
    blue = np.abs(np.asarray(panel.reduce(panels.DENSITY)).astype(int) - rgb_of(charts.COST.colour)).sum(axis=2) < 90
    row, top = np.flatnonzero(blue.sum(axis=1) > 300).mean(), panels.CHART_MARGINS[1] + charts.LEGEND_ROW
    assert row == pytest.approx(top + panels.CHART[1] / 2, abs=2)  # half and double are the ends


def test_the_caption_of_the_costs_explains_what_is_drawn(entries):
    scans = entries[0].scans
    every = replace(scans, tracked=np.ones(len(scans.time_s), bool), cost_mm2=np.ones(len(scans.time_s)))
    plain = with_document(replace(entries[0], scans=every), tracking=None)
    assert charts.caption([plain]) == ""
    tracked = every.tracked.copy()
    tracked[3] = False
    lost = {"intervals": [{"start_s": 1e6, "end_s": 1e6}]}
    other = with_document(replace(entries[0], scans=replace(every, tracked=tracked)), tracking=lost, method="paper")
    shown = charts.caption([plain, other])
    assert shown == (
        "Crosses: rejected scans that were matched. Shaded: stretches where the track was lost. "
        "Costs compare within a method only."
    )


def test_the_curve_of_costs_lies_where_its_ticks_say(entries):
    scans = entries[0].scans
    level = replace(scans, time_s=np.linspace(0.0, 2.0, len(scans.time_s)), cost_mm2=np.full(len(scans.time_s), 200.0))
    (dense,) = charts.cost_panels([with_document(replace(entries[0], scans=level), tracking=None)])
    panel = dense.reduce(panels.DENSITY)
    blue = np.abs(np.asarray(panel).astype(int) - rgb_of(charts.COST.colour)).sum(axis=2) < 90
    row = np.flatnonzero(blue.sum(axis=1) > 300).mean()
    ink = np.asarray(panel).astype(int).sum(axis=2) < 450
    ticks = np.flatnonzero(ink[:, 89:93].all(axis=1))  # on the left of the axis, labels end before
    assert min(abs(ticks - row)) <= 1.5


def test_pictures_have_twice_the_pixels_of_their_size_on_the_page(report):
    shown = re.findall(r'<img src="data:image/png;base64,([^"]+)" width="(\d+)" height="(\d+)"', report)
    assert len(shown) > 5
    for data, *size in shown:
        with Image.open(BytesIO(b64decode(data))) as image:
            assert image.size == tuple(panels.DENSITY * int(side) for side in size)


def test_a_picture_of_few_colours_keeps_them_all_in_its_file():
    colours = np.random.default_rng(3).integers(0, 256, (100, 3), np.uint8)
    blocks = np.kron(colours.reshape(10, 10, 3), np.ones((2, 2, 1), np.uint8))  # as narrow as a line
    with Image.open(BytesIO(panels.png(Image.fromarray(blocks)))) as image:
        assert np.abs(np.asarray(image.convert("RGB")).astype(int) - blocks).max() <= 8


def test_a_large_picture_is_made_smaller_on_the_page():
    noise = Image.fromarray(np.random.default_rng(1).integers(0, 255, (400, 400, 3), np.uint8))
    assert len(panels.data_uri(noise, 20_000)) < 28_000


def test_the_close_up_is_where_the_maps_differ(run):
    grid = run.slam.grid
    planted = doubled(run).slam.grid
    (x0, y0), cell_m = grid.origin_xy_m, grid.cell_m
    rows, cols = grid.hits.shape
    window = Viewport(x0, x0 + cols * cell_m, y0, y0 + rows * cell_m)
    first = differing_places([grid, planted, grid], window)[0]
    wall_x, wall_y = x0 + (cols // 2 + 30) * cell_m, y0 + (rows // 2 + 1) * cell_m
    assert abs((first.x0_m + first.x1_m) / 2 - wall_x) < 0.4
    assert abs((first.y0_m + first.y1_m) / 2 - wall_y) < 0.1
    assert differing_places([grid, grid], window) == []
    assert differing_places([grid], window) == []


def test_close_ups_do_not_overlap():
    window, empty, walls = (
        Viewport(0.0, 10.0, 0.0, 10.0),
        np.zeros((500, 500), np.int32),
        np.zeros((500, 500), np.int32),
    )
    walls[::50, ::2] = 5
    found = differing_places([Grid(0.02, (0.0, 0.0), h, h) for h in (walls, empty)], window)
    assert len(found) == 3
    for k, a in enumerate(found):
        for b in found[:k]:
            assert abs(a.x0_m - b.x0_m) >= a.size_m[0] * 0.5 or abs(a.y0_m - b.y0_m) >= a.size_m[1] * 0.5


def test_the_winner_is_marked_and_named(entries):
    rows = {row.name: row for row in tables.table(entries).rows}
    titles = [c.title for c in tables.table(entries).columns]
    ghost = titles.index("ghosts")
    assert rows["robust 40/20x20"].fields[ghost].best
    assert not rows["robust 20/5x5"].fields[ghost].best
    assert headline(entries).startswith("A finer grid pays on this log: robust 40/20x20 gives the best map")


def with_document(entry, **changes):
    return replace(entry, document=entry.document | changes)


def test_the_cost_is_relative_to_the_coarsest_grid(entries):
    search, timing = {"evaluations_per_scan": {"mean": 20_000.0}}, entries[0].document["timing"]
    coarse = entries[0]
    fine = with_document(entries[1], search=search, timing=timing | {"cpu_s": 3.0 * timing["cpu_s"]})
    search_0 = coarse.document["search"]["evaluations_per_scan"]["mean"]
    assert tables.relative_cost([coarse, fine], fine) == pytest.approx(20_000.0 / search_0)
    assert tables.table([coarse, fine]).rows[1].relative_costs == pytest.approx((20_000.0 / search_0, 3.0))
    assert f"{20_000.0 / search_0:.1f} times the evaluations of robust 20/5x5" in headline([coarse, fine])


def test_the_coarsest_grid_of_two_may_win(entries):
    lower = with_document(entries[1], grid="4x4", azimuth=10)
    assert headline([entries[0], lower]).startswith(
        "A finer grid does not pay on this log: robust 40/20x20 gives the best"
    )
    other = with_document(lower, method="paper")
    assert "finer" not in headline([entries[0], other])


def test_equal_maps_have_no_winner(entries):
    same = with_document(entries[1], grid="5x5")
    assert "equally good" in headline([entries[1], same])
    assert not any(f.best for row in tables.table([entries[1], same]).rows for f in row.fields)


def test_a_small_difference_is_called_small(entries):
    def crisp(cells):
        crispness = {"occupied_cells_per_m": cells}
        return with_document(entries[1], map_quality=quality() | {"crispness": crispness})

    assert "are equally good by every measure here" in headline([crisp(200.0), crisp(202.0)])
    assert "gives the best map" in headline([crisp(200.0), crisp(220.0)])


def test_a_difference_within_the_noise_does_not_count(entries):
    def walls(p95_mm):
        return with_document(entries[1], wall_thickness={"spread": {"p95_mm": p95_mm}})

    def best(*runs):
        table = tables.table(runs)
        p95 = [c.title for c in table.columns].index("wall p95")
        return [row.fields[p95].best for row in table.rows]

    assert best(walls(60.0), walls(62.0)) == [False, False]
    assert best(walls(60.0), walls(62.0), walls(90.0)) == [True, True, False]


def test_the_table_has_the_doubt_of_each_track(entries):
    doubtful = with_document(entries[0], tracking={"lost": False, "doubt": {"probability": 0.814, "reasons": []}})
    table = tables.table([entries[1], doubtful])
    doubt = [c.title for c in table.columns].index("doubt")
    assert table.rows[1].fields[doubt] == tables.Field("0.81", best=False)
    assert not any(row.fields[doubt].best for row in table.rows)


def test_doubtful_stretches_are_drawn_on_the_map(entries):
    scans = entries[0].scans
    doubtful = replace(entries[0], scans=replace(scans, doubtful=np.arange(len(scans.time_s)) < 20))
    red = rgb_of(map_axes.DOUBTFUL.colour)
    drawn = [(np.asarray(draw([e]).maps[0]) == red).all(axis=2).sum() for e in (entries[0], doubtful)]
    assert drawn[1] > drawn[0] + 50
    assert not scans.doubtful.any()


def test_the_legend_of_the_costs_lies_above_the_axes(entries, monkeypatch):
    (panel,) = map(np.asarray, charts.cost_panels(entries[:1]))
    monkeypatch.setattr(charts, "legend", lambda *_: None)
    (bare,) = map(np.asarray, charts.cost_panels(entries[:1]))
    top_of_axes = np.flatnonzero((bare[:, panels.DENSITY * panels.CHART_MARGINS[0]] == rgb_of(MUTED)).all(axis=1))[0]
    legend = np.flatnonzero((panel != bare).any(axis=(1, 2)))
    assert len(legend) and legend[-1] < top_of_axes


def test_headline_and_mark_agree_on_what_is_the_same(entries):
    """63.4 and 68.6 mm read 63 and 69: they differ in both, or in neither."""

    def walls(p95_mm, grid, ghosts):
        spread = {"spread": {"p95_mm": p95_mm}}
        return with_document(entries[1], grid=grid, wall_thickness=spread, map_quality=quality(ghosts=ghosts))

    fine, coarse = walls(63.4, "20x20", 0.0), walls(68.6, "5x5", 1.0)
    titles = [c.title for c in tables.table([coarse, fine]).columns]
    assert tables.table([coarse, fine]).rows[1].fields[titles.index("wall p95")].best
    assert "wall p95 63 against 69 mm" in headline([coarse, fine])


def test_a_map_of_nothing_never_wins(entries):
    nothing = with_document(entries[1], map_quality=quality(meaningful=False))
    assert "Only robust 20/5x5" in headline([entries[0], nothing])
    assert not any(f.best for f in tables.table([entries[0], nothing]).rows[1].fields)
    assert "None of the 2 maps" in headline([nothing, nothing])
    assert "each failed" in headline([])


def test_a_run_without_the_profile_is_judged_by_its_scans(entries):
    bare = with_document(entries[1], map_quality=None)
    few = with_document(bare, map={"accepted_share": 0.02})
    lost = with_document(bare, tracking={"lost": True})
    whys = [row.why_not for row in tables.table([bare, few, lost]).rows]
    assert whys == ["", "only 2 % of the scans were accepted", "the track was lost for good"]


def test_one_run_has_a_page_with_its_true_walls(run, base, tmp_path):
    cell = leave(run, base / "one")
    walls = np.array([[0.0, 1.0, 3.0, 1.0]]), np.array([[1.0, 1.0, 0.5, 0.0, 1.0]])
    truth = Truth(*walls, map_T_laser=Trajectory.of([], []), goal_xy_map_m=(1, 1))
    write_true_walls(replace(run, truth=truth), base / "one" / "true_walls.json")
    entry = load(cell, base)
    assert not len(entry.goal_xy_m)  # the walls alone are no mission
    np.testing.assert_allclose(entry.true_walls[0], [[0.0, 1.0], [3.0, 1.0]])
    assert len(entry.true_walls) == 2
    document = json.loads((base / "one" / "run.json").read_text())
    (base / "one" / "run.json").write_text(json.dumps(document | {"mission": {"reached": True, "reason": "goal"}}))
    mission = load(cell, base)
    assert mission.goal_xy_m.tolist() == [[1.0, 1.0]]
    red = rgb_of(map_axes.GOAL.colour)
    drawn = [(np.asarray(draw([e]).maps[0]) == red).all(axis=2).sum() for e in (entry, mission)]
    assert drawn[1] > drawn[0] + 50
    write_report({"cells": [cell]}, base, tmp_path / "report.html")
    text = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert text.open == [] and not (tmp_path / "closeups.png").exists()


def test_a_run_directory_that_is_gone_is_a_failed_run(comparison, base, tmp_path):
    gone = {**comparison["cells"][0], "directory": "nowhere"}
    write_report({"cells": [gone]}, base, tmp_path / "report.html")
    assert "nowhere cannot be read" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_settings_that_differ_are_told_apart(entries):
    coarse = with_document(entries[0], config={"grid": "5x5", "cell": 20, "paper": {"gate_mm2": 400.0}})
    fine = with_document(entries[1], config={"grid": "20x20", "cell": 20, "paper": {"gate_mm2": 400.0}})
    found = tables.settings([coarse, fine])
    assert found.differing == [("grid", ["5x5", "20x20"])]
    assert found.common == [("cell", "20")]


def test_a_place_that_cannot_be_written_is_told(comparison, base, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        write_report(comparison, base, tmp_path / "file" / "report.html")


def test_speed_is_that_between_the_poses_before_and_after():
    time_s = np.array([0.0, 0.1, 0.2, 0.3, 3.0, 3.1])
    xy_m = np.column_stack((0.5 * time_s, np.zeros(6)))
    xy_m[2] = np.nan
    found = charts.speeds(time_s, xy_m)
    np.testing.assert_allclose(found[1], 0.5)
    assert np.isnan(found[[0, 2, 3, 4, 5]]).all()  # no pose, next to a gap, and the ends
    assert np.isnan(charts.speeds(time_s[:2], xy_m[:2])).all()


def test_the_motion_has_a_curve_of_the_error_where_the_truth_is_known(entries):
    scans = entries[0].scans
    yaw = replace(scans, yaw_rad=np.linspace(3.0, 4.0, len(scans.time_s)) % (2 * np.pi) - np.pi)
    names = [*charts.curves(replace(entries[0], scans=yaw))]
    assert names == ["x [m]", "y [m]", "yaw [deg]", "speed [m/s]"]
    known = replace(yaw, error_m=np.full(len(scans.time_s), 0.02))
    curves = charts.curves(replace(entries[0], scans=known))
    assert [*curves.items()][-1] == ("error [mm]", pytest.approx(20.0))
    assert np.abs(np.diff(curves["yaw [deg]"])).max() < 90.0  # unwrapped
    with_error, without = (charts.motion_panel(replace(entries[0], scans=s)) for s in (known, yaw))
    assert with_error.height > without.height
