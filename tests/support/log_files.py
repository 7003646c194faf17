"""Small logs of every format, written by the libraries of the formats from a list of messages."""

from __future__ import annotations

import json
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import zstandard
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from msgspec import Struct, field
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

LASER = "sensor_msgs/msg/LaserScan"
IMU = "sensor_msgs/msg/Imu"
ODOM = "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH = "nav_msgs/msg/Path"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000


@cache
def store(ros: int) -> Any:
    if ros == 2:
        return get_typestore(Stores.ROS2_HUMBLE)
    noetic = get_typestore(Stores.ROS1_NOETIC)
    noetic.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return noetic


class Message(Struct, frozen=True):
    """A message to write; ``build`` converts it to a message of ROS 1 or ROS 2."""

    topic: str
    type: str
    stamp_ns: int
    fields: dict[str, Any] = field(default_factory=dict)
    log_ns: int | None = None

    @property
    def time_ns(self) -> int:
        return self.stamp_ns if self.log_ns is None else self.log_ns


def _header(types: dict[str, Any], stamp_ns: int, frame_id: str, ros: int) -> Any:
    stamp = types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    extra = {"seq": 0} if ros == 1 else {}
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id, **extra)


def build(message: Message, ros: int) -> Any:
    types, f = store(ros).types, message.fields
    if message.type == LASER:
        defaults = {"angle_max": f["angle_min"] + f["angle_increment"] * (len(f["ranges"]) - 1)}
        defaults |= {"time_increment": 0.0, "scan_time": 0.1, "range_min": 0.1, "range_max": 10.0}
        values = defaults | {k: v for k, v in f.items() if k != "frame_id"}
        values["ranges"] = np.asarray(values["ranges"], dtype=np.float32)
        header = _header(types, message.stamp_ns, f.get("frame_id", "laser"), ros)
        return types[LASER](header=header, intensities=np.array([], dtype=np.float32), **values)
    if message.type == IMU:
        none, vector = np.zeros(9), types["geometry_msgs/msg/Vector3"]
        turn = types["geometry_msgs/msg/Quaternion"](*f.get("xyzw", (0.0, 0.0, 0.0, 1.0)))
        covariance = none if "xyzw" in f else np.r_[-1.0, none[1:]]
        header, gravity = _header(types, message.stamp_ns, "imu", ros), f.get("up", (0.0, 0.0, 9.81))
        return types[IMU](header, turn, covariance, vector(*f["rates"]), none, vector(*gravity), none)
    if message.type == POSE:
        return types[POSE](header=_header(types, message.stamp_ns, "world", ros), pose=_pose(types, f))
    if message.type == POSE_COVARIANCE:
        pose = types["geometry_msgs/msg/PoseWithCovariance"](pose=_pose(types, f), covariance=np.zeros(36))
        return types[POSE_COVARIANCE](header=_header(types, message.stamp_ns, "world", ros), pose=pose)
    if message.type == PATH:
        poses = [build(pose, ros) for pose in f["poses"]]
        return types[PATH](header=_header(types, message.stamp_ns, "world", ros), poses=poses)
    if message.type == ODOM:
        zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        pose = _pose(types, f)
        covariance = np.zeros(36)
        twist = types["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
        return types[ODOM](
            header=_header(types, message.stamp_ns, "odom", ros),
            child_frame_id=f.get("child", "base_link"),
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=covariance),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=covariance),
        )
    transform = types["geometry_msgs/msg/Transform"](
        translation=types["geometry_msgs/msg/Vector3"](x=f["x"], y=f["y"], z=f.get("z", 0.0)),
        rotation=types["geometry_msgs/msg/Quaternion"](**f["q"]) if "q" in f else _yaw(types, f["yaw"]),
    )
    stamped = types["geometry_msgs/msg/TransformStamped"](
        header=_header(types, message.stamp_ns, f["parent"], ros), child_frame_id=f["child"], transform=transform
    )
    return stamped if message.type == TRANSFORM else types[TF](transforms=[stamped])


def _pose(types: dict[str, Any], fields: dict[str, Any]) -> Any:
    position = types["geometry_msgs/msg/Point"](x=fields["x"], y=fields["y"], z=fields.get("z", 0.0))
    turn = types["geometry_msgs/msg/Quaternion"](**fields["q"]) if "q" in fields else _yaw(types, fields["yaw"])
    return types["geometry_msgs/msg/Pose"](position=position, orientation=turn)


def _yaw(types: dict[str, Any], yaw: float) -> Any:
    return types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))


def laser(k: int, *, topic: str = "/scan", beams: int = 16, **fields: Any) -> Message:
    """Return scan number k, with random ranges from seed k, one of them 0."""
    ranges = np.random.default_rng(k).uniform(0.5, 9.0, beams).astype(np.float32)
    ranges[k % beams] = 0.0
    defaults = {"angle_min": -1.0, "angle_increment": 2.0 / beams, "ranges": ranges} | fields
    return Message(topic, LASER, START_NS + k * PERIOD_NS, defaults)


def drive(scans: int = 25) -> list[Message]:
    """Return scans, odometry of a straight drive, and the mounting."""
    mounting = {"parent": "base_link", "child": "laser", "x": 0.2, "y": 0.1, "yaw": 0.5}
    messages = [Message("/tf_static", TF, START_NS, mounting)]
    for k in range(scans):
        messages.append(laser(k))
        messages.append(Message("/odom", ODOM, START_NS + k * PERIOD_NS, {"x": 0.1 * k, "y": 0.0, "yaw": 0.0}))
    return messages


def serialized(message: Message, ros: int) -> bytes:
    built = build(message, ros)
    return bytes(
        store(1).serialize_ros1(built, message.type) if ros == 1 else store(2).serialize_cdr(built, message.type)
    )


def write_mcap(
    path: Path,
    messages: Sequence[Message],
    *,
    ros: int = 2,
    compression: str = "ZSTD",
    chunk_size: int = 2000,
    **options: Any,
) -> Path:
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType[compression], chunk_size=chunk_size, **options)
        writer.start(profile=f"ros{ros}")
        channels: dict[str, int] = {}
        for message in messages:
            if message.topic not in channels:
                name = message.type if ros == 2 else message.type.replace("/msg/", "/")
                schema = writer.register_schema(name, f"ros{ros}msg", b"")
                channels[message.topic] = writer.register_channel(message.topic, "cdr" if ros == 2 else "ros1", schema)
            data = serialized(message, ros)
            writer.add_message(channels[message.topic], message.time_ns, data, message.time_ns)
        writer.finish()
    return path


def copy_messages(
    source: Path,
    target: Path,
    topics: Callable[[str, int], list[str]],
    change: Callable[[str, int, bytes], bytes] = lambda topic, scans, data: data,
) -> None:
    """Copy an MCAP file in many chunks, each message to the ``topics``, as ``change`` returns it.

    Both are called with the topic and the number of the latest scan, from 1.
    """
    with source.open("rb") as stream, target.open("wb") as sink:
        writer, scans = McapWriter(sink, chunk_size=64 * 1024), 0
        channels: dict[str, int] = {}
        writer.start(profile="ros2")
        for schema, channel, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
            scans += channel.topic == "/scan"
            data = change(channel.topic, scans, message.data)
            for topic in topics(channel.topic, scans):
                if topic not in channels:
                    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[topic] = writer.register_channel(topic, channel.message_encoding, schema_id)
                writer.add_message(channels[topic], message.log_time, data, message.publish_time)
        writer.finish()


def write_bag1(path: Path, messages: Sequence[Message], compression: str = "") -> Path:
    writer = Bag1Writer(path)
    writer.chunk_threshold = 2000
    if compression:
        writer.set_compression(Bag1Writer.CompressionFormat[compression])
    with writer:
        connections: dict[str, Any] = {}
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(message.topic, message.type, typestore=store(1))
            writer.write(connections[message.topic], message.time_ns, serialized(message, 1))
    return path


def write_bag2(path: Path, messages: Sequence[Message], storage: str = "SQLITE3", mode: str = "NONE") -> Path:
    writer = Bag2Writer(path, version=9, storage_plugin=StoragePlugin[storage])
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(message.topic, message.type, typestore=store(2))
            writer.write(connections[message.topic], message.time_ns, serialized(message, 2))
    return path


def write_zstd(path: Path, source: Path) -> Path:
    """Compress a file in blocks of 1000 bytes, so that small files have several blocks."""
    data, packer = source.read_bytes(), zstandard.ZstdCompressor().compressobj()
    with path.open("wb") as file:
        for at in range(0, len(data), 1000):
            file.write(packer.compress(data[at : at + 1000]))
            file.write(packer.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK))
        file.write(packer.flush())
    return path


def _lone_db3(path: Path, messages: Sequence[Message]) -> Path:
    return next(write_bag2(path, messages).glob("*.db3"))


def _packed(path: Path, messages: Sequence[Message]) -> Path:
    return write_zstd(path, write_mcap(path.with_suffix(".inner"), messages))


WRITERS: dict[str, tuple[str, Callable[[Path, Sequence[Message]], Path]]] = {
    **{
        f"mcap-{name.lower()}": ("mcap", lambda p, m, name=name: write_mcap(p, m, compression=name))
        for name in ("NONE", "LZ4", "ZSTD")
    },
    "mcap-unchunked": ("mcap", lambda p, m: write_mcap(p, m, use_chunking=False, enable_data_crcs=True)),
    "mcap-ros1": ("mcap", lambda p, m: write_mcap(p, m, ros=1)),
    "mcap-file-zstd": ("mcap-zstd", _packed),
    "bag1": ("rosbag1", write_bag1),
    "bag1-bz2": ("rosbag1", lambda p, m: write_bag1(p, m, "BZ2")),
    "bag1-lz4": ("rosbag1", lambda p, m: write_bag1(p, m, "LZ4")),
    "bag2-sqlite": ("rosbag2-sqlite3", write_bag2),
    "bag2-sqlite-message": ("rosbag2-sqlite3", lambda p, m: write_bag2(p, m, mode="MESSAGE")),
    "bag2-sqlite-file": ("rosbag2-sqlite3-zstd", lambda p, m: write_bag2(p, m, mode="FILE")),
    "bag2-mcap": ("rosbag2-mcap", lambda p, m: write_bag2(p, m, "MCAP")),
    "bag2-mcap-file": ("rosbag2-mcap-zstd", lambda p, m: write_bag2(p, m, "MCAP", "FILE")),
    "db3": ("rosbag2-sqlite3", _lone_db3),
}
"""Name -> (format that the survey reports, writer)."""


def foxglove_json(path: Path, scans: Sequence[dict[str, Any]], **options: Any) -> Path:
    with path.open("wb") as file:
        writer = McapWriter(file, **options)
        writer.start()
        schema = writer.register_schema("foxglove.LaserScan", "jsonschema", b"{}")
        channel = writer.register_channel("/scan", "json", schema)
        for k, scan in enumerate(scans):
            writer.add_message(channel, START_NS + k * PERIOD_NS, json.dumps(scan).encode(), START_NS)
        writer.finish()
    return path


def foxglove_protobuf(path: Path, scans: Sequence[dict[str, Any]], **options: Any) -> Path:
    """Write scans with an own schema that has the field numbers of Foxglove's."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP

    kind = descriptor_pb2.FieldDescriptorProto
    files = descriptor_pb2.FileDescriptorSet()
    TIMESTAMP.CopyToProto(files.file.add())
    file = files.file.add(name="foxglove.proto", package="foxglove", syntax="proto3", dependency=[TIMESTAMP.name])
    for name, axes in (("Vector3", "xyz"), ("Quaternion", "xyzw")):
        message = file.message_type.add(name=name)
        for number, axis in enumerate(axes, 1):
            message.field.add(name=axis, number=number, type=kind.TYPE_DOUBLE, label=kind.LABEL_OPTIONAL)
    pose = file.message_type.add(name="Pose")
    scan = file.message_type.add(name="LaserScan")
    for owner, number, name, type_name in (
        (pose, 1, "position", ".foxglove.Vector3"),
        (pose, 2, "orientation", ".foxglove.Quaternion"),
        (scan, 1, "timestamp", ".google.protobuf.Timestamp"),
        (scan, 3, "pose", ".foxglove.Pose"),
    ):
        owner.field.add(name=name, number=number, type=kind.TYPE_MESSAGE, type_name=type_name, label=1)
    scan.field.add(name="frame_id", number=2, type=kind.TYPE_STRING, label=1)
    for number, name, label in ((4, "start_angle", 1), (5, "end_angle", 1), (6, "ranges", 3)):
        scan.field.add(name=name, number=number, type=kind.TYPE_DOUBLE, label=label)
    pool = descriptor_pool.DescriptorPool()
    for each in files.file:
        pool.Add(each)
    message_class = message_factory.GetMessageClass(pool.FindMessageTypeByName("foxglove.LaserScan"))
    with path.open("wb") as stream:
        writer = McapWriter(stream, **options)
        writer.start()
        schema = writer.register_schema("foxglove.LaserScan", "protobuf", files.SerializeToString())
        channel = writer.register_channel("/scan", "protobuf", schema)
        for k, fields in enumerate(scans):
            message = message_class(
                **{k: v for k, v in fields.items() if k in ("frame_id", "start_angle", "end_angle")}
            )
            message.ranges.extend(fields["ranges"])
            message.timestamp.seconds, message.timestamp.nanos = (
                fields["timestamp"]["sec"],
                fields["timestamp"]["nsec"],
            )
            writer.add_message(channel, START_NS + k * PERIOD_NS, message.SerializeToString(), START_NS)
        writer.finish()
    return path
