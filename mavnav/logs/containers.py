"""Containers to write logs to: MCAP and ROS 2 bag folders (CDR), ROS 1 bags.

Each is a context manager that gives a function ``put(topic, stamp_ns, message)``, in constant memory. Nothing in the
files depends on the clock: the time of recording is the one that is passed in, so that equal messages give equal bytes.
"""

from __future__ import annotations

import sqlite3
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer

from mavnav import __version__
from mavnav.logs import ros

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from contextlib import AbstractContextManager
    from pathlib import Path

    Put = Callable[[str, int, Any], None]


@dataclass(frozen=True, slots=True)
class Channel:
    """The type of a topic's messages, and whether a late subscriber gets the last one (latched, transient local)."""

    type: str
    latched: bool = False


CHUNK_BYTES: Final = 128 * 1024
"""Of an MCAP file: a file that is cut keeps all chunks before the cut, some four seconds of scans each."""

_FOREVER = QosTime(9223372036, 854775807)
_QOS: Final = """\
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {{sec: 9223372036, nsec: 854775807}}
  lifespan: {{sec: 9223372036, nsec: 854775807}}
  liveliness: automatic
  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}
  avoid_ros_namespace_conventions: false
"""


def qos_text(channel: Channel) -> str:
    """Return the quality of service of a channel as rosbag2 writes it into the metadata."""
    return _QOS.format(
        depth=1 if channel.latched else 10, durability="transient_local" if channel.latched else "volatile"
    )


def _qos(channel: Channel) -> Qos:
    return Qos(
        QosHistory.KEEP_LAST,
        1 if channel.latched else 10,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if channel.latched else QosDurability.VOLATILE,
        _FOREVER,
        _FOREVER,
        QosLiveliness.AUTOMATIC,
        _FOREVER,
        avoid_ros_namespace_conventions=False,
    )


@contextmanager
def write_mcap(path: Path, channels: Mapping[str, Channel]) -> Iterator[Put]:
    """Write an MCAP file of ROS 2 messages with their definitions, chunks compressed with zstd.

    Its ``put`` takes messages that are serialised already (``cdr``) as well.
    """
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library=f"mavnav {__version__}")
        schemas = {
            name: writer.register_schema(name, "ros2msg", ros.definition(name).encode())
            for name in dict.fromkeys(channel.type for channel in channels.values())
        }
        numbers = {
            topic: writer.register_channel(
                topic, "cdr", schemas[channel.type], {"offered_qos_profiles": qos_text(channel)}
            )
            for topic, channel in channels.items()
        }

        def put(topic: str, stamp_ns: int, message: Any) -> None:  # noqa: ANN401
            data = message if isinstance(message, bytes) else ros.cdr(message)
            writer.add_message(numbers[topic], stamp_ns, data, stamp_ns)

        yield put
        writer.finish()


@contextmanager
def write_bag1(path: Path, channels: Mapping[str, Channel]) -> Iterator[Put]:
    """Write a ROS 1 bag, chunks compressed with bz2: the codec whose output does not change with its version."""
    writer = Bag1Writer(path)
    writer.set_compression(Bag1Writer.CompressionFormat.BZ2)
    with writer:
        connections = {
            topic: writer.add_connection(
                topic,
                channel.type,
                typestore=ros.types_ros1(),
                callerid="/mavnav",
                latching=int(channel.latched),
            )
            for topic, channel in channels.items()
        }

        def put(topic: str, stamp_ns: int, message: Any) -> None:  # noqa: ANN401
            writer.write(connections[topic], stamp_ns, ros.ros1(message))

        yield put


@contextmanager
def write_bag2(path: Path, channels: Mapping[str, Channel]) -> Iterator[Put]:
    """Write the folder of a ROS 2 bag: sqlite3 storage and metadata.yaml. Raises OSError for what sqlite refuses."""
    writer = Bag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    try:
        with writer:
            connections = {
                topic: writer.add_connection(
                    topic, channel.type, typestore=ros.types_ros2(), offered_qos_profiles=[_qos(channel)]
                )
                for topic, channel in channels.items()
            }

            def put(topic: str, stamp_ns: int, message: Any) -> None:  # noqa: ANN401
                writer.write(connections[topic], stamp_ns, ros.cdr(message))

            yield put
    except sqlite3.Error as error:
        raise OSError(f"sqlite: {error}") from error


CONTAINERS: Final[dict[str, Callable[[Path, Mapping[str, Channel]], AbstractContextManager[Put]]]] = {
    ".mcap": write_mcap,
    ".bag": write_bag1,
    "": write_bag2,
}
"""Suffix of a log's name -> its writer; a name without one is the folder of a ROS 2 bag."""
