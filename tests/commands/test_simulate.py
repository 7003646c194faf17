"""mavnav simulate: what it leaves and prints, its exit codes, and one line for whatever is wrong with a scenario."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mavnav.config.loading import scenarios
from mavnav.errors import ExitCode
from mavnav.metrics.reference import absolute_error
from support.error_lines import expect_error

PICTURES = ("map.png", "true_map.png", "wall_thickness.png")

FEW = ("--outputs", "trajectory", "--online")

GOOD = """\
walls:
  - polyline: {closed: true, points_m: [[0, 0], [3, 0], [3, 2], [0, 2]]}
  - box: {center_m: [1.5, 1.7], size_m: [0.4, 0.4]}
start: {x_m: 0.6, y_m: 0.8}
goal_m: [2.3, 0.8]
max_steps: 60
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(GOOD)
    return path


@pytest.fixture(scope="module")
def corner(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """Fly the corner by name from an empty folder, in a process of its own."""
    folder = tmp_path_factory.mktemp("empty")
    command = ["simulate", "corner.yaml", "-o", "out", "--record", "corner.mcap", "--animate", "corner.gif", "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "mavnav", *command], cwd=folder, capture_output=True, text=True, check=False, timeout=120
    )
    return folder, done


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the pictures out of runs in this process: they take two seconds each."""
    from mavnav.outputs.writers import WRITERS

    for name in PICTURES:
        monkeypatch.delitem(WRITERS, name)


def table(path: Path) -> np.ndarray:
    return np.loadtxt(path, ndmin=2)


# ---- what it leaves --------------------------------------------------------------------------------------------------


def test_leaves_what_it_promises(corner: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    folder, done = corner
    assert done.returncode == 0, done.stderr
    promised = {"trajectory.tum", "trajectory_base.tum", "trajectory.csv", "map.pgm", "map.yaml", "hits.npz", "map.png"}
    promised |= {
        "walls.csv",
        "wall_thickness.png",
        "result.mcap",
        "foxglove_layout.json",
        "metrics.json",
        "truth.tum",
        "true_map.png",
        "true_walls.json",
    }
    left = {path.name for path in (folder / "out").iterdir()}
    assert left == promised | {"report.html", "run.json"}
    assert set(json.loads(done.stdout)["outputs"]) == promised
    assert {path.name for path in folder.iterdir()} == {"out", "corner.mcap", "corner.gif"}
    assert (folder / "corner.gif").read_bytes()[:4] == b"GIF8"
    for name in ("map.png", "true_map.png"):
        assert (folder / "out" / name).read_bytes()[1:4] == b"PNG"


def test_json_is_run_json_and_nothing_else(corner: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    folder, done = corner
    document = json.loads(done.stdout)
    assert document == json.loads((folder / "out" / "run.json").read_text())
    assert document["exit_code"] == 0
    assert document["input"]["format"] == "scenario"
    mission, truth = document["mission"], document["truth"]
    assert (mission["reached"], mission["reason"]) == (True, "goal")
    assert mission["steps"] == document["scans"]["processed"] == len(table(folder / "out" / "truth.tum"))
    assert 4.0 < mission["path_length_m"] < 7.0
    assert mission["min_clearance_m"] > 0.15
    assert mission["goal_distance_m"] < 0.5
    assert truth["ate_poses"] == document["scans"]["tracked"]
    assert 0.0 < truth["ate_rmse_m"] <= truth["ate_max_m"] < 0.06
    assert 0.0 < truth["final_aligned_error_m"] < 0.06
    assert truth["final_error_m"] < 0.4
    assert truth["wall_distance_error_share"] < 0.03


def test_the_truth_file_is_the_errors_source(corner: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    folder, done = corner
    estimate, truth = table(folder / "out" / "trajectory.tum"), table(folder / "out" / "truth.tum")
    rows = np.searchsorted(truth[:, 0], estimate[:, 0])
    apart = np.hypot(*(estimate[:, 1:3] - truth[rows, 1:3]).T)
    assert np.sqrt((apart**2).mean()) == pytest.approx(json.loads(done.stdout)["truth"]["unaligned_rmse_m"], abs=1e-5)


def test_the_document_s_scenario_flies_the_same_mission(
    corner: tuple[Path, subprocess.CompletedProcess[str]], mavnav: Callable, tmp_path: Path
) -> None:
    """JSON is YAML: what run.json keeps is a scenario file; equal bytes come of it."""
    document = json.loads(corner[1].stdout)
    (tmp_path / "again.yaml").write_text(json.dumps(document["scenario"]))
    code, out, _ = mavnav("simulate", tmp_path / "again.yaml", "-o", tmp_path / "out", "-q", "--json")
    again = json.loads(out)
    assert code == 0
    assert again["outputs"].items() == {k: v for k, v in document["outputs"].items() if k not in PICTURES}.items()
    assert again["mission"] == document["mission"]


@pytest.mark.slow
def test_again_repeats_a_mission_without_its_file(mavnav: Callable, scenario: Path, tmp_path: Path) -> None:
    words = ("--seed", 3, "--set", "vehicle.noise_yaw_deg=2", "--grid", "6x6", "-q")
    assert mavnav("simulate", scenario, *words, "-o", tmp_path / "first")[0] == 0
    scenario.unlink()
    code, _, err = mavnav("simulate", "--again", tmp_path / "first", "-o", tmp_path / "second", "-q")
    assert code == 0
    assert f"files are the same as {tmp_path / 'first' / 'run.json'} lists" in err
    first, second = (json.loads((tmp_path / name / "run.json").read_text()) for name in ("first", "second"))
    assert {name for name in first if first[name] != second[name]} <= {"timing", "provenance"}
    assert shlex.split(first["provenance"]["again"]) == ["mavnav", "simulate", "--again", str(tmp_path / "first")]
    assert "--again takes --seed from the run" in mavnav("simulate", "--again", tmp_path / "first", "--seed", 4)[2]
    assert "write mavnav simulate --again" in mavnav("replay", "--again", tmp_path / "first")[2]


@pytest.mark.slow
def test_recordings_replay_to_the_same_map(
    corner: tuple[Path, subprocess.CompletedProcess[str]], mavnav: Callable, tmp_path: Path
) -> None:
    folder, done = corner
    code, out, _ = mavnav("replay", folder / "corner.mcap", "-o", tmp_path / "replayed", "-q", "--json")
    flown, replayed = json.loads(done.stdout), json.loads(out)
    assert code == 0
    assert replayed["scans"]["processed"] == flown["scans"]["processed"]
    then, now = table(folder / "out" / "trajectory.tum"), table(tmp_path / "replayed" / "trajectory.tum")
    np.testing.assert_allclose(now[:, 0], then[:, 0], rtol=0, atol=1e-6)
    assert absolute_error(now[:, 1:3], then[:, 1:3]).rmse_m < 0.01
    for hits in ("1", "2"):
        a, b = (document["wall_thickness"][hits]["p95_mm"] for document in (flown, replayed))
        assert b == pytest.approx(a, abs=flown["map"]["cell_mm"])


@pytest.mark.slow
def test_a_recorded_truth_measures_as_the_truth_file(
    corner: tuple[Path, subprocess.CompletedProcess[str]], mavnav: Callable, tmp_path: Path
) -> None:
    folder, _ = corner
    given = {"auto": "auto", "named": "topic:/ground_truth", "file": folder / "out" / "truth.tum"}
    found = {}
    for name, truth in given.items():
        words = ("replay", folder / "corner.mcap", "--truth", truth, "-o", tmp_path / name, "-q", "--json", *FEW)
        code, out, err = mavnav(*words)
        assert (code, err) == (0, "")
        found[name] = json.loads(out)
    numbers = {name: run["reference"] for name, run in found.items()}
    assert numbers["auto"] == numbers["named"]
    for part in ("ate", "rpe"):
        of_file = {key: value for key, value in numbers["file"][part].items() if key != "alignment"}
        assert {key: numbers["auto"][part][key] for key in of_file} == pytest.approx(of_file, rel=1e-5)
    assert found["auto"]["input"]["truth"] == {"topic": "/ground_truth", "body_frame": None}
    assert "truth" not in found["file"]["input"]


@pytest.mark.parametrize("name", ["short.bag", "short_ros2"])
def test_every_format_replays_to_the_same_path(mavnav: Callable, scenario: Path, tmp_path: Path, name: str) -> None:
    paths = []
    for log in (tmp_path / name, tmp_path / "short.mcap"):
        flown, replayed = tmp_path / f"{log.name} flown", tmp_path / f"{log.name} replayed"
        code, out, err = mavnav("simulate", scenario, "-o", flown, "--record", log, "-q", "--json", *FEW[:2])
        assert code == 0, err
        code, replay, _ = mavnav("replay", log, "-o", replayed, "-q", "--json", *FEW)
        assert code == 0
        assert json.loads(replay)["scans"]["total"] == json.loads(out)["mission"]["steps"]
        paths.append((replayed / "trajectory_base.tum").read_bytes())
    assert paths[0] == paths[1]
    then, now = (table(folder / "trajectory_base.tum") for folder in (flown, replayed))
    assert absolute_error(now[:, 1:3], then[:, 1:3]).rmse_m < 0.01


# ---- how it ends -----------------------------------------------------------------------------------------------------


@pytest.fixture
def map_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write an empty map.png at once."""
    from mavnav.outputs.writers import WRITERS

    monkeypatch.setitem(WRITERS, "map.png", lambda run, path: path.touch())


@pytest.mark.usefixtures("map_picture")
def test_a_failed_mission_is_written_and_told(mavnav: Callable, scenario: Path, tmp_path: Path) -> None:
    code, out, err = mavnav("simulate", scenario, "-o", tmp_path / "r", "-q", "--set", "max_steps=3")
    assert code == ExitCode.GATE_FAILED
    assert "step limit" in out
    assert err == f"mavnav: error: the mission failed: step limit; look at {tmp_path / 'r' / 'map.png'}\n"
    document = json.loads((tmp_path / "r" / "run.json").read_text())
    assert (document["exit_code"], document["mission"]["reached"]) == (1, False)
    assert document["mission"]["steps"] == 4


@pytest.mark.usefixtures("map_picture")
def test_a_failed_mission_without_pictures_names_none(mavnav: Callable, scenario: Path, tmp_path: Path) -> None:
    line = ("simulate", scenario, "-o", tmp_path / "r", "-q", "--set", "max_steps=3")
    code, _, err = mavnav(*line, "--outputs", "trajectory")
    assert code == ExitCode.GATE_FAILED
    assert err.endswith("step limit; look at map.png of a run with --outputs pictures\n")
    mavnav(*line, "--outputs", "pictures", "--force")
    assert (tmp_path / "r" / "map.png").is_file()


@pytest.mark.slow
def test_a_mission_without_a_wall_at_flight_height(mavnav: Callable, tmp_path: Path) -> None:
    """Walls end 5 mm below the slice, and begin 5 mm above it: the tilted laser sees them."""
    outline = "points_m: [[0, 0], [4, 0], [4, 2], [0, 2]], closed: true"
    path = tmp_path / "slit.yaml"
    path.write_text(
        f"walls:\n  - polyline: {{{outline}, height_m: [0, 1.07]}}\n  - polyline: {{{outline}, height_m: [1.13, 2]}}\n"
        "start: {x_m: 0.7, y_m: 1}\ngoal_m: [3.3, 1]\nflight: {height_m: 1.1, slice_mm: 50}\nseed: 1\n"
    )
    log, run = tmp_path / "slit.mcap", tmp_path / "r"
    code, out, _ = mavnav("simulate", path, "-o", run, "-q", "--record", log, "--outputs", "trajectory")
    assert code == ExitCode.DONE
    assert "no wall at flight height" in out
    document = json.loads((run / "run.json").read_text())
    assert document["mission"]["min_clearance_m"] is None
    assert document["truth"]["true_wall_distance_m"] is None
    code, out, _ = mavnav("replay", log, "--truth-map", path, "-o", run, "-q", "--force", "--outputs", "trajectory")
    assert code == ExitCode.DONE
    assert "no wall at flight height, start pose" in out


def test_a_lost_mission_is_told(mavnav: Callable, tmp_path: Path) -> None:
    narrow = ["--set", "laser.field_of_view_deg=20", "--set", "recovery.fly_on_steps=0"]
    code, out, err = mavnav("simulate", "corner", "-o", tmp_path / "r", "-q", *narrow, "--json")
    assert code == json.loads(out)["exit_code"] == ExitCode.TRACKING_LOST
    assert json.loads(out)["mission"]["reason"] == "tracking lost"
    assert "the mission failed: tracking lost" in err


def test_tracking_lost_on_the_way_outweighs_the_goal(
    mavnav: Callable, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mavnav.slam.result import SlamResult

    monkeypatch.setattr(SlamResult, "lost_for_good", property(lambda _: True))
    code, out, err = mavnav("simulate", scenario, "-o", tmp_path / "r", "-q")
    document = json.loads((tmp_path / "r" / "run.json").read_text())
    assert (document["mission"]["reached"], document["tracking"]["lost"]) == (True, True)
    assert code == document["exit_code"] == ExitCode.TRACKING_LOST
    assert re.search(r"^mission +goal reached, but tracking was lost for good; \d", out, re.MULTILINE)
    assert err.startswith("mavnav: error: lost: tracking was lost, 100 % of the scans have a pose; ")


def test_the_summary(mavnav: Callable, scenario: Path, tmp_path: Path) -> None:
    code, out, err = mavnav("simulate", scenario, "-o", tmp_path / "r", "-q")
    assert (code, err) == (0, "")
    for word in ("goal reached", "clearance", "ATE", "wall distance"):
        assert word in out
    taken = json.loads((tmp_path / "r" / "run.json").read_text())["mission"]["steps"]
    assert re.search(rf"^used +100 % of {taken} scans have a pose$", out, re.MULTILINE)
    assert re.search(r"^walls +median \d+ mm, p95 \d+ mm ", out, re.MULTILINE)


def test_options_reach_the_mission(
    mavnav: Callable, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--seed", 3, "--method", "paper", "--grid", "6x7", "--azimuth", 15, "--planner", "field"]
    code, out, _ = mavnav("simulate", scenario, *options, "--set", "max_steps=2", "-q", "--json")
    document = json.loads(out)
    assert code == ExitCode.GATE_FAILED
    assert (document["method"], document["grid"], document["azimuth"]) == ("paper", "6x7", 15)
    assert (document["scenario"]["seed"], document["scenario"]["planner"]["technique"]) == (3, "field")
    assert (tmp_path / "runs" / "short-paper-15-6x7" / "run.json").is_file()


def test_the_trap(mavnav: Callable, tmp_path: Path) -> None:
    code, out, err = mavnav("simulate", "u_trap", "--planner", "field", "-o", tmp_path / "r", "-q", "--json")
    assert code == ExitCode.GATE_FAILED
    assert json.loads(out)["mission"]["reason"] == "stuck"
    assert "the mission failed: stuck" in err


# ---- list and schema -------------------------------------------------------------------------------------------------


def test_list_shows_the_scenarios(mavnav: Callable) -> None:
    code, out, err = mavnav("simulate", "--list")
    assert (code, err) == (0, "")
    names = [line.split()[0] for line in out.splitlines()]
    assert names == scenarios()
    assert {"corner", "hover", "ring"} <= set(names)


def test_the_schema_is_json(mavnav: Callable) -> None:
    code, out, err = mavnav("simulate", "--schema")
    assert (code, err) == (0, "")
    assert {"walls", "start", "goal_m", "laser", "vehicle", "planner", "slam"} <= set(json.loads(out)["properties"])


# ---- errors: one line, one code, before the flight -------------------------------------------------------------------


@pytest.fixture
def grounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail where a mission is flown."""
    import mavnav.pipelines.simulate

    monkeypatch.setattr(mavnav.pipelines.simulate, "fly", lambda *_: pytest.fail("flew"))


@pytest.mark.usefixtures("grounded")
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("goal_m: [2.3, 0.8]", "goal_m: [1.5, 1.7]", [":5: goal_m [1.5, 1.7] lies inside a wall", "move it"]),
        ("x_m: 0.6", "x_m: -0.6", [":4: start [-0.6, 0.8] lies outside the world", "x 0 to 3"]),
        ("max_steps", "max_stops", [":6: unknown key max_stops; did you mean max_steps?"]),
        ("max_steps: 60", "laser: {noise_percent: -1}", [":6: laser.noise_percent is -1", "greater than or equal"]),
        ("max_steps: 60", "vehicle: {noise_yaw_deg: -1}", [":6: vehicle.noise_yaw_deg is -1"]),
        ("max_steps: 60", "slam: {method: magic}", [":6: slam.method is 'magic', it should be 'robust' or 'paper'"]),
        ("max_steps: 60", "max_steps: 0", [":6: max_steps is 0"]),
        ("walls:", "walls: [", [":"]),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_scenarios_that_cannot_be(
    mavnav: Callable, scenario: Path, tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    scenario.write_text(GOOD.replace(old, new, 1))
    expect_error(mavnav("simulate", scenario, "-o", tmp_path / "r", "-q"), ExitCode.USAGE, str(scenario), *words)
    assert list(tmp_path.iterdir()) == [scenario]


@pytest.mark.usefixtures("grounded")
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["no scenario", "--list"]),
        (["korner"], ["korner: no such file", "complex, complex-paper, corner"]),
        (["korner.yaml"], ["korner.yaml: no such file"]),
        (["corner", "--planner", "magic"], ["--planner: planner.technique is 'magic'", "'wavefront', 'field'"]),
        (["corner", "--method", "magic"], ["--method: slam.method is 'magic'"]),
        (["corner", "--grid", "5"], ["--grid: slam.grid is '5', it should be NxM with 2 to 200 points"]),
        (["corner", "--seed", "-1"], ["--seed: seed is -1"]),
        (["corner", "--seed", "x"], ["--seed", "see 'mavnav simulate --help'"]),
        (["corner", "--set", "nonsense"], ["--set 'nonsense' is not key=value"]),
        (["corner", "--set", "zzz=1"], ["unknown key zzz; see 'mavnav simulate --schema'"]),
        (["corner", "--set", "vehicle.radius_mm=-5"], ["--set vehicle.radius_mm=-5: vehicle.radius_mm is -5"]),
        (["corner", "--set", "goal_m=[9, 9]"], ["--set goal_m=[9, 9]: goal_m [9, 9] lies outside the world"]),
        (["corner", "--record", "corner.txt"], ["corner.txt", ".mcap or .bag"]),
        (["corner", "-o", "x", "--record", "x"], ["x is to be two things"]),
    ],
    ids=lambda value: " ".join(value) or "nothing",
)
def test_arguments_that_cannot_be(
    mavnav: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    expect_error(mavnav("simulate", *arguments, "-q"), ExitCode.USAGE, *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("grounded")
@pytest.mark.parametrize("option", ["-o", "--record", "--animate"])
def test_what_exists_is_refused_before_the_flight(
    mavnav: Callable, scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str
) -> None:
    monkeypatch.chdir(tmp_path)
    there = tmp_path / {"-o": "run", "--record": "there.mcap", "--animate": "there.gif"}[option]
    if option == "-o":
        there.mkdir()
        (there / "run.json").touch()
    else:
        there.touch()
    expect_error(mavnav("simulate", scenario, option, there, "-q"), ExitCode.OUTPUT, there.name, "exists", "--force")


def test_force_replaces_all_three(mavnav: Callable, scenario: Path, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    for there in (tmp_path / "run" / "run.json", tmp_path / "there.bag", tmp_path / "there.gif"):
        there.touch()
    options = ["-o", tmp_path / "run", "--record", tmp_path / "there.bag", "--animate", tmp_path / "there.gif"]
    assert mavnav("simulate", scenario, *options, "-q", "--set", "max_steps=2", "--force")[0] == ExitCode.GATE_FAILED
    assert {path.name for path in tmp_path.iterdir()} == {"run", "there.bag", "there.gif", "short.yaml"}
    assert all(path.stat().st_size for path in (tmp_path / "there.bag", tmp_path / "there.gif"))


def test_a_blind_laser_is_no_bug(mavnav: Callable, scenario: Path, tmp_path: Path) -> None:
    result = mavnav("simulate", scenario, "-o", tmp_path / "r", "-q", "--set", "laser.range_max_mm=100")
    expect_error(result, ExitCode.NO_SCANS, str(scenario), "the laser saw too little")
    assert not (tmp_path / "r").exists()
