"""Writers of log containers: MCAP and ROS 2 bag folders (CDR), ROS 1 bags.

Each is a context manager that yields a function ``put(topic, stamp_ns, message)`` and needs constant memory. The time
of recording is ``stamp_ns``, not the clock, so that equal messages give equal bytes.
"""

from __future__ import annotations

import sqlite3
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.rosbag2.metadata import parse_qos

from mavnav.logs.messages import ros
from mavnav.logs.writing.mcap_writer import qos_text, write_serialized

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from contextlib import AbstractContextManager
    from pathlib import Path

    from mavnav.logs.writing.mcap_writer import OutputChannel

    Put = Callable[[str, int, Any], None]


@contextmanager
def write_mcap(path: Path, channels: Mapping[str, OutputChannel]) -> Iterator[Put]:
    """Write an MCAP file of ROS 2 messages with their definitions, chunks compressed with zstd."""
    with write_serialized(path, channels) as put_bytes:

        def put(topic: str, stamp_ns: int, message: Any) -> None:  # noqa: ANN401
            put_bytes(topic, stamp_ns, ros.cdr(message))

        yield put


@contextmanager
def write_bag1(path: Path, channels: Mapping[str, OutputChannel]) -> Iterator[Put]:
    """Write a ROS 1 bag, chunks compressed with bz2, whose output does not depend on the version of the library."""
    writer = Bag1Writer(path)
    writer.set_compression(Bag1Writer.CompressionFormat.BZ2)
    with writer:
        options = {topic: {"callerid": "/mavnav", "latching": int(c.latched)} for topic, c in channels.items()}
        yield _put(writer, channels, ros.types_ros1(), options, ros.ros1)


@contextmanager
def write_bag2(path: Path, channels: Mapping[str, OutputChannel]) -> Iterator[Put]:
    """Write the folder of a ROS 2 bag: sqlite3 storage and metadata.yaml. Raises OSError for errors of sqlite."""
    writer = Bag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    try:
        with writer:
            options = {topic: {"offered_qos_profiles": parse_qos(qos_text(c))} for topic, c in channels.items()}
            yield _put(writer, channels, ros.types_ros2(), options, ros.cdr)
    except sqlite3.Error as error:
        raise OSError(f"sqlite: {error}") from error


def _put(
    writer: Any,  # noqa: ANN401  (rosbags is untyped here)
    channels: Mapping[str, OutputChannel],
    types: Any,  # noqa: ANN401
    options: Mapping[str, Mapping[str, Any]],
    serialize: Callable[[Any], bytes],
) -> Put:
    """Declare the channels to a writer of rosbags, each with its options; return the function that writes to them."""
    connections = {
        topic: writer.add_connection(topic, channel.type, typestore=types, **options[topic])
        for topic, channel in channels.items()
    }

    def put(topic: str, stamp_ns: int, message: Any) -> None:  # noqa: ANN401
        writer.write(connections[topic], stamp_ns, serialize(message))

    return put


CONTAINERS: Final[dict[str, Callable[[Path, Mapping[str, OutputChannel]], AbstractContextManager[Put]]]] = {
    ".mcap": write_mcap,
    ".bag": write_bag1,
    "": write_bag2,
}
"""Suffix of a log's name -> its writer; a name without a suffix is the folder of a ROS 2 bag."""
