"""Tilt and height of the laser in a log: what is read, when it is used, and what is refused."""

from __future__ import annotations

from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.cli import run
from mavnav.errors import TopicError
from mavnav.logs import Log, open_log
from mavnav.logs.derived_scans import RecordedAttitude, ceiling_height_m
from mavnav.pose import Pose
from mavnav.scan import Attitude, Scan, level_scan
from support.log_files import IMU, ODOM, START_NS, TF, Message, laser, write_mcap
from support.synthetic import DEG, cast, room
from support.tilted import SPEC, attitude_message, flight, furnished, quaternion, tilted_scan

SCANS = 12
STEP_NS = 100_000_000
LEVEL = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def tilt(k: float, most_deg: float = 12.0) -> Attitude:
    return Attitude(most_deg * DEG * np.sin(k), -0.5 * most_deg * DEG * np.cos(k), 1.0 + 0.02 * k)


def log_of(tmp_path: Path, messages: list[Message], **options: str) -> Log:
    scans = [laser(k, beams=64) for k in range(SCANS)]
    return open_log(write_mcap(tmp_path / "a.mcap", [*scans, *messages]), **options)


def attitudes(topic: str = "/attitude", most_deg: float = 12.0, shift_ns: int = 0, scans: int = SCANS) -> list[Message]:
    stamps = [START_NS + k * STEP_NS + shift_ns for k in range(scans)]
    return [attitude_message(stamp, tilt(k, most_deg), topic) for k, stamp in enumerate(stamps)]


def imu(k: int, q: dict[str, float]) -> Message:
    told = {"rates": (0.0, 0.0, 0.0), "xyzw": tuple(float(q[axis]) for axis in "xyzw")}
    return Message("/imu", IMU, START_NS + k * STEP_NS, told)


def mounted(child: str, q: dict[str, float], z: float = 0.0) -> Message:
    return Message(
        "/tf_static", TF, START_NS, {"parent": "base_link", "child": child, "x": 0.0, "y": 0.0, "z": z, "q": q}
    )


def test_scans_are_levelled_by_the_attitude_of_their_time(tmp_path: Path) -> None:
    log = log_of(tmp_path, attitudes())
    raw = log_of(tmp_path, attitudes(), attitude="off")
    assert log.attitude is not None
    assert raw.attitude is None
    assert (log.attitude.topic, log.attitude.source) == ("/attitude", "pose")
    for k, (scan, recorded) in enumerate(zip(log, raw, strict=True)):
        expected = level_scan(recorded, *tilt(k))
        np.testing.assert_allclose(scan.ranges_m, expected.ranges_m, atol=1e-5)
        np.testing.assert_allclose(scan.heights_m, expected.heights_m, atol=1e-5)


def test_attitudes_are_interpolated_for_every_beam() -> None:
    stamps_ns = np.array([0, 100_000_000])
    found = RecordedAttitude("/a", "pose", stamps_ns, np.array([0.0, 0.2]), np.array([0.1, 0.1]), np.array([1.0, 2.0]))
    roll, pitch, height = found.at(np.array([0.0, 25e6, 50e6, 2e8]))
    np.testing.assert_allclose((roll, pitch, height), ([0, 0.05, 0.1, 0.2], [0.1] * 4, [1, 1.25, 1.5, 2]))
    assert found.known_at(np.array([-400_000_000, 0, 500_000_000, 700_000_000])).tolist() == [True, True, True, False]


def test_every_beam_is_levelled_by_the_attitude_of_its_time() -> None:
    """A laser that rolls during its sweep in an empty room: each beam is cast with an attitude of its own."""
    spec, walls, pose = replace(SPEC, time_increment_s=0.1 / 240), room(6.0, 4.0), Pose(2.5, 1.8, 0.3)
    rolls = 0.2 * np.arange(240) / 240
    every = [tilted_scan(walls, np.full(4, 3.0), pose, Attitude(roll, 0.1, 1.5), spec)[0].ranges_m for roll in rolls]
    scan = Scan(0, np.array([ranges[k] for k, ranges in enumerate(every)]), spec)
    ends = (np.array([0, 10**8]), np.array([0.0, 0.2]), np.array([0.1, 0.1]), np.array([1.5, 1.5]))
    flat = RecordedAttitude("/attitude", "pose", *ends).level(scan).ranges_m
    off_m = np.abs(flat - cast(walls, (2.5, 1.8), spec.angles_rad + 0.3))
    assert np.nanmedian(off_m) < 1e-4
    assert np.nanquantile(off_m, 0.9) < 0.002  # but at the corners


def test_an_imu_is_brought_to_the_frame_of_the_laser(tmp_path: Path) -> None:
    """The sensor is turned by 90 deg on the base: the roll of the base is the pitch of the laser."""
    quarter = {"x": 0.0, "y": 0.0, "z": np.sqrt(0.5), "w": np.sqrt(0.5)}
    messages = [mounted("imu", LEVEL), mounted("laser", quarter)]
    messages += [imu(k, quaternion(Attitude(0.2 * np.sin(k), 0.0, 1.0))) for k in range(SCANS)]
    found = log_of(tmp_path, messages).attitude
    assert found is not None
    assert (found.source, found.has_heights) == ("imu", False)
    np.testing.assert_allclose(found.pitch_rad, -0.2 * np.sin(np.arange(SCANS)), atol=1e-6)
    np.testing.assert_allclose(found.roll_rad, 0.0, atol=1e-6)


def test_a_laser_that_is_mounted_upside_down_is_seen_from_above(tmp_path: Path) -> None:
    over = {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}
    messages = [mounted("imu", LEVEL), mounted("laser", over)]
    messages += [imu(k, quaternion(Attitude(0.2 * np.sin(k), 0.1 * np.cos(k), 1.0))) for k in range(SCANS)]
    log = log_of(tmp_path, messages)
    assert log.upside_down
    assert log.attitude is not None
    np.testing.assert_allclose(log.attitude.roll_rad, 0.2 * np.sin(np.arange(SCANS)), atol=1e-6)
    np.testing.assert_allclose(log.attitude.pitch_rad, 0.1 * np.cos(np.arange(SCANS)), atol=1e-6)


def test_odometry_in_space_gives_the_height_of_the_laser(tmp_path: Path) -> None:
    told = [{"x": 0.0, "y": 0.0, "z": tilt(k).height_m, "q": quaternion(tilt(k))} for k in range(SCANS)]
    messages = [Message("/odom", ODOM, START_NS + k * STEP_NS, fields) for k, fields in enumerate(told)]
    found = log_of(tmp_path, [mounted("laser", LEVEL, z=0.3), *messages]).attitude
    assert found is not None
    assert (found.source, found.topic) == ("odom", "/odom")
    expected = [tilt(k).height_m + 0.3 * np.cos(tilt(k).roll_rad) * np.cos(tilt(k).pitch_rad) for k in range(SCANS)]
    np.testing.assert_allclose(found.height_m, expected, atol=1e-6)


def test_a_sensor_that_hardly_tilts_or_whose_mounting_is_unknown_is_not_used(tmp_path: Path) -> None:
    noisy = [imu(k, quaternion(tilt(k, 4.0))) for k in range(SCANS)]
    still = log_of(tmp_path, [mounted("imu", LEVEL), mounted("laser", LEVEL), *noisy])
    assert (still.attitude, still.warnings) == (None, ())
    unknown = log_of(tmp_path, [imu(k, quaternion(tilt(k))) for k in range(SCANS)])
    assert unknown.attitude is None
    assert unknown.warnings == (
        "/imu: no transform from 'imu' to 'laser'; its tilt is not used (record /tf_static, or give --attitude /imu)",
    )
    named = log_of(tmp_path, [imu(k, quaternion(tilt(k))) for k in range(SCANS)], attitude="/imu")
    assert named.attitude is not None
    assert "their axes are taken as parallel" in named.warnings[0]


def test_heights_below_the_floor_are_not_used(tmp_path: Path) -> None:
    low = [attitude_message(START_NS + k * STEP_NS, tilt(k)._replace(height_m=0.1 * k)) for k in range(SCANS)]
    log = log_of(tmp_path, low)
    assert log.attitude is not None
    assert not log.attitude.has_heights
    assert next(iter(log)).heights_m is None
    assert "the heights (position.z) are not all above the floor" in log.warnings[0]


REFUSED = {
    "unknown": ("/tilt", r"no topic '/tilt'; topics with poses or orientations: /attitude \(geometry_msgs"),
    "wrong type": ("/scan", "/scan is of sensor_msgs/msg/LaserScan, which holds no attitude"),
    "other clock": ("/late", "attitude and scans share no time; check its clock, or write --attitude off"),
    "steep": ("/steep", "all scans are tilted by more than 60 deg; check its axes"),
    "not finite": ("/nan", "no attitude in it is finite; see what publishes it"),
}


@pytest.mark.parametrize(("topic", "text"), REFUSED.values(), ids=REFUSED)
def test_a_named_topic_that_cannot_be_used_is_refused(tmp_path: Path, topic: str, text: str) -> None:
    steep = [attitude_message(START_NS + k * STEP_NS, Attitude(1.2, 0.0, 1.0), "/steep") for k in range(SCANS)]
    bad = [attitude_message(START_NS + k * STEP_NS, Attitude(nan, 0.0, 1.0), "/nan") for k in range(SCANS)]
    messages = [*attitudes(), *attitudes("/late", shift_ns=10**12), *steep, *bad]
    with pytest.raises(TopicError, match=text):
        log_of(tmp_path, messages, attitude=topic)


def test_a_refusal_is_one_line_and_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_mcap(tmp_path / "a.mcap", [laser(k) for k in range(3)])
    assert run(["replay", str(path), "--attitude", "/tilt", "-o", str(tmp_path / "run"), "-q"]) == 2
    error = capsys.readouterr().err.splitlines()
    assert error == [
        "mavnav: error: --attitude: no topic '/tilt'; topics with poses or orientations: none; name one of them, or "
        "write --attitude off"
    ]


def test_what_is_odd_about_an_attitude_is_one_line_each(tmp_path: Path) -> None:
    odd = attitudes(scans=6)
    odd[2] = attitude_message(odd[2].stamp_ns, Attitude(0.1, 0.0, nan))
    odd[4] = attitude_message(odd[4].stamp_ns, Attitude(1.3, 0.0, 1.0))
    log = log_of(tmp_path, odd)
    assert log.warnings == (
        "/attitude: 1 of 6 attitudes are not finite; they are left out, see what publishes them",
        "/attitude: 1 of 12 scans, from 1.1 to 1.1 s, have no attitude in 0.5 s; they are not used: record it for the "
        "whole log, or cut the log with --start and --end",
        "/attitude: 1 of 12 scans are tilted by more than 60 deg, by up to 74 deg; they are not used, check its axes "
        "(x forward, z up) and the mounting",
    )
    valid = [bool(np.isfinite(scan.ranges_m).any()) for scan in log]
    assert [k for k in range(SCANS) if not valid[k]] == [4, 11]


def test_an_attitude_of_another_clock_is_not_used(tmp_path: Path) -> None:
    log = log_of(tmp_path, attitudes(shift_ns=10**12))
    assert log.attitude is None
    assert log.warnings == ("/attitude: attitude and scans share no time; check its clock; it is not used",)


def test_several_lasers_have_no_attitude(tmp_path: Path) -> None:
    messages = [laser(k, topic="/other", beams=64) for k in range(SCANS)]
    with pytest.raises(TopicError, match="--attitude is that of one laser"):
        log_of(tmp_path, [*messages, *attitudes()], topic="/scan,/other", attitude="/attitude")


def test_the_ceiling_is_found_where_it_is_seen() -> None:
    scene, path = furnished(), flight(60)
    stamps_ns = np.arange(60)
    tilts, heights = np.array([attitude[:2] for _, attitude in path]), np.array([a.height_m for _, a in path])
    recorded = RecordedAttitude("/a", "pose", stamps_ns, tilts[:, 0].copy(), tilts[:, 1].copy(), heights)
    for ceiling_m in (1.7, inf):
        tops_m = np.minimum(scene.tops_m, ceiling_m)
        seen = [tilted_scan(scene.walls, tops_m, pose, tilt, SPEC, ceiling_m)[0] for pose, tilt in path]
        scans = [type(scan)(k, scan.ranges_m, scan.spec) for k, scan in enumerate(seen)]
        assert ceiling_height_m(scans, recorded) == pytest.approx(ceiling_m, abs=0.03)


def test_poses_of_a_level_laser_change_nothing(tmp_path: Path) -> None:
    level = [attitude_message(START_NS + k * STEP_NS, Attitude(0.0, 0.0, 0.2)) for k in range(SCANS)]
    log, raw = log_of(tmp_path, level), log_of(tmp_path, level, attitude="off")
    assert log.attitude is not None
    for scan, recorded in zip(log, raw, strict=True):
        np.testing.assert_array_equal(scan.ranges_m, recorded.ranges_m)


def test_info_reports_the_tilt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_mcap(tmp_path / "a.mcap", [*(laser(k) for k in range(SCANS)), *attitudes()])
    assert run(["info", str(path)]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("attitude"))
    assert "/attitude, 12 messages, tilt" in row
    assert row.endswith("deg at most, height 1.00 to 1.22 m")


def test_a_stamp_from_the_future_costs_one_attitude(tmp_path: Path) -> None:
    messages = attitudes()
    far = Message(messages[0].topic, messages[0].type, START_NS + 10**15, messages[0].fields, START_NS)
    log = log_of(tmp_path, [messages[0], far, *messages[1:]])
    sound = log_of(tmp_path, messages)
    assert log.attitude is not None and sound.attitude is not None
    np.testing.assert_array_equal(log.attitude.roll_rad, sound.attitude.roll_rad)
    assert [w for w in log.warnings if "left out" in w] == [
        f"/attitude: 1 of {SCANS + 1} messages are left out, their stamps do not ascend"
    ]
