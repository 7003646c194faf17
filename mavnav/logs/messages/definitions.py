"""Messages: the names of their types, the definitions of those that mavnav writes, and the records of decoded ones.

The definitions are in definitions.msg; ``ros`` has the others. The records do not depend on the encoding.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

TF: Final = "tf2_msgs/msg/TFMessage"
TF_ROS1: Final = "tf/msg/tfMessage"
SCAN: Final = "sensor_msgs/msg/LaserScan"
MULTI_ECHO: Final = "sensor_msgs/msg/MultiEchoLaserScan"
CLOUD: Final = "sensor_msgs/msg/PointCloud2"
POSE: Final = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE: Final = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM: Final = "geometry_msgs/msg/TransformStamped"
PATH: Final = "nav_msgs/msg/Path"
MARKERS: Final = "visualization_msgs/msg/MarkerArray"
MAP: Final = "nav_msgs/msg/OccupancyGrid"
IMU: Final = "sensor_msgs/msg/Imu"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
FOXGLOVE_SCAN: Final = "foxglove.LaserScan"

MD5: Final = {
    SCAN: "90c7ef2dc6895d81024acba2ac42f369",
    ODOMETRY: "cd5e73d190d741a2f92e81eda573aca7",
    TF: "94810edda583a504dfda3829e70d7eec",
    TF_ROS1: "94810edda583a504dfda3829e70d7eec",
    IMU: "6a62c6daae103f4ff57a132d6f95cec2",
    POSE: "d3812c3cbc69362b77dc0b19b345f8f5",
    TRANSFORM: "b5764a33bfeb3588febc2682852579b0",
}
"""Sums by which ROS 1 knows the definitions of types."""


@cache
def fields() -> dict[str, str]:
    """Return the types that mavnav writes, without ``msg`` -> their fields, a line each."""
    text = Path(__file__).with_name("definitions.msg").read_text("ascii")
    blocks = (block.partition("\n") for block in text.split("MSG: ")[1:])
    return {name: lines for name, _, lines in blocks}


def definition(msgtype: str) -> str:
    """Return the definition of a type of `fields` with the types that it contains (MCAP's ``ros2msg``)."""
    first, *others = _nested_types(msgtype.replace("/msg/", "/"))
    line = "=" * 80
    return fields()[first] + "".join(f"{line}\nMSG: {name}\n{fields()[name]}" for name in others)


def _nested_types(name: str) -> list[str]:
    """Return a type and, recursively, the types of its fields, each once, in depth-first order."""
    names = {name: None}
    for field in fields()[name].splitlines():
        kind = field.partition(" ")[0].partition("[")[0]
        names |= dict.fromkeys(_nested_types(kind)) if kind in fields() else {}
    return list(names)


class DecodeError(Exception):
    """The bytes of a message do not fit the type of its channel."""


class LaserMessage(NamedTuple):
    """A scan message before cleaning: lengths in m, angles in rad, ``ranges_m`` of any float type, shape (beams,).

    ``last_angle_rad`` is None if the message does not contain it. Range limits are NaN if there are none.
    """

    stamp_ns: int
    frame_id: str
    angle_min_rad: float
    angle_step_rad: float
    last_angle_rad: float | None
    range_min_m: float
    range_max_m: float
    time_increment_s: float
    scan_time_s: float
    ranges_m: NDArray[Any]
    has_limits: bool = True
    has_pose: bool = False


class ImuMessage(NamedTuple):
    """Measurements of an inertial sensor, in its own frame.

    Angular velocity in rad/s, acceleration in m/s2 (up at rest), and the orientation ``xyzw`` in a frame with z up,
    None if the message has no orientation.
    """

    stamp_ns: int
    xyzw: tuple[float, float, float, float] | None
    angular_velocity_rad_s: tuple[float, float, float]
    acceleration_m_s2: tuple[float, float, float]
    frame_id: str = ""


class Measurements(NamedTuple):
    """Measurements of an inertial sensor, in columns: those of `ImuMessage`, ``xyzw`` NaN where there is none.

    ``rows`` (n,) are the numbers of the messages among those read together, ``log_ns`` the times of recording.
    """

    rows: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    xyzw: NDArray[np.float64]
    angular_velocity_rad_s: NDArray[np.float64]
    acceleration_m_s2: NDArray[np.float64]
    frame_id: str


class Poses(NamedTuple):
    """Poses of frame ``child`` in frame ``parent``, in columns: ``xyz`` (3, n) in m, quaternions ``xyzw`` (4, n).

    ``rows`` (n,) are the numbers of the messages among those read together, ``log_ns`` the times of recording.
    """

    rows: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    parent: str
    child: str
    xyz: NDArray[np.float64]
    xyzw: NDArray[np.float64]

    def of_message(self, row: int) -> Poses:
        """Return the poses of one message."""
        own = self.rows == row
        xyz, xyzw = self.xyz[:, own], self.xyzw[:, own]
        return Poses(self.rows[own], self.stamps_ns[own], self.log_ns[own], self.parent, self.child, xyz, xyzw)


class TransformMessage(NamedTuple):
    """The pose of frame ``child`` in frame ``parent``: ``xyz`` in m, quaternion ``xyzw``."""

    stamp_ns: int
    parent: str
    child: str
    xyz: tuple[float, float, float]
    xyzw: tuple[float, float, float, float]
