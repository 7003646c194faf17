"""Recording of a drive - scans, odometry and ground truth - as a log in standard message types.

=================  ==========================  ====================================================================
topic              type                        what
=================  ==========================  ====================================================================
``/scan``          sensor_msgs/LaserScan       frame ``laser``; 0.0 where there is no return, as in a URG's scans
``/odom``          nav_msgs/Odometry           ``odom`` -> ``base_link``; velocities and covariances are unknown
``/ground_truth``  geometry_msgs/PoseStamped   the base in the frame ``world``
``/attitude``      geometry_msgs/PoseStamped   roll, pitch and height of the laser, x = y = 0; of aerial vehicles alone
``/tf``            tf2_msgs/TFMessage          ``odom`` -> ``base_link``, with every ``/odom``
``/tf_static``     tf2_msgs/TFMessage          ``base_link`` -> ``laser``, once, before everything else
=================  ==========================  ====================================================================

The ground truth is no Odometry message and not in ``/tf``, so that no reader mistakes it for odometry. The time of
recording is the stamp, not the clock, so that equal messages give equal bytes.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Final

from msgspec import Struct, field
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.rosbag2.metadata import parse_qos

from mavnav.atomic_files import check_name, is_stream, replacing
from mavnav.errors import OutputError, UsageError
from mavnav.logs.formats.rosbag2 import METADATA
from mavnav.logs.messages import cdr, definitions, ros
from mavnav.logs.writing.mcap_writer import OutputChannel, qos_text, write_serialized
from mavnav.pose import Pose, Trajectory
from mavnav.scan import Attitude, Scan

CHANNELS: Final = {
    "/tf_static": OutputChannel(definitions.TF, latched=True),
    "/tf": OutputChannel(definitions.TF),
    "/odom": OutputChannel(definitions.ODOMETRY),
    "/ground_truth": OutputChannel(definitions.POSE),
    "/scan": OutputChannel(definitions.SCAN),
}
ATTITUDE: Final = {"/attitude": OutputChannel(definitions.POSE)}
NO_RETURN_M: Final = 0.0
WORLD, ODOM, BASE, LASER = "world", "odom", "base_link", "laser"
Put = Callable[[str, int, bytes], None]
"""Writes a message in CDR: its topic, its stamp in ns, and its bytes."""


class Recording(Struct, frozen=True):
    """A drive to be recorded: scans, odometry and ground truth of the base, and the pose of the laser on the base.

    A missing trajectory is empty. ``attitudes`` are the measured attitudes of the laser with their stamps, ns. All
    stamps are of one clock.
    """

    scans: Sequence[Scan]
    odom_T_base: Trajectory
    world_T_base: Trajectory
    base_T_laser: Pose = field(default_factory=Pose)
    attitudes: Sequence[tuple[int, Attitude]] = ()


def record(recording: Recording, path: Path, *, force: bool = False) -> None:
    """Write a recording in the order of time, at equal stamps the scan last; the log appears complete or not at all.

    The suffix decides the format: ``.mcap``, ``.bag`` (ROS 1), or a folder (ROS 2 bag). Equal calls write equal bytes.
    A recording with attitudes has a topic for them.

    Raises
    ------
    UsageError
        The suffix is another one.
    OutputError
        The target exists and ``force`` is false, is no log of this kind, or cannot be written.
    """
    check_recording(path, force=force)
    channels = CHANNELS | (ATTITUDE if recording.attitudes else {})
    with (
        replacing(path, force=force, another="another name for the recording", room="another place") as unfinished,
        CONTAINERS[path.suffix](unfinished, channels) as put,
    ):
        for stamp_ns, topic, message in _messages(recording):
            put(topic, stamp_ns, message)


def _messages(r: Recording) -> Iterator[tuple[int, str, bytes]]:
    """Yield stamps, topics and messages in the order of time; before the first, at its stamp, the laser's mounting."""
    pose, attitude, scan = cdr.poses(WORLD), cdr.attitudes(WORLD), cdr.scans(LASER, NO_RETURN_M)
    builders = (("/tf", cdr.transforms(ODOM, BASE)), ("/odom", cdr.odometry(ODOM, BASE)))
    truth = ((stamp, "/ground_truth", pose(stamp, place)) for stamp, place in _poses(r.world_T_base))
    odometry = (
        (stamp, topic, build(stamp, place)) for stamp, place in _poses(r.odom_T_base) for topic, build in builders
    )
    attitudes = ((stamp, "/attitude", attitude(stamp, tilt)) for stamp, tilt in r.attitudes)
    scans = ((each.stamp_ns, "/scan", scan(each)) for each in r.scans)
    for number, message in enumerate(merge(truth, odometry, attitudes, scans, key=itemgetter(0))):
        if number == 0:
            yield message[0], "/tf_static", cdr.transforms(BASE, LASER)(message[0], r.base_T_laser)
        yield message


def _poses(trajectory: Trajectory) -> Iterator[tuple[int, Pose]]:
    for k, stamp_ns in enumerate(trajectory.stamps_ns.tolist()):
        yield stamp_ns, trajectory[k]


def check_recording(path: Path, *, force: bool) -> None:
    """Raise the errors of ``record`` for this path before any work is done."""
    if path.suffix not in CONTAINERS:
        advice = "end it in .mcap or .bag (ROS 1), or leave the ending out for the folder of a ROS 2 bag"
        raise UsageError(f"{path}: no format of this name can be recorded; {advice}")
    check_name(path)
    if path.suffix and is_stream(path):
        return
    if path.is_dir():
        if path.suffix or (any(path.iterdir()) and not (path / METADATA).is_file()):
            raise OutputError(f"{path} is a folder, but no ROS 2 bag; choose another name for the recording")
    elif path.exists() and (not path.suffix or not path.is_file()):
        raise OutputError(f"{path} is in the way; choose another name for the recording")
    if path.exists() and not force:
        raise OutputError(f"{path} exists; choose another name for the recording, or --force to replace it")


@contextmanager
def write_bag1(path: Path, channels: Mapping[str, OutputChannel]) -> Iterator[Put]:
    """Write a ROS 1 bag, chunks compressed with bz2, whose output does not depend on the version of the library."""
    writer = Bag1Writer(path)
    writer.set_compression(Bag1Writer.CompressionFormat.BZ2)
    with writer:
        add = partial(writer.add_connection, typestore=ros.types_ros1(), callerid="/mavnav")
        connections = {topic: add(topic, c.type, latching=int(c.latched)) for topic, c in channels.items()}
        to_ros1 = ros.types_ros2().cdr_to_ros1
        yield lambda topic, stamp_ns, message: writer.write(
            connections[topic], stamp_ns, to_ros1(message, channels[topic].type)
        )


@contextmanager
def write_bag2(path: Path, channels: Mapping[str, OutputChannel]) -> Iterator[Put]:
    """Write the folder of a ROS 2 bag: sqlite3 storage and metadata.yaml. Raises OSError for errors of sqlite."""
    writer = Bag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    try:
        with writer:
            add = partial(writer.add_connection, typestore=ros.types_ros2())
            qos = {topic: parse_qos(qos_text(channel)) for topic, channel in channels.items()}
            connections = {topic: add(topic, c.type, offered_qos_profiles=qos[topic]) for topic, c in channels.items()}
            yield lambda topic, stamp_ns, message: writer.write(connections[topic], stamp_ns, message)
    except sqlite3.Error as error:
        raise OSError(f"sqlite: {error}") from error


CONTAINERS: Final[dict[str, Callable[[Path, Mapping[str, OutputChannel]], AbstractContextManager[Put]]]] = {
    ".mcap": write_serialized,
    ".bag": write_bag1,
    "": write_bag2,
}
"""Suffix of a log's name -> its writer; a name without a suffix is the folder of a ROS 2 bag."""
