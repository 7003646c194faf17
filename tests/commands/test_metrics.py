"""``mavnav metrics``: runs and map files measured, references, errors in one line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from mavnav.commands.run_screen import quality_rows
from mavnav.ground_truth.tables import read_tum
from mavnav.logs import open_log
from support.log_files import laser, write_mcap
from support.strange_runs import on_purpose

PARTS = {
    "profile", "meaningful", "why", "ghost_walls", "crispness", "revisits", "support", "occupied_share", "corners",
    "enclosed_areas", "walls",
}  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory, repo_root: Path) -> Path:
    """Simulate the corner once, small."""
    from mavnav.cli import run as command

    folder = tmp_path_factory.mktemp("runs") / "corner"
    assert command(["simulate", "corner", "-o", str(folder), "-q", "--set", "max_steps=30", "--json"]) in {0, 1}
    return folder


def measured(mavnav, *args: object) -> list[dict]:
    code, out, err = mavnav("metrics", *args, "--json", "-q")
    assert (code, err) == (0, "")
    return json.loads(out)["maps"]


def same(a: object, b: object) -> bool:
    """Compare documents; numbers may differ by what text files of poses leave out."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    return a == pytest.approx(b, rel=1e-4, abs=1e-6) if isinstance(a, float) else a == b


def test_a_run_measures_what_its_document_says(mavnav, run) -> None:
    capture = json.loads((run / "run.json").read_text())
    (found,) = measured(mavnav, run)
    assert set(found["map_quality"]) == PARTS
    assert same(found["map_quality"], capture["map_quality"])
    assert same(found["wall_thickness"], capture["wall_thickness"])
    assert json.loads((run / "metrics.json").read_text())["map_quality"] == capture["map_quality"]


def test_a_simulation_knows_its_references(mavnav, run) -> None:
    capture = json.loads((run / "run.json").read_text())
    (found,) = measured(mavnav, run, "--truth", run / "truth.tum", "--truth-map", "corner")
    assert same(found["reference"], capture["reference"])
    assert found["reference"]["ate"]["rmse_m"] == pytest.approx(capture["truth"]["ate_rmse_m"], abs=1e-6)
    assert found["reference"]["map_distance"]["alignment"] == "start pose"
    assert found["reference"]["map_distance"]["median_mm"] < 100


def test_the_map_file_of_a_run_agrees_with_it(mavnav, run) -> None:
    of_run, of_file = measured(mavnav, run, run / "map.yaml", "--truth-map", "corner")
    assert (of_run["kind"], of_file["kind"]) == ("run", "map")
    a, b = of_run["map_quality"], of_file["map_quality"]
    for name in ("walls", "corners", "enclosed_areas", "occupied_share"):
        assert same(a[name], b[name]), name
    assert same(a["support"]["wall_m"], b["support"]["wall_m"])
    assert same(of_run["reference"]["map_distance"], of_file["reference"]["map_distance"])
    assert set(of_file["wall_thickness"]) == {"published_map"}
    assert same(of_file["wall_thickness"]["published_map"], of_run["wall_thickness"]["published_map"])
    unknown = [b["revisits"], b["crispness"]["entropy_bits"], b["support"]["mapped_share"]]
    assert [*unknown, b["support"]["explained_share"]] == [None] * 4


def test_the_table_and_the_warning(mavnav, run, tmp_path) -> None:
    code, out, err = mavnav("metrics", run, "--truth", run / "truth.tum", "-q")
    assert (code, err) == (0, "")
    for words in ("ghost walls", "explained", "crispness", "ATE, aligned", "RPE per 1 m", "enclosed areas"):
        assert words in out
    (tmp_path / "empty.pgm").write_bytes(b"P5\n4 4\n255\n" + bytes([205] * 16))
    (tmp_path / "empty.yaml").write_text("image: empty.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")
    code, out, err = mavnav("metrics", tmp_path / "empty.yaml", "-q")
    assert code == 0
    assert "not meaningful" in out
    (found,) = measured(mavnav, tmp_path / "empty.yaml", "--truth-map", "corner")
    assert found["map_quality"]["occupied_share"] is None
    assert found["map_quality"]["ghost_walls"]["worst_offset_mm"] is None
    assert found["reference"]["map_distance"]["mean_mm"] is None


def broken(run: Path, tmp_path: Path, name: str) -> Path:
    """Copy a run and spoil one file of it."""
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    (copy / name).write_bytes(b"broken")
    return copy


@pytest.mark.parametrize("name", ["run.json", "hits.npz", "trajectory.tum", "result.mcap"])
def test_a_run_that_is_not_whole(mavnav, run, tmp_path, name) -> None:
    code, out, err = mavnav("metrics", broken(run, tmp_path, name), "-q")
    assert (code, out) == (2, "")
    assert "is no whole run" in err
    assert err.count("\n") == 1


@pytest.fixture(scope="module")
def lost(run, make_log, tmp_path_factory) -> Path:
    """Localize a laser that is nowhere in the map: a whole run without a pose."""
    from mavnav.cli import run as command

    folder = tmp_path_factory.mktemp("runs") / "lost"
    args = ["replay", make_log("nowhere.mcap", blind_after=0), "-o", folder, "--end", 0.6, "--odom", "off", "-q"]
    assert command([str(arg) for arg in (*args, "--map", run)]) == 5
    assert (folder / "trajectory.tum").read_bytes() == b""
    return folder


def test_a_run_without_a_pose_is_listed_without_figures(mavnav, run, lost, tmp_path) -> None:
    without, other = measured(mavnav, lost, run)
    assert (without["path"], other["path"]) == (str(lost), str(run))
    document = json.loads((lost / "run.json").read_text())
    assert same(without["map_quality"], document["map_quality"])
    assert same(without["wall_thickness"], document["wall_thickness"])
    assert without["wall_thickness"]["spread"]["p95_mm"] is None
    assert other["wall_thickness"]["spread"]["p95_mm"] > 0.0
    first, last = ((run / "truth.tum").read_text().splitlines()[k].split()[0] for k in (0, -1))
    (tmp_path / "some.relations").write_text(f"{first} {last} 0 0 0 0 0 0\n")
    options = ("--truth", run / "truth.tum", "--relations", tmp_path / "some.relations")
    found = [each["reference"] for each in measured(mavnav, run, lost, *options)]
    assert [reference["relations"]["all"]["scored"] for reference in found] == [1, 0]
    assert [reference.get("ate") is None for reference in found] == [False, True]


def test_runs_without_a_pose_alone_are_refused(mavnav, lost, tmp_path) -> None:
    code, out, err = mavnav("metrics", lost, "-q")
    advice = "nothing to measure; examine the log with 'mavnav info'"
    assert (code, out, err) == (2, "", f"mavnav: error: no scan of {lost} has a pose: {advice}\n")
    copy = Path(shutil.copytree(lost, tmp_path / "copy"))
    document = json.loads((copy / "run.json").read_text())
    document["scans"]["accepted"] = 7
    (copy / "run.json").write_text(json.dumps(document))
    code, out, err = mavnav("metrics", copy, lost, "-q")
    assert (code, out) == (2, "")
    assert f"{copy} is no whole run: " in err
    assert "make it again" in err


@pytest.mark.parametrize("change", [{"cell_m": 1e12}, {"counts": -1}, {"passes": -1}], ids=str)
def test_counts_that_were_edited_are_refused(mavnav, run, tmp_path, change) -> None:
    copy = Path(shutil.copytree(run, tmp_path / "copy"))
    with np.load(run / "hits.npz") as counts:
        np.savez(copy / "hits.npz", **{name: array * change.get(name, 1) for name, array in counts.items()})
    on_purpose(copy, "hits.npz")
    for args, words in ((["metrics", copy], "is no whole run"), (["diff", run, copy], "holds no map of a run")):
        code, out, err = mavnav(*args, "-q")
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert words in err
        assert "no counts of a map" in err


def test_a_run_without_some_files_is_told_in_plain_words(mavnav, run, tmp_path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    for name in ("hits.npz", "trajectory.tum"):
        (copy / name).unlink()
    code, out, err = mavnav("metrics", copy, "-q")
    assert (code, out) == (2, "")
    advice = "repeat its command with --force, without --outputs"
    assert err == f"mavnav: error: {copy} is no whole run: it has no hits.npz, trajectory.tum; {advice}\n"
    for name in ("hits.npz", "trajectory.tum"):
        (copy / name).mkdir()
    err = mavnav("metrics", copy, "-q")[2]
    assert f"{copy} is no whole run: it has no hits.npz; repeat its command" in err


def test_what_cannot_be_measured(mavnav, run, tmp_path) -> None:
    (tmp_path / "late.tum").write_text("9e8 0 0 0 0 0 0 1\n9.1e8 1 0 0 0 0 0 1\n")
    for args, word in (
        ([tmp_path / "gone"], "no such file"),
        ([tmp_path], "holds no run"),
        ([run / "map.pgm"], "map.pgm"),
        ([run, "--truth", tmp_path / "gone.tum"], "cannot be read"),
        ([run, "--truth", tmp_path / "late.tum"], "share no time"),
        ([run, "--truth-map", run / "run.json"], "neither"),
        ([], "Missing argument"),
    ):
        code, out, err = mavnav("metrics", *args, "-q")
        assert (code, out) == (2, ""), args
        assert word in err, args
        assert err.count("\n") == 1, args


def test_references_of_poses_need_a_run(mavnav, run, tmp_path) -> None:
    file = run / "map.yaml"
    (tmp_path / "some.relations").write_text("0 1 0 0 0 0 0 0\n")
    for option in (["--truth", run / "truth.tum"], ["--relations", tmp_path / "some.relations"]):
        code, out, err = mavnav("metrics", file, *option, "-q")
        assert (code, out) == (2, "")
        assert err == f"mavnav: error: {file}: a map has no poses; --truth and --relations need a run directory\n"
    code, out, err = mavnav("metrics", file, run, "--truth", run / "truth.tum", "-q", "--json")
    assert [found.get("reference") is None for found in json.loads(out)["maps"]] == [True, False]
    expected = f"mavnav: warning: {file}: a map has no poses; --truth and --relations are not used for it\n"
    assert (code, err) == (0, expected)
    code, out, err = mavnav("metrics", file, "--truth-map", "corner", "-q")
    assert (code, err) == (0, "")


def test_replay_takes_references(mavnav, sample, tmp_path) -> None:
    args = ("replay", sample, "-o", tmp_path / "r", "--end", 2, "-q", "--json", "--truth-map", "corridor")
    code, out, _ = mavnav(*args)
    assert code == 0
    document = json.loads(out)
    assert set(document["map_quality"]) == PARTS
    assert document["reference"]["map_distance"]["p95_mm"] < 200
    assert {"true_walls.json", "map.png"} <= set(document["outputs"])
    assert "goal" not in json.loads((tmp_path / "r" / "true_walls.json").read_text())
    (tmp_path / "late.tum").write_text("9e8 0 0 0 0 0 0 1\n9.1e8 1 0 0 0 0 0 1\n")
    code, out, err = mavnav("replay", sample, "-o", tmp_path / "s", "-q", "--truth", tmp_path / "late.tum")
    assert (code, out) == (2, "")
    assert "share no time" in err
    assert not (tmp_path / "s").exists()


@pytest.mark.slow
def test_an_aligned_run_has_the_same_errors(mavnav, sample, tmp_path) -> None:
    documents, truths = {}, ("--truth", "auto", "--truth-map", "corridor")
    for name, align in {"plain": ("--align", "none"), "placed": ("--align", "2,1,1.5707963267948966")}.items():
        assert mavnav("replay", sample, "-o", tmp_path / name, "--end", 2, "-q", *align, *truths)[0] == 0
        documents[name] = json.loads((tmp_path / name / "run.json").read_text())
    plain, placed = documents.values()
    assert "alignment" not in plain
    assert plain["provenance"]["options"]["align"] == "none"
    assert placed["alignment"] == {"x_m": 2.0, "y_m": 1.0, "yaw_deg": 90.0}
    assert placed["provenance"]["options"]["align"] == "2.0,1.0,1.5707963267948966"
    before, after = read_tum(tmp_path / "plain" / "trajectory.tum"), read_tum(tmp_path / "placed" / "trajectory.tum")
    there = np.column_stack((2.0 - before.xyyaw[:, 1], 1.0 + before.xyyaw[:, 0]))
    assert np.allclose(after.xyyaw[:, :2], there, atol=1e-3)
    for name in ("rmse_m", "unaligned_rmse_m"):
        assert placed["reference"]["ate"][name] == pytest.approx(plain["reference"]["ate"][name], abs=1e-3)
    distance = placed["reference"]["map_distance"]
    assert distance["mean_mm"] == pytest.approx(plain["reference"]["map_distance"]["mean_mm"], abs=1.0)
    (found,) = measured(mavnav, tmp_path / "placed", "--truth-map", "corridor")
    assert same(found["reference"]["map_distance"], distance)
    assert mavnav("replay", "--again", tmp_path / "placed", "-o", tmp_path / "again", "-q")[0] == 0
    again = json.loads((tmp_path / "again" / "run.json").read_text())
    assert again["outputs"] == placed["outputs"]


def test_the_walls_of_a_scenario_need_the_first_scan_of_the_mission(mavnav, sample, tmp_path) -> None:
    """With --start 2 the map was compared with walls in the wrong place: 0.6 m off instead of 0.02 m."""
    late = ("replay", sample, "-o", tmp_path / "r", "--start", 1, "--end", 3, "-q")
    code, out, err = mavnav(*late, "--truth-map", "corridor")
    assert (code, out) == (2, "")
    assert "leave out --start" in err
    assert not (tmp_path / "r").exists()
    assert mavnav(*late)[0] == 0
    code, _, err = mavnav("metrics", tmp_path / "r", "--truth-map", "corridor", "-q")
    assert code == 2
    assert "its map begins after the first scan" in err


@pytest.mark.slow
def test_a_map_that_begins_late_is_not_compared_with_a_scenario(mavnav, sample, tmp_path) -> None:
    scans, rng = list(open_log(sample, end_s=4.0).scans()), np.random.default_rng(0)
    messages = [
        laser(
            k,
            ranges=rng.uniform(0.3, 3.0, scan.spec.beams) if k < 8 else np.nan_to_num(scan.ranges_m),
            angle_min=scan.spec.angle_min_rad,
            angle_increment=scan.spec.angle_step_rad,
        )
        for k, scan in enumerate(scans)
    ]
    log = write_mcap(tmp_path / "late.mcap", messages)
    _, out, _ = mavnav("replay", log, "-o", tmp_path / "r", "-q", "--json", "--truth-map", "corridor")
    document = json.loads(out)
    assert document["scans"]["tracked"] > 20
    assert document.get("reference") is None
    assert any("it is not compared with them" in warning for warning in document["warnings"])


def test_places_seen_twice_but_never_by_neighbouring_scans_have_a_row() -> None:
    quality = {
        "ghost_walls": {"count": 0},
        "revisits": {"nn_l_mm": 12.3, "nn_s_mm": None},
        "support": {"wall_m": 3.0},
        "why": [],
    }
    assert ("revisits", "12.3 mm apart") in list(quality_rows(quality))


def test_a_comparison_stands_for_its_runs(mavnav, run, comparison, tmp_path) -> None:
    """Those that are named besides are measured once; a folder of nothing is refused as before."""
    runs = sorted(str(path.parent) for path in comparison.glob("cells/*/run.json"))
    assert sorted(each["path"] for each in measured(mavnav, run, comparison, runs[0])) == sorted([str(run), *runs])
    finished = tmp_path / "finished"
    assert mavnav("compare", *runs, "-o", finished, "-q")[0] == 0
    assert len(measured(mavnav, finished, comparison)) == len(runs)
    assert mavnav("metrics", tmp_path, "-q")[0] == 2
