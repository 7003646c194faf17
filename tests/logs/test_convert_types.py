"""`mavnav convert`: the definition of a type decides how its messages are written, not the first message."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mavnav.logs import survey
from mavnav.logs.records import Topic
from mavnav.logs.writing.convert import convert_log
from support.log_files import START_NS, drive, serialized, store, write_bag1

if TYPE_CHECKING:
    from pathlib import Path

RANGE = "sensor_msgs/msg/Range"
MARKERS = "visualization_msgs/msg/MarkerArray"


def without_definitions(folder: Path, topic: str, kind: str, messages: list[bytes], types: Any = None) -> Path:
    """Write a bag as ROS 2 did before it stored definitions."""
    with Bag2Writer(folder, version=8) as writer:
        connection = writer.add_connection(topic, kind, typestore=types or store(2))
        for k, message in enumerate(messages):
            writer.write(connection, START_NS + k, message)
    with closing(sqlite3.connect(next(folder.glob("*.db3")))) as database:
        database.execute("DROP TABLE IF EXISTS message_definitions")
        database.commit()
    return folder


def sonar(range_m: float, variance: tuple[float, ...] = ()) -> bytes:
    """Return a Range, as ROS 2 Humble writes it, or Iron with its variance."""
    types = get_typestore(Stores.ROS2_IRON if variance else Stores.ROS2_HUMBLE)
    stamp = types.types["builtin_interfaces/msg/Time"](1, 2)
    header = types.types["std_msgs/msg/Header"](stamp, "sonar")
    message = types.types[RANGE](header, 0, 0.1, 0.1, 3.0, range_m, *variance)
    return bytes(types.serialize_cdr(message, RANGE))


def decoded(path: Path) -> list[Any]:
    """Decode all messages of an MCAP by the definitions in it."""
    found = []
    with path.open("rb") as file:
        for schema, _, message in make_reader(file).iter_messages():
            types = get_typestore(Stores.EMPTY)
            types.register(get_types_from_msg(schema.data.decode(), schema.name))
            found.append(types.deserialize_cdr(message.data, schema.name))
    return found


@pytest.mark.parametrize("variance", [(), (0.25,)])
def test_a_definition_fits_the_recorded_layout(tmp_path: Path, variance: tuple[float, ...]) -> None:
    bag = without_definitions(tmp_path / "bag", "/sonar", RANGE, [sonar(1.5, variance), sonar(2.0, variance)])
    assert convert_log(bag, tmp_path / "b.mcap").warnings == ()
    messages = decoded(tmp_path / "b.mcap")
    assert [message.range for message in messages] == [1.5, 2.0]
    assert [hasattr(message, "variance") for message in messages] == [bool(variance)] * 2


@pytest.mark.parametrize("stored", [True, False])
def test_a_type_of_its_own_keeps_its_name_and_definition(tmp_path: Path, *, stored: bool) -> None:
    kind, text = "my_msgs/msg/Gripper", "int32 force\nstring state\n"
    types = get_typestore(Stores.ROS2_HUMBLE)
    types.register(get_types_from_msg(text, kind))
    bag, message = tmp_path / "bag", bytes(types.serialize_cdr(types.types[kind](7, "open"), kind))
    if stored:
        with Bag2Writer(bag, version=9) as writer:
            writer.write(writer.add_connection("/gripper", kind, typestore=types), START_NS, message)
    else:
        without_definitions(bag, "/gripper", kind, [message], types)
    done = convert_log(bag, tmp_path / "b.mcap")
    missing = (f"/gripper: no definition of {kind} fits its messages; they are copied without one",)
    assert done.warnings == (() if stored else missing)
    assert [topic.type for topic in survey(tmp_path / "b.mcap").topics] == [kind]
    if stored:
        assert [(m.force, m.state) for m in decoded(tmp_path / "b.mcap")] == [(7, "open")]


def test_a_merged_bag_keeps_both_definitions_of_a_type(tmp_path: Path) -> None:
    kind, texts = "my_msgs/msg/Gripper", ("int32 force\n", "int32 force\nint32 speed\n")
    with Bag1Writer(tmp_path / "a.bag") as writer:
        for k, text in enumerate(texts):
            types = get_typestore(Stores.EMPTY)
            types.register(get_types_from_msg(text, kind))
            connection = writer.add_connection("/gripper", kind, typestore=types, callerid=f"/node{k}")
            message = types.types[kind](*range(7, 8 + k))
            writer.write(connection, START_NS + k, bytes(types.serialize_ros1(message, kind)))
    done = convert_log(tmp_path / "a.bag", tmp_path / "b.mcap")
    assert done.topics == survey(tmp_path / "a.bag").topics == (Topic("/gripper", kind, "ros1", 2),)
    with (tmp_path / "b.mcap").open("rb") as file:
        found = [(schema.data.decode(), len(message.data)) for schema, _, message in make_reader(file).iter_messages()]
    assert found == [(texts[0], 4), (texts[1], 8)]


def test_messages_that_no_definition_fits_get_none(tmp_path: Path) -> None:
    bag = without_definitions(tmp_path / "bag", "/sonar", RANGE, [sonar(1.5) + bytes(40)])
    done = convert_log(bag, tmp_path / "b.mcap")
    assert done.warnings == (f"/sonar: no definition of {RANGE} fits its messages; they are copied without one",)
    with (tmp_path / "b.mcap").open("rb") as file:
        ((schema, channel, message),) = make_reader(file).iter_messages()
    assert (schema.name, schema.encoding, schema.data, channel.message_encoding) == (RANGE, "", b"", "cdr")
    assert message.data == sonar(1.5) + bytes(40)


def marker(number: int) -> Any:
    types = store(1).types
    three = types["geometry_msgs/msg/Vector3"](1.0, 1.0, 1.0)
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](1, 0), "map")
    color, forever = types["std_msgs/msg/ColorRGBA"](1.0, 0.0, 0.0, 1.0), types["builtin_interfaces/msg/Duration"](0, 0)
    return types["visualization_msgs/msg/Marker"](
        header, "a", number, 0, 0, pose, three, color, forever, False, [], [], "", "", False
    )


def test_an_empty_first_message_does_not_decide_for_the_others(tmp_path: Path) -> None:
    """Empty arrays of markers fit both definitions, that of ROS 1 and that of ROS 2."""
    with Bag1Writer(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/markers", MARKERS, typestore=store(1))
        for k in range(10):
            message = store(1).types[MARKERS]([marker(k)] if k else [])
            writer.write(connection, START_NS + k, store(1).serialize_ros1(message, MARKERS))
    done = convert_log(tmp_path / "a.bag", tmp_path / "b.mcap")
    assert (done.left_out, done.damage) == ({}, ())
    assert [(topic.encoding, topic.count) for topic in done.topics] == [("ros1", 10)]


def test_a_first_scan_that_is_cut_does_not_decide_for_the_others(tmp_path: Path) -> None:
    scans = [message for message in drive(10) if message.topic == "/scan"]
    with Bag1Writer(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/scan", scans[0].type, typestore=store(1))
        for k, scan in enumerate(scans):
            data = serialized(scan, 1)
            writer.write(connection, scan.stamp_ns, data[: 40 if k == 0 else len(data)])
    done = convert_log(tmp_path / "a.bag", tmp_path / "b.mcap")
    assert done.left_out == {"undecodable": 1}
    assert [(topic.encoding, topic.count) for topic in done.topics] == [("cdr", 9)]
    assert [len(scan.ranges) for scan in decoded(tmp_path / "b.mcap")] == [16] * 9


def test_types_that_ros_2_renamed_or_filled_are_translated(tmp_path: Path) -> None:
    types = store(1).types
    header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](1, 0), "camera")
    region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    matrices = (np.zeros(0), np.arange(9.0), np.zeros(9), np.zeros(12))
    camera = types["sensor_msgs/msg/CameraInfo"](header, 1, 1, "", *matrices, 0, 0, region)
    with Bag1Writer(tmp_path / "a.bag") as writer:
        for topic, message in (("/camera", camera), ("/empty", None)):
            kind = camera.__msgtype__ if message else "std_msgs/msg/Empty"
            connection = writer.add_connection(topic, kind, typestore=store(1))
            writer.write(connection, START_NS, store(1).serialize_ros1(message, kind) if message else b"")
    done = convert_log(tmp_path / "a.bag", tmp_path / "b.mcap")
    assert {topic.encoding for topic in done.topics} == {"cdr"}
    assert decoded(tmp_path / "b.mcap")[0].k.tolist() == list(range(9))


def test_a_damaged_definition_does_not_stop_the_translation(tmp_path: Path) -> None:
    path = write_bag1(tmp_path / "a.bag", drive(5))
    path.write_bytes(
        path.read_bytes().replace(b"geometry_msgs/PoseWithCovariance pose", b"@eometry_msgs/PoseWith?ovariance pose")
    )
    done = convert_log(path, tmp_path / "b.mcap")
    assert {topic.encoding for topic in done.topics} == {"cdr"}
