"""Verdicts: what makes a run suspect, wrong or lost, in which order, and what the advice is."""

from __future__ import annotations

from typing import Any

import pytest

from mavnav.metrics.gates import VERDICTS
from mavnav.outputs.documents.verdict import CERTAIN, MEANINGS, OPEN, Verdict, verdict_of, worst_verdict
from mavnav.slam.doubt.features import FEATURES
from mavnav.slam.findings import HIGH

GOOD: dict[str, Any] = {
    "method": "robust",
    "config": {"odom": "auto"},
    "input": {"duration_s": 60.0, "odometry": None},
    "scans": {"processed": 600, "tracked": 600},
    "tracking": {
        "lost": False, "tracked_share": 1.0, "intervals": [], "doubt": {"probability": 0.1, "reasons": []}
    },
    "search": {"beams_used": {"median": 500}},
    "map_quality": {"meaningful": True, "why": []},
}  # fmt: skip


def run(**tracking: Any) -> dict[str, Any]:
    """Return the sections of a run that is good but for some keys of its tracking."""
    return GOOD | {"tracking": GOOD["tracking"] | tracking}


def doubtful(probability: float | None, *reasons: tuple[str, float, float, float]) -> dict[str, Any]:
    keys = ("reason", "from_s", "to_s", "value")
    listed = [dict(zip(keys, reason, strict=True)) for reason in reasons]
    return run(doubt={"probability": probability, "reasons": listed})


def external(pairs: int, revisits_mm: float | None, neighbors_mm: float | None) -> dict[str, Any]:
    known = {"pairs": pairs, "nn_l_mm": revisits_mm, "nn_s_mm": neighbors_mm}
    return GOOD | {"method": "external", "map_quality": GOOD["map_quality"] | {"revisits": known}}


def beside(misfit_mm: float | None) -> dict[str, Any]:
    """Return a run at given poses, in cells of 20 mm."""
    config = GOOD["config"] | {"robust": {"cell_mm": 20.0}}
    return external(0, None, None) | {"config": config, "external": {"misfit_mm": misfit_mm}}


def differing(late_s: float = 0.0, distance_scale: float = 1.0, **jump: float) -> dict[str, Any]:
    """Return a run at given poses that differ from those of mavnav."""
    section = {"late_s": late_s, "distance_scale": distance_scale, "jumps": [jump] if jump else []}
    return external(0, None, None) | {"external": section}


def lost(share: float = 0.3, **more: Any) -> dict[str, Any]:
    return run(lost=True, tracked_share=share, **more)


def test_a_run_without_a_sign_of_an_error_is_good_and_needs_no_advice() -> None:
    assert verdict_of(GOOD) == Verdict("good", "no sign of an error in path or map", "")
    undrawn = {name: section for name, section in GOOD.items() if name != "map_quality"}
    assert verdict_of(undrawn) == Verdict("good", "no sign of an error in the path", "")
    back = {"start_s": 3.0, "end_s": 4.0, "scans": 10, "recovered": True}
    assert verdict_of(run(intervals=[back])).word == "good"


@pytest.mark.parametrize(
    ("probability", "word"), [(0.0, "good"), (HIGH, "good"), (HIGH + 0.01, "suspect"), (CERTAIN + 0.01, "wrong")]
)
def test_the_doubt_decides(probability: float, word: str) -> None:
    assert verdict_of(doubtful(probability, ("slip", 3.0, 3.0, 2.0))).word == word


@pytest.mark.parametrize(
    "sections",
    [
        external(100, 21.9, 10.0),
        external(99, 90.0, 10.0),
        external(100, None, 10.0),
        external(100, 90.0, 10.0) | {"method": "robust"},
        beside(14.9),
        beside(None),
        differing(),
    ],
)
def test_revisits_that_fit_as_well_as_those_of_good_tracks_do_no_harm(sections: dict[str, Any]) -> None:
    assert verdict_of(sections).word == "good"


def test_given_poses_are_doubted_and_lost_without_advice_for_a_search() -> None:
    doubted = doubtful(0.8, ("slip", 3.0, 3.1, 2.0)) | {"method": "external"}
    assert verdict_of(doubted).advice == "compare map.png with the place"
    few = lost(0.4) | {"method": "external"}
    assert verdict_of(few).reason == "only 40 % of the scans have a pose"
    assert "the clock of its scans" in verdict_of(few).advice


def test_the_cause_is_the_strongest_stretch_of_the_first_reason_that_is_no_symptom() -> None:
    tracks = ("two tracks disagree", 5.1, 8.4, 9.0)
    tilted, more = ("not planar", 4.7, 5.1, 1.2), ("not planar", 13.5, 19.7, 5.1)
    reason = verdict_of(doubtful(0.95, tracks, tilted, more)).reason
    assert reason.startswith("the path is probably wrong (doubt 0.95): the laser seems to have tilted")
    assert reason.endswith(", from 13.5 to 19.7 s")
    assert "coarser voxels, the path differs, from 5.1 to 8.4 s" in verdict_of(doubtful(0.6, tracks)).reason
    assert verdict_of(doubtful(0.6, ("slip", 7.0, 7.2, 1.0))).reason.endswith("the path jumps, at 7.0 s")
    assert verdict_of(doubtful(0.6)).reason.endswith("many weak signs together")


def test_a_reason_that_holds_everywhere_has_no_place() -> None:
    assert verdict_of(doubtful(0.6, ("too few beams", 0.0, 60.0, 2.0))).reason.endswith("have few points")
    assert verdict_of(doubtful(0.6, ("too few beams", 0.0, 50.0, 2.0))).reason.endswith("points, from 0.0 to 50.0 s")


def test_a_mission_has_no_options_that_cut_it_and_its_truth_is_known() -> None:
    for run_ in (doubtful(0.8, ("slip", 3.0, 3.1, 2.0)), lost()):
        assert verdict_of(run_ | {"mission": True}).advice == "compare map.png with true_map.png"
        assert verdict_of(run_ | {"mission": False}).advice != "compare map.png with true_map.png"
    assert verdict_of(GOOD | {"mission": True}).advice == ""


def test_a_part_of_a_few_scans_is_no_loss() -> None:
    few = {"from_s": 0.0, "to_s": 1.8, "scans": 19, "joined": False}
    assert verdict_of(run(parts=[few])).word == "good"
    assert verdict_of(run(parts=[few | {"scans": 20}])).word == "suspect"


def test_every_reason_of_the_doubt_has_a_meaning() -> None:
    assert {feature.reason for feature in FEATURES.values()} == set(MEANINGS)


@pytest.mark.parametrize(
    ("change", "reason", "advice"),
    [
        (
            run(intervals=[{"start_s": 57.34, "end_s": 60.0, "scans": 27, "recovered": False}], tracked_share=0.955),
            "no scan matches any more from 57.3 s after the first scan; 96 % of the scans have a pose",
            "leave the rest out with --end 57.3",
        ),
        (
            run(intervals=[{"start_s": 2.9, "end_s": 3.0, "scans": 0, "recovered": True}]),
            "the path jumps faster than any vehicle, at 3.0 s",
            "a clock set back",
        ),
        (
            run(parts=[{"from_s": 9.104, "to_s": 12.001, "scans": 30, "joined": False}]),
            "1 part of the log, 30 scans, is not in the map",
            "replay it alone with --start 9.10 --end 12.01",
        ),
        (
            GOOD
            | {
                "map_quality": {
                    "meaningful": False,
                    "why": ["0.3 m of its occupied cells lie on straight lines, 2 m are needed"],
                }
            },
            "the map cannot be measured: 0.3 m of its occupied cells lie on straight lines, 2 m are needed",
            "compare map.png with the place",
        ),
        (
            differing(-0.2, 1.02),
            "the poses are 0.20 s early beside the scans, distances are 2.0 % long",
            "check the clock and the units of the poses; compare map.png with the place",
        ),
        (
            differing(0.2, at_s=12.44, moved_m=0.1, turned_deg=2.0),
            "the poses are 0.20 s late beside the scans, "
            "the path jumps where the scans do not, by 0.10 m and 2.0 deg at 12.4 s",
            "check the clock and the units of the poses; compare map.png with the place",
        ),
        (beside(15.1), "the median scan fits the map 15 mm beside its pose", "compare map.png with the place"),
        (
            external(100, 22.1, 10.0),
            "places that are seen again are drawn 22 mm apart, scans in a row 10 mm",
            "compare map.png with the place",
        ),
        (doubtful(None), "too few scans to check the path", "compare map.png with the place"),
        (doubtful(None) | {"localisation": {}, "partial": True}, "the run was stopped", "repeat it"),
    ],
)
def test_what_makes_a_run_suspect(change: dict[str, Any], reason: str, advice: str) -> None:
    verdict = verdict_of(change)
    assert verdict.word == "suspect"
    assert verdict.reason.startswith(reason)
    assert advice in verdict.advice


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        ({"config": {"odom": "auto", "robust": {"cell_mm": 2.0}}}, "leave out robust.cell_mm=2.0 (default 20.0)"),
        ({"config": {"odom": "off"}}, "use --odom auto if the log has odometry; compare map.png with the place"),
        ({}, "map a part alone, with --start 12.0 --end 60.0; compare map.png with the place"),
    ],
)
def test_advice_for_a_doubtful_path(change: dict[str, Any], advice: str) -> None:
    assert verdict_of(doubtful(0.8, ("slip", 3.0, 3.1, 2.0), ("gap", 9.0, 12.0, 1.0)) | change).advice == advice


def test_where_no_sound_stretch_is_left_odometry_is_advised_if_there_is_none() -> None:
    everywhere = doubtful(0.8, ("weakly constrained pose", 0.0, 55.0, 2.0))
    assert verdict_of(everywhere).advice == "compare map.png with the place; record odometry"
    recorded = everywhere | {"input": GOOD["input"] | {"odometry": {"topic": "/odom"}}}
    assert verdict_of(recorded).advice == "compare map.png with the place"


def test_the_worst_cause_is_said() -> None:
    ended = [{"start_s": 20.0, "end_s": 60.0, "scans": 400, "recovered": False}]
    assert verdict_of(lost(intervals=ended, doubt={"probability": 0.99, "reasons": []})).word == "lost"
    both = doubtful(0.99, ("slip", 3.0, 3.0, 2.0)) | {"map_quality": {"meaningful": False, "why": ["no wall"]}}
    assert verdict_of(both).word == "wrong"


def test_a_lost_run_says_since_when_unless_it_came_back() -> None:
    found_again = {"start_s": 0.1, "end_s": 13.2, "scans": 132, "recovered": True}
    assert verdict_of(lost(0.014, intervals=[found_again])).reason == "tracking was lost, 1 % of the scans have a pose"
    gone = found_again | {"recovered": False}
    assert verdict_of(lost(intervals=[gone])).reason.startswith("tracking was lost 0.1 s after the first scan, 30 %")
    blind = lost() | {"search": {"beams_used": {"median": 3}}}
    assert verdict_of(blind).reason == "the scans see too little to be matched (3 usable beams in the median)"
    assert verdict_of(blind).advice.startswith("look at the ranges")
    changed = blind | {"config": {"robust": {"far_mm": 700.0}}}
    assert verdict_of(changed).advice.startswith("leave out robust.far_mm=700.0")


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        ({"method": "paper"}, "use --method robust"),
        ({"config": {"odom": "off", "robust": {"cell_mm": 2.0}}}, "leave out robust.cell_mm=2.0 (default 20.0)"),
        ({"method": "paper", "config": {"paper": {"gate_mm2": 1}}}, "leave out paper.gate_mm2=1 (default 500"),
        ({"config": {"odom": "off"}}, "use --odom auto if the log has odometry"),
        ({"input": {"odometry": None, "duration_s": 9.0}}, "record odometry, or more scans a second"),
        (
            {"input": {"odometry": {"topic": "/odom"}, "duration_s": 9.0}},
            "with mavnav info; record more scans a second",
        ),
        ({"localisation": {"start_pose": None}}, "give a --start-pose"),
        ({"localisation": {"start_pose": {"x_m": 0.0}}}, "give another --start-pose"),
    ],
)
def test_the_advice_fits_the_lost_run(change: dict[str, Any], advice: str) -> None:
    assert advice in verdict_of(lost() | change).advice


def test_of_a_lost_run_the_longest_stretch_with_poses_is_worth_a_map() -> None:
    gaps = [
        {"start_s": 0.0, "end_s": 8.24, "scans": 41, "recovered": True},
        {"start_s": 16.27, "end_s": 21.8, "scans": 28, "recovered": False},
    ]
    short = GOOD["input"] | {"duration_s": 21.8}
    assert verdict_of(lost(0.2, intervals=gaps) | {"input": short}).advice == (
        "map what has poses alone, with --start 8.3 --end 16.2; look at map.png"
    )
    slow = verdict_of(lost(0.2, intervals=gaps) | {"input": short, "scans": GOOD["scans"] | {"processed": 22}})
    assert slow.advice.endswith("--end 16.2; record odometry, or more scans a second; look at map.png")
    gaps[1]["start_s"] = 9.0
    assert "--start" not in verdict_of(lost(0.2, intervals=gaps) | {"input": short}).advice


def test_large_parts_that_are_left_out_are_worth_a_replay() -> None:
    parts = [{"from_s": 0.0, "to_s": 9.0, "scans": 91, "joined": True}]
    parts += [{"from_s": 9.1, "to_s": 12.0, "scans": 30, "joined": False}]
    large = lost(0.7, parts=parts) | {"scans": {"processed": 121}}
    assert verdict_of(large).advice.startswith("replay the parts that are left out alone with --start and --end")
    assert "--start" not in verdict_of(large | {"scans": {"processed": 900}}).advice


def from_(start_s: float, sections: dict[str, Any]) -> dict[str, Any]:
    """Return a run that begins so long after its log."""
    return sections | {"input": sections["input"] | {"start_s": start_s}}


def test_advised_windows_count_from_the_first_scan_of_the_log() -> None:
    late = doubtful(0.8, ("slip", 3.0, 3.1, 2.0), ("gap", 9.0, 12.0, 1.0))
    assert "with --start 196.4 --end 244.3;" in verdict_of(from_(184.333, late)).advice
    early = doubtful(0.8, ("slip", 26.8, 26.8, 2.0), ("slip", 31.0, 60.0, 2.0))
    assert "with --start 184.3 --end 211.1;" in verdict_of(from_(184.333, early)).advice
    ended = run(intervals=[{"start_s": 51.27, "end_s": 60.0, "scans": 87, "recovered": False}])
    assert verdict_of(from_(10.0, ended)).advice.endswith("leave the rest out with --end 61.2")
    left_out = run(parts=[{"from_s": 11.404, "to_s": 12.244, "scans": 20, "joined": False}])
    assert verdict_of(from_(10.0, left_out)).advice == "replay it alone with --start 21.40 --end 22.25"


def test_a_session_that_did_not_join_is_lost() -> None:
    apart = {"name": "tuesday", "run": "runs/monday", "joined": False, "why": "too few scans fit"}
    verdict = verdict_of(GOOD | {"continued": apart})
    assert (verdict.word, "tuesday did not join runs/monday" in verdict.reason) == ("lost", True)
    assert verdict.advice == "record it along 3 m or more of the way of another session"
    assert verdict_of(GOOD | {"continued": apart | {"joined": True}}).word == "good"
    repeated = verdict_of(GOOD | {"continued": apart | {"why": "it has the scans of monday"}})
    assert repeated.advice == "leave it out: its scans are in the map already"
    blind = GOOD | {"scans": GOOD["scans"] | {"tracked": 0}, "continued": apart}
    assert verdict_of(blind).advice == "examine it with mavnav info"


def test_the_worst_of_some_verdicts() -> None:
    verdicts = [Verdict(word, "", "") for word in VERDICTS]  # type: ignore[arg-type]
    assert worst_verdict(verdicts[1::-1]) == verdicts[1]
    assert worst_verdict(verdicts) == verdicts[3]
    assert worst_verdict([]) is None


def test_what_walls_leave_open_alone_makes_no_given_poses_wrong() -> None:
    open_way, jump = (OPEN, 0.0, 9.0, 9.0), ("slip", 3.0, 3.1, 2.0)
    own, given = (doubtful(0.9, open_way) | {"method": method} for method in ("robust", "external"))
    assert (verdict_of(own).word, verdict_of(given).word) == ("wrong", "suspect")
    assert verdict_of(doubtful(0.9, open_way, jump) | {"method": "external"}).word == "wrong"
