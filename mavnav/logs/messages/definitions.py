"""Names of message types, and the standard definitions of those that mavnav writes; ``ros`` has the others."""

from __future__ import annotations

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

_XYZ: Final = ("float64 x", "float64 y", "float64 z")
_LASER: Final = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")
_MARKERS: Final = (
    "ARROW", "CUBE", "SPHERE", "CYLINDER", "LINE_STRIP", "LINE_LIST", "CUBE_LIST", "SPHERE_LIST", "POINTS",
    "TEXT_VIEW_FACING", "MESH_RESOURCE", "TRIANGLE_LIST", "ARROW_STRIP",
)  # fmt: skip
FIELDS: Final[dict[str, tuple[str, ...]]] = {
    "builtin_interfaces/Time": ("int32 sec", "uint32 nanosec"),
    "builtin_interfaces/Duration": ("int32 sec", "uint32 nanosec"),
    "std_msgs/ColorRGBA": ("float32 r", "float32 g", "float32 b", "float32 a"),
    "std_msgs/Header": ("builtin_interfaces/Time stamp", "string frame_id"),
    "geometry_msgs/Point": _XYZ,
    "geometry_msgs/Vector3": _XYZ,
    "geometry_msgs/Quaternion": (*_XYZ, "float64 w"),
    "geometry_msgs/Pose": ("geometry_msgs/Point position", "geometry_msgs/Quaternion orientation"),
    "geometry_msgs/PoseStamped": ("std_msgs/Header header", "geometry_msgs/Pose pose"),
    "geometry_msgs/PoseWithCovariance": ("geometry_msgs/Pose pose", "float64[36] covariance"),
    "geometry_msgs/Transform": ("geometry_msgs/Vector3 translation", "geometry_msgs/Quaternion rotation"),
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header", "string child_frame_id", "geometry_msgs/Transform transform",
    ),
    "geometry_msgs/Twist": ("geometry_msgs/Vector3 linear", "geometry_msgs/Vector3 angular"),
    "geometry_msgs/TwistWithCovariance": ("geometry_msgs/Twist twist", "float64[36] covariance"),
    "nav_msgs/MapMetaData": (
        "builtin_interfaces/Time map_load_time", "float32 resolution", "uint32 width", "uint32 height",
        "geometry_msgs/Pose origin",
    ),
    "nav_msgs/OccupancyGrid": ("std_msgs/Header header", "nav_msgs/MapMetaData info", "int8[] data"),
    "nav_msgs/Odometry": (
        "std_msgs/Header header", "string child_frame_id", "geometry_msgs/PoseWithCovariance pose",
        "geometry_msgs/TwistWithCovariance twist",
    ),
    "nav_msgs/Path": ("std_msgs/Header header", "geometry_msgs/PoseStamped[] poses"),
    "sensor_msgs/CompressedImage": ("std_msgs/Header header", "string format", "uint8[] data"),
    "sensor_msgs/LaserScan": (
        "std_msgs/Header header", *(f"float32 {name}" for name in _LASER), "float32[] ranges", "float32[] intensities",
    ),
    "tf2_msgs/TFMessage": ("geometry_msgs/TransformStamped[] transforms",),
    "visualization_msgs/UVCoordinate": ("float32 u", "float32 v"),
    "visualization_msgs/MeshFile": ("string filename", "uint8[] data"),
    "visualization_msgs/Marker": (
        *(f"int32 {name}={number}" for number, name in enumerate(_MARKERS)),
        "int32 ADD=0", "int32 MODIFY=0", "int32 DELETE=2", "int32 DELETEALL=3",
        "std_msgs/Header header", "string ns", "int32 id", "int32 type", "int32 action", "geometry_msgs/Pose pose",
        "geometry_msgs/Vector3 scale", "std_msgs/ColorRGBA color", "builtin_interfaces/Duration lifetime",
        "bool frame_locked", "geometry_msgs/Point[] points", "std_msgs/ColorRGBA[] colors", "string texture_resource",
        "sensor_msgs/CompressedImage texture", "visualization_msgs/UVCoordinate[] uv_coordinates", "string text",
        "string mesh_resource", "visualization_msgs/MeshFile mesh_file", "bool mesh_use_embedded_materials",
    ),
    "visualization_msgs/MarkerArray": ("visualization_msgs/Marker[] markers",),
}  # fmt: skip
"""Name of a type without ``msg`` -> its fields."""


def definition(msgtype: str) -> str:
    """Return the definition of a type of ``FIELDS`` with the types that it contains (MCAP's ``ros2msg``)."""
    first, *others = _nested_types(msgtype.replace("/msg/", "/"))
    line = "=" * 80
    return _text(first) + "".join(f"{line}\nMSG: {name}\n{_text(name)}" for name in others)


def _text(name: str) -> str:
    return "\n".join(FIELDS[name]) + "\n"


def _nested_types(name: str) -> list[str]:
    """Return a type and, recursively, the types of its fields, each once, in depth-first order."""
    names = {name: None}
    for field in FIELDS[name]:
        kind = field.partition(" ")[0].partition("[")[0]
        names |= dict.fromkeys(_nested_types(kind)) if kind in FIELDS else {}
    return list(names)
