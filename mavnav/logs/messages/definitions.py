"""Names of message types, and the definitions (definitions.msg) of those that mavnav writes; ``ros`` has the others."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

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
