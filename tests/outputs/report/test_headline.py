"""The headline of a report: what it says of doubtful tracks, and of maps that hardly differ."""

from types import SimpleNamespace

import pytest

from mavnav.outputs.report.headline import headline

GOOD = ("good", "no sign of an error in path or map")


def entry(name="robust 20/10x10", *, verdict=GOOD, p95_mm=60.0, cells_per_m=200.0, cell_mm=20, meaningful=True):
    """Return what a headline reads of a run."""
    crispness = {"occupied_cells_per_m": cells_per_m}
    document = {
        "verdict": {"word": verdict[0], "reason": verdict[1], "advice": ""},
        "method": name.partition(" ")[0],
        "grid": name.rpartition("/")[2],
        "azimuth": 20,
        "scans": {"accepted": 751, "processed": 756},
        "tracking": {"lost": False},
        "map": {"cell_mm": cell_mm},
        "wall_thickness": {"spread": {"p95_mm": p95_mm}},
        "map_quality": {"meaningful": meaningful, "why": [] if meaningful else ["2 % mapped"], "crispness": crispness},
    }
    return SimpleNamespace(name=name, document=document)


def test_the_headline_of_a_run_begins_with_its_verdict():
    assert headline([entry()]) == (
        "Good: no sign of an error in path or map. robust 20/10x10 accepted 751 of 756 scans; "
        "95 % of the wall length is at most 60 mm thick."
    )
    assert headline([entry(verdict=("suspect", "scans are missing"))]).startswith("Suspect: scans are missing. robust")
    wrong = headline([entry(verdict=("wrong", "the path jumps"))])
    assert wrong == "Wrong: the path jumps. robust 20/10x10 accepted 751 of 756 scans; measures of the map say nothing."
    few = entry(verdict=("suspect", "the map cannot be measured: 2 % mapped"), meaningful=False)
    assert headline([few]).endswith("751 of 756 scans; measures of the map say nothing.")


@pytest.mark.parametrize(("count", "said"), [(0, "no wall is"), (1, "1 of its walls is"), (2, "2 of its walls are")])
def test_walls_that_are_drawn_twice_are_counted(count: int, said: str):
    run = entry()
    run.document["map_quality"]["ghost_walls"] = {"count": count}
    assert headline([run]).endswith(f"mm thick, and {said} drawn twice.")


def test_a_run_of_an_earlier_version_has_a_headline_without_a_verdict():
    old = entry()
    del old.document["verdict"]
    assert headline([old]).startswith("robust 20/10x10 accepted 751 of 756 scans; 95 %")


def test_the_headline_of_a_mission_says_that_it_failed():
    flown = entry()
    plain = headline([flown])
    flown.document["mission"] = {"reached": False, "reason": "stuck"}
    assert headline([flown]) == f"The mission failed: stuck. {plain}"
    flown.document["mission"] = {"reached": True, "reason": "goal"}
    assert headline([flown]) == plain


@pytest.mark.parametrize("word", ["wrong", "lost"])
def test_a_wrong_or_lost_run_does_not_compete_and_a_suspect_one_is_named(word):
    bad = entry(verdict=(word, "the path jumps"), p95_mm=40.0)
    assert headline([entry("robust 10/5x5"), bad]).startswith("Only robust 10/5x5 gives a map worth looking at")
    assert headline([bad, bad]) == f"None of the 2 maps is worth comparing; robust 20/10x10: {word}: the path jumps."
    two = [entry("robust 10/5x5"), entry(p95_mm=90.0, verdict=("suspect", "scans are missing"))]
    assert headline(two).endswith(" robust 20/10x10 is suspect: scans are missing.")
    assert headline([*two, bad]).endswith(" 1 run is left out: the table says why.")
    two[0].document["verdict"] = two[1].document["verdict"]
    assert headline(two).endswith(" robust 10/5x5 and robust 20/10x10 are suspect: scans are missing.")


def test_the_headline_says_first_whether_a_finer_grid_pays():
    coarse, fine = entry("robust 10/5x5"), entry(p95_mm=40.0)
    assert headline([coarse, fine]).startswith("A finer grid pays on this log: robust 20/10x10 gives the best map")
    assert headline([fine, entry("robust 10/5x5", p95_mm=30.0)]).startswith(
        "A finer grid does not pay on this log: robust 10/5x5 gives the best map"
    )
    same = headline([coarse, entry()])
    assert same.startswith("A finer grid does not pay on this log: the maps of robust 10/5x5 and robust 20/10x10 are")
    other = headline([coarse, entry("paper 10/5x5")])
    assert other.startswith("No setting stands out: the maps of robust 10/5x5 and paper 10/5x5 are equally good")
    assert headline([coarse, entry("paper 10/5x5", p95_mm=40.0)]).startswith("paper 10/5x5 gives the best map")


def test_maps_that_differ_within_the_noise_are_equally_good_and_the_noise_is_told():
    pair = [entry("robust 10/5x5", p95_mm=131.2, cells_per_m=200.0), entry(p95_mm=135.4, cells_per_m=205.0)]
    assert "equally good by every measure here (wall p95 131 to 135 mm, uncertain by 9 %)." in headline(pair)
    for run, mean in zip(pair, (30, 20), strict=True):
        run.document["search"] = {"evaluations_per_scan": {"mean": mean}}
    assert headline(pair).endswith("uncertain by 9 %); robust 20/10x10 needs the fewest evaluations.")
    pair[1].document["search"] = pair[0].document["search"]
    assert headline(pair).endswith("uncertain by 9 %).")


def test_the_measures_that_decide_are_told_with_their_uncertainty():
    pair = [entry("robust 10/5x5", cells_per_m=180.0), entry(p95_mm=40.0, cells_per_m=200.0)]
    assert headline(pair).startswith(
        "A finer grid does not pay on this log: robust 10/5x5 and robust 20/10x10 are each best by 1 of the 2 measures "
        "that differ (cells per m 180.0 against 200.0, uncertain by 6 %)"
    )
    assert headline([pair[0], entry(p95_mm=40.0)]).startswith("A finer grid does not pay on this log: robust 10/5x5")
    pair[0].document["wall_thickness"]["spread"]["p95_mm"] = 30.0
    assert "best by all 2 measures that differ (wall p95 30 against 40 mm, uncertain by 9 %; cells" in headline(pair)


def test_the_best_is_compared_with_the_next_one():
    three = [entry("robust 10/5x5", p95_mm=90.0), entry(p95_mm=40.0), entry("robust 5/3x3", p95_mm=60.0)]
    assert "(wall p95 40 against 60 mm, " in headline(three)


def test_counts_of_cells_of_two_sizes_are_not_among_the_measures_that_hardly_differ():
    pair = [entry("robust 10/5x5", p95_mm=60.0), entry(p95_mm=60.2, cells_per_m=100.0, cell_mm=40)]
    assert headline(pair).startswith(
        "A finer grid does not pay on this log: the maps of robust 10/5x5 and robust 20/10x10 are equally good by "
        "every measure that does not depend on the cell size. "
        "Wall thickness and crispness are not compared, because the cell sizes differ (40 and 20 mm)."
    )
    pair[0].document["map"]["accepted_share"], pair[1].document["map"]["accepted_share"] = 0.99, 0.97
    assert "equally good" in headline(pair)


def test_maps_of_one_cell_size_are_compared_with_each_other():
    coarse = [entry("robust 10/5x5", p95_mm=60.0), entry(p95_mm=90.0)]
    fine = [entry("paper 10/5x5", p95_mm=50.0, cell_mm=14), entry("paper 20/10x10", p95_mm=50.0, cell_mm=14)]
    text = headline(coarse + fine)
    assert " compared only among maps of the same cell size, because the cell sizes differ (20 and 14 mm). " in text
    best = "robust 10/5x5 gives the best map, best by the one measure that differs (wall p95 60"
    assert f" Cells of 20 mm: A finer grid does not pay on this log: {best}" in text
    equal = "the maps of paper 10/5x5 and paper 20/10x10 are equally good by every measure here"
    assert f" Cells of 14 mm: A finer grid does not pay on this log: {equal}" in text


def test_walls_of_maps_with_other_cells_are_not_compared():
    for cell_mm, named in ((20, True), (14, False)):
        pair = [entry("robust 10/5x5", p95_mm=90.0), entry(p95_mm=60.0, cell_mm=cell_mm)]
        pair[0].document["map"]["accepted_share"], pair[1].document["map"]["accepted_share"] = 0.7, 0.9
        assert "robust 20/10x10 gives the best map" in headline(pair)
        assert ("wall p95 60 against 90 mm" in headline(pair)) == named
