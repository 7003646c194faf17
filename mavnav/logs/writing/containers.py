"""Writers of log containers: MCAP and ROS 2 bag folders (CDR), ROS 1 bags.

Each is a context manager that yields a function ``put(topic, stamp_ns, message)`` and needs constant memory. The time
of recording is ``stamp_ns``, not the clock, so that equal messages give equal bytes.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.rosbag2.metadata import parse_qos

from mavnav.logs.messages import ros
from mavnav.logs.writing.mcap_writer import OutputChannel, qos_text, write_serialized

Put = Callable[[str, int, Any], None]


@contextmanager
def write_mcap(path: Path, channels: Mapping[str, OutputChannel]) -> Iterator[Put]:
    """Write an MCAP file of ROS 2 messages with their definitions, chunks compressed with zstd."""
    with write_serialized(path, channels) as put_bytes:
        yield lambda topic, stamp_ns, message: put_bytes(topic, stamp_ns, ros.cdr(message))


@contextmanager
def write_bag1(path: Path, channels: Mapping[str, OutputChannel]) -> Iterator[Put]:
    """Write a ROS 1 bag, chunks compressed with bz2, whose output does not depend on the version of the library."""
    writer = Bag1Writer(path)
    writer.set_compression(Bag1Writer.CompressionFormat.BZ2)
    with writer:
        add = partial(writer.add_connection, typestore=ros.types_ros1(), callerid="/mavnav")
        connections = {topic: add(topic, c.type, latching=int(c.latched)) for topic, c in channels.items()}
        yield lambda topic, stamp_ns, message: writer.write(connections[topic], stamp_ns, ros.ros1(message))


@contextmanager
def write_bag2(path: Path, channels: Mapping[str, OutputChannel]) -> Iterator[Put]:
    """Write the folder of a ROS 2 bag: sqlite3 storage and metadata.yaml. Raises OSError for errors of sqlite."""
    writer = Bag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    try:
        with writer:
            add = partial(writer.add_connection, typestore=ros.types_ros2())
            qos = {topic: parse_qos(qos_text(channel)) for topic, channel in channels.items()}
            connections = {topic: add(topic, c.type, offered_qos_profiles=qos[topic]) for topic, c in channels.items()}
            yield lambda topic, stamp_ns, message: writer.write(connections[topic], stamp_ns, ros.cdr(message))
    except sqlite3.Error as error:
        raise OSError(f"sqlite: {error}") from error


CONTAINERS: Final[dict[str, Callable[[Path, Mapping[str, OutputChannel]], AbstractContextManager[Put]]]] = {
    ".mcap": write_mcap,
    ".bag": write_bag1,
    "": write_bag2,
}
"""Suffix of a log's name -> its writer; a name without a suffix is the folder of a ROS 2 bag."""
