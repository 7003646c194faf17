"""A run put back into its log: what was recorded stays as it was, and every frame is found on the map."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from mavnav.cli import run
from mavnav.ground_truth.tables import read_tum
from mavnav.pose import Pose, Trajectory, yaw_of_quaternion
from support.field_logs import START_S, drive_log, poses_at, tour
from support.log_files import TF, Message, write_bag1, write_bag2, write_mcap

BASE_T_LASER = Pose(0.2, -0.1, 0.4)
SECONDS = 3.0


def transform(parent: str, child: str, stamp_ns: int, pose: Pose, topic: str = "/tf") -> Message:
    fields = dict(zip(("x", "y", "yaw"), pose, strict=True))
    return Message(topic, TF, stamp_ns, {"parent": parent, "child": child} | fields)


def messages(parent: str) -> list[Message]:
    """Return a drive with the base in a frame ``parent``, and the frame of a camera on it."""
    path, start_ns = tour(SECONDS + 0.5), START_S * 10**9
    static = [
        transform("base_link", "laser", start_ns, BASE_T_LASER, "/tf_static"),
        transform("base_link", "camera", start_ns, Pose(0.3, 0.0, 0.0), "/tf_static"),
    ]
    scans = [message for message in drive_log(SECONDS, beams=180) if message.topic == "/scan"]
    odometry = [
        transform(
            parent, "base_link", stamp_ns, Pose(*poses_at(path, np.array([stamp_ns]))[0]) @ BASE_T_LASER.inverse()
        )
        for stamp_ns in range(start_ns, start_ns + int((SECONDS + 0.4) * 1e9), 33_000_000)
    ]
    return static + sorted([*scans, *odometry], key=lambda message: message.stamp_ns)


def augmented(folder: Path, log: Path) -> Path:
    assert run(["replay", str(log), "-q", "--odom", "off", "-o", str(folder / "run")]) == 0
    assert run(["convert", str(log), str(folder / "with_map.mcap"), "--run", str(folder / "run"), "-q"]) == 0
    return folder / "with_map.mcap"


def stored(path: Path) -> list[tuple[str, int, int, bytes]]:
    """Return topic, times and bytes of the messages of an MCAP, by its own library."""
    with path.open("rb") as file:
        return [
            (channel.topic, message.log_time, message.publish_time, message.data)
            for _, channel, message in make_reader(file).iter_messages()
        ]


def decoded(path: Path) -> list[tuple[str, Any]]:
    """Return topics and messages of a log, by rosbags."""
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        return [(c.topic, reader.deserialize(raw, c.msgtype)) for c, _, raw in reader.messages()]


def planar(message: Any) -> Pose:
    p, q = message.transform.translation, message.transform.rotation
    return Pose(p.x, p.y, yaw_of_quaternion(q.x, q.y, q.z, q.w))


def look_up(transforms: list[Any], frames: tuple[str, ...], stamp_ns: int) -> Pose:
    """Follow named frames down from the first, each transform interpolated: the slow twin of tf2."""
    pose = Pose()
    for parent, child in pairwise(frames):
        edge = [t for t in transforms if (t.header.frame_id, t.child_frame_id) == (parent, child)]
        edge.sort(key=lambda t: (t.header.stamp.sec, t.header.stamp.nanosec))
        stamps = [t.header.stamp.sec * 10**9 + t.header.stamp.nanosec for t in edge]
        found = Trajectory.of(stamps, [*map(planar, edge)]).at(stamp_ns, 10**10) if len(edge) > 1 else planar(edge[0])
        assert found is not None
        pose = pose @ found
    return pose


def check_transforms(folder: Path, path: Path, frames: tuple[str, ...]) -> None:
    transforms = [t for topic, m in decoded(path) if topic.startswith("/tf") for t in m.transforms]
    assert all(
        n == 1
        for n in Counter(child for _, child in {(t.header.frame_id, t.child_frame_id) for t in transforms}).values()
    )  # one parent each
    map_T_laser = read_tum(folder / "run" / "trajectory.tum")
    for k in np.linspace(0, len(map_T_laser) - 1, 10).astype(int).tolist():
        away_m, turned_rad = look_up(transforms, frames, int(map_T_laser.stamps_ns[k])).gap(map_T_laser[k])
        assert away_m < 0.001
        assert turned_rad < 0.001


@pytest.mark.parametrize("write", [write_mcap, write_bag2, write_bag1])
def test_what_was_recorded_is_unchanged_and_lies_on_the_map(tmp_path: Path, write) -> None:
    name = {write_mcap: "log.mcap", write_bag2: "log", write_bag1: "log.bag"}[write]
    log = write(tmp_path / name, messages("odom"))
    out = augmented(tmp_path, log)
    assert run(["convert", str(log), str(tmp_path / "plain.mcap"), "-q"]) == 0
    before, after = stored(log if write is write_mcap else tmp_path / "plain.mcap"), stored(out)
    added = Counter(after) - Counter(before)
    assert not Counter(before) - Counter(after)
    assert {topic for topic, *_ in added} == {"/tf", "/pose", "/map", "/path", "/markers"}
    check_transforms(tmp_path, out, ("map", "odom", "base_link", "laser"))
    assert [time for _, time, *_ in after] == sorted(time for _, time, *_ in after)
    with out.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert Counter(channel.topic for channel in summary.channels.values())["/tf"] == 1


@pytest.mark.slow
def test_names_that_the_log_has_are_left_to_it(tmp_path: Path) -> None:
    recorded = Message("/pose", "geometry_msgs/msg/PoseStamped", START_S * 10**9, {"x": 1.0, "y": 2.0, "yaw": 0.0})
    log = write_mcap(tmp_path / "log.mcap", [recorded, *messages("map")])
    out = augmented(tmp_path, log)
    known = decoded(out)
    assert len([m for topic, m in known if topic == "/pose"]) == 1
    for topic, message in known:
        if topic in {"/map", "/path", "/mavnav/pose"}:
            assert message.header.frame_id == "mavnav_map"
        if topic == "/markers":
            assert {marker.header.frame_id for marker in message.markers} <= {"mavnav_map"}
        if topic == "/path":
            assert {pose.header.frame_id for pose in message.poses} == {"mavnav_map"}
    check_transforms(tmp_path, out, ("mavnav_map", "map", "base_link", "laser"))


@pytest.mark.slow
def test_a_log_without_transforms_gets_the_laser_on_the_map(tmp_path: Path) -> None:
    log = write_mcap(tmp_path / "log.mcap", [m for m in messages("odom") if m.topic == "/scan"])
    check_transforms(tmp_path, augmented(tmp_path, log), ("map", "laser"))


def test_a_run_of_another_log_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = write_mcap(tmp_path / "log.mcap", messages("odom"))
    other = write_mcap(tmp_path / "other.mcap", messages("map"))
    assert run(["replay", str(log), "-q", "--outputs", "trajectory,mcap", "-o", str(tmp_path / "run")]) == 0
    assert run(["convert", str(other), str(tmp_path / "out.mcap"), "--run", str(tmp_path / "run"), "-q"]) == 2
    assert "is a run of" in capsys.readouterr().err
    assert not (tmp_path / "out.mcap").exists()
