"""Write ``room.mcap``, the small log that ``make demo`` replays: the same bytes on every run.

A URG-04LX-like laser is walked through two furnished rooms (tests/synthetic.py): /scan with 0.5 % noise in whole
millimetres and 0.0 for no return, /odom that drifts, /tf_static with the laser 60 mm ahead of the base.

    python sample_logs/make_sample.py [FILE]
"""

from __future__ import annotations

import hashlib
import sys
from math import cos, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests"))

from synthetic import TOUR, URG_04LX, along, drifting_odometry, furnished_rooms, record  # noqa: E402

from mavnav.pose import Pose  # noqa: E402

if TYPE_CHECKING:
    from mavnav.scan import Scan

STORE = get_typestore(Stores.ROS2_HUMBLE)
BASE_T_LASER = Pose(0.06, 0.0, 0.0)
SEED = 4


def message(name: str, *fields: object) -> Any:  # noqa: ANN401  rosbags makes the classes at run time
    """Make a ROS 2 message of a type by its full name."""
    return STORE.types[name](*fields)


def header(stamp_ns: int, frame: str) -> Any:  # noqa: ANN401
    """Make a std_msgs/Header."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return message("std_msgs/msg/Header", message("builtin_interfaces/msg/Time", seconds, nanoseconds), frame)


def vector(x: float, y: float) -> Any:  # noqa: ANN401
    """Make a geometry_msgs/Vector3 in the plane."""
    return message("geometry_msgs/msg/Vector3", x, y, 0.0)


def quaternion(yaw_rad: float) -> Any:  # noqa: ANN401
    """Make a geometry_msgs/Quaternion about z."""
    return message("geometry_msgs/msg/Quaternion", 0.0, 0.0, sin(yaw_rad / 2), cos(yaw_rad / 2))


def laser_scan(scan: Scan) -> Any:  # noqa: ANN401
    """Make a sensor_msgs/LaserScan as the sensor would send it: whole millimetres, 0.0 for no return."""
    spec = scan.spec
    ranges = np.round(np.nan_to_num(scan.ranges_m, nan=0.0), 3).astype(np.float32)
    return message(
        "sensor_msgs/msg/LaserScan",
        header(scan.stamp_ns, "laser"),
        spec.angle_min_rad,
        spec.angle_min_rad + spec.field_of_view_rad,
        spec.angle_step_rad,
        spec.time_increment_s,
        spec.scan_time_s,
        spec.range_min_m,
        spec.range_max_m,
        ranges,
        np.zeros(0, np.float32),
    )


def odometry(stamp_ns: int, odom_T_base: Pose) -> Any:  # noqa: ANN401
    """Make a nav_msgs/Odometry without velocities."""
    point = message("geometry_msgs/msg/Point", odom_T_base.x_m, odom_T_base.y_m, 0.0)
    pose = message("geometry_msgs/msg/Pose", point, quaternion(odom_T_base.yaw_rad))
    twist = message("geometry_msgs/msg/Twist", vector(0.0, 0.0), vector(0.0, 0.0))
    return message(
        "nav_msgs/msg/Odometry",
        header(stamp_ns, "odom"),
        "base_link",
        message("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
        message("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
    )


def mounting(stamp_ns: int) -> Any:  # noqa: ANN401
    """Make the tf2_msgs/TFMessage that says where the laser sits on the base."""
    rotation = quaternion(BASE_T_LASER.yaw_rad)
    transform = message("geometry_msgs/msg/Transform", vector(BASE_T_LASER.x_m, BASE_T_LASER.y_m), rotation)
    stamped = message("geometry_msgs/msg/TransformStamped", header(stamp_ns, "base_link"), "laser", transform)
    return message("tf2_msgs/msg/TFMessage", [stamped])


def write_sample(path: Path) -> None:
    """Write the sample log."""
    world_T_base = along(TOUR, speed_m_s=0.8, turn_rad_s=1.4)
    scans = record(furnished_rooms(), world_T_base.compose(BASE_T_LASER), URG_04LX, noise=0.005, seed=SEED).scans
    wheels = drifting_odometry(world_T_base, seed=SEED)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=256 * 1024, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="mavnav sample_logs")
        channels = {
            topic: _channel(writer, topic, name)
            for topic, name in (
                ("/tf_static", "tf2_msgs/msg/TFMessage"),
                ("/odom", "nav_msgs/msg/Odometry"),
                ("/scan", "sensor_msgs/msg/LaserScan"),
            )
        }

        def add(topic: str, stamp_ns: int, content: Any) -> None:  # noqa: ANN401
            data = bytes(STORE.serialize_cdr(content, content.__msgtype__))
            writer.add_message(channels[topic], log_time=stamp_ns, publish_time=stamp_ns, data=data)

        add("/tf_static", scans[0].stamp_ns, mounting(scans[0].stamp_ns))
        for k, scan in enumerate(scans):
            add("/odom", scan.stamp_ns, odometry(scan.stamp_ns, wheels[k]))
            add("/scan", scan.stamp_ns, laser_scan(scan))
        writer.finish()


def _channel(writer: Writer, topic: str, name: str) -> int:
    definition, _ = STORE.generate_msgdef(name, ros_version=2)
    schema = writer.register_schema(name, "ros2msg", definition.encode())
    return int(writer.register_channel(topic, "cdr", schema))


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "room.mcap"
    write_sample(target)
    print(f"{hashlib.sha256(target.read_bytes()).hexdigest()}  {target}")
