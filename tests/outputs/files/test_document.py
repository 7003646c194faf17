"""run.json: everything promised, nothing that JSON lacks."""

import json

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.logs import Damage
from mavnav.metrics.gates import judge, parse_gate
from mavnav.metrics.walls import wall_sections
from mavnav.outputs.files.document import plain, run_document, to_json, write_metrics
from mavnav.outputs.report.markdown import inert
from mavnav.pose import Pose, Trajectory
from mavnav.slam.findings import Doubt, Loop, Loops, Reason, TrackedAgain
from mavnav.slam.matching.steps import LostInterval, Steps, tracked_trajectory

KEYS = {
    "schema_version", "mavnav_version", "verdict", "input", "config", "method", "grid", "azimuth", "scans", "cleaning",
    "tracking", "timing", "search", "wall_thickness", "map", "damage", "warnings", "outputs", "partial", "exit_code",
    "python", "provenance", "libraries", "map_quality", "loop_closure",
}  # fmt: skip


def strict(document):
    """Write and read back, refusing NaN and infinities."""

    def refuse(word):
        raise AssertionError(word)

    return json.loads(to_json(document), parse_constant=refuse)


def test_the_promised_names_are_there(run):
    document = strict(run_document(run, {"map.pgm": "abc"}))
    assert set(document) == KEYS
    assert {"path", "sha256", "format", "topic"} <= set(document["input"])
    assert set(document["wall_thickness"]) == {"spread", "paper_cells", "1", "2", "5", "published_map"}
    assert set(document["wall_thickness"]["spread"]) >= {"median_mm", "p95_mm", "length_m", "measured_share"}
    assert {"max_cells", "p95_cells", "median_cells", "sections", "length_m"} <= set(document["wall_thickness"]["2"])
    assert {"wall_s", "cpu_s", "compile_s", "stages", "scans_per_s", "realtime_factor"} < set(document["timing"])
    assert document["timing"]["scan"] == {"median_ms": 250, "p95_ms": 700, "max_ms": 750, "period_ms": 100}
    assert document["outputs"] == {"map.pgm": "abc"}
    assert (document["grid"], document["config"]["grid"]) == ("10x10", "10x10")


def test_scans_are_accounted_for(run):
    scans = plain(run_document(run, {}))["scans"]
    assert (scans["total"], scans["usable"], scans["skipped"]) == (22, 20, {"stamp repeats": 2})
    assert (scans["processed"], scans["tracked"], scans["accepted"], scans["rejected"]) == (20, 18, 18, 2)


def test_a_closed_loop_is_told_by_both_its_scans(run):
    assert plain(run_document(run, {}))["loop_closure"] == {"closures": [], "rejected": 0, "corrected": False}
    loop = Loop(2, 16, Pose(0.1, 0.0, 0.0), Pose(0.3, -0.4, np.pi / 60), 0.8)
    closed = replace(run, slam=replace(run.slam, loops=Loops((loop,), 5, run.slam.trajectory)))
    told = strict(run_document(closed, {}))["loop_closure"]
    assert (told["rejected"], told["corrected"]) == (5, True)
    (closure,) = told["closures"]
    indices = [step.index for step in run.slam.steps if step.tracked]
    assert (closure["from_scan"], closure["to_scan"]) == (indices[2], indices[16])
    stamps_ns = run.slam.trajectory.stamps_ns
    assert closure["to_s"] - closure["from_s"] == pytest.approx((stamps_ns[16] - stamps_ns[2]) * 1e-9)
    assert closure["correction_m"] == pytest.approx(0.5)
    assert closure["correction_deg"] == pytest.approx(3.0)


def test_a_lost_stretch_is_told_in_seconds_from_the_first_scan(run):
    tracking = plain(run_document(run, {}))["tracking"]
    assert tracking["lost"] is False
    (interval,) = tracking["intervals"]
    assert interval["start_s"] == pytest.approx(5.0, abs=1e-6)
    assert interval["end_s"] == pytest.approx(5.5, abs=1e-6)
    assert (interval["scans"], interval["recovered"]) == (2, True)
    assert tracking["tracked_share"] == 0.9
    assert tracking["frames"] == {
        "trajectory.tum": ["map", "/laser"], "trajectory_base.tum": ["map", "base_footprint"]
    }  # fmt: skip


def doubtful(run, probability):
    stamps_ns = run.slam.trajectory.stamps_ns
    slip = Reason("slip", int(stamps_ns[2]), int(stamps_ns[4]), 3.0)
    return replace(run, slam=replace(run.slam, doubt=Doubt(probability, (slip,), ("resampled track",))))


def test_doubt_is_reported_with_its_reasons(run):
    document = strict(run_document(doubtful(run, 0.75), {}))
    doubt = document["tracking"]["doubt"]
    assert set(doubt) == {"probability", "reasons", "tried"}
    assert doubt["probability"] == 0.75
    assert doubt["tried"] == ["resampled track"]
    assert doubt["reasons"] == [
        {"reason": "slip", "from_s": pytest.approx(1.0), "to_s": pytest.approx(2.0), "value": 3.0}
    ]
    assert document["verdict"]["word"] == "suspect"
    assert document["verdict"]["reason"] == "the path may be wrong (doubt 0.75): the path jumps, from 1.0 to 2.0 s"
    assert document["warnings"] == strict(run_document(run, {}))["warnings"]
    (held, failed) = judge([parse_gate(f"tracking.doubt.probability<={p}") for p in (0.8, 0.5)], document)
    assert held["passed"]
    assert not failed["passed"]


def test_the_verdict_follows_from_the_doubt_and_comes_first(run):
    words = [plain(run_document(doubtful(run, p), {}))["verdict"]["word"] for p in (0.3, 0.5, 0.51, 0.75, 0.76)]
    assert words == ["good", "good", "suspect", "suspect", "wrong"]
    assert list(plain(run_document(run, {})))[:3] == ["schema_version", "mavnav_version", "verdict"]


def test_a_run_that_was_not_judged_has_no_probability(run):
    doubt = strict(run_document(run, {}))["tracking"]["doubt"]
    assert doubt == {"probability": None, "reasons": [], "tried": []}
    assert plain(run_document(run, {}))["verdict"]["word"] == "suspect"


def ends_without_a_pose(run, share):
    """Return a run without a pose from the end of a share of its scans on."""
    steps = Steps(step._replace(tracked=k < share * len(run.slam.steps)) for k, step in enumerate(run.slam.steps))
    last = LostInterval(run.log.last_ns, run.log.last_ns, 1, recovered=False)
    path = tracked_trajectory(steps)
    return replace(run, slam=replace(run.slam, steps=steps, trajectory=path, lost=(*run.slam.lost, last)))


def lost_for_good(run):
    return ends_without_a_pose(run, 0.8)


def test_exit_codes(run, change):
    damaged = change(run, damage=(Damage("chunk cut short", "byte 7"),))
    assert run_document(run, {}).exit_code == 0
    assert run_document(damaged, {}).exit_code == 3
    assert run_document(damaged, {}).damage == [Damage("chunk cut short", "byte 7")]
    assert run_document(lost_for_good(run), {}).exit_code == 5
    assert run_document(lost_for_good(damaged), {}).exit_code == 5
    assert run_document(lost_for_good(run), {}).tracking.lost is True


def test_a_log_whose_end_alone_does_not_match_is_suspect_and_done(run):
    """A robot that was lifted off its wheels at the end has a right map."""
    document = strict(run_document(ends_without_a_pose(doubtful(run, 0.1), 0.9), {}))
    assert (document["exit_code"], document["tracking"]["lost"]) == (0, False)
    assert document["verdict"]["word"] == "suspect"
    assert document["verdict"]["reason"].startswith("no scan matches any more from 9.5 s after the first scan; 90 %")
    assert "--end 9.5" in document["verdict"]["advice"]
    lost = strict(run_document(ends_without_a_pose(run, 0.85), {}))
    assert (lost["exit_code"], lost["verdict"]["word"]) == (5, "lost")


def test_no_wall_is_null(run):
    empty = wall_sections(np.zeros((3, 3), np.int32), 0.02, 5)
    measured = replace(run.measures, sections={5: empty})
    document = strict(run_document(replace(run, metrics=measured), {}))
    assert document["wall_thickness"]["5"]["max_cells"] is None
    assert document["wall_thickness"]["5"]["sections"] == 0


def test_a_run_of_no_steps_has_a_document(run):
    nothing = replace(run, slam=replace(run.slam, steps=Steps(), trajectory=Trajectory.of([], [])))
    document = strict(run_document(nothing, {}))
    assert document["search"]["evaluations_per_scan"] == {"mean": None, "median": None, "min": None, "max": None}
    assert document["map"]["accepted_share"] == 0


def test_plain_values():
    value = {"a": np.float32(1.5), "b": [np.int64(2), float("inf"), np.nan], 3: (True, np.bool_(False), None)}
    assert plain(value) == {"a": 1.5, "b": [2, None, None], "3": [True, False, None]}


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1"])
def test_no_cell_of_a_csv_file_is_a_formula(text: str) -> None:
    assert inert(text) == f"'{text}"
    assert [inert(value) for value in ("a=1", "", -1.5, None)] == ["a=1", "", -1.5, None]


def test_negative_zeros_lose_their_sign():
    assert to_json([-0.0, np.float64(-0.0), -0.5]).split() == ["[", "0.0,", "0.0,", "-0.5", "]"]


def test_attempts_to_track_again_are_reported_where_there_are_any(run):
    assert "attempts" not in strict(run_document(run, {}))["tracking"]
    again = replace(run, slam=replace(run.slam, attempts=(TrackedAgain("coarser voxels", kept=False),)))
    assert strict(run_document(again, {}))["tracking"]["attempts"] == [{"name": "coarser voxels", "kept": False}]


def test_attempts_are_no_metric(run, tmp_path):
    write_metrics(run, tmp_path / "one.json")
    write_metrics(replace(run, slam=replace(run.slam, attempts=(TrackedAgain("a", kept=True),))), tmp_path / "two.json")
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()
