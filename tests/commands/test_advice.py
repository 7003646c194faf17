"""Advice is tried: each message that names a setting or a command is caused by a log, and what it names helps."""

from __future__ import annotations

import json
import re
from ast import literal_eval
from pathlib import Path
from shlex import split
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from msgspec.structs import replace

import mavnav
from mavnav.cli import run
from mavnav.config.loading import load_config
from mavnav.errors import NoScansError, TopicError, UsageError
from mavnav.logs import open_log, survey
from mavnav.outputs.documents import verdict
from mavnav.pose import Pose, Trajectory
from mavnav.scan import Attitude
from support.field_logs import START_S, drive_log, wheels, with_fields
from support.log_files import LASER, ODOM, PERIOD_NS, START_NS, TF, Message, laser, write_bag1, write_mcap
from support.synthetic import TOUR, along, box, polyline
from support.tilted import attitude_message

CORNERS = [(1.0, 0.8), (4.9, 0.8), (4.6, 2.9), (2.2, 3.0)]
TURNING = along(CORNERS, 0.02, 0.7, 1.5, START_S * 10**9)
MOSTLY_STRAIGHT = along(CORNERS, 0.02, 0.5, 2.5, START_S * 10**9)


def replayed(log: Path, directory: Path, *more: str) -> tuple[int, dict[str, Any]]:
    """Return the exit code of a replay and its run.json."""
    code = run(["replay", str(log), "-o", str(directory), "-q", "--outputs", "trajectory,metrics", *more])
    return code, json.loads((directory / "run.json").read_text())


def advised(text: str) -> list[str]:
    """Return the words of the setting that a message names."""
    return split(text[text.index("--set") :].replace(";", ""))[:2]


def warning_with(document: dict[str, Any], part: str) -> str:
    (text,) = [text for text in document["warnings"] if part in text]
    return text


@pytest.mark.slow
@pytest.mark.parametrize("path", [TURNING, MOSTLY_STRAIGHT], ids=["turning", "mostly straight"])
def test_mirrored_scans_are_named_where_odometry_turns_the_other_way(path: Trajectory, tmp_path: Path) -> None:
    messages = drive_log(path=path, odometry=True, beams=120)
    mirrored = [m for m in messages if m.type != LASER] + with_fields(
        [m for m in messages if m.type == LASER], angle_min=np.pi, angle_increment=-2 * np.pi / 120
    )
    log = write_mcap(tmp_path / "log.mcap", sorted(mirrored, key=lambda m: m.time_ns))
    _, document = replayed(log, tmp_path / "a")
    words = advised(warning_with(document, "the laser turns the other way"))
    assert words == ["--set", "upside_down=true"]
    code, document = replayed(log, tmp_path / "b", *words)
    assert (code, document["tracking"]["odometry"]["used"]) == (0, True)
    assert not [text for text in document["warnings"] if "contradicts" in text]


@pytest.mark.slow
def test_beside_mirrored_odometry_the_run_is_right_as_said(tmp_path: Path) -> None:
    messages = drive_log(path=TURNING, odometry=True, beams=120)
    mirrored = [
        replace(m, fields=m.fields | {"y": -m.fields["y"], "yaw": -m.fields["yaw"]}) if m.type == ODOM else m
        for m in messages
    ]
    _, document = replayed(write_mcap(tmp_path / "log.mcap", mirrored), tmp_path / "a")
    assert warning_with(document, "contradicts").endswith("; if the odometry is mirrored, this run is right")
    replayed(write_mcap(tmp_path / "right.mcap", messages), tmp_path / "b", "--odom", "off")
    paths = [(tmp_path / name / "trajectory.tum").read_text() for name in "ab"]
    assert paths[0] == paths[1]


@pytest.mark.slow
def test_scans_that_transforms_turn_over_wrongly_are_used_as_recorded(tmp_path: Path) -> None:
    over = {"parent": "base_link", "child": "laser", "x": 0.0, "y": 0.0, "q": {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}}
    messages = drive_log(path=MOSTLY_STRAIGHT, beams=120) + wheels(MOSTLY_STRAIGHT, child="base_link")
    messages.append(Message("/tf_static", TF, messages[0].stamp_ns, over))
    log = write_mcap(tmp_path / "log.mcap", sorted(messages, key=lambda m: m.time_ns))
    _, document = replayed(log, tmp_path / "a")
    assert "--extrinsic x,y,yaw instead" in warning_with(document, "the laser turns the other way")
    code, document = replayed(log, tmp_path / "b", "--extrinsic", "0,0,0")
    assert (code, document["tracking"]["odometry"]["used"]) == (0, True)
    assert not [text for text in document["warnings"] if "contradicts" in text]


def yard(reach_m: float = 80.0) -> list[Message]:
    """Return a drive through a yard whose walls are mostly beyond 30 m."""
    walls = np.vstack((polyline((0, 0), (110, 0), (110, 76), (0, 76), closed=True), box(62.0, 60.0, 9.0, 5.0, 0.4)))
    path = along([(40.0, 38.0), (45.0, 38.0)], 0.02, 1.5, 1.0, START_S * 10**9)
    return drive_log(path=path, walls=walls, beams=240, range_max_m=reach_m)


@pytest.mark.slow
def test_returns_beyond_the_default_are_used_where_most_are(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", yard())
    code, document = replayed(log, tmp_path / "a", "--end", "2")
    assert (code, document["config"]["robust"]["far_mm"]) == (0, 80_000.0)
    assert "returns up to 80 m are used" in warning_with(document, "set robust.far_mm")
    code, document = replayed(log, tmp_path / "b", "--end", "0.5", "--set", "robust.far_mm=29000")
    assert (document["config"]["robust"]["far_mm"], document["warnings"]) == (29_000.0, document["warnings"])
    assert not [text for text in document["warnings"] if "are used" in text]


def warning_of(path: Path, part: str, **chosen: Any) -> str:
    (text,) = [text for text in open_log(path, **chosen).warnings if part in text]
    return text


def scans(**fields: Any) -> list[Message]:
    return [laser(k, **fields) for k in range(30)]


def odometry(topic: str) -> list[Message]:
    return [Message(topic, ODOM, START_NS + k * PERIOD_NS, {"x": 0.02 * k, "y": 0.0, "yaw": 0.0}) for k in range(30)]


def transform(topic: str, k: int, **fields: float) -> Message:
    told = {"parent": "base_link", "child": "laser", "x": 0.0, "y": 0.0, "yaw": 0.0} | fields
    return Message(topic, TF, START_NS + k * PERIOD_NS, told)


def test_a_scan_topic_that_is_listed_can_be_chosen(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", scans(topic="/front") + scans(topic="/rear"))
    with pytest.raises(TopicError, match="choose one with --topic NAME") as error:
        open_log(path)
    names = re.findall(r"(/\w+) \(30 scans\)", str(error.value))
    assert [len(open_log(path, topic=name)) for name in names] == [30, 30]


@pytest.mark.parametrize("names", [["/a", "/b"], ["/base_pose_ground_truth"]], ids=["several", "truth"])
def test_an_odometry_topic_that_is_named_can_be_chosen(names: list[str], tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", scans() + [message for name in names for message in odometry(name)])
    text = warning_of(path, "--odom")
    for name in names:
        assert name in text
        log = open_log(path, odom=name)
        assert log.odometry is not None
        assert not [other for other in log.warnings if "--odom" in other]
    if "--truth" in text:
        (name,) = re.findall(r"--truth topic:(\S+),", text)
        assert open_log(path, truth=name).truth is not None


@pytest.mark.parametrize(
    ("messages", "part"),
    [
        ([], "no transform from"),
        ([transform("/tf", k, yaw=0.1 * k) for k in range(20)], "moves; give where"),
        ([transform("/tf_static", k, x=0.1 * k) for k in range(2)], "gives several transforms"),
    ],
    ids=["none", "moving", "several"],
)
def test_a_mounting_that_is_given_takes_the_warning_away(messages: list[Message], part: str, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [*messages, *scans(), *odometry("/odom")])
    assert "--extrinsic x,y,yaw" in warning_of(path, part)
    log = open_log(path, extrinsic=Pose(0.1, 0.0, 0.2))
    assert (log.base_T_laser, [text for text in log.warnings if "--extrinsic" in text]) == (Pose(0.1, 0.0, 0.2), [])


@pytest.mark.parametrize(
    ("units", "limits_too", "advice"),
    [
        (100, True, "divide them by 100, range_min and range_max too"),
        (1000, False, "divide them by 1000, not the limits"),
    ],
)
def test_ranges_divided_as_the_error_says_are_used(units: int, limits_too: bool, advice: str, tmp_path: Path) -> None:
    walls, of_limits = np.linspace(0.6, 9.0, 60), units if limits_too else 1
    right = {"ranges": walls, "range_min": 0.1, "range_max": 12.0, "angle_increment": 0.1}
    wrong = right | {"ranges": walls * units, "range_min": 0.1 * of_limits, "range_max": 12.0 * of_limits}
    with pytest.raises(NoScansError, match=advice):
        open_log(write_mcap(tmp_path / "a", scans(**wrong)))
    assert len(open_log(write_mcap(tmp_path / "b", scans(**right)))) == 30


@pytest.mark.parametrize("wrong", [0.0, 4.0])
def test_an_increment_set_as_the_warning_says_is_no_news(wrong: float, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", scans(angle_increment=wrong, angle_max=1.0))
    (step,) = re.findall(r"it is (\S+) rad", warning_of(path, "set it in the driver"))
    again = open_log(write_mcap(tmp_path / "b", scans(angle_increment=float(step), angle_max=1.0)))
    assert not [text for text in again.warnings if "angle" in text]


@pytest.mark.slow
def test_a_time_increment_set_as_the_warning_says_is_kept(tmp_path: Path) -> None:
    messages = drive_log(path=TURNING, beams=120)
    log = write_mcap(tmp_path / "a.mcap", with_fields(messages, time_increment=0.0))
    _, document = replayed(log, tmp_path / "a")
    (beam_s,) = re.findall(r"fit better with (\S+) s", warning_with(document, "time_increment"))
    log = write_mcap(tmp_path / "b.mcap", with_fields(messages, time_increment=float(beam_s)))
    code, document = replayed(log, tmp_path / "b")
    assert (code, [text for text in document["warnings"] if "time_increment" in text]) == (0, [])


def test_a_window_within_the_time_that_an_error_states_has_scans(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", scans())
    with pytest.raises(NoScansError, match=r"the scans last (2\.9) s: check --start and --end"):
        open_log(path, start_s=60.0)
    assert len(open_log(path, start_s=1.0, end_s=2.9)) == 20


def test_the_bags_of_a_folder_can_be_named_or_run_as_a_batch(tmp_path: Path) -> None:
    write_mcap(tmp_path / "drive.mcap", drive_log(1.0, beams=60))
    write_bag1(tmp_path / "drive.bag", drive_log(1.0, beams=60))
    with pytest.raises(NoScansError, match=r"drive\.bag and drive\.mcap; name one, or use 'mavnav batch FOLDER'"):
        open_log(tmp_path)
    assert len(open_log(tmp_path / "drive.bag")) == len(open_log(tmp_path / "drive.mcap"))


def lost(sets: list[str], beams: int = 0, valid: int = 360) -> tuple[str, str]:
    """Return cause and advice for a lost log of 50 scans, with settings, matched and valid beams a scan."""
    cause = verdict._lost(
        {
            "tracking": {"lost": True, "tracked_share": 0.1, "intervals": [], "parts": []},
            "search": {"beams_used": {"median": beams}},
            "scans": {"usable": 50, "processed": 50},
            "cleaning": {"valid": 50 * valid},
            "method": "robust",
            "config": load_config(None, sets, {}).document(),
            "input": {"odometry": None, "duration_s": 5.0},
        }
    )
    assert cause
    return cause


@pytest.mark.parametrize(("beams", "valid", "few"), [(0, 360, False), (0, 5, True), (11, 360, True), (150, 360, False)])
def test_a_lost_log_is_said_to_see_little_where_that_is_so(beams: int, valid: int, few: bool) -> None:
    """Scans that were never matched have no matched beams, however much they see."""
    assert ("see too little" in lost([], beams, valid)[0]) == few


def test_no_advice_leads_back_to_fewer_returns() -> None:
    """A log whose walls are far is used to its limit; to leave that out would go in a circle."""
    assert "far_mm" not in lost(["robust.far_mm=80000"])[1]
    assert "leave out robust.far_mm=5000" in lost(["robust.far_mm=5000"])[1]


@pytest.mark.slow
def test_a_log_of_calibrated_odometry_is_replayed_as_the_calibration_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line that calibrate prints for odometry half a second late keeps that, and the offset is stated."""
    path = along(TOUR, 0.02, 0.6, 1.2, START_S * 10**9)
    messages = drive_log(path=path, beams=90, odometry=True)
    late = [replace(m, stamp_ns=m.stamp_ns + 500_000_000) if m.type == ODOM else m for m in messages]
    log = write_mcap(tmp_path / "log.mcap", sorted(late, key=lambda m: m.stamp_ns))
    assert run(["calibrate", str(log), "-q"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("mavnav replay")]
    _, *words = split(line)
    assert run([*words, "-o", str(tmp_path / "run"), "-q", "--outputs", "trajectory", "--end", "12"]) == 0
    used = json.loads((tmp_path / "run" / "run.json").read_text())["tracking"]["odometry"]
    assert (used["used"], used["offset_s"]) == (True, pytest.approx(-0.5, abs=0.06))


def test_logs_without_scans_are_explained_by_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [write_mcap(tmp_path / name, scans(ranges=[])) for name in ("a.mcap", "b.mcap")]
    assert run(["merge", *map(str, paths), "-o", str(tmp_path / "m"), "-q"]) == 4
    assert "has a tracked scan; examine them with mavnav info" in capsys.readouterr().err
    assert run(["info", str(paths[0])]) == 4
    said = "none of the 30 scans on /scan is usable (30 empty); see what publishes them: each needs ranges, and finite"
    assert said in capsys.readouterr().err
    drive = write_mcap(tmp_path / "drive.mcap", drive_log(2.0, beams=120))
    assert run(["merge", str(drive), str(paths[0]), "-o", str(tmp_path / "m"), "-q", "--json"]) == 1
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert "a did not join: " in verdict["reason"]
    assert verdict["advice"] == "examine it with mavnav info"


def test_settings_of_python_are_a_dictionary_as_the_error_writes_it(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", drive_log(0.6, beams=60))
    with pytest.raises(UsageError, match="give a dictionary such as") as error:
        mavnav.replay(log, settings="robust.cell_mm=25")  # type: ignore[arg-type]
    written = literal_eval(str(error.value)[str(error.value).index("{") :])
    assert mavnav.replay(log, settings=written | {"final_pass": False}).metrics["config"]["robust"]["cell_mm"] == 25


def test_scans_that_repeat_are_cut_off(tmp_path: Path) -> None:
    repeated = [laser(min(k, 20)) for k in range(30)]
    messages = [replace(m, stamp_ns=START_NS + k * PERIOD_NS) for k, m in enumerate(repeated)]
    path = write_mcap(tmp_path / "a", messages)
    assert "cut the log with --start and --end" in warning_of(path, "repeat the one before")
    assert open_log(path, end_s=1.9).warnings == ()


@pytest.mark.slow
def test_the_returns_that_info_names_are_used_or_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Some of the walls lie beyond the default; a driver writes a value of its own where there is no return."""

    def found(log: Path) -> str:
        assert run(["info", str(log)]) == 0
        return capsys.readouterr().out

    walls = np.vstack((polyline((0, 0), (60, 0), (60, 20), (0, 20), closed=True), box(30.0, 12.0, 4.0, 2.0, 0.0)))
    path = along([(12.0, 8.0), (16.0, 8.0)], 0.02, 1.0, 1.0, START_S * 10**9)
    messages = drive_log(path=path, walls=walls, beams=360, range_max_m=80.0)
    far = write_mcap(tmp_path / "far.mcap", messages)
    assert "replay with a larger robust.far_mm, in mm (--set)" in found(far)
    usual, larger = (
        replayed(far, tmp_path / name, *more)[1] for name, more in (("a", []), ("b", ["--set", "robust.far_mm=60000"]))
    )
    assert larger["search"]["beams_used"]["median"] > usual["search"]["beams_used"]["median"]
    capped = [
        replace(m, fields=m.fields | {"ranges": np.minimum(m.fields["ranges"], 20.0), "range_max": 25.0})
        for m in messages
    ]
    log = write_mcap(tmp_path / "capped.mcap", capped)
    code, document = replayed(log, tmp_path / "c")
    assert (code, document["verdict"]["word"]) == (0, "good")
    assert [text for text in document["warnings"] if "many ranges are exactly 20 m" in text]


def test_a_truth_without_a_mounting_is_that_of_the_laser_once_it_is_given(tmp_path: Path) -> None:
    messages = [*scans(), *(replace(m, fields=m.fields | {"child": "body"}) for m in odometry("/gt"))]
    path = write_mcap(tmp_path / "a", messages)
    assert "give the mounting with --extrinsic x,y,yaw" in warning_of(
        path, "the ground truth is taken as", truth="auto"
    )
    log = open_log(path, truth="auto", extrinsic=Pose(0.5, 0.0, 0.0))
    assert log.truth is not None
    assert (log.truth.world_T_laser[0].x_m, log.warnings) == (pytest.approx(0.5), ())


def test_an_attitude_of_a_part_is_enough_for_that_part(tmp_path: Path) -> None:
    tilts = [attitude_message(START_NS + k * PERIOD_NS, Attitude(0.1 * np.sin(k), 0.0, 1.0)) for k in range(15)]
    path = write_mcap(tmp_path / "a", [*scans(), *tilts])
    assert "cut the log with --start and --end" in warning_of(path, "have no attitude")
    log = open_log(path, end_s=1.4)
    assert (log.attitude is not None, log.warnings) == (True, ())


def test_an_attitude_that_cannot_be_used_is_left_out_by_off(tmp_path: Path) -> None:
    late = [attitude_message(START_NS + 10**12 + k, Attitude(0.1, 0.0, 1.0), "/late") for k in range(15)]
    path = write_mcap(tmp_path / "a", [*scans(), *late])
    with pytest.raises(TopicError, match="or write --attitude off"):
        open_log(path, attitude="/late")
    assert open_log(path, attitude="off").warnings == ()


def test_warnings_of_many_topics_are_listed_by_topic(tmp_path: Path) -> None:
    many = [laser(k, topic=f"/scan{n:03}", angle_increment=0.0, angle_max=1.0) for n in range(120) for k in range(2)]
    path = write_mcap(tmp_path / "a", many)
    assert [text for text in survey(path).warnings if "more warnings; choose a topic with --topic" in text]
    assert len(survey(path, topic="/scan119").warnings) == 1


def test_damage_that_is_not_printed_is_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        channel = writer.register_channel("/odom", "cdr", writer.register_schema(ODOM, "ros2msg", b""))
        for k in range(15):
            writer.add_message(channel, START_NS + k, b"none", START_NS + k)
        writer.finish()
    assert run(["info", str(path)]) == 4
    assert "mavnav: damage: 5 more; --json lists them" in capsys.readouterr().err
    assert run(["info", str(path), "--json"]) == 4
    assert len(json.loads(capsys.readouterr().out)["damage"]) == 15
