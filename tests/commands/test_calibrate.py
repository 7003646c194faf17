"""``mavnav calibrate``: the table, the document, the files, the lines to copy, and logs that show nothing."""

from __future__ import annotations

import json
import re
import shlex
from html import unescape
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace
from PIL import Image

import mavnav as api
from mavnav.logs.writing.recorder import Recording, record
from mavnav.metrics.calibration.quantities import KINDS
from mavnav.pipelines.calibrate import SWITCHES, calibration_headline
from mavnav.pose import Pose, Trajectory
from support.log_files import drive, write_mcap
from support.robots import SMALL, Robot, odometry_of, path_of, scans_of, written
from support.robots import drive as drive_of
from support.synthetic import DEG

ROBOT = Robot(
    Pose(0.1, 0.05, 0.6),
    offset_s=0.15,
    distance_scale=1.05,
    mirrored=True,
    moving=True,
    spec=SMALL,
    speed_m_s=0.6,
    turn_rad_s=1.0,
)


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """Return the log of a robot whose laser is upside down, and whose transforms do not say so."""
    return written(ROBOT, 3, tmp_path_factory.mktemp("robot") / "drive.mcap")


def test_the_log_of_a_robot(mavnav, log, tmp_path) -> None:
    document, picture = tmp_path / "found.json", tmp_path / "found.png"
    reading = ["--topic", "/scan", "--odom", "/odom", "--strict"]
    files = ["-o", document, "--picture", picture, "--report", tmp_path / "page.html"]
    code, out, err = mavnav("calibrate", log, "-q", *files, *reading)
    headline = json.loads(document.read_text())["headline"]
    assert headline.startswith("The laser's stamps are 0.14 s later than the odometry's; the distances of the odometry")
    assert headline in unescape((tmp_path / "page.html").read_text())
    assert re.search(r"^result +The laser's stamps are 0.14 s later", out, re.MULTILINE)
    assert (code, err) == (0, "")
    found = json.loads(document.read_text())
    given = {row["name"]: row for row in found["quantities"]}
    truth = dict(zip(given, ROBOT.truth * (1, 1, 1 / DEG, 1, 1, 1, 1 / DEG), strict=True))
    for name, row in given.items():
        assert row["value"] == pytest.approx(truth[name], abs=1.5 * row["ci95"]), name
    assert [given[name]["agrees"] for name in ("yaw_deg", "offset_s", "distance_scale")] == [False] * 3
    assert found["upside_down"] == {"value": True, "in_log": False, "agrees": False, "refused": None}
    assert found["beams_reversed"]["value"] is False
    assert np.asarray(Image.open(picture)).std() > 5
    transform, replay = out.splitlines()[-3], out.splitlines()[-1]
    assert "--roll 3.14159" in transform
    assert transform.endswith("--frame-id base_link --child-frame-id laser")
    assert shlex.split(replay)[:8] == ["mavnav", "replay", str(log), *reading]
    words = [*shlex.split(replay)[1:], "-q", "-o", tmp_path / "run", "--outputs", "metrics"]
    code, out, err = mavnav(*words)
    assert (code, err) == (0, "")
    used = json.loads((tmp_path / "run/run.json").read_text())
    assert used["config"]["odometry"]["offset_s"] == given["offset_s"]["value"]
    assert used["config"]["upside_down"]
    code, out, err = mavnav("calibrate", log, "-q", "-o", document)
    assert (code, out) == (6, "")
    assert "--force" in err


@pytest.mark.slow
def test_a_log_on_standard_input_is_called_by_a_dash(mavnav, log, tmp_path, monkeypatch) -> None:
    def piped(path: Path) -> str:
        monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=BytesIO(path.read_bytes()), isatty=lambda: False))
        return "-"

    code, out, err = mavnav("calibrate", piped(log), "--json", "-q")
    document, of_file = json.loads(out), json.loads(mavnav("calibrate", log, "--json", "-q")[1])
    assert (code, err, document["input"]["path"]) == (0, "", "-")
    assert document["quantities"] == of_file["quantities"]
    assert document["lines"]["replay"] == of_file["lines"]["replay"].replace(str(log), "-")
    alone = write_mcap(tmp_path / "alone.mcap", [m for m in drive() if m.topic == "/scan"])
    code, out, err = mavnav("calibrate", piped(alone), "-q")
    assert (code, out) == (2, "")
    assert err.startswith("mavnav: error: -: no odometry; record")


def at_rest(path: Path, scans: int) -> Path:
    """Write a log of a robot that stands still."""
    robot = replace(ROBOT, mirrored=False, moving=False)
    still = path_of(robot)
    still.poses[:] = still.poses[0]
    some = scans_of(robot, still, np.random.default_rng(0))[:scans]
    stamps = [still.start_ns + k * 10**8 for k in range(2 * scans)]
    record(Recording(some, Trajectory.of(stamps, [Pose()] * len(stamps)), Trajectory.of([], [])), path)
    return path


def test_logs_that_show_nothing(mavnav, tmp_path) -> None:
    """Each gets one line that says what to do."""
    alone = write_mcap(tmp_path / "alone.mcap", [m for m in drive() if m.topic == "/scan"])
    empty, torn = tmp_path / "empty.mcap", tmp_path / "torn.mcap"
    empty.touch()
    torn.write_bytes(alone.read_bytes()[:300])
    for args, code, word in (
        ([alone], 2, "no odometry; record nav_msgs/Odometry"),
        ([alone, "--odom", "/wheels"], 2, "no odometry on topic '/wheels'; the log holds none, leave --odom out"),
        ([alone, "--odom", "off"], 2, "leave --odom off away"),
        ([alone, "--topic", "/a", "--topic", "/b"], 2, "one --topic at a time"),
        ([alone, "--set", "method=paper"], 2, "needs the robust method"),
        ([alone, "--set", "upside_down=true"], 2, "as recorded"),
        ([alone, "-o", tmp_path], 6, "is a directory; name a file"),
        ([tmp_path / "gone.mcap"], 2, "no such file"),
        ([empty], 4, "no usable scans"),
        ([torn], 4, "no usable scan"),
        ([at_rest(tmp_path / "short.mcap", 8)], 1, "20 are needed"),
        ([at_rest(tmp_path / "rest.mcap", 100)], 1, "the laser moves by 0.00 m and turns by 0 deg in all"),
    ):
        found, out, err = mavnav("calibrate", *args, "-q")
        assert (found, out, err.count("\n")) == (code, "", 1), (args, err)
        assert word in err, (args, err)


@pytest.mark.slow
def test_reversed_beams_are_found(mavnav, tmp_path) -> None:
    backwards = written(replace(ROBOT, mirrored=False, backwards=True), 3, tmp_path / "drive.mcap")
    code, _, _ = mavnav("calibrate", backwards, "-q", "-o", tmp_path / "found.json")
    found = json.loads((tmp_path / "found.json").read_text())
    assert code == 0
    assert found["beams_reversed"] == {"value": True, "in_log": False, "agrees": False, "refused": None}
    assert found["upside_down"]["value"] is False


@pytest.mark.slow
def test_a_lost_track_calibrates_nothing(mavnav, tmp_path) -> None:
    """From a fifth of the scans on all ranges are random."""
    recording, rng = drive_of(ROBOT, 3), np.random.default_rng(0)
    first = len(recording.scans) // 5
    noise = [replace(scan, ranges_m=rng.uniform(0.3, 3.5, scan.spec.beams)) for scan in recording.scans[first:]]
    record(replace(recording, scans=[*recording.scans[:first], *noise]), tmp_path / "lost.mcap")
    code, out, err = mavnav("calibrate", tmp_path / "lost.mcap", "-q", "-o", tmp_path / "found.json")
    assert (code, out) == (5, "")
    assert "tracking was lost 7.5 s after the first scan, 20 % of the scans have a pose" in err
    assert "look at map.png of a run with --outputs pictures" in err  # calibrate draws no map
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["tracking"]["lost"] is True
    assert all(row["refused"] and row["value"] is None for row in found["quantities"])


@pytest.mark.slow
def test_a_doubtful_track_calibrates_nothing(mavnav, tmp_path) -> None:
    """Between two walls without ends nothing shows the motion along them."""
    robot, rng = replace(ROBOT, mirrored=False, moving=False), np.random.default_rng(0)
    path = path_of(robot, [(0.0, 0.0), (6.0, 0.3), (9.0, 0.0), (14.0, 0.2)])
    walls = np.array([[-50.0, -1.0, 50.0, -1.0], [-50.0, 1.0, 50.0, 1.0]])
    corridor = scans_of(robot, path, rng, walls)
    record(Recording(corridor, odometry_of(robot, path, rng), Trajectory.of([], [])), tmp_path / "corridor.mcap")
    code, out, err = mavnav("calibrate", tmp_path / "corridor.mcap", "-q", "-o", tmp_path / "found.json")
    assert (code, out) == (1, "")
    assert "the walls leave a direction open" in err
    assert json.loads((tmp_path / "found.json").read_text())["verdict"]["word"] in {"suspect", "wrong"}
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["tracking"]["doubt"] > 0.5
    assert all(row["refused"] and row["value"] is None for row in found["quantities"])


def test_from_python(tmp_path) -> None:
    document = api.calibrate(at_rest(tmp_path / "rest.mcap", 60), document=tmp_path / "found.json")
    assert document["exit_code"] == 1
    assert document["lines"] == {"static_transform": None, "replay": None}
    assert json.loads((tmp_path / "found.json").read_text()) == document


@pytest.mark.parametrize("name", [kind.name for kind in KINDS])
@pytest.mark.parametrize("sign", [-1, 1])
def test_the_headline_says_of_each_quantity_how_it_differs(name: str, sign: int) -> None:
    rows = [{"name": kind.name, "value": 1.0, "difference": 0.25 * sign, "agrees": kind.name != name} for kind in KINDS]
    document = {"refused": None, "quantities": rows, **{switch: {"agrees": True} for switch in SWITCHES}}
    text = calibration_headline(document)
    assert re.search(r"0\.25|25\.0 %|0\.2 deg", text) and name not in text and name.replace("_", " ") not in text
    assert name != "veer_deg_per_m" or f"to the {'right' if sign > 0 else 'left'} by 0.25 deg per m" in text
