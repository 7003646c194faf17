"""``mavnav merge``: logs and runs to one map, what did not join, and what cannot be merged."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msgspec import convert
from msgspec.structs import fields, replace

import mavnav as api
from mavnav.ground_truth.tables import read_tum
from mavnav.metrics.journey import one_after_another
from mavnav.outputs.documents.run_json import RunDocument
from mavnav.pipelines.merge import merge_verdict, session_names
from mavnav.pose import Pose, Trajectory
from mavnav.scan import LaserSpec, Scan
from support.log_files import drive, laser, write_mcap
from support.sessions import CELLAR, errors_m, tour, written


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> dict[str, Path]:
    """Write two logs of one building, a longer one of another, and one without a usable scan."""
    folder = tmp_path_factory.mktemp("logs")
    tours = {"hall": tour("hall"), "back": tour("back", 1), "cellar": tour("hall", 2, CELLAR)}
    found = {name: written(recording, folder / f"{name}.mcap") for name, recording in tours.items()}
    return found | {"blind": write_mcap(folder / "blind.mcap", drive(0))}


@pytest.fixture(scope="module")
def replayed(logs, tmp_path_factory) -> Path:
    """Return the run of the way back; for reading."""
    run = tmp_path_factory.mktemp("runs") / "back"
    api.replay(logs["back"], directory=run)
    return run


@pytest.fixture
def back(replayed, tmp_path) -> Path:
    """Return a copy of the run of the way back."""
    return Path(shutil.copytree(replayed, tmp_path / "back"))


def test_logs_and_runs_are_joined(mavnav, logs, back, tmp_path) -> None:
    code, out, err = mavnav("merge", logs["hall"], back, "-o", tmp_path / "m", "-q", "--json", "--report")
    assert "2 of 2 sessions" in (tmp_path / "m" / "report.html").read_text()
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert document == json.loads((tmp_path / "m" / "merge.json").read_text())
    assert (document["joined"], document["refused"], document["exit_code"]) == (2, 0, 0)
    files = {"map.pgm", "map.yaml", "map.png", "hits.npz", "walls.csv", "report.html"}
    files |= {f"session_{name}.{kind}" for name in ("hall", "back") for kind in ("tum", "mcap")}
    assert {file.name for file in (tmp_path / "m").iterdir()} == {*files, "merge.json", "run.json"}
    assert set(document["outputs"]) == files
    hall = tour("hall")
    for name, recording in (("hall", hall), ("back", tour("back", 1))):
        poses = read_tum(tmp_path / "m" / f"session_{name}.tum")
        assert len(poses) == len(recording.scans)
        assert errors_m(poses, recording, hall.world_T_laser[0]) < 0.05
    first, second = document["sessions"]
    reasons = [each["verdict"]["reason"].removeprefix("no sign of an error in ") for each in (first, second)]
    assert reasons == ["the path", "path or map"]  # of a log and of a run: logs are measured together
    assert "-0.0" not in map(str, [*first["map_T_session"].values(), *second["map_T_session"].values()])
    assert [first["map_T_session"][key] for key in ("x_m", "yaw_deg")] == pytest.approx([0, 0], abs=0.05)
    assert {row["name"]: row["closures"] for row in [*first["joined_to"], *second["joined_to"]]}
    diff = api.diff(tmp_path / "m", back)
    assert (diff["changed_m2"], diff["changes"]) == (0, [])
    check_that_commands_take_a_merge(mavnav, tmp_path / "m", back)


def check_that_commands_take_a_merge(mavnav, merge: Path, run: Path) -> None:
    """Assert that run.json of a merge has keys and types of that of a run, is measured alike, and serves commands."""
    document = json.loads((merge / "run.json").read_text())
    assert list(document) == [key for key in json.loads((run / "run.json").read_text()) if key in document]
    types = {field.name: field.type for field in fields(RunDocument)}
    assert all(convert(value, types[key]) is not None for key, value in document.items() if key != "config")
    assert document["wall_thickness"]["spread"]["length_m"] > 10

    code, out, _ = mavnav("metrics", merge, "--json", "-q")
    (entry,) = json.loads(out)["maps"]
    assert (code, entry["kind"], entry["verdict"]) == (0, "merge", document["verdict"])
    measured, stored = (each["wall_thickness"]["spread"] for each in (entry, document))
    assert measured["median_mm"] == pytest.approx(stored["median_mm"], rel=0.01)
    assert measured["length_m"] == pytest.approx(stored["length_m"], rel=0.01)
    assert mavnav("metrics", merge, "--truth-map", "corner", "-q")[0] == 2
    assert mavnav("check", merge, "--gate", "wall_thickness.p95_mm<=150")[0] == 0
    assert mavnav("check", merge, "--gate", "wall_thickness.p95_mm<=1")[0] == 1
    assert mavnav("view", merge, "--no-browser", "-q")[0] == 0
    assert mavnav("compare", merge, run, "-q", "-o", merge.parent / "c")[0] == 2


def test_sessions_follow_one_another_for_the_metrics() -> None:
    spec = LaserSpec(beams=1, angle_min_rad=0.0, angle_step_rad=0.1, range_min_m=0.0, range_max_m=9.0)

    def track(*times_s: int) -> tuple[Trajectory, Callable[[], list[Scan]]]:
        stamps_ns = [t * 10**9 for t in times_s]
        poses = Trajectory.of(stamps_ns, [Pose(float(t)) for t in times_s])
        return poses, lambda: [Scan(stamp_ns, np.ones(1), spec) for stamp_ns in stamps_ns]

    journey = one_after_another([track(5, 7), track(5, 6, 9)], 0.5)
    assert journey.map_T_laser.stamps_ns.tolist() == [0, 2 * 10**9, 1002 * 10**9, 1003 * 10**9, 1006 * 10**9]
    assert journey.map_T_laser.xyyaw[:, 0].tolist() == [5, 7, 5, 6, 9]
    for _ in range(2):
        assert [scan.stamp_ns for scan in journey.scans()] == journey.map_T_laser.stamps_ns.tolist()


@pytest.mark.slow
def test_the_map_of_all_is_judged_besides_the_paths() -> None:
    """Parts of a log may be too short to measure walls on, and their map is not."""
    good = {"word": "good", "reason": "no sign of an error in the path", "advice": ""}
    rows = [{"name": name, "joined": True, "verdict": good} for name in ("a", "b")]
    assert merge_verdict(rows, {"map_quality": {"meaningful": True, "why": []}}).word == "good"
    empty = merge_verdict(rows, {"map_quality": {"meaningful": False, "why": ["0.4 m of walls"]}})
    assert (empty.word, empty.reason) == ("suspect", "the map cannot be measured: 0.4 m of walls")


def test_what_does_not_join_is_said(mavnav, logs, tmp_path) -> None:
    names = ("cellar", "hall", "blind", "empty")
    (tmp_path / "empty.mcap").touch()
    code, out, err = mavnav(
        "merge", *(logs[name] for name in names[:3]), tmp_path / "empty.mcap", "-o", tmp_path / "m", "-q"
    )
    assert code == 1
    assert "empty.mcap: no usable scans; the file is empty" in err
    assert f"hall ({logs['hall']}) did not join: too few of its scans fit" in err
    assert "error: cellar" not in err
    assert f"blind ({logs['blind']}) did not join" in err
    assert [line.split()[0] for line in out.splitlines()] == ["?", "try", "result", *names, "walls", "written"]
    assert not (tmp_path / "m" / "session_hall.tum").exists()
    code, out, err = mavnav("merge", logs["hall"], logs["back"], "-o", tmp_path / "m", "-q")
    assert (code, out) == (6, "")
    assert "--force" in err


@pytest.mark.slow
def test_a_log_without_any_pose_does_not_join(mavnav, logs, tmp_path) -> None:
    log = write_mcap(tmp_path / "few.mcap", [laser(k, beams=8) for k in range(20)])
    code, _, err = mavnav("merge", log, logs["hall"], "-o", tmp_path / "m", "-q")
    assert code == 5
    assert f"few ({log}) did not join: no scan was tracked" in err
    assert f"few ({log}): tracking was lost for good, 0 % of the scans have a pose" in err
    api.replay(log, directory=tmp_path / "few")
    code, _, err = mavnav("replay", "--continue", tmp_path / "few", logs["hall"], "-o", tmp_path / "c", "-q")
    assert (code, err.count("\n")) == (2, 1)
    assert "cannot be continued: no scan was tracked" in err


@pytest.mark.slow
def test_what_became_of_each_log_is_stated(mavnav, logs, back, tmp_path) -> None:
    """A run that was lost for good outweighs a damaged log, and a log that is named twice counts once."""
    data = logs["back"].read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(0.8 * len(data))])
    code, out, err = mavnav("merge", logs["hall"], tmp_path / "cut.mcap", "-o", tmp_path / "m", "-q", "--json")
    hall, cut = json.loads(out)["sessions"]
    assert code == 3
    assert (hall["damage"], hall["tracking"]["lost"], hall["tracking"]["tracked_share"]) == ([], False, 1.0)
    assert cut["joined"]
    assert cut["damage"][0]["what"] in err
    document = json.loads((back / "run.json").read_text())
    document["tracking"]["lost"], document["exit_code"] = True, 5
    (back / "run.json").write_text(json.dumps(document))
    copy = Path(shutil.copy(logs["hall"], tmp_path))
    code, out, err = mavnav("merge", logs["hall"], copy, back, "-o", tmp_path / "n", "-q")
    assert code == 5
    assert f"hall-2 ({copy}) did not join: it has the scans of hall-1" in err
    assert [line.split()[:2] for line in out.splitlines()[3:5]] == [
        ["hall-1", f"{logs['hall']},"],
        ["hall-2", f"{copy},"],
    ]
    assert f"back ({back}): tracking was lost for good" in err
    sessions = json.loads((tmp_path / "n" / "merge.json").read_text())["sessions"]
    assert [session["joined"] for session in sessions] == [True, False, True]


def test_what_cannot_be_merged(mavnav, logs, tmp_path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}")
    merged = tmp_path / "merged"
    merged.mkdir()
    rows = [{"name": name, "joined": True, "tracking": {"lost": False}} for name in ("a", "b")]
    (merged / "merge.json").write_text(
        json.dumps({"sessions": rows, "outputs": {}, "config": {}, "mavnav_version": "0.2.0"})
    )
    two = write_mcap(
        tmp_path / "two.mcap", [*drive(2), *(replace(m, topic="/rear") for m in drive(2) if m.topic == "/scan")]
    )
    for args, word in (
        ([two, logs["hall"]], f"; write mavnav replay {two} --topic NAME, and merge that run"),
        ([logs["hall"]], "nothing to merge"),
        ([logs["hall"], tmp_path / "gone.bag"], "no such file"),
        ([tmp_path / "run", logs["hall"]], "is no whole run"),
        ([merged, logs["hall"]], "has several sessions; add others to it with mavnav replay --continue"),
        ([logs["hall"], logs["back"], "--set", "method=paper"], "use the robust method"),
    ):
        code, out, err = mavnav("merge", *args, "-o", tmp_path / "m", "-q")
        assert (code, out, err.count("\n")) == (2, "", 1), args
        assert word in err, args


def test_a_run_that_was_altered_is_not_merged(mavnav, logs, back, tmp_path) -> None:
    with (back / "trajectory.tum").open("a") as file:
        file.write("# mine\n")
    code, out, err = mavnav("merge", back, logs["hall"], "-o", tmp_path / "m", "-q")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "back is no whole run: trajectory.tum has been altered since it was written" in err


@pytest.mark.parametrize(
    ("inputs", "names"),
    [
        (("a", "b"), ["a", "b"]),
        (("x/a", "y/a.mcap", "b"), ["a-1", "a-2", "b"]),
        (("x/a", "y/a", "a-1"), ["a-2", "a-3", "a-1"]),
        (("x/a-2", "x/a", "y/a-2", "y/a"), ["a-2-1", "a-1", "a-2-2", "a-3"]),
        (("a-1-1", "x/a", "x/a-1", "y/a", "y/a-1"), ["a-1-1", "a-2", "a-1-2", "a-3", "a-1-3"]),
    ],
)
def test_names_of_sessions_are_distinct(inputs: tuple[str, ...], names: list[str]) -> None:
    assert session_names(tuple(map(Path, inputs))) == names
