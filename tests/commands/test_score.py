"""Trajectories of other programs are scored: files, topics and frames, the runs, the page, and what is refused."""

from __future__ import annotations

import json
import shlex
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavnav.cli import run
from mavnav.ground_truth.tables import read_tum
from mavnav.outputs.files.trajectory import write_poses
from mavnav.pose import Pose, Trajectory
from support.field_logs import START_S, drive_log
from support.log_files import TF, Message, write_mcap
from support.synthetic import along

PATH = along([(1.0, 0.8), (4.9, 0.8), (4.6, 2.9), (1.2, 2.6), (1.0, 0.8)], 0.02, 0.8, 1.5, START_S * 10**9)
BASE_T_LASER = Pose(0.2, -0.1, 0.4)
SHORT = ("--end", "4")


def document(directory: Path) -> dict[str, Any]:
    return dict(json.loads((directory / "run.json").read_text()))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log, whose /tf has the true base, the true laser, a run of mavnav, and its scores."""
    made = tmp_path_factory.mktemp("score")
    mounting = {"parent": "base_link", "child": "laser"} | BASE_T_LASER._asdict()
    fields = {"x": BASE_T_LASER.x_m, "y": BASE_T_LASER.y_m, "yaw": BASE_T_LASER.yaw_rad}
    messages = [Message("/tf_static", TF, START_S * 10**9, mounting | fields)]
    for k in range(len(PATH)):
        x_m, y_m, yaw_rad = PATH[k] @ BASE_T_LASER.inverse()
        base = {"parent": "map", "child": "base_link", "x": x_m, "y": y_m, "yaw": yaw_rad}
        messages.append(Message("/tf", TF, int(PATH.stamps_ns[k]), base))
    write_mcap(made / "log.mcap", [*drive_log(path=PATH, beams=180, noise_m=0.005), *messages])
    write_poses(PATH, made / "truth.tum")
    write_poses(Trajectory(PATH.stamps_ns + 200_000_000, PATH.xyyaw), made / "late.tum")
    assert run(["replay", str(made / "log.mcap"), "--online", "-q", "-o", str(made / "own")]) == 0
    return made


def score(folder: Path, *trajectories: str, out: str = "scores", more: tuple[str, ...] = ()) -> int:
    given = [word for each in trajectories for word in ("--trajectory", each)]
    return run(["score", str(folder / "log.mcap"), *given, *more, "-q", "--force", "-o", str(folder / out)])


@pytest.fixture(scope="module")
def scores(folder: Path) -> Path:
    """Return the scores of the truth, the run of mavnav, and the truth 0.2 s late, beside the truth."""
    wanted = [f"{folder}/truth.tum@first", f"own={folder}/own", f"too late={folder}/late.tum@first"]
    assert score(folder, *wanted, more=("--truth", str(folder / "truth.tum"))) == 0
    return folder / "scores"


def test_the_page_has_them_side_by_side(scores: Path) -> None:
    page = json.loads((scores / "comparison.json").read_text())
    assert [cell["trajectory"] for cell in page["cells"]] == ["truth", "own", "too late"]
    assert page["headline"].startswith("No run stands out: truth and own")
    assert "evaluations" not in page["headline"]  # nothing is searched
    text = (scores / "report.html").read_text()
    assert "too late" in text
    assert not any(word in text for word in ("relative cost", "Costs are relative", "<dt>cpu", "<dt>evaluations"))
    error_m = {cell["name"]: cell["run"]["reference"]["ate"]["rmse_m"] for cell in page["cells"]}
    assert error_m["truth"] < 0.001
    assert error_m["own"] < 0.02
    assert error_m["too late"] > 0.05


def test_the_scans_are_drawn_where_the_poses_are_and_measured_alike(folder: Path, scores: Path) -> None:
    given, drawn = read_tum(folder / "own" / "trajectory.tum"), read_tum(scores / "own" / "trajectory.tum")
    first = given[0].inverse()
    np.testing.assert_array_equal(given.stamps_ns, drawn.stamps_ns)
    np.testing.assert_allclose(drawn.xyyaw, given.seen_from(first).xyyaw, atol=2e-9)
    own, scored = document(folder / "own"), document(scores / "own")
    assert (scored["method"], scored["external"]["poses"]) == ("external", len(given))
    values = [each["map_quality"]["revisits"]["nn_s_mm"] for each in (own, scored)]
    assert values[1] == pytest.approx(values[0], rel=0.02)
    thick = [each["wall_thickness"]["spread"]["p95_mm"] for each in (own, scored)]
    assert thick[1] == pytest.approx(thick[0], rel=0.02)


def test_a_scored_run_is_measured_as_any_other(scores: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run(["metrics", str(scores / "truth"), "--json"]) == 0
    (again,) = json.loads(capsys.readouterr().out)["maps"]
    assert again["map_quality"]["revisits"] == pytest.approx(document(scores / "truth")["map_quality"]["revisits"])
    assert run(["check", str(scores / "truth"), "--gate", "map.accepted_share>=0.95"]) == 0


@pytest.mark.slow
def test_a_scored_run_is_repeated_by_its_own_command(scores: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run(["replay", "--again", str(scores / "own")]) == 2
    assert "write mavnav score" in capsys.readouterr().err
    again = shlex.split(document(scores / "own")["provenance"]["again"])
    repeated = scores.parent / "repeated"
    assert run([*again[1:], "-q", "-o", str(repeated)]) == 0
    assert document(repeated / "own")["outputs"] == document(scores / "own")["outputs"]


def test_bases_and_frames_are_brought_to_the_laser(folder: Path, scores: Path) -> None:
    base = PATH.compose(BASE_T_LASER.inverse())
    write_poses(base, folder / "base.tum")
    assert (
        score(folder, f"file={folder}/base.tum,base@first", "tf=tf:map,base_link@first", out="bodies", more=SHORT) == 0
    )
    true = read_tum(scores / "truth" / "trajectory.tum")
    for name in ("file", "tf"):
        poses = read_tum(folder / "bodies" / name / "trajectory.tum")
        assert len(poses) > 30
        np.testing.assert_allclose(poses.xyyaw, true.xyyaw[: len(poses)], atol=1e-6)
    assert document(folder / "bodies" / "tf")["external"]["frame"] == "base_link"


def test_what_has_no_pose_is_counted(folder: Path) -> None:
    keep = np.ones(len(PATH), bool)
    keep[200:400] = False  # 4 s
    for name, rows in (("gap", keep), ("short", np.arange(len(PATH)) < 300)):
        write_poses(Trajectory(PATH.stamps_ns[rows], PATH.xyyaw[rows]), folder / f"{name}.tum")
    assert score(folder, f"{folder}/gap.tum@first", f"{folder}/short.tum@first", out="covered") == 5
    gap, short = (document(folder / "covered" / name) for name in ("gap", "short"))
    scans = gap["scans"]["processed"]
    assert gap["map"]["accepted_share"] == pytest.approx(1.0 - 40 / scans, abs=2 / scans)
    (interval,) = gap["tracking"]["intervals"]
    assert (interval["start_s"], interval["end_s"]) == pytest.approx((4.0, 7.9), abs=0.11)
    assert short["verdict"]["word"] == "lost"
    assert "of the scans have a pose" in short["verdict"]["reason"]


def test_several_poses_of_a_stamp_are_counted_and_the_last_is_used(
    folder: Path, scores: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = (folder / "truth.tum").read_text().splitlines(keepends=True)
    others = [f"{row.split()[0]} 9 9 0 0 0 0 1\n" for row in rows[10:13]]
    for name, first in (("twice", others), ("same", rows[10:13])):
        (folder / f"{name}.tum").write_text("".join([*first, *rows]))
    assert score(folder, f"{folder}/twice.tum@first", f"{folder}/same.tum@first", out="repeated", more=SHORT) == 0
    said = f"{folder}/twice.tum: 3 of {len(PATH)} stamps have poses that differ; the last of each is used"
    err = capsys.readouterr().err
    assert f"warning: {said}" in err
    assert "same.tum" not in err
    for name in ("twice", "same"):
        poses, true = (read_tum(path / "trajectory.tum") for path in (folder / "repeated" / name, scores / "truth"))
        np.testing.assert_array_equal(poses.xyyaw, true.xyyaw[: len(poses)])
    assert [said in text for text in document(folder / "repeated" / "twice")["warnings"]] == [True]


WRITER = """
import sys, time, subprocess
log, poses, out, how = sys.argv[1:]
print("reads", log, flush=True)
if how == "fails":
    sys.exit(3)
if how == "hangs":
    subprocess.run([sys.executable, "-c", "import time; time.sleep(60)"])
numbers = [k * k for k in range(2_000_000)]
if how == "writes":
    open(out, "w").write(open(poses).read())
if how == "nonsense":
    open(out, "w").write("no poses")
"""


@pytest.mark.slow
def test_programs_are_run_and_measured_and_those_that_fail_are_rows(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "writer.py").write_text(WRITER)
    run_it = f"{sys.executable} {folder}/writer.py {{log}} {folder}/own/trajectory.tum {{out}}"
    words = [f"--external={how}={run_it} {how}" for how in ("writes", "fails", "hangs", "nothing", "nonsense")]
    words += ["--external", "absent=no-such-program {out}", "--time-limit", "3"]
    started_s = time.monotonic()
    assert score(folder, f"own={folder}/own/trajectory.tum", out="programs", more=tuple(words)) == 1
    assert time.monotonic() - started_s < 55.0
    printed, page = capsys.readouterr().err, json.loads((folder / "programs" / "comparison.json").read_text())
    errors = {cell["name"]: cell["error"] for cell in page["cells"]}
    assert errors["own"] is errors["writes"] is None
    for name, why in {
        "fails": "it ended with code 3",
        "hangs": "it took over 3 s",
        "nothing": "it wrote no trajectory",
        "nonsense": "2 columns in place of 8",
        "absent": "no-such-program cannot be started",
    }.items():
        assert why in errors[name]
        assert f"error: {name}: " in printed
    own, written = (document(folder / "programs" / name) for name in ("own", "writes"))
    assert written["map_quality"] == own["map_quality"]
    assert "wall_s" not in own["external"]
    assert 0.02 < written["external"]["cpu_s"] < 30.0
    assert 50.0 < written["external"]["peak_memory_mb"] < 1000.0  # of a list of two million numbers
    assert "reads" in (folder / "programs" / "programs" / "fails.txt").read_text()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--external", "a=program {log}"], "has no {out}"),
        (["--external", "a/b=program {out}"], "names no directory"),
        (["--external", "a='program {out}"], "cannot be split"),
        ([], "no trajectory; name one"),
    ],
)
def test_programs_are_checked_before_the_work(
    folder: Path, words: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert score(folder, out="none", more=tuple(words)) == 2
    assert why in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["a={folder}/truth.tum", "a={folder}/own"], "two trajectories are named a"),
        (["a={folder}/early.tum"], "share no time"),
        (["a={folder}/truth.tum,wheel"], "known are laser, base, laser, base_link"),
        (["../a={folder}/truth.tum"], "names no directory"),
        (["a={folder}/merge"], "merge/session_a.tum or {folder}/merge/session_b.tum"),
        (["a=tf:map,wheel"], "no transforms lead from 'map' to 'wheel'"),
        (
            ["a=topic:/nothing"],
            "no poses on topic '/nothing'; topics with poses: none; give topic:NAME of one with poses, or a file",
        ),
    ],
)
def test_mistakes_are_found_before_the_work(
    folder: Path, words: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_poses(Trajectory(PATH.stamps_ns - 10**12, PATH.xyyaw), folder / "early.tum")
    (folder / "merge").mkdir(exist_ok=True)
    for name in "ab":
        write_poses(PATH, folder / "merge" / f"session_{name}.tum")
    assert score(folder, *(word.format(folder=folder) for word in words), out="none") == 2
    assert why.format(folder=folder) in capsys.readouterr().err
    assert not (folder / "none").exists()


def test_an_instant_holds_for_a_sweep_that_the_scans_show_and_the_log_lacks(tmp_path: Path) -> None:
    turning = along([(3.4, 0.8), (4.9, 0.8), (4.6, 2.9), (4.6, 1.2)], 0.02, 0.6, 2.0, START_S * 10**9)
    write_mcap(tmp_path / "log.mcap", drive_log(path=turning, beams=120, time_increment_s=0.0))
    write_poses(turning, tmp_path / "t.tum")
    given = (f"{tmp_path}/t.tum@first", f"late={tmp_path}/t.tum@last")
    score(tmp_path, *given, more=("--truth", str(tmp_path / "t.tum")))
    first, last = (document(tmp_path / "scores" / name)["external"] for name in ("t", "late"))
    assert first["misfit_mm"] < 5 < last["misfit_mm"]


def compare(folder: Path, *words: str, out: str) -> int:
    fixed = ("--end", "1", "--online", "-q", "-o", str(folder / out))
    return run(["compare", str(folder / "log.mcap"), *words, *fixed])


@pytest.mark.slow
def test_given_poses_stand_beside_the_run_and_its_own_poses(folder: Path) -> None:
    words = ("--trajectory", f"true={folder}/truth.tum@first", "--external", "fails=false {out}")
    assert compare(folder, *words, out="beside") == 1
    page = json.loads((folder / "beside" / "comparison.json").read_text())
    assert [cell.get("trajectory") for cell in page["cells"]] == [None, "mavnav", "true", "fails"]
    assert [cell["status"] for cell in page["cells"]] == ["done"] * 3 + ["failed"]
    assert page["cells"][0]["method"] == "robust"
    assert [cost is None for cost in page["price"]["cpu"]] == [False, True, True, True]
    own_m, posed_m = (page["cells"][k]["run"]["tracking"]["path_length_m"] for k in (0, 1))
    assert posed_m == pytest.approx(own_m, rel=1e-3)
    assert "fails" in (folder / "beside" / "report.html").read_text()
    folders = [str(folder / "beside" / cell["directory"]) for cell in page["cells"][:2]]
    assert run(["compare", *folders, "-q", "-o", str(folder / "finished")]) == 0
    finished = json.loads((folder / "finished" / "comparison.json").read_text())
    assert [cell.get("trajectory") for cell in finished["cells"]] == [None, "mavnav"]
    for one, other in zip(page["cells"], finished["cells"], strict=False):
        assert one["run"] == other["run"]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--trajectory", "mavnav={folder}/truth.tum"], "mavnav names the poses of mavnav's own run"),
        (["--trajectory", "a={folder}/truth.tum", "{folder}/other.mcap"], "are about one log"),
        (["--external", "a=program {{log}}"], "has no {out}"),
        (["--trajectory", "a={folder}/missing.tum"], "missing.tum cannot be read"),
    ],
)
def test_what_cannot_stand_beside_a_run_is_refused(
    folder: Path, words: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_mcap(folder / "other.mcap", drive_log(path=Trajectory(PATH.stamps_ns[:40], PATH.xyyaw[:40]), beams=90))
    assert compare(folder, *(word.format(folder=folder) for word in words), out="refused") == 2
    assert why in capsys.readouterr().err
    assert not (folder / "refused" / "cells").exists()


def test_a_directory_of_something_else_is_kept(
    folder: Path, scores: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def scored(directory: Path, *words: str) -> tuple[int, str]:
        wanted = ["--trajectory", f"short={folder}/truth.tum@first", "--end", "1", "-q", "-o", str(directory)]
        return run(["score", str(folder / "log.mcap"), *wanted, *words]), capsys.readouterr().err

    other, page = tmp_path / "other", tmp_path / "foreign" / "report.html"
    page.parent.mkdir()
    page.write_text("of somebody else")
    other.mkdir()
    kept = (scores / "comparison.json").read_text().replace("log.mcap", "another.mcap")
    (other / "comparison.json").write_text(kept)
    for words in ((), ("--force",)):
        for directory in (page.parent, folder / "own"):
            code, err = scored(directory, *words)
            assert (code, "holds other files" in err) == (6, True)
    code, err = scored(other)
    assert (code, "of other runs; choose another directory with -o, or --force" in err) == (6, True)
    assert ((other / "comparison.json").read_text(), page.read_text()) == (kept, "of somebody else")
    assert scored(other, "--force")[0] == scored(tmp_path / "new")[0] == 0
    assert scored(tmp_path / "new", "--trajectory", f"late={folder}/late.tum@first")[0] == 6  # the run is there
