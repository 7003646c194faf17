"""Which topic, which odometry, which mounting; and inputs that are no logs."""

from __future__ import annotations

import gzip
import os
from math import pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from msgspec.structs import replace

from mavnav.errors import NoScansError, TopicError, UsageError
from mavnav.logs import open_log
from mavnav.pose import Pose
from support.log_files import (
    IMU,
    LASER,
    ODOM,
    PERIOD_NS,
    POSE,
    START_NS,
    TF,
    Message,
    drive,
    laser,
    write_bag1,
    write_mcap,
)

if TYPE_CHECKING:
    from pathlib import Path


def tf(parent: str, child: str, topic: str = "/tf_static", k: int = 0, **fields: Any) -> Message:
    told = {"x": 0.0, "y": 0.0, "yaw": 0.0} | fields
    return Message(topic, TF, START_NS + k * PERIOD_NS, {"parent": parent, "child": child, **told})


def odom(topic: str, k: int, **fields: Any) -> Message:
    return Message(topic, ODOM, START_NS + k * PERIOD_NS, {"x": 1.0 * k, "y": 0.0, "yaw": 0.0} | fields)


def test_several_scan_topics_are_listed_and_one_can_be_chosen(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(0, topic="/front"), laser(1, topic="/front"), laser(2, topic="/rear")])
    with pytest.raises(
        TopicError, match=r": /front \(2 scans\), /rear \(1 scans\); choose one with --topic NAME, or merge"
    ):
        open_log(path)
    log = open_log(path, topic="/front")
    assert (log.topic, log.counts.total, sum(1 for _ in log.scans())) == ("/front", 2, 2)
    with pytest.raises(TopicError, match=r"no scans on topic '/left'; scan topics here: /front \(2 scans\)"):
        open_log(path, topic="/left")


def test_a_topic_without_scans_is_told_the_scan_topics(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [odom("/odom", 0), laser(0), laser(1)])
    for name in ("/odom", "/nope"):
        with pytest.raises(TopicError, match=rf"no scans on topic '{name}'; scan topics here: /scan \(2 scans\)"):
            open_log(path, topic=name)


def test_log_without_scans_names_its_topics(tmp_path: Path) -> None:
    with pytest.raises(NoScansError, match="no LaserScan messages; topics here: /odom"):
        open_log(write_mcap(tmp_path / "a", [odom("/odom", 0)]))


def test_log_whose_scans_are_all_unusable_says_why(tmp_path: Path) -> None:
    with pytest.raises(NoScansError, match=r"none of the 2 scans on /scan is usable \(2 empty\)"):
        open_log(write_mcap(tmp_path / "a", [laser(k, ranges=[]) for k in range(2)]))
    far = [laser(k, range_min=20.0, range_max=5000.0) for k in range(2)]
    with pytest.raises(NoScansError, match=r"94 % below min, 6 % zero, and range_min and range_max are 20 and 5000 m"):
        open_log(write_mcap(tmp_path / "b", far))


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b"", "the file is empty"),
        (b"hello world", "not an MCAP file"),
        (b"#ROSRECORD V1.1\nxyz", "format 1.1"),
        (b"\x28\xb5\x2f\xfdrubbish", "compressed with zstd, but"),
        (b"\xfd7zXZ\0" + bytes(30), "compressed with xz, which is not read"),
        (gzip.compress(b"nothing", mtime=0), "compressed with gzip, but the start of what is inside is no log"),
        (gzip.compress(b"\x00CObservation2DRangeScan", mtime=0), "rawlog of MRPT"),
        (b"ULog\x01\x12\x35\x01", "PX4"),
        (b"# .PCD v0.7 - Point Cloud Data", "cloud of points"),
        (b"rosbag2_bagfile_information:\n  version: 5\n", "name its folder"),
        (b"\x89HDF\r\n\x1a\n\0", "HDF5"),
        (b"\xd4\xc3\xb2\xa1\x02\0\x04\0", "pcap"),
        (b"RRF2\0\0", "Rerun"),
    ],
)
def test_files_that_are_no_logs_are_refused(content: bytes, what: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(NoScansError, match=what):
        open_log(path)


def test_paths_that_cannot_be_read_are_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such file"):
        open_log(tmp_path / "absent")
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(UsageError, match="or pipe one into 'mavnav replay -'"):
        open_log(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    with pytest.raises(NoScansError, match="holds no ROS 2 bag"):
        open_log(tmp_path / "folder")


def test_a_folder_of_other_logs_names_them(tmp_path: Path) -> None:
    write_bag1(tmp_path / "drive.bag", [laser(0)])
    with pytest.raises(NoScansError, match=r"the folder holds drive\.bag; name it, or use 'mavnav batch FOLDER'"):
        open_log(tmp_path)
    write_mcap(tmp_path / "drive.mcap", [laser(0)])
    names = r"drive\.bag and drive\.mcap; name one, or use 'mavnav batch FOLDER'"
    with pytest.raises(NoScansError, match=f"the folder holds {names}"):
        open_log(tmp_path)


def test_fifo_in_a_folder_does_not_hang(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.db3")
    write_mcap(tmp_path / "b.mcap", [laser(0)])
    assert open_log(tmp_path).counts.usable == 1


def test_odometry_by_itself_is_the_only_topic_or_odom_or_tf(tmp_path: Path) -> None:
    scans = [laser(k) for k in range(4)]
    moving = [tf("odom", "base_link", "/tf", k, x=2.0 * k) for k in range(4)]
    cases = {
        "one": ([odom("/wheels", k) for k in range(4)], "/wheels"),
        "named": ([odom(t, k) for k in range(4) for t in ("/odom", "/icp")], "/odom"),
        "several": ([odom(t, k) for k in range(4) for t in ("/a", "/b")], None),
        "tf": (moving, "/tf"),
        "none": ([], None),
    }
    for name, (messages, topic) in cases.items():
        log = open_log(write_mcap(tmp_path / name, scans + messages))
        assert (log.odometry.topic if log.odometry else None) == topic, name
        assert any("choose with --odom" in w for w in log.warnings) == (name == "several")
    log = open_log(tmp_path / "tf")
    assert log.odometry is not None
    assert log.odometry.source == "tf"
    np.testing.assert_allclose(log.odometry.odom_T_base.xyyaw[:, 0], [0.0, 2.0, 4.0, 6.0])


def two_robots(tmp_path: Path, motion: list[Message]) -> Path:
    """Write scans of the second robot of two, and the mountings of both."""
    mountings = [tf(f"r{n}/base_link", f"r{n}/laser", x=0.1 * n) for n in (1, 2)]
    return write_mcap(tmp_path / "a", [*(laser(k, frame_id="r2/laser") for k in range(4)), *mountings, *motion])


def test_odometry_of_tf_is_that_of_the_laser_s_vehicle(tmp_path: Path) -> None:
    one = [tf("r1/odom", "r1/base_link", "/tf", k, x=5.0 * k) for k in range(6)]
    two = [tf("r2/odom", "r2/base_link", "/tf", k, x=2.0 * k) for k in range(4)]
    log = open_log(two_robots(tmp_path, one + two))
    assert (log.base_frame, log.base_T_laser) == ("r2/base_link", Pose(0.2, 0.0, 0.0))
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry.odom_T_base.xyyaw[:, 0], [0.0, 2.0, 4.0, 6.0])


def test_of_several_odometry_topics_that_of_the_laser_s_vehicle_is_used(tmp_path: Path) -> None:
    motion = [odom(f"/r{n}/odom", k, child=f"r{n}/base_link") for k in range(4) for n in (1, 2)]
    log = open_log(two_robots(tmp_path, motion))
    assert log.odometry is not None
    assert (log.odometry.topic, log.base_frame) == ("/r2/odom", "r2/base_link")
    assert not any("several odometry" in text for text in log.warnings)


def test_without_odometry_the_base_may_be_in_a_namespace(tmp_path: Path) -> None:
    log = open_log(two_robots(tmp_path, [tf("r1/base_link", "r2/base_link")]))
    assert (log.base_frame, log.base_T_laser) == ("r2/base_link", Pose(0.2, 0.0, 0.0))


def test_odometry_can_be_named_or_left_out(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", [laser(0), laser(1), *(odom(t, k) for k in range(2) for t in ("/odom", "/icp"))])
    named = open_log(path, odom="/icp").odometry
    assert named is not None
    assert named.topic == "/icp"
    assert open_log(path, odom="off").odometry is None
    with pytest.raises(TopicError, match=r"no odometry on topic '/x'; name one that the log holds: /odom, /icp$"):
        open_log(path, odom="/x")


LATER = "messages are left out, their stamps do not ascend"


@pytest.mark.parametrize(
    ("stamps", "kept", "left_out"),
    [
        ((0, 1, 90_000, 3, 4, 5), (0, 1, 3, 4, 5), f"/odom: 1 of 6 {LATER}"),
        ((0, 1, 2, 2, 3), (0, 1, 2, 3), ""),
        ((0, 1, 2, 0, 1, 2, 3, 4), (0, 1, 2, 3, 4), ""),
        ((0, 3, 1, 2, 4), (0, 1, 2, 4), f"/odom: 1 of 5 {LATER}"),
    ],
    ids=["from the future", "twice", "again", "one early"],
)
def test_of_odometry_the_most_poses_of_ascending_stamps_are_used(
    stamps: tuple[int, ...], kept: tuple[int, ...], left_out: str, tmp_path: Path
) -> None:
    poses = [odom("/odom", n, x=float(n)) for n in stamps]
    poses = [Message(m.topic, m.type, m.stamp_ns, m.fields, START_NS + k * PERIOD_NS) for k, m in enumerate(poses)]
    log = open_log(write_mcap(tmp_path / "a", [*(laser(k) for k in range(6)), *poses]))
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry.odom_T_base.xyyaw[:, 0], kept)
    assert [w for w in log.warnings if "left out" in w] == ([left_out] if left_out else [])


def test_odometry_that_lies_in_the_file_out_of_order_is_used_in_the_order_of_recording(tmp_path: Path) -> None:
    swapped = [odom("/odom", k, x=float(k)) for k in (3, 4, 5, 0, 1, 2)]
    log = open_log(write_mcap(tmp_path / "a", [*(laser(k) for k in range(6)), *swapped]))
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry.odom_T_base.xyyaw[:, 0], range(6))
    assert not any("left out" in w for w in log.warnings)


@pytest.mark.parametrize("length", [1e-3, 1.02, 3.0])
def test_the_length_of_a_quaternion_does_not_matter(length: float, tmp_path: Path) -> None:
    q = {"x": 0.0, "y": 0.0, "z": length * np.sin(0.4), "w": length * np.cos(0.4)}
    log = open_log(write_mcap(tmp_path / "a", [laser(0), laser(1), odom("/odom", 0, q=q), odom("/odom", 1, q=q)]))
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry.odom_T_base.xyyaw[:, 2], 0.8)


def test_poses_without_an_orientation_are_left_out_and_told(tmp_path: Path) -> None:
    none = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0}
    log = open_log(write_mcap(tmp_path / "a", [laser(0), laser(1), odom("/odom", 0), odom("/odom", 1, q=none)]))
    assert log.odometry is not None
    assert len(log.odometry.odom_T_base) == 1
    said = "/odom: 1 of 2 poses are left out, not finite, beyond 10^8 m or with a quaternion of zeros"
    assert any(said in w for w in log.warnings)


def test_odometry_without_a_mounting_is_the_lasers_own_and_told(tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", [laser(0), odom("/odom", 0, x=3.0)]))
    assert log.odometry is not None
    assert log.odometry.odom_T_laser[0].x_m == 3.0
    assert log.base_T_laser is None
    assert any("taken as the laser's own" in w for w in log.warnings)


@pytest.mark.parametrize("late", [-100, 100])
def test_odometry_of_another_time_is_not_used_and_told(late: int, tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", [laser(0), laser(1), odom("/odom", late), odom("/odom", late + 1)]))
    assert log.odometry is None
    assert [w for w in log.warnings if "odom" in w] == [
        "/odom: odometry and scans share no time; it is not used, check its clock"
    ]


def test_mounting_is_composed_along_the_chain_of_frames(tmp_path: Path) -> None:
    chain = [
        tf("/base_footprint", "/base_link", x=1.0, yaw=pi / 2),
        tf("base_link", "laser", "/tf", x=1.0, z=0.3),  # constant, though on /tf
        tf("odom", "base_footprint", "/tf", 0),
        tf("odom", "base_footprint", "/tf", 1, x=1.0),
    ]
    log = open_log(write_mcap(tmp_path / "a", [*chain, laser(0, frame_id="/laser"), laser(1)]))
    assert (log.base_frame, log.mounting_source) == ("base_footprint", "tf_static")
    assert log.base_T_laser is not None
    np.testing.assert_allclose(log.base_T_laser.as_array(), (1.0, 1.0, pi / 2), atol=1e-12)


@pytest.mark.parametrize("options", [{}, {"extrinsic": Pose(0.5, 0.0, 0.0)}])
def test_mountings_that_contradict_each_other_are_told(options: dict[str, Pose], tmp_path: Path) -> None:
    twice = [tf("base_link", "laser", x=x) for x in (0.1, 0.1, 0.3)]
    path = write_mcap(tmp_path / "a", [*twice, tf("base_link", "camera"), laser(0), laser(1)])
    log = open_log(path, **options)
    assert log.base_T_laser == (Pose(0.5, 0.0, 0.0) if options else Pose(0.3, 0.0, 0.0))
    assert any("several transforms from 'base_link' to 'laser'" in w for w in log.warnings) == (not options)
    assert not open_log(write_mcap(tmp_path / "b", [*twice[:2], laser(0), laser(1)])).warnings


def test_transforms_that_move_are_no_mounting(tmp_path: Path) -> None:
    turning = [tf("base_link", "laser", "/tf", k, yaw=0.1 * k) for k in range(3)]
    assert open_log(write_mcap(tmp_path / "a", [laser(0), *turning])).base_T_laser is None


@pytest.mark.parametrize(
    ("q", "word"),
    [({"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}, "upside down"), ({"x": 0.3, "y": 0.0, "z": 0.0, "w": 0.95}, "tilted")],
)
def test_laser_that_is_not_level_is_told(q: dict[str, float], word: str, tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", [laser(0), tf("base_link", "laser", q=q)]))
    assert any(word in w for w in log.warnings)


def test_scans_of_a_laser_upside_down_are_turned_over(tmp_path: Path) -> None:
    mounted = tf("base_link", "laser", x=0.2, q={"x": sqrt(0.5), "y": sqrt(0.5), "z": 0.0, "w": 0.0})
    path = write_mcap(tmp_path / "a", [laser(0), mounted, laser(1)])
    log = open_log(path)
    assert log.base_T_laser is not None
    np.testing.assert_allclose(log.base_T_laser.as_array(), (0.2, 0.0, pi / 2), atol=1e-12)
    (scan, _), recorded = log.scans(), log.sensor
    np.testing.assert_array_equal(scan.spec.angles_rad, -recorded.angles_rad)
    assert any("turned over" in w for w in log.warnings)
    told = open_log(path, extrinsic=Pose(0.2, 0.0, 1.0))
    assert next(told.scans()).spec == recorded
    assert any("used as recorded" in w for w in told.warnings)


def test_progress_ascends_to_the_size_of_the_file(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a", drive(200))
    told: list[tuple[int, int]] = []
    open_log(path, progress=lambda done, total: told.append((done, total)))
    done = [d for d, _ in told]
    assert done == sorted(done)
    assert {total for _, total in told} == {path.stat().st_size}
    assert 0.8 * path.stat().st_size < done[-1] <= path.stat().st_size


def test_topics_are_listed_with_type_encoding_and_count(tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", drive(5), ros=1))
    assert [(t.name, t.type, t.encoding, t.count) for t in log.topics] == [
        ("/odom", ODOM, "ros1", 5),
        ("/scan", LASER, "ros1", 5),
        ("/tf_static", TF, "ros1", 1),
    ]


@pytest.mark.parametrize("start_s", [float("nan"), float("inf"), -5.0])
def test_a_start_that_is_no_time_is_refused(start_s: float, tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", drive(3))
    with pytest.raises(UsageError, match=r"--start .* is no time"):
        open_log(tmp_path / "a.mcap", start_s=start_s)


def test_times_of_recording_that_no_clock_tells_are_taken(tmp_path: Path) -> None:
    never = 2**64 - 1  # the largest that an MCAP file holds
    messages = [replace(message, log_ns=never) for message in drive(5)]
    log = open_log(write_mcap(tmp_path / "a", messages))
    assert (log.counts.usable, len(log.odometry.odom_T_base)) == (5, 5)


def test_two_lasers_on_one_topic_are_chosen_by_frame_or_merged(tmp_path: Path) -> None:
    """Scans of two frames on one topic, with the same stamps: none is taken for the other's."""
    scans = [laser(k, frame_id=f"laser_{k % 2}", beams=16 + 4 * (k % 2)) for k in range(40)]
    scans = [replace(scan, stamp_ns=START_NS + k // 2 * PERIOD_NS) for k, scan in enumerate(scans)]
    mounts = [tf("base_link", f"laser_{n}", x=0.1 + n, yaw=0.5 * n) for n in range(2)]
    path = write_mcap(tmp_path / "a", [*mounts, *scans])
    for topic in (None, "/scan"):
        with pytest.raises(TopicError, match=r"/scan@laser_0 \(20 scans\), /scan@laser_1 \(20 scans\); choose one"):
            open_log(path, topic=topic)
    for n in range(2):
        log = open_log(path, topic=f"/scan@laser_{n}")
        assert (log.topic, log.frame_id, log.counts.total, len(log)) == (f"/scan@laser_{n}", f"laser_{n}", 20, 20)
        assert log.base_T_laser == pytest.approx(Pose(0.1 + n, 0.0, 0.5 * n))
        assert all(np.array_equal(a.ranges_m, b[1], True) for a, b in zip(log.scans(), log._reread(), strict=True))
    merged = open_log(path, topic="/scan@laser_0,/scan@laser_1")
    assert (len(merged), merged.sensor.beams > 40) == (20, True)
    with pytest.raises(TopicError, match="no scans on topic '/scan@other'"):
        open_log(path, topic="/scan@other")


def test_a_frame_that_is_renamed_once_is_of_one_laser(tmp_path: Path) -> None:
    log = open_log(write_mcap(tmp_path / "a", [laser(k, frame_id="ab"[k > 9]) for k in range(40)]))
    assert (log.topic, len(log), log.frame_id) == ("/scan", 40, "a")
    assert any("the frame of the scans changes on the way (a, b)" in text for text in log.warnings)


@pytest.mark.parametrize(
    ("topics", "scan", "chosen"),
    [
        (["/robot1/odom", "/robot2/odom", "/robot2/scan"], "/robot1/scan", "/robot1/odom"),
        (["/robot1/odom", "/robot2/odom"], "/robot1/front/scan", "/robot1/odom"),
        (["/odom", "/robot2/odom", "/robot2/scan"], "/robot1/scan", "/odom"),
        (["/robot2/odom"], "/robot1/scan", None),
        (["/a/odom", "/b/odom", "/b/scan"], "/a/scan", "/a/odom"),
        (["/b/odom", "/b/scan"], "/a/scan", None),
        (["/wheels/odom"], "/lidar/scan", "/wheels/odom"),
        (["/tb3/odom", "/tb3/camera/odom"], "/tb3/scan", "/tb3/odom"),
        (["/base_pose_ground_truth"], "/scan", None),
        (["/gt/odom", "/odom"], "/scan", "/odom"),
        (["/robot1/ground_truth", "/robot1/wheels"], "/robot1/scan", "/robot1/wheels"),
    ],
)
def test_odometry_and_inertial_sensor_are_those_of_the_robot(
    topics: list[str], scan: str, chosen: str | None, tmp_path: Path
) -> None:
    scans = [laser(k, topic=name) for k in range(20) for name in (scan, *(t for t in topics if "scan" in t))]
    motion = [odom(name, k) for k in range(20) for name in topics if "scan" not in name]
    turns = [
        Message(name.replace("odom", "imu"), IMU, START_NS + k * PERIOD_NS, {"rates": (0.0, 0.0, 0.1)})
        for k in range(20)
        for name in topics
        if name.endswith("odom")
    ]
    log = open_log(write_mcap(tmp_path / "a", [*scans, *motion, *turns]), topic=scan)
    assert (log.odometry and log.odometry.topic) == chosen
    if chosen and chosen.endswith("odom"):
        assert log.imu is not None
        assert log.imu.topic == chosen.replace("odom", "imu")
    truths = [name for name in topics if "truth" in name or "gt" in name]
    offered = [text for text in log.warnings if "--truth topic:" in text]
    assert len(offered) == len(truths)
    if "ground_truth" in "".join(topics):
        truth = open_log(tmp_path / "a", topic=scan, truth="auto").truth
        assert truth is not None
        assert truth.topic == truths[0]


def test_the_attitude_is_that_of_the_robot(tmp_path: Path) -> None:
    scans = [laser(k, topic=f"/robot{n}/scan") for k in range(20) for n in (1, 2)]
    tilts = [
        Message(f"/robot{n}/attitude", POSE, START_NS + k * PERIOD_NS, {"x": 0.0, "y": 0.0, "z": 1.0 * n, "yaw": 0.0})
        for k in range(20)
        for n in (1, 2)
    ]
    path = write_mcap(tmp_path / "a", [*scans, *tilts])
    for n in (1, 2):
        attitude = open_log(path, topic=f"/robot{n}/scan").attitude
        assert attitude is not None
        assert attitude.topic == f"/robot{n}/attitude"


def test_transforms_of_another_robot_are_no_mounting(tmp_path: Path) -> None:
    scans = [laser(k, topic="/robot1/scan") for k in range(4)]
    log = open_log(write_mcap(tmp_path / "a", [tf("base_link", "laser", "/robot2/tf_static", x=0.3), *scans]))
    assert log.base_T_laser is None


def test_a_mounting_in_tf_that_moves_after_a_rest_is_said_to_move(tmp_path: Path) -> None:
    """Transforms that repeat the one before are not looked at again; the next other one is."""
    yaws = [0.0] * 10 + [0.3] * 10 + [0.0] * 10
    turns = [tf("base_link", "laser", "/tf", k, yaw=yaw) for k, yaw in enumerate(yaws)]
    motion = [odom("/odom", k) for k in range(30)]
    log = open_log(write_mcap(tmp_path / "a", [*turns, *motion, *(laser(k) for k in range(30))]))
    assert log.base_T_laser is None
    assert any("the transform from 'base_link' to 'laser' moves" in text for text in log.warnings)
