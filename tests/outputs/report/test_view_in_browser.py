"""The interactive map in a real browser: clicks, keys and the mouse, and what the page then shows."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.mapping.slices import Slice, Slices
from mavnav.outputs.files import gridmap
from mavnav.outputs.files.gridmap import slice_files, write_slice
from mavnav.outputs.report.entry import load
from mavnav.outputs.report.page import list_text, write_report
from mavnav.pose import Pose, transform_points
from support.browser import WAIT_S, browser
from support.report_runs import doubled, leave, quality

NAME = '<img src=x onerror=evil=1>"onload=evil=1 <!--<script>.mcap'
EVIL = f"logs/{NAME}"
DOUBT = {"probability": 0.8, "reasons": [{"reason": "gap", "from_s": 2.5, "to_s": 3.5, "value": 1.5}], "tried": []}


class Shown:
    """The page in the browser: what it says of itself, its elements, and scripts that ask it."""

    def __init__(self, driver, path):
        self.driver, self.address = driver, path.as_uri()
        self.open()

    def open(self):
        self.driver.get(self.address)
        self.wait(lambda: self.state("ready") == "yes")

    def script(self, text, *arguments):
        return self.driver.execute_script(text, *arguments)

    def state(self, name):
        return self.script("return document.getElementById('view').dataset[arguments[0]]", name)

    def element(self, selector):
        return self.driver.find_element("css selector", selector)

    def click(self, selector):
        element = self.element(selector)
        self.script("arguments[0].scrollIntoView({block: 'center'})", element)
        element.click()

    def keys(self, *keys, to="body"):
        self.element(to).send_keys(*keys)

    def mouse(self, selector, x, y, *, click=False):
        """Move the mouse to a place in an element, in pixels from its upper left corner, and click there."""
        from selenium.webdriver import ActionChains

        element = self.element(selector)
        self.script("arguments[0].scrollIntoView({block: 'center'})", element)
        width, height = (element.size[key] for key in ("width", "height"))
        moves = ActionChains(self.driver).move_to_element_with_offset(element, x - width // 2, y - height // 2)
        (moves.click() if click else moves).perform()

    def on_map(self, x_m, y_m):
        """Return the pixels of a place on the map."""
        point = self.script(
            "const p = viewer.map.latLngToContainerPoint([arguments[0], arguments[1]]); return [p.x, p.y]", y_m, x_m
        )
        return [round(each) for each in point]

    def wait(self, holds):
        end = time.monotonic() + WAIT_S
        while not holds():
            assert time.monotonic() < end, self.driver.get_log("browser")
            time.sleep(0.02)


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    """Write a comparison of two runs of one log, with scans to see and places to look at."""
    base = tmp_path_factory.mktemp("view")
    tracking = json.loads(json.dumps({"intervals": [], "doubt": DOUBT, "tracked_share": 0.9, "lost": False}))
    loops = {"closures": [{"from_s": 0.5, "to_s": 4.0, "correction_m": 0.012}]}
    sections = {"map_quality": quality(ghosts=1.2), "tracking": tracking, "loop_closure": loops}
    fine = leave(run, base / "fine", recording=True, grid="20x20", azimuth=40, **sections)
    coarse = leave(doubled(run), base / "coarse", grid="5x5", map_quality=quality())
    cells = [{**cell, "log": EVIL} for cell in (fine, coarse)]
    write_report({"schema_version": 1, "cells": cells}, base, base / "report.html")
    other = {**coarse, "log": "other.mcap"}
    (base / "list.html").write_text(list_text([load(cell, base) for cell in (cells[0], other)], "Batch of 2 runs"))
    layers = [Slice(0.2 * k, 0.2 * k - 0.1, 0.2 * k + 0.1, run.known) for k in (1, 2, 3)]
    rows = [{"map": slice_files([layer])[1], "from_m": layer.from_m, "to_m": layer.to_m} for layer in layers]
    cut = leave(run, base / "cut", slices=rows)
    for file in slice_files(layers):
        write_slice(replace(run, slices=Slices(tuple(layers), np.zeros((0, 3)))), base / "cut" / file)
    (base / "cut.html").write_text(list_text([load(cut, base)], "Slices"))
    return base


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


@pytest.fixture
def page(driver, folder):
    return Shown(driver, folder / "report.html")


def test_the_page_loads_nothing_and_has_nothing_to_complain_of(page):
    assert page.driver.get_log("browser") == []
    assert (
        page.script("return performance.getEntriesByType('resource').filter(e => !e.name.startsWith('data:')).length")
        == 0
    )
    assert page.element("#view").is_displayed()


def test_names_are_texts_and_never_code(driver, folder):
    page = Shown(driver, folder / "list.html")
    assert NAME in page.element("#runs button").text and NAME in page.element("#run").text
    assert page.script("return document.querySelectorAll('[onload], [onerror], #runs img').length") == 0
    assert page.script("return window.evil") is None


def test_a_click_zooms_and_the_whole_map_comes_back(page):
    before, scale = float(page.state("zoom")), page.element(".leaflet-control-scale-line").text
    for _ in range(4):
        zoom = float(page.state("zoom"))
        page.click(".leaflet-control-zoom-in")
        page.wait(lambda: float(page.state("zoom")) > zoom)  # noqa: B023  it is called at once
    assert page.element(".leaflet-control-scale-line").text != scale
    page.click("#fit")
    page.wait(lambda: float(page.state("zoom")) == before)


def test_the_closest_zoom_shows_single_cells(page):
    cell_px = page.script("return viewer.run.cell_m * 2 ** viewer.map.getMaxZoom()")
    assert cell_px >= 40


def test_layers_are_shown_and_hidden(page):
    pictures = "return document.querySelectorAll('#map img.cells').length"
    assert page.script(pictures) == 2
    page.click("input[name=hits]")
    assert page.script(pictures) == 1 and "hits" not in page.state("layers").split()
    page.click("input[name=walls]")
    assert "walls" in page.state("layers").split()


def test_slices_have_colours_of_their_own_and_wait_to_be_chosen(driver, folder):
    page = Shown(driver, folder / "cut.html")
    assert not any("map_" in layer for layer in page.state("layers").split())
    keys = page.script(
        "return [...document.querySelectorAll('#layers .key')].filter(k => k.className.includes('map_'))"
        ".map(k => getComputedStyle(k).backgroundColor)"
    )
    assert len(set(keys)) == 3
    page.click("#layers [name^=map_]")
    assert sum("map_" in layer for layer in page.state("layers").split()) == 1


def test_the_slider_shows_the_scan_where_it_was_seen(page, run):
    from selenium.webdriver.common.keys import Keys

    page.keys(Keys.HOME, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, to="#scan")
    assert page.state("scan") == "3" and page.element("#when").text.startswith("scan 3, 1.5 s: accepted, x ")
    scan = list(run.log.scans())[3]
    expected = transform_points(Pose(*run.slam.trajectory.xyyaw[3].tolist()), scan.points())
    seen = np.array(page.script("return pointsOf(viewer.arrays, 3)"))[:, ::-1]
    assert int(page.state("points")) == len(expected) == len(seen)
    np.testing.assert_allclose(seen, expected, atol=2e-3)


def test_a_scan_is_reached_by_its_number(page):
    from selenium.webdriver.common.keys import Keys

    page.keys(Keys.CONTROL + "a", to="#number")
    page.keys("7", Keys.ENTER, to="#number")
    assert page.state("scan") == "7" and page.element("#when").text.startswith("scan 7, ")
    page.keys(Keys.CONTROL + "a", to="#number")
    page.keys("999", Keys.ENTER, to="#number")
    assert page.state("scan") == page.element("#number").get_attribute("value") == "19"


def test_a_scan_without_a_pose_says_so_and_shows_no_points(page):
    page.script("viewer.goTo(10)")
    assert "no pose" in page.element("#when").text and page.state("points") == "0"


def test_play_and_pause_by_click_and_by_key(page):
    page.click("#play")
    page.wait(lambda: int(page.state("scan")) > 2)
    page.wait(lambda: page.state("playing") == "no")
    assert page.state("scan") == page.element("#scan").get_attribute("max")
    page.keys(",", to="#map")
    last = int(page.element("#scan").get_attribute("max"))
    assert int(page.state("scan")) == last - 1


def test_a_reason_of_doubt_leads_to_its_scans(page):
    reason = page.element("#places .place")
    assert reason.text == "gap, strength 1.50, 2.5 to 3.5 s"
    assert "Doubt 80 %: reasons (1)" in page.element("#places").text
    page.click("#places .place")
    assert page.state("scan") == "5"


def test_stretches_are_marked_in_the_plots_that_do_not_hold_everywhere(page):
    marked = "const p = viewer.plots; return p.isMarked({kind: 'doubt', from_s: p.start, to_s: p.start + arguments[0]})"
    duration_s = page.script("return viewer.plots.end - viewer.plots.start")
    assert page.script(marked, 0.5 * duration_s)
    assert not page.script(marked, 0.95 * duration_s)
    assert not page.script("viewer.plots.run = {verdict: {word: 'good'}};" + marked, 0.5 * duration_s)


def test_a_closed_loop_leads_to_its_scans_and_is_drawn(page):
    summary = next(s for s in page.driver.find_elements("css selector", "#places summary") if "Loops" in s.text)
    page.script("arguments[0].click()", summary)
    loop = next(b for b in page.driver.find_elements("css selector", ".place") if b.text.startswith("loop closed"))
    assert loop.text == "loop closed, moved by 12 mm, 0.5 to 4.0 s" and "loops" not in page.state("layers").split()
    page.script("arguments[0].click()", loop)
    assert page.state("scan") == "8" and "loops" in page.state("layers").split()


def test_a_ghost_wall_leads_to_its_place(page):
    ghost = next(b for b in page.driver.find_elements("css selector", ".place") if "ghost wall" in b.text)
    page.script("arguments[0].click()", ghost)
    page.wait(lambda: page.script("const c = viewer.map.getCenter(); return Math.hypot(c.lng - 1, c.lat - 2)") < 0.05)


def test_the_mouse_reads_walls_and_poses(page, folder, run):
    cuts = gridmap.read_cuts(folder / "fine" / gridmap.WALLS_FILE)
    k = int(np.flatnonzero(np.isfinite(cuts.width_m))[20])
    page.script("viewer.map.setView([arguments[1], arguments[0]], 8, {animate: false})", *cuts.xy_m[k].tolist())
    page.mouse("#map", *page.on_map(*cuts.xy_m[k].tolist()))
    page.wait(lambda: page.element("#hover").is_displayed())
    near = np.hypot(*(cuts.xy_m - cuts.xy_m[k]).T) < 0.05
    widths = {f"wall {width:.0f} mm thick" for width in 1e3 * cuts.width_m[near & np.isfinite(cuts.width_m)]}
    assert widths & set(page.element("#hover").text.split("\n"))
    x, y = run.slam.trajectory.xyyaw[7, :2].tolist()
    page.script("viewer.map.setView([arguments[1], arguments[0]], 9, {animate: false})", x, y)
    page.mouse("#map", *page.on_map(x, y), click=True)
    assert "accepted" in page.element("#hover").text
    at = page.script("const k = viewer.scan; return [viewer.arrays.xy[2 * k], viewer.arrays.xy[2 * k + 1]]")
    assert np.hypot(at[0] - x, at[1] - y) < 0.05


def test_a_click_on_a_plot_goes_to_that_time(page):
    width = page.element("#plots").size["width"]
    page.mouse("#plots", round(52 + 0.5 * (width - 60)), 40, click=True)
    shown = page.script("return viewer.arrays.time[viewer.scan] / viewer.arrays.time.at(-1)")
    assert abs(shown - 0.5) < 0.06


def test_two_maps_are_swiped_and_blinked(page):
    from selenium.webdriver.common.keys import Keys

    clip = "return [viewer.first, viewer.second].map((each) => each.pane.style.clip)"
    page.click("#swipe")
    page.wait(lambda: page.script("return Boolean(viewer.second)"))
    left, right = page.script(clip)
    assert left != right and "20/20x20" not in right
    page.keys(Keys.HOME, to="#divider")
    assert page.script(clip) != [left, right]
    page.click("#blink")
    page.wait(lambda: page.script("return viewer.first.pane.style.visibility") == "hidden")
    page.wait(lambda: page.script("return viewer.second?.pane.style.visibility") == "hidden")
    page.click("#blink")
    assert page.state("mode") == "one" and page.script("return viewer.second") is None


def test_where_maps_differ_is_one_click_away(page):
    place = next(b for b in page.driver.find_elements("css selector", ".place") if b.text.startswith("A, "))
    zoom = float(page.state("zoom"))
    page.script("arguments[0].click()", place)
    page.wait(lambda: float(page.state("zoom")) > zoom)


def test_a_run_of_the_list_is_shown_by_one_click(driver, folder):
    page = Shown(driver, folder / "list.html")
    buttons = driver.find_elements("css selector", "#runs button")
    assert [button.get_attribute("aria-pressed") for button in buttons] == ["true", "false"]
    assert "other.mcap" in buttons[1].text
    buttons[1].click()
    page.wait(lambda: page.state("run") == "1")
    assert page.state("points") == "0"  # it has no recording


def test_a_phone_scrolls_in_one_direction_only_and_lists_runs_in_short_lines(page, folder):
    metrics = {"width": 380, "height": 800, "deviceScaleFactor": 2, "mobile": True}
    page.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        page.open()
        assert page.script("return document.documentElement.scrollWidth") <= 380
        assert page.element("#map").size["width"] > 300
        sizes = page.script(
            "return [...document.querySelectorAll('.view button')].filter(b => b.offsetParent).map(b => b.offsetHeight)"
        )
        assert min(sizes) >= 30
        Shown(page.driver, folder / "list.html")
        assert max(page.script("return [...document.querySelectorAll('#runs button')].map(b => b.offsetHeight)")) < 150
    finally:
        page.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_without_script_the_page_is_read_as_before(page):
    page.driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        page.driver.get(page.address)
        assert not page.element("#view").is_displayed()
        assert page.element(".headline").is_displayed() and page.element(".panels img").is_displayed()
    finally:
        page.driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})


@pytest.mark.slow
def test_the_dark_theme_is_dark(folder, tmp_path):
    with browser(tmp_path / "profile", dark=True) as driver:
        page = Shown(driver, folder / "report.html")
        paper = page.script("return getComputedStyle(document.getElementById('map')).backgroundColor")
        assert max(map(int, paper.removeprefix("rgb(").rstrip(")").split(","))) < 60
        assert "invert" in page.script("return getComputedStyle(document.querySelector('img.cells')).filter")
