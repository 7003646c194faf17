"""The headline of a report: what it says of doubtful tracks, and of maps that hardly differ."""

from types import SimpleNamespace

from mavnav.outputs.documents.quantities import probably_wrong
from mavnav.outputs.report.headline import headline
from mavnav.slam.findings import HIGH


def entry(
    name="robust 20/10x10", *, doubt=0.1, reasons=(), p95_mm=60.0, cells_per_m=200.0, cell_mm=20, meaningful=True
):
    """Return what a headline reads of a run."""
    found = [{"reason": reason, "from_s": 0.0, "to_s": 1.0, "value": 1.0} for reason in reasons]
    crispness = {"occupied_cells_per_m": cells_per_m}
    document = {
        "method": "robust",
        "grid": name.rpartition("/")[2],
        "azimuth": 20,
        "scans": {"accepted": 751, "processed": 756},
        "tracking": {"lost": False, "doubt": {"probability": doubt, "reasons": found}},
        "map": {"cell_mm": cell_mm},
        "wall_thickness": {"spread": {"p95_mm": p95_mm}},
        "map_quality": {"meaningful": meaningful, "why": [] if meaningful else ["2 % mapped"], "crispness": crispness},
    }
    return SimpleNamespace(name=name, document=document)


def test_the_headline_of_a_run_says_that_its_track_is_probably_wrong():
    wrong = headline([entry(doubt=0.81, reasons=("two tracks disagree", "unclosed loop", "two tracks disagree"))])
    assert wrong.endswith("; the track is probably wrong (probability 0.81): two tracks disagree, unclosed loop.")
    assert wrong.startswith("robust 20/10x10 accepted 751 of 756 scans; 95 % of the wall length is at most 60 mm thick")
    unreliable = headline([entry(doubt=0.81, reasons=("not planar",), meaningful=False)])
    assert unreliable.endswith("2 % mapped; the track is probably wrong (probability 0.81): not planar.")


def test_the_headline_of_a_mission_says_that_it_failed():
    flown = entry()
    plain = headline([flown])
    flown.document["mission"] = {"reached": False, "reason": "stuck"}
    assert headline([flown]) == f"The mission failed: stuck. {plain}"
    flown.document["mission"] = {"reached": True, "reason": "goal"}
    assert headline([flown]) == plain


def test_a_track_is_probably_wrong_above_the_probability_that_gives_a_warning():
    assert "wrong" not in headline([entry(doubt=HIGH)])
    assert "wrong" in headline([entry(doubt=HIGH + 0.01)])
    assert not probably_wrong({"tracking": {"doubt": {"probability": None, "reasons": []}}})  # causal mode
    assert not probably_wrong({"tracking": {"lost": False}})  # earlier versions


def test_the_headline_of_several_runs_names_those_whose_track_is_probably_wrong():
    sound, one = entry("robust 10/5x5"), entry(p95_mm=90.0, doubt=0.8, reasons=("gap",))
    assert headline([sound, one]).endswith(" The track of robust 20/10x10 is probably wrong (probability 0.80): gap.")
    other = entry("robust 40/20x20", doubt=0.61, reasons=("too few beams",))
    both = headline([one, other, entry("robust 10/5x5", meaningful=False)])
    assert (
        " The tracks of robust 20/10x10 and robust 40/20x20 are probably wrong (probability 0.61 to 0.80): "
        "gap, too few beams. 1 run is left out" in both
    )
    only = headline([one, entry("robust 10/5x5", meaningful=False)])
    assert only.startswith("Only robust 20/10x10") and "is probably wrong (probability 0.80): gap." in only


def test_the_share_by_which_no_measure_differs_holds_for_those_within_the_noise_too():
    pair = [entry("robust 10/5x5", p95_mm=131.2, cells_per_m=200.0), entry(p95_mm=135.4, cells_per_m=205.0)]
    assert "no measure differs by more than 3.1 %" in headline(pair)


def test_counts_of_cells_of_two_sizes_are_not_among_the_measures_that_hardly_differ():
    pair = [entry("robust 10/5x5", p95_mm=60.0), entry(p95_mm=60.2, cells_per_m=100.0, cell_mm=40)]
    assert headline(pair).startswith(
        "The maps of robust 10/5x5 and robust 20/10x10 are equally good by every measure that does not depend on the "
        "cell size; robust 10/5x5 needs the fewest evaluations. Wall thickness and crispness are not compared, because "
        "the cell sizes differ (40 and 20 mm)."
    )
    pair[0].document["map"]["accepted_share"], pair[1].document["map"]["accepted_share"] = 0.99, 0.97
    assert "no measure differs by more than 2.0 %" in headline(pair)


def test_maps_of_one_cell_size_are_compared_with_each_other():
    coarse = [entry("robust 10/5x5", p95_mm=60.0), entry(p95_mm=90.0)]
    fine = [entry("paper 10/5x5", p95_mm=50.0, cell_mm=14), entry("paper 20/10x10", p95_mm=50.0, cell_mm=14)]
    text = headline(coarse + fine)
    assert " compared only among maps of the same cell size, because the cell sizes differ (20 and 14 mm). " in text
    assert " Cells of 20 mm: robust 10/5x5 gives the best map, by the one measure that differs (wall p95)" in text
    assert " Cells of 14 mm: The maps of paper 10/5x5 and paper 20/10x10 are equally good by every measure here" in text


def test_walls_of_maps_with_other_cells_are_not_called_thinner():
    for cell_mm, named in ((20, True), (14, False)):
        pair = [entry("robust 10/5x5", p95_mm=90.0), entry(p95_mm=60.0, cell_mm=cell_mm)]
        pair[0].document["map"]["accepted_share"], pair[1].document["map"]["accepted_share"] = 0.7, 0.9
        assert headline(pair).startswith("robust 20/10x10 gives the best map")
        assert ("its walls are thinner" in headline(pair)) == named
